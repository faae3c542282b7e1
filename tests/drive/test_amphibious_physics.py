"""The amphibious robot in MultibodyPlant with its driver, against answers known on paper."""

import math

import numpy as np
import pytest
from naraha.models.amphibious.urdf import AmphibiousShape
from naraha.systems.drive import TrackedDriver, quasi_static_twist
from pydrake.math import RollPitchYaw

from tests.drive.rig import RIDE_HEIGHTS, Rig, slope

SHAPE = AmphibiousShape()
HEIGHT = RIDE_HEIGHTS["amphibious"]
FRICTION = 2 * SHAPE.belt_friction * 0.9 / (SHAPE.belt_friction + 0.9)


def climbing_speed(angle, *, heading=0.0, command=0.3):
    boxes, X_WB = slope(angle, height=HEIGHT, heading=heading)
    rig = Rig(model="amphibious", boxes=boxes, X_WB=X_WB, ground_friction=0.9)
    rig.command(command, command)
    rig.run(1.0)
    start = rig.p_WB
    rig.run(2.0)
    return (rig.p_WB - start) @ rig.X_WB.rotation().matrix()[:, 0] / 2.0


def at_step(height, *, speed=0.3, down=False):
    """Drives against a step up 1 m ahead, or from a platform of that height 0.5 m ahead; returns the rig at the end."""
    floor = ((0, 0, -0.5 - (height if down else 0)), (30, 30, 1))
    step = ((-2.5, 0, -height / 2), (6, 4, height)) if down else ((4.0, 0, height / 2), (6, 4, height))
    rig = Rig(model="amphibious", boxes=[floor, step], ground_friction=0.9)
    rig.command(speed, speed)
    rig.run(1.8 / speed)
    return rig


def centre_of_mass():
    rig = Rig(model="amphibious")
    return rig.plant.CalcCenterOfMassPositionInWorld(rig.plant_context) - rig.p_WB + [0, 0, HEIGHT]


def highest_step():
    """Highest step on paper: on the way up the centre of mass must come over the edge before the robot tips backwards.

    With the rear pulley (radius r) on the floor, pitch φ, and the belt on the edge at a distance d ahead of the axle of
    the pulley, the step is h = r (1 − cos φ) + d sin φ. The centre of mass, a ahead of that axle and z over the belt,
    is over the edge when d = a − z tan φ. The highest step is the maximum over φ.
    """
    x, _, z = centre_of_mass()
    a = x - (SHAPE.middle + SHAPE.pulleys[0, 0])
    pitch = np.linspace(0, 1, 1001)
    return float(np.max(SHAPE.track_radius * (1 - np.cos(pitch)) + (a - z * np.tan(pitch)) * np.sin(pitch)))


@pytest.mark.parametrize("speed", [0.1, 0.8, -0.4])
def test_it_drives_straight_at_the_commanded_speed(speed):
    rig = Rig(model="amphibious")
    rig.command(speed, speed)
    rig.run(1.5)
    start = rig.p_WB
    rig.run(2.0)
    np.testing.assert_allclose((rig.p_WB - start) / 2.0, [speed, 0, 0], atol=1e-3)


@pytest.mark.parametrize("yaw_rate", [0.3, -1.0])
def test_it_turns_on_the_spot_at_the_commanded_rate_about_its_origin(yaw_rate):
    rig = Rig(model="amphibious", driver=TrackedDriver())
    rig.command(0.0, yaw_rate)
    rig.run(2.0)
    assert rig.V_WB.rotational()[2] == pytest.approx(yaw_rate, rel=0.01)
    np.testing.assert_allclose(rig.p_WB[:2], 0, atol=0.02)


def test_it_turns_on_the_spot_as_its_contact_points_and_loads_say():
    rig = Rig(model="amphibious")
    rig.command(-0.2, 0.2)
    rig.run(1.5)
    points, loads, links = rig.contacts()
    speeds = [0.2 if "right" in link else -0.2 for link in links]
    expected = quasi_static_twist(points[:, :2], loads, speeds)
    assert rig.V_WB.rotational()[2] == pytest.approx(expected[2], rel=0.003)
    assert TrackedDriver().gauge == pytest.approx(0.4 / expected[2], rel=0.002)


def test_it_climbs_the_34_degrees_of_its_specification_and_slips_at_the_friction_angle():
    limit = math.atan(FRICTION)
    assert math.degrees(limit) == pytest.approx(34.3, abs=0.1)
    assert climbing_speed(limit - math.radians(1.5)) == pytest.approx(0.3, rel=0.02)
    assert 0.05 < climbing_speed(math.radians(34)) < 0.3
    assert climbing_speed(limit + math.radians(1)) < 0


def test_it_drives_down_and_along_what_it_climbs():
    angle = math.atan(FRICTION) - math.radians(2)
    assert climbing_speed(angle, heading=math.pi) == pytest.approx(0.3, rel=0.03)
    assert climbing_speed(angle, heading=math.pi / 2) == pytest.approx(0.3, rel=0.03)


def test_it_stands_on_any_slope_that_it_climbs():
    """Static stability: the centre of mass stays between the pulleys and between the belts, up to 34°."""
    x, _, z = centre_of_mass()
    ahead = SHAPE.middle + SHAPE.pulleys[1, 0] - x
    behind = x - SHAPE.middle - SHAPE.pulleys[0, 0]
    assert math.degrees(math.atan(min(ahead, behind) / z)) > 34 + 2
    assert math.degrees(math.atan(SHAPE.gauge / 2 / z)) > 50


def test_it_climbs_a_step_of_10_cm_and_none_above_its_limit_on_paper():
    limit = highest_step()
    assert limit == pytest.approx(0.112, abs=0.006)
    for speed in (0.1, 0.6):
        rig = at_step(0.1, speed=speed)
        assert rig.p_WB[2] == pytest.approx(HEIGHT + 0.1, abs=2e-3)
    rig = at_step(1.25 * limit, speed=0.1)
    assert abs(rig.p_WB[2] - HEIGHT - 1.25 * limit) > 0.05 or abs(rig.rpy[1]) > 0.3  # reared up, or over on its back


def test_it_comes_down_what_it_climbs():
    rig = at_step(0.1, down=True)
    assert rig.p_WB[2] == pytest.approx(HEIGHT - 0.1, abs=2e-3)
    np.testing.assert_allclose(rig.rpy, 0, atol=5e-3)


def test_encoders_see_the_belts_and_not_the_ground():
    angle = math.atan(FRICTION) + math.radians(3)
    boxes, X_WB = slope(angle, height=HEIGHT)
    rig = Rig(model="amphibious", boxes=boxes, X_WB=X_WB, ground_friction=0.9)
    rig.command(0.3, 0.3)
    rig.run(2.0)
    assert rig.output("track_displacements") == pytest.approx(0.3 * 2.0 - 0.045, abs=0.02)
    assert rig.p_WB[0] < 0.3
    assert RollPitchYaw(rig.X_WB.rotation()).pitch_angle() == pytest.approx(-angle, abs=0.02)
