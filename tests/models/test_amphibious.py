import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.models import MODELS_DIR
from naraha.models.amphibious.urdf import AmphibiousShape, amphibious_urdf
from naraha.models.belt import outline_around
from naraha.systems.errors import ConfigError
from pydrake.geometry import Role

from tests.models.ground_robot import GroundRobot

SHAPE = AmphibiousShape()
TRACKS = ["left_track", "right_track"]


@pytest.fixture(scope="module")
def robot():
    return GroundRobot("amphibious", SHAPE.track_radius)


def test_the_shipped_file_is_what_the_generator_writes():
    assert (MODELS_DIR / "amphibious" / "amphibious.urdf").read_text(encoding="utf-8") == amphibious_urdf(SHAPE)


def test_it_is_as_large_and_heavy_as_the_source_says(robot):
    """690 x 650 x 610 mm and 80 kg (S3-e), with the scanner, as drawn and in contact."""
    np.testing.assert_allclose(robot.size(), [0.69, 0.65, 0.61], atol=0.01)
    np.testing.assert_allclose(robot.size(Role.kProximity), [0.69, 0.65, 0.61], atol=2e-3)
    assert robot.plant.CalcTotalMass(robot.plant_context) == pytest.approx(80.0)


def test_tracks_touch_flat_ground_and_their_surface_drives_forward(robot):
    for name in TRACKS:
        assert robot.reach(Role.kProximity, [0, 0, -1], [name]) == pytest.approx(0, abs=1e-9)
        axis = robot.plant.GetSurfaceVelocityAxis(robot.plant.GetBodyByName(name))
        np.testing.assert_allclose(axis, [0, 1, 0])
    assert robot.reach(Role.kProximity, [0, 0, -1], ["base"]) == pytest.approx(-SHAPE.hull_bottom)


def test_the_tracks_reach_out_before_hull_and_scanner(robot):
    """What the robot drives against meets its belts first."""
    for direction in ([1, 0, 0], [-1, 0, 0]):
        belts = robot.reach(Role.kProximity, direction, TRACKS)
        assert belts > robot.reach(Role.kProximity, direction, ["base", "lidar"]) + 0.01


def test_the_nose_is_raised_and_the_hull_lies_behind_it(robot):
    """The lower corner of the hull is above the run from the front pulley to the nose."""
    (x, z), (x_nose, z_nose) = np.add(SHAPE.pulleys[1:], [SHAPE.middle, SHAPE.track_radius])
    slope = math.atan2(z_nose - z, x_nose - x)
    assert math.degrees(slope) == pytest.approx(40, abs=1)
    below = np.array([math.sin(slope), -math.cos(slope)])
    corner = np.array([SHAPE.hull_front, SHAPE.hull_bottom])
    assert (corner - [x, z]) @ below < SHAPE.track_radius - 0.01


def test_level_beams_pass_over_the_robot(robot):
    eye = robot.pose("lidar").translation()
    assert robot.reach(Role.kPerception, [0, 0, 1], ["base", *TRACKS]) < eye[2] - 0.03
    assert robot.pose("imu").IsNearlyEqualTo(robot.pose("base"), 1e-12)


def test_it_never_touches_itself_and_sensors_see_what_is_drawn(robot):
    robot.check_never_touches_itself()
    robot.check_sensors_see_what_is_drawn()


@pytest.mark.parametrize("options", [{"track_radius": 0.0}, {"outline_tilt": 2.0}, {"belt_friction": -0.1}])
def test_dimensions_out_of_range_are_refused(options):
    with pytest.raises(ConfigError, match=next(iter(options))):
        amphibious_urdf(AmphibiousShape(**options))


@given(
    runs=st.lists(st.tuples(st.floats(0.05, 0.5), st.floats(0.0, 0.6)), min_size=1, max_size=4),
    radius=st.floats(0.01, 0.2),
    spacing=st.floats(0.005, 0.05),
)
def test_an_outline_runs_evenly_below_all_pulleys(runs, radius, spacing):
    """A level run and then steeper ones towards the nose: every point is one radius from the line of the axles."""
    slopes = np.cumsum([0.0, *(slope for _, slope in runs[1:])]) / len(runs)
    steps = [(length * math.cos(a), length * math.sin(a)) for (length, _), a in zip(runs, slopes, strict=True)]
    centres = np.vstack([[0, 0], np.cumsum(steps, axis=0)])
    points = outline_around(centres, radius, spacing)
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert gaps.max() <= spacing * (1 + 1e-6)
    distance = np.full(len(points), np.inf)
    for a, b in pairwise(centres):
        t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        distance = np.minimum(distance, np.linalg.norm(points - a - t[:, None] * (b - a), axis=1))
    np.testing.assert_allclose(distance, radius, atol=1e-9)
    np.testing.assert_allclose(points[[0, -1]], centres[[0, -1]] + [0, radius], atol=1e-9)
