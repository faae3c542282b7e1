"""The Pioneer 3-DX in MultibodyPlant with its driver, against answers known on paper."""

import math

import numpy as np
import pytest
from naraha.models.pioneer.urdf import PioneerShape, pioneer_urdf
from naraha.systems.drive import DifferentialDriver
from pydrake.math import RigidTransform

from tests.drive.rig import RIDE_HEIGHTS, Rig, slope

G = 9.81
SHAPE = PioneerShape()
HEIGHT = RIDE_HEIGHTS["pioneer"]


def on_slope(angle, *, heading=0.0, **options):
    boxes, X_WB = slope(angle, height=HEIGHT, heading=heading)
    return Rig(model="pioneer", boxes=boxes, X_WB=X_WB, **{"ground_friction": 0.9, **options})


def at_step(height, *, speed=0.1):
    """Drives against a step of the given height, 1 m ahead, for long enough to be on it."""
    boxes = [((0, 0, -0.5), (30, 30, 1)), ((4.0, 0, height / 2), (6, 4, height))]
    rig = Rig(model="pioneer", boxes=boxes, ground_friction=0.9)
    rig.command(speed, speed)
    rig.run(1.4 / speed)
    return rig


def pair_friction(own, ground):
    return 2 * own * ground / (own + ground)


def slip_angle(ground, shape=SHAPE):
    """Steepest slope uphill of the docstring of `naraha.models.pioneer.urdf` [rad]."""
    rig = Rig(model="pioneer")
    centre = rig.plant.CalcCenterOfMassPositionInWorld(rig.plant_context) - rig.p_WB
    d, h = shape.caster_distance, centre[2] + HEIGHT
    s = (d + centre[0]) / d
    mu, c = (pair_friction(own, ground) for own in (shape.tyre_friction, shape.caster_friction))
    return math.atan((s * mu - (1 - s) * c) / (1 + h / d * (mu + c)))


def climbing_speed(rig, command=0.3):
    rig.command(command, command)
    rig.run(1.0)
    start = rig.p_WB
    rig.run(2.0)
    return (rig.p_WB - start) @ rig.X_WB.rotation().matrix()[:, 0] / 2.0


@pytest.mark.parametrize("speed", [0.1, 0.5, 1.0, -0.4])
def test_it_drives_straight_at_the_commanded_speed(speed):
    rig = Rig(model="pioneer")
    rig.command(speed, speed)
    rig.run(2.0)
    start = rig.p_WB
    rig.run(2.0)
    np.testing.assert_allclose((rig.p_WB - start) / 2.0, [speed, 0, 0], atol=1e-3)
    assert rig.rpy[2] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("yaw_rate", [0.3, -1.0, 2.0])
def test_it_turns_on_the_spot_at_the_commanded_rate_about_the_middle_of_the_axle(yaw_rate):
    rig = Rig(model="pioneer", driver=DifferentialDriver())
    rig.command(0.0, yaw_rate)
    rig.run(1.0)
    assert rig.V_WB.rotational()[2] == pytest.approx(yaw_rate, rel=0.01)
    np.testing.assert_allclose(rig.p_WB[:2], 0, atol=2e-3)


def test_an_arc_has_the_radius_of_its_twist():
    rig = Rig(model="pioneer", driver=DifferentialDriver())
    rig.command(0.4, 0.8)
    rig.run(1.0)
    p, heading = rig.p_WB[:2], rig.rpy[2]
    centre = p + 0.5 * np.array([-math.sin(heading), math.cos(heading)])
    rig.run(2.0)
    assert np.linalg.norm(rig.p_WB[:2] - centre) == pytest.approx(0.5, rel=0.01)


def test_wheels_and_caster_carry_what_the_lever_arms_say():
    rig = Rig(model="pioneer")
    rig.run(1.0)
    _, loads, links = rig.contacts()
    weight = G * rig.plant.CalcTotalMass(rig.plant_context)
    centre = rig.plant.CalcCenterOfMassPositionInWorld(rig.plant_context)[0] - rig.p_WB[0]
    caster = sum(load for load, link in zip(loads, links, strict=True) if link == "base")
    assert sum(loads) == pytest.approx(weight, rel=1e-3)
    assert caster == pytest.approx(weight * -centre / SHAPE.caster_distance, rel=0.01)


def test_it_climbs_the_13_degrees_of_its_specification_and_slips_where_the_paper_answer_says():
    limit = slip_angle(0.9)
    assert limit == pytest.approx(math.radians(14), abs=math.radians(0.3))
    assert climbing_speed(on_slope(math.radians(13))) > 0.25
    assert climbing_speed(on_slope(limit - math.radians(1.5))) == pytest.approx(0.3, rel=0.02)
    assert climbing_speed(on_slope(limit + math.radians(0.5))) < 0.02


