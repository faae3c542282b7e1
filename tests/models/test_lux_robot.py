import math

import numpy as np
import pytest
from naraha.models import MODELS_DIR
from naraha.models.lux_robot.urdf import LuxRobotShape, lux_robot_urdf
from naraha.systems.errors import ConfigError
from pydrake.geometry import Role
from pydrake.math import RigidTransform

from tests.drive.rig import Rig
from tests.models.ground_robot import GroundRobot

SHAPE = LuxRobotShape()
HEIGHT = SHAPE.wheel_radius
G = 9.81


@pytest.fixture(scope="module")
def robot():
    return GroundRobot("lux_robot", HEIGHT)


def rig(**options):
    return Rig(model="lux_robot", ground_friction=0.9, X_WB=RigidTransform([0, 0, HEIGHT]), **options)


def test_the_shipped_file_is_what_the_generator_writes():
    assert (MODELS_DIR / "lux_robot" / "lux_robot.urdf").read_text(encoding="utf-8") == lux_robot_urdf(SHAPE)


def test_it_stands_on_wheels_and_caster_and_turns_in_its_own_width(robot):
    for links in (["left_wheel"], ["right_wheel"], ["base"]):
        assert robot.reach(Role.kProximity, [0, 0, -1], links) == pytest.approx(0, abs=1e-9)
    for angle in np.arange(0, 2 * np.pi, 0.1):
        assert robot.reach(Role.kProximity, [math.cos(angle), math.sin(angle), 0]) <= 0.2631


def test_the_meter_is_the_highest_thing_and_looks_up(robot):
    meter = robot.plant.GetFrameByName("meter").CalcPoseInWorld(robot.plant_context)
    assert meter.translation()[2] == pytest.approx(0.85)
    np.testing.assert_allclose(meter.rotation().matrix()[:, 2], [0, 0, 1], atol=1e-12)
    assert robot.reach(Role.kPerception, [0, 0, 1]) == pytest.approx(0.85)


def test_the_laser_is_level_over_the_body_and_the_mast_is_outside_of_its_field(robot):
    laser = robot.pose("lidar")
    assert laser.rotation().IsNearlyIdentity(1e-12)
    body = ["base", "left_wheel", "right_wheel"]
    assert robot.reach(Role.kPerception, [0, 0, 1], body) < laser.translation()[2] - 0.03
    to_mast = robot.pose("mast").translation()[:2] - laser.translation()[:2]
    assert abs(math.atan2(to_mast[1], to_mast[0])) - math.atan(0.03 / np.hypot(*to_mast)) > np.deg2rad(136)


def test_it_never_touches_itself_and_sensors_see_what_is_drawn(robot):
    robot.check_never_touches_itself()
    robot.check_sensors_see_what_is_drawn()


@pytest.mark.parametrize("options", [{"wheel_radius": 0.0}, {"tyre_friction": -1.0}, {"base_mass": float("nan")}])
def test_dimensions_out_of_range_are_refused(options):
    with pytest.raises(ConfigError, match=next(iter(options))):
        lux_robot_urdf(LuxRobotShape(**options))


def test_wheels_and_caster_carry_what_the_lever_arms_say():
    stand = rig()
    stand.run(1.0)
    _, loads, links = stand.contacts()
    weight = G * stand.plant.CalcTotalMass(stand.plant_context)
    centre = stand.plant.CalcCenterOfMassPositionInWorld(stand.plant_context)[0] - stand.p_WB[0]
    caster = sum(load for load, link in zip(loads, links, strict=True) if link == "base")
    assert sum(loads) == pytest.approx(weight, rel=1e-3)
    assert caster == pytest.approx(weight * -centre / SHAPE.caster_distance, rel=0.01)
    assert caster > 0.1 * weight


def test_it_drives_as_commanded_and_stops_level_from_full_speed():
    drive = rig()
    drive.command(0.8, 0.8)
    drive.run(2.0)
    start = drive.p_WB
    drive.run(1.0)
    np.testing.assert_allclose(drive.p_WB - start, [0.8, 0, 0], atol=2e-3)
    before = drive.p_WB[0]
    drive.command(0.0, 0.0)
    pitch = []
    for _ in range(20):
        drive.run(0.1)
        pitch.append(abs(drive.rpy[1]))
    assert max(pitch) < 0.02
    # v²/2a with the driver's 1 m/s².
    assert drive.p_WB[0] - before == pytest.approx(0.32, abs=0.02)


def test_it_turns_on_the_spot_about_the_axle():
    turn = rig()
    turn.command(-0.1655, 0.1655)
    turn.run(1.0)
    assert turn.V_WB.rotational()[2] == pytest.approx(1.0, rel=0.01)
    np.testing.assert_allclose(turn.p_WB[:2], 0, atol=5e-3)
