"""The crawler in MultibodyPlant with its real driver, against answers known on paper."""

import math

import numpy as np
import pytest
from naraha.models.crawler.urdf import CRAWLERS, CrawlerShape, crawler_urdf
from naraha.systems.drive import CrawlerDriver, effective_gauge, quasi_static_twist, turn_rate
from pydrake.math import RigidTransform

from tests.drive.rig import FLOOR, RIDE_HEIGHT, Rig, slope, stairs

G = 9.81
both_belts = pytest.mark.parametrize("model", list(CRAWLERS))


def pair_friction(ground):
    """Drake's combination of the belt's friction and the ground's."""
    belt = CRAWLERS["crawler"].belt_friction
    return 2 * belt * ground / (belt + ground)


def track_gauge(model):
    shape = CRAWLERS[model]
    return 2 * shape.belt_outer_edge - shape.belt_width


@both_belts
def test_it_drives_straight_at_the_commanded_speed(model):
    rig = Rig(model=model)
    rig.command(0.25, 0.25)
    rig.run(1.0)
    start = rig.p_WB
    rig.run(4.0)
    np.testing.assert_allclose((rig.p_WB - start) / 4.0, [0.25, 0, 0], atol=1e-4)
    np.testing.assert_allclose(rig.rpy, 0, atol=1e-4)


def test_it_starts_with_the_acceleration_and_stops_at_the_speed_of_its_limits():
    rig = Rig(driver=CrawlerDriver(command="track_speeds", max_speed=0.2, max_acceleration=0.4))
    rig.command(5.0, 5.0)
    rig.run(3.0)
    # Uniform acceleration to v takes v/a and lags v²/2a; each step of the 20 ms staircase comes up to one period early.
    lag = 0.2**2 / (2 * 0.4)
    assert rig.p_WB[0] == pytest.approx(0.2 * 3.0 - lag, abs=0.2 * 0.02)
    assert rig.V_WB.translational()[0] == pytest.approx(0.2, rel=1e-4)


def test_belts_at_rest_are_a_brake_below_the_friction_angle():
    boxes, X_WB = slope(0.97 * math.atan(pair_friction(0.5)))
    rig = Rig(boxes=boxes, X_WB=X_WB, ground_friction=0.5)
    rig.run(0.5)
    start = rig.p_WB
    rig.run(2.0)
    assert np.linalg.norm(rig.p_WB - start) < 2e-3


def test_it_climbs_at_full_speed_below_the_friction_angle():
    angle = 0.95 * math.atan(pair_friction(0.5))
    boxes, X_WB = slope(angle)
    rig = Rig(boxes=boxes, X_WB=X_WB, ground_friction=0.5)
    rig.command(0.2, 0.2)
    rig.run(1.0)
    start = rig.p_WB
    rig.run(2.0)
    uphill = np.array([math.cos(angle), 0, math.sin(angle)])
    assert (rig.p_WB - start) @ uphill / 2.0 == pytest.approx(0.2, rel=0.02)


def test_it_slides_down_above_the_friction_angle_as_a_block_does():
    friction = pair_friction(0.5)
    angle = 1.1 * math.atan(friction)
    boxes, X_WB = slope(angle)
    rig = Rig(boxes=boxes, X_WB=X_WB, ground_friction=0.5)
    rig.command(0.3, 0.3)
    rig.run(0.2)
    start = rig.V_WB.translational()
    rig.run(1.0)
    acceleration = -(rig.V_WB.translational() - start) @ [math.cos(angle), 0, math.sin(angle)]
    assert acceleration == pytest.approx(G * (math.sin(angle) - friction * math.cos(angle)), rel=0.02)


@pytest.mark.parametrize(("ground_friction", "climbs"), [(1.0, True), (0.8, False)])
def test_it_climbs_the_45_degrees_of_its_specification_where_friction_holds(ground_friction, climbs):
    assert (pair_friction(ground_friction) > math.tan(math.radians(45))) == climbs
    boxes, X_WB = slope(math.radians(45))
    rig = Rig(boxes=boxes, X_WB=X_WB, ground_friction=ground_friction)
    rig.command(0.1, 0.1)
    rig.run(1.0)
    start = rig.p_WB
    rig.run(2.0)
    speed = (rig.p_WB - start) @ [math.sqrt(0.5), 0, math.sqrt(0.5)] / 2.0
    assert speed == pytest.approx(0.1, rel=0.01) if climbs else speed < -0.5


def yaw_rate_on_the_spot(model, track_speed, time_step=0.004):
    rig = Rig(model=model, time_step=time_step)
    rig.command(-track_speed, track_speed)
    rig.run(1.0)
    start = rig.rpy[2]
    rig.run(1.0)
    return rig.rpy[2] - start, rig


@both_belts
def test_it_turns_on_the_spot_as_the_closed_form_for_uniform_load_says(model):
    yaw_rate, _ = yaw_rate_on_the_spot(model, 0.2)
    expected = turn_rate(0.2, CRAWLERS[model].track_length, track_gauge(model))
    # The closed form has belts without width; the 80 mm belt scrubs at both its edges and turns 1.2 % slower.
    assert yaw_rate == pytest.approx(expected, rel=0.015)