def test_less_friction_lowers_the_limit_as_on_paper():
    limit = slip_angle(0.4)
    assert limit < slip_angle(0.9) - math.radians(3)
    assert climbing_speed(on_slope(limit - math.radians(1.5), ground_friction=0.4)) == pytest.approx(0.3, rel=0.03)
    assert climbing_speed(on_slope(limit + math.radians(0.5), ground_friction=0.4)) < 0.02


def weak(torque):
    """A Pioneer whose tyres hold and whose motors do not."""
    return pioneer_urdf(PioneerShape(wheel_effort=torque, tyre_friction=3.0, base_mass_x=-0.05))


@pytest.mark.parametrize("degrees", [5.0, 10.0])
def test_a_motor_climbs_what_its_torque_lifts(degrees):
    """Two motors of torque T drive up a slope as long as 2 T > m g r sin α, plus the drag of the caster."""
    angle = math.radians(degrees)
    rig = Rig(model="pioneer")
    mass = rig.plant.CalcTotalMass(rig.plant_context)
    torque = mass * G * SHAPE.wheel_radius * math.sin(angle) / 2
    assert climbing_speed(on_slope(angle, urdf=weak(1.4 * torque))) == pytest.approx(0.3, rel=0.02)
    assert climbing_speed(on_slope(angle, urdf=weak(0.95 * torque))) < 0.0


def test_a_motor_that_was_held_back_does_not_catch_up():
    boxes = [((0, 0, -0.5), (30, 30, 1)), ((1.0, 0, 0.5), (1.0, 4, 1.0))]
    rig = Rig(model="pioneer", urdf=pioneer_urdf(PioneerShape(tyre_friction=3.0)), boxes=boxes)
    rig.command(0.3, 0.3)
    rig.run(4.0)  # against the wall since 1 s
    held = rig.p_WB[0]
    rig.command(-0.3, -0.3)
    rig.run(1.5)
    assert held - rig.p_WB[0] > 0.3


def test_it_holds_on_a_slope_at_rest():
    rig = on_slope(math.radians(10))
    rig.run(0.5)
    start = rig.p_WB
    rig.run(3.0)
    assert np.linalg.norm(rig.p_WB - start) < 2e-3


@pytest.mark.parametrize("share", [0.9, 1.1])
@pytest.mark.parametrize("downhill", [True, False])
def test_it_tips_over_at_the_angle_of_its_geometry(share, downhill):
    """With friction that holds: over the axle facing downhill, over the caster facing uphill."""
    urdf = pioneer_urdf(PioneerShape(tyre_friction=9.0, caster_friction=9.0, wheel_effort=30.0, base_mass_height=0.25))
    rig = Rig(model="pioneer", urdf=urdf)
    centre = rig.plant.CalcCenterOfMassPositionInWorld(rig.plant_context) - rig.p_WB
    arm = -centre[0] if downhill else SHAPE.caster_distance + centre[0]
    limit = math.atan(arm / (centre[2] + HEIGHT))
    rig = on_slope(share * limit, urdf=urdf, heading=math.pi if downhill else 0.0, ground_friction=9.0)
    rig.run(2.0)
    leaned = rig.rpy[1] - (share * limit if downhill else -share * limit)
    assert (abs(leaned) > 0.2) == (share > 1)


def test_steps_end_where_friction_holds_the_wheels_on_the_edge():
    """On paper r (1 − cos(atan μ)) at walking pace, 15 mm here; 10 cm are out of question at any speed."""
    limit = SHAPE.wheel_radius * (1 - math.cos(math.atan(pair_friction(SHAPE.tyre_friction, 0.9))))
    assert limit == pytest.approx(0.0148, abs=2e-4)
    low, high = at_step(0.8 * limit), at_step(1.6 * limit)
    assert low.p_WB[2] == pytest.approx(HEIGHT + 0.8 * limit, abs=1e-3)
    assert high.p_WB[2] == pytest.approx(HEIGHT, abs=1e-3)
    for speed in (0.3, 0.8):
        assert at_step(0.1, speed=speed).p_WB[0] < 1.0


def test_encoders_say_how_far_it_drove():
    rig = Rig(model="pioneer")
    rig.command(0.5, 0.5)
    rig.run(3.0)
    rig.command(0.0, 0.0)
    rig.run(1.0)
    np.testing.assert_allclose(rig.output("track_displacements"), rig.p_WB[0], rtol=2e-3)
    np.testing.assert_allclose(rig.output("track_speeds"), 0, atol=1e-3)


def test_a_command_that_is_not_finite_stops_it():
    rig = Rig(model="pioneer")
    rig.command(0.5, 0.5)
    rig.run(1.0)
    rig.command(np.nan, 0.5)
    rig.run(1.5)
    assert np.linalg.norm(rig.V_WB.translational()) < 1e-3


def test_two_runs_are_equal():
    ends = []
    for _ in range(2):
        rig = Rig(model="pioneer", driver=DifferentialDriver(), X_WB=RigidTransform([0, 0, HEIGHT]))
        rig.command(0.5, 0.7)
        rig.run(1.0)
        ends.append(rig.X_WB.GetAsMatrix4())
    np.testing.assert_array_equal(*ends)
