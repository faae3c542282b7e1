import numpy as np
import pytest
from naraha.models import MODELS_DIR
from naraha.models.pioneer.urdf import PioneerShape, pioneer_urdf
from naraha.systems.errors import ConfigError
from pydrake.geometry import Role, Sphere

from tests.models.ground_robot import GroundRobot

SHAPE = PioneerShape()
BODY = ["base", "left_wheel", "right_wheel"]


@pytest.fixture(scope="module")
def robot():
    return GroundRobot("pioneer", SHAPE.wheel_radius)


def test_the_shipped_file_is_what_the_generator_writes():
    assert (MODELS_DIR / "pioneer" / "pioneer.urdf").read_text(encoding="utf-8") == pioneer_urdf(SHAPE)


def test_it_is_as_large_and_heavy_as_the_source_says(robot):
    """455 x 381 x 237 mm and 9 kg (S3-e), without the scanner on its tilt unit."""
    without_scanner = robot.size(Role.kProximity, ["base"])
    np.testing.assert_allclose(without_scanner[[0, 2]], [0.455, 0.237], atol=1e-9)
    assert robot.size(links=BODY)[1] == pytest.approx(0.381, abs=3e-3)
    masses = {body.name(): body.default_mass() for body in robot.bodies()}
    assert sum(masses.values()) - masses["lidar"] - masses["tilt"] == pytest.approx(9.0)


def test_wheels_and_caster_touch_flat_ground_and_nothing_else(robot):
    for links in (["left_wheel"], ["right_wheel"], ["base"]):
        assert robot.reach(Role.kProximity, [0, 0, -1], links) == pytest.approx(0, abs=1e-9)
    shapes = [robot.inspector.GetShape(g) for g in robot.ids(Role.kProximity, ["left_wheel", "right_wheel"])]
    assert [type(shape) for shape in shapes] == [Sphere, Sphere]


def test_wheels_have_a_limit_of_torque_and_position_control(robot):
    for side in ("left", "right"):
        actuator = robot.plant.GetJointActuatorByName(f"{side}_wheel_actuator")
        assert actuator.effort_limit() == SHAPE.wheel_effort
        assert (actuator.get_controller_gains().p, actuator.get_controller_gains().d) == (SHAPE.wheel_p, SHAPE.wheel_d)
        np.testing.assert_allclose(actuator.joint().revolute_axis(), [0, 1, 0])
        y = robot.pose(f"{side}_wheel").translation()[1]
        assert y == pytest.approx((1 if side == "left" else -1) * SHAPE.gauge / 2)


def test_the_imu_sits_in_the_origin_and_the_scanner_over_the_top_plate(robot):
    assert robot.pose("imu").IsNearlyEqualTo(robot.pose("base"), 1e-12)
    eye = robot.pose("lidar").translation()
    assert eye[2] > 0.237 + 0.05
    assert robot.reach(Role.kPerception, [0, 0, 1], BODY) < eye[2] - 0.03  # level beams pass over the robot
    assert robot.pose("lidar").rotation().IsNearlyIdentity(1e-12)


def test_it_never_touches_itself_and_sensors_see_what_is_drawn(robot):
    robot.check_never_touches_itself()
    robot.check_sensors_see_what_is_drawn()


@pytest.mark.parametrize("options", [{"wheel_radius": 0.0}, {"tyre_friction": -1.0}, {"base_mass": float("nan")}])
def test_dimensions_out_of_range_are_refused(options):
    with pytest.raises(ConfigError, match=next(iter(options))):
        pioneer_urdf(PioneerShape(**options))