@both_belts
def test_it_turns_on_the_spot_as_its_contact_points_and_loads_say(model):
    yaw_rate, rig = yaw_rate_on_the_spot(model, 0.2)
    points, loads, links = rig.contacts()
    assert loads.sum() == pytest.approx(G * rig.plant.CalcTotalMass(rig.plant_context), rel=1e-3)
    speeds = [0.2 if "right" in link else -0.2 for link in links]
    v_x, v_y, expected = quasi_static_twist(points[:, :2], loads, speeds)
    assert yaw_rate == pytest.approx(expected, rel=0.003)
    assert abs(v_x) < 1e-3
    assert abs(v_y) < 1e-3


def test_turning_does_not_depend_on_the_time_step():
    rates = [yaw_rate_on_the_spot("crawler", 0.2, time_step)[0] for time_step in (0.001, 0.002, 0.004, 0.008)]
    assert max(rates) / min(rates) < 1.005


def test_more_footing_turns_alike():
    rates = []
    for footing_count in (9, 17):
        rig = Rig(urdf=crawler_urdf(CrawlerShape(footing_count=footing_count)))
        rig.command(-0.2, 0.2)
        rig.run(1.0)
        rates.append(rig.V_WB.rotational()[2])
    assert rates[0] == pytest.approx(rates[1], rel=0.005)


def test_friction_does_not_change_how_it_turns():
    rates = []
    for ground_friction in (0.4, 1.0):
        rig = Rig(ground_friction=ground_friction)
        rig.command(-0.2, 0.2)
        rig.run(1.0)
        rates.append(rig.V_WB.rotational()[2])
    assert rates[0] == pytest.approx(rates[1], rel=0.01)


@pytest.mark.parametrize("twist", [(0.0, 0.4), (0.2, 0.3), (0.2, -0.2), (-0.15, 0.3)])
def test_a_twist_command_is_the_twist_that_it_drives(twist):
    rig = Rig(driver=CrawlerDriver(command="twist"))
    rig.command(*twist)
    rig.run(2.0)
    V_WB = rig.V_WB
    p = V_WB.translational()
    assert V_WB.rotational()[2] == pytest.approx(twist[1], rel=0.02)
    assert math.hypot(p[0], p[1]) == pytest.approx(abs(twist[0]), abs=0.005)


def test_the_default_gauge_is_the_effective_gauge_of_both_robots():
    for model, shape in CRAWLERS.items():
        assert CrawlerDriver().gauge == pytest.approx(effective_gauge(shape.track_length, track_gauge(model)), rel=0.01)


def test_encoders_see_the_belt_and_not_the_slip():
    boxes, X_WB = slope(1.1 * math.atan(pair_friction(0.5)))
    rig = Rig(boxes=boxes, X_WB=X_WB, ground_friction=0.5)
    rig.command(0.2, 0.1)
    rig.run(2.0)
    assert rig.p_WB[0] < 0
    np.testing.assert_allclose(rig.output("track_speeds"), [0.2, 0.1], atol=0.0061)
    displacements = rig.output("track_displacements")
    assert displacements[0] == pytest.approx(0.2 * 2.0 - 0.2**2 / (2 * 0.5), abs=0.01)
    assert displacements[1] == pytest.approx(displacements[0] / 2, abs=2e-4)


def test_flippers_pressed_down_lift_the_robot_on_their_tips():
    angle = -0.6
    rig = Rig(driver=CrawlerDriver(flipper_presets=presets(stand=[angle] * 4)), preset="stand")
    rig.run(3.0)
    shape = CRAWLERS["crawler"]
    np.testing.assert_allclose(rig.output("flipper_angles"), angle, atol=0.07)
    height = -shape.flipper_length * math.sin(rig.output("flipper_angles").mean()) + shape.flipper_tip_radius
    assert rig.p_WB[2] == pytest.approx(height, abs=1e-3)
    assert set(rig.contacts()[2]) == {
        f"{end}_{side}_flipper" for end in ("front", "rear") for side in ("left", "right")
    }


def test_flippers_hold_the_robot_with_the_torque_that_statics_asks_for():
    """Without friction a quarter of the weight acts straight up on the tip of each flipper."""
    rig = Rig(driver=CrawlerDriver(flipper_presets=presets(stand=[-0.6] * 4)), preset="stand", ground_friction=0.0)
    rig.run(3.0)
    shape = CRAWLERS["crawler"]
    angles = rig.output("flipper_angles")
    load = G * rig.plant.CalcTotalMass(rig.plant_context) / 4
    centre = (shape.flipper_length + shape.flipper_tip_radius - shape.flipper_root_radius) / 2
    expected = (load * shape.flipper_length - G * shape.flipper_mass * centre) * np.cos(angles)
    np.testing.assert_allclose(shape.flipper_p * (angles + 0.6), expected, rtol=0.005)


def presets(**more):
    return CrawlerDriver().flipper_presets | more


