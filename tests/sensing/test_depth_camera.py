"""Depth images against closed forms."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.sensing import Surface, SurfaceTable
from naraha.systems.sensing.depth_camera import DepthCamera, DepthCameraConfig, render_depth
from pydrake.geometry import Box, HalfSpace
from pydrake.math import RigidTransform, RollPitchYaw

from tests.sensing.camera_rig import FORWARD

EXACT = {"subpixel": 0.0, "dropout": 0.0, "specular_dropout": 0.0}


def look(world, X_WC=FORWARD, *, surfaces=None, seed=0, X_WF=None, own_geometry=None, own_distance=None, **changes):
    config = DepthCameraConfig(**{"width": 64, "height": 48, **changes})
    model = config.model()
    depth = render_depth(
        model,
        X_WC,
        world.rays(surfaces),
        np.random.default_rng(seed),
        config=config,
        X_WF=X_WF,
        own_geometry=own_geometry,
        own_distance=own_distance,
    )
    return model, depth


def wall(make_world, distance=3.0, turn=(0, 0, 0)):
    """A wall whose front meets the x axis at a distance."""
    return make_world().add(
        Box(1, 500, 500), RigidTransform(RollPitchYaw(*turn), [distance, 0, 0]) @ RigidTransform([0.5, 0, 0])
    )


def test_depth_of_a_wall_square_on_is_its_distance_in_every_pixel(make_world):
    """Depth is along the optical axis; the range to the corners is a third longer."""
    _, depth = look(wall(make_world), **EXACT)
    assert depth.shape == (48, 64)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, 3.0, rtol=1e-5)


@pytest.mark.parametrize("distortion", [[0.0] * 5, [0.1, -0.05, 2e-3, 1e-3, 0.0]])
def test_depth_of_a_slanting_wall_is_that_of_its_plane(make_world, distortion):
    model, depth = look(wall(make_world, 3.0, (0, 0.2, 0.5)), **EXACT, distortion=distortion)
    n_C = FORWARD.rotation().matrix().T @ RollPitchYaw(0, 0.2, 0.5).ToRotationMatrix().matrix()[:, 0]
    rays = np.column_stack([model.xy, np.ones(64 * 48)])
    expected = (n_C @ [0, 0, 3]) / (rays @ n_C)
    np.testing.assert_allclose(depth.ravel(), expected, rtol=1e-4)


def test_points_of_a_depth_image_lie_on_the_floor_that_was_seen(make_world):
    X_WC = RigidTransform(RollPitchYaw(0, np.deg2rad(10), 0.4), [1, 2, 0.56]) @ FORWARD
    model, depth = look(make_world().add(HalfSpace()), X_WC, **EXACT)
    points = X_WC.multiply(model.unproject(depth).T.astype(float)).T
    near = np.isfinite(depth.ravel()) & (depth.ravel() > 0)
    assert 0.4 < near.mean() < 0.9
    np.testing.assert_allclose(points[near, 2], 0, atol=2e-5)


def test_step_in_depth_is_at_its_pixel(make_world):
    world = wall(make_world, 4.0).add(Box(1e-4, 10, 10), [2, 5.2, 0], "front")  # covers y > 0.2 at x = 2
    model, depth = look(world, **EXACT)
    left = model.xy[:64, 0] < -0.2 / 2
    np.testing.assert_allclose(depth[:, left], 2, rtol=1e-4)
    np.testing.assert_allclose(depth[:, ~left], 4, rtol=1e-5)


def test_noise_grows_with_the_square_of_depth_by_the_disparity(make_world):
    """0.08 px of disparity, f = 320 px / tan 34.7°, b = 55 mm: 3.1 mm at 1 m."""
    factor = 0.08 / (320 / np.tan(np.deg2rad(34.7)) * 0.055)
    assert factor == pytest.approx(0.00315, abs=1e-5)
    for z in (1.0, 2.0, 5.0):
        _, depth = look(wall(make_world, z), width=160, height=120, dropout=0.0)
        assert depth.std() == pytest.approx(factor * z**2, rel=0.02)
        assert depth.mean() == pytest.approx(z, abs=4 * factor * z**2 / 138)


def test_a_thinned_image_is_as_exact_as_a_full_one():
    assert DepthCameraConfig(width=160, height=120).noise_factor() == DepthCameraConfig().noise_factor()
    half = DepthCameraConfig(stereo_width=320).noise_factor()
    assert half == pytest.approx(2 * DepthCameraConfig().noise_factor())


def test_too_near_is_zero_and_too_far_or_nothing_is_infinite(make_world):
    for z, expected in ((0.44, 0), (0.46, 0.46), (9.9, 9.9), (10.1, np.inf), (30, np.inf)):
        np.testing.assert_allclose(look(wall(make_world, z), **EXACT)[1], np.float32(expected), rtol=1e-5)
    _, nothing = look(make_world().add(Box(1, 1, 1), [-9, 0, 0]))
    assert np.isposinf(nothing).all()


def test_share_of_pixels_drops_out(make_world):
    _, depth = look(wall(make_world), width=200, height=100, dropout=0.1)
    assert np.mean(depth == 0) == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / 20000))


@pytest.mark.parametrize("specular", [0.5, 1.0])
def test_mirroring_surfaces_drop_out_more(make_world, specular):
    surfaces = SurfaceTable(default=Surface(specular=specular))
    _, depth = look(wall(make_world), surfaces=surfaces, width=200, height=100, dropout=0.1, specular_dropout=0.4)
    lost = 1 - 0.9 * (1 - 0.4 * specular)
    assert np.mean(depth == 0) == pytest.approx(lost, abs=4 * np.sqrt(lost * (1 - lost) / 20000))


@pytest.mark.parametrize(("incidence", "lost"), [(60.0, 0.0), (84.0, 0.0), (86.0, 0.2), (88.0, 0.6), (89.0, 0.8)])
def test_surfaces_seen_at_a_grazing_angle_are_lost(make_world, incidence, lost):
    """A view so narrow that the incidence is the same in all of it."""
    options = {**EXACT, "width": 200, "height": 100, "fov_x_deg": 0.2, "fov_y_deg": 0.1}
    _, depth = look(wall(make_world, turn=(0, 0, np.deg2rad(incidence))), **options)
    assert np.mean(depth == 0) == pytest.approx(lost, abs=0.03)


def test_randomness_of_a_pixel_does_not_depend_on_what_others_see(make_world):
    world = wall(make_world)
    _, before = look(world, seed=3)
    _, after = look(world.add(Box(0.2, 1, 1), [2, 0, 0], "crate"), seed=3)
    assert 0.05 < np.mean(before != after) < 0.5


def test_the_robot_gives_zero_and_others_their_depth(make_world):
    world = wall(make_world)
    arm = world.frame("arm")
    world.add(Box(0.2, 0.2, 4), name="arm", frame=arm)
    pose = {arm: RigidTransform([1.1, 0, 0])}
    model, seen = look(world, X_WF=pose, **EXACT)
    middle = np.abs(model.xy[:64, 0]) < 0.1
    np.testing.assert_allclose(seen[:, middle], 1, rtol=1e-5)
    _, own = look(world, X_WF=pose, own_geometry=world.rays().geometries_of([arm]), **EXACT)
    assert not own[:, middle].any()
    np.testing.assert_array_equal(own[:, ~middle], seen[:, ~middle])
    distance = np.where(np.tile(middle, 48), 2.0, np.inf)
    _, behind = look(world, own_distance=distance, **EXACT)
    assert not behind[:, middle].any()
    np.testing.assert_allclose(behind[:, ~middle], 3, rtol=1e-5)


def test_ranges_must_fit_each_other(make_world):
    world = wall(make_world)
    with pytest.raises(ConfigError, match="min_range < max_range"):
        DepthCamera(
            DepthCameraConfig(min_range=3.0, max_range=2.0),
            scene=world.rays(),
            parent_frame=world.scene_graph.world_frame_id(),
            X_PC=FORWARD,
        )