def test_a_wide_belt_stands_on_a_rail_that_a_narrow_belt_sinks_beside():
    """A plate of 0.21 m width under the robot: the inner edges of the 80 mm belts (0.08 m) are on it."""
    heights = {}
    for model in CRAWLERS:
        rig = Rig(model=model, boxes=[(RigidTransform([0, 0, -0.5]), (30, 0.21, 1))])
        rig.run(1.0)
        heights[model] = rig.p_WB[2]
        np.testing.assert_allclose(rig.rpy, 0, atol=0.01)
    assert heights["crawler"] == pytest.approx(RIDE_HEIGHT, abs=2e-4)
    assert heights["crawler_narrow_belt"] < RIDE_HEIGHT - 0.005


@pytest.mark.parametrize("ground_friction", [0.38, 0.46])
def test_flat_flippers_climb_a_wall_only_where_friction_lifts_the_nose(ground_friction):
    """The belts push with N_f = μ N_r against the wall and rub up it with μ N_f, while W = N_r + μ N_f.

    About the rear end of the tracks, N_f (at axle height R) and μ N_f must lift the weight in the middle:
    N_f (R + μ (L/2 + nose)) > W L/2, with N_f = μ W/(1 + μ²).
    """
    shape = CRAWLERS["crawler"]
    mu, half = pair_friction(ground_friction), shape.track_length / 2
    nose = half + shape.flipper_length + shape.flipper_tip_radius
    lift = mu / (1 + mu**2) * (shape.track_radius + mu * (half + nose)) / half
    rig = Rig(boxes=[*FLOOR, ((1.0, 0.0, 0.2), (0.8, 4.0, 0.4))], ground_friction=ground_friction, preset="flat")
    rig.command(0.2, 0.2)
    rig.run(4.0)
    assert (lift > 1) == (ground_friction > 0.42)
    assert (-rig.rpy[1] > 0.1) == (lift > 1)


class TestStairs:
    """Six steps of 0.18 m rise and 0.26 m run (35°), a landing, and six steps down."""

    rise, tread, steps, landing, first_edge = 0.18, 0.26, 6, 1.6, 0.8

    def rig(self, **options):
        boxes, self.far = stairs(
            first_edge=self.first_edge, rise=self.rise, run=self.tread, steps=self.steps, landing=self.landing
        )
        self.top = self.rise * self.steps + RIDE_HEIGHT
        self.crest = self.first_edge + self.tread * (self.steps - 1)
        return Rig(boxes=boxes, **options)

    def drive(self, rig, speed, reached, time_limit=40.0):
        """Drives until `reached`; returns the presets that were active and the largest tilts [rad]."""
        rig.command(speed, speed)
        active, roll, pitch = [rig.output("active_preset")], 0.0, 0.0
        stop = rig.context.get_time() + time_limit
        while not reached(rig.p_WB[0]):
            assert rig.context.get_time() < stop, f"stuck at {rig.p_WB}, rpy {rig.rpy}"
            rig.run(0.1)
            roll, pitch = max(roll, abs(rig.rpy[0])), max(pitch, abs(rig.rpy[1]))
            if rig.output("active_preset") != active[-1]:
                active.append(rig.output("active_preset"))
        return active, roll, pitch

    @both_belts
    def test_up_with_the_climb_preset_and_down_the_far_side_by_the_rule(self, model):
        rig = self.rig(model=model, preset="climb")
        rig.run(0.8)
        _, roll, pitch = self.drive(rig, 0.3, lambda x: x > self.first_edge + 0.2)
        rig.preset("auto")
        active, roll_up, pitch_up = self.drive(rig, 0.3, lambda x: x > self.crest + 0.7)
        assert rig.p_WB[2] == pytest.approx(self.top, abs=2e-3)
        assert active == ["climb", "flat"]
        active, roll_down, pitch_down = self.drive(rig, 0.3, lambda x: x > self.far + 0.7)
        rig.command(0.0, 0.0)
        rig.run(1.0)
        assert rig.p_WB[2] == pytest.approx(RIDE_HEIGHT, abs=2e-3)
        assert active == ["flat", "descend", "flat"]
        assert max(roll, roll_up, roll_down) < math.radians(3)
        assert max(pitch, pitch_up, pitch_down) < math.radians(42)
        assert abs(rig.p_WB[1]) < 0.1

    @both_belts
    def test_up_and_backwards_down_again(self, model):
        rig = self.rig(model=model, preset="climb")
        rig.run(0.8)
        _, roll_up, pitch_up = self.drive(rig, 0.2, lambda x: x > self.crest + 0.7)
        assert rig.p_WB[2] == pytest.approx(self.top, abs=2e-3)
        rig.preset("descend")
        _, roll_down, pitch_down = self.drive(rig, -0.2, lambda x: x < 0.1)
        assert rig.p_WB[2] == pytest.approx(RIDE_HEIGHT, abs=2e-3)
        assert max(roll_up, roll_down) < math.radians(3)
        assert max(pitch_up, pitch_down) < math.radians(42)
