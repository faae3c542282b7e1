import numpy as np
import pytest
from naraha.systems.calibration.edge_calibration import CalibrationView, EdgeCalibrationConfig, calibrate_from_views
from naraha.systems.calibration.edge_points import image_edges, space_edges
from naraha.systems.calibration.pose_fit import change_between, changed
from naraha.systems.errors import CameraError, ConfigError
from naraha.systems.sensing.camera_model import CameraModel
from pydrake.math import RigidTransform

from tests.calibration.calibration_world import (
    DEPTH,
    NIR,
    THERMAL,
    X_DN,
    nir_sweep,
    small_change,
    sweep_angles,
    thermal_views,
)

JUMP = {"min_jump": 0.1, "jump_per_z2": 0.02}


def step_image(angle, offset, size=64, low=40.0, high=90.0, parts=8):
    """A straight edge between two brightnesses, at `offset` from the centre across `angle`, as mean over pixels."""
    fine = (np.arange(size * parts) + 0.5) / parts - 0.5 - (size - 1) / 2
    u, v = np.meshgrid(fine, fine)
    bright = np.cos(angle) * u + np.sin(angle) * v > offset
    return np.where(bright, high, low).reshape(size, parts, size, parts).mean(axis=(1, 3))


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1, 1.5707963, 2.5, 4.0])
def test_an_edge_of_an_image_is_found_to_a_tenth_of_a_pixel_with_its_direction(angle):
    edges = image_edges(step_image(angle, 3.3) + np.random.default_rng(0).normal(size=(64, 64)), 1.0)
    normal = np.array([np.cos(angle), np.sin(angle)])
    across = (edges.uv - 31.5) @ normal - 3.3
    assert len(edges.uv) > 40
    assert np.abs(np.median(across)) < 0.05
    assert np.percentile(np.abs(across), 95) < 0.25
    assert np.median(edges.normal @ normal) > 0.999


def test_noise_and_slow_shading_are_no_edges():
    u, v = np.meshgrid(np.arange(128), np.arange(128))
    shaded = 100 * np.exp(-((u - 40) ** 2 + (v - 90) ** 2) / 90**2) + np.random.default_rng(1).normal(size=u.shape)
    assert len(image_edges(np.rint(shaded).astype(np.uint8), 1.0).uv) < 30


def plate_depth(noise=0.0):
    """A plate of 0.4 m × 0.3 m at 1.5 m before a wall at 3 m."""
    x, y = 1.5 * DEPTH.xy.T
    depth = np.where((np.abs(x) < 0.2) & (np.abs(y) < 0.15), 1.5, 3.0).reshape(DEPTH.shape)
    return depth + noise * depth**2 * np.random.default_rng(2).normal(size=depth.shape)


def test_depth_edges_lie_on_the_outline_of_the_foreground():
    edges = space_edges(plate_depth(0.0032), DEPTH, **JUMP)
    x, y, z = edges.p_DP.T
    pixel = 1.5 / DEPTH.fx
    outside = np.maximum(np.abs(x) - 0.2, np.abs(y) - 0.15)
    assert len(x) > 400
    assert np.abs(outside).max() < 0.75 * pixel
    assert np.abs(z - 1.5).max() < 0.02
    sides = np.abs(x) > 0.19
    assert np.abs(edges.t_DP[sides, 0]).max() < 0.2 * np.abs(edges.t_DP[sides, 1]).min()
    assert len(np.unique(edges.group)) == 4


def test_unknown_depth_makes_no_edge_and_infinity_is_far_away():
    depth = plate_depth()
    hole = depth.copy()
    hole[depth > 2] = np.nan
    assert len(space_edges(hole, DEPTH, **JUMP).p_DP) == 0
    hole[depth > 2] = 0.0
    assert len(space_edges(hole, DEPTH, **JUMP).p_DP) == 0
    hole[depth > 2] = np.inf
    assert len(space_edges(hole, DEPTH, **JUMP).p_DP) > 400
    assert len(space_edges(np.full(DEPTH.shape, np.nan), DEPTH, **JUMP).p_DP) == 0


def test_borders_in_reflectance_become_edges_on_a_flat_wall():
    x, _ = 2.0 * DEPTH.xy.T
    brightness = np.where(x > 0.1, 0.8, 0.2).reshape(DEPTH.shape)
    edges = space_edges(np.full(DEPTH.shape, 2.0), DEPTH, **JUMP, brightness=brightness)
    assert len(edges.p_DP) > 400
    assert np.abs(edges.p_DP[:, 0] - 0.1).max() < 2.0 / DEPTH.fx
    np.testing.assert_allclose(edges.p_DP[:, 2], 2.0)


def run(kind, seed, **options):
    """One calibration from a start that is 3 cm and 2 degrees off: errors [m], [deg], e² / σ² and the result."""
    if kind == "nir":
        views, X_HC = nir_sweep(seed, options.get("angles", sweep_angles()), options.get("rooms", 1))
        camera, mount = NIR, X_DN
    else:
        views, X_HC = thermal_views(seed, options.get("rooms", 1))
        camera, mount = THERMAL, None
    guess = changed(X_HC, small_change(np.random.default_rng(5000 + seed)))
    result = calibrate_from_views(views, DEPTH, camera, guess, X_DN=mount)
    change = change_between(X_HC, result.X_HC)
    nees = change @ np.linalg.solve(result.covariance, change)
    return np.linalg.norm(change[3:]), np.rad2deg(np.linalg.norm(change[:3])), nees, result


def test_a_near_infrared_sweep_calibrates_the_head_of_the_pan_tilt():
    metres, degrees, _, result = run("nir", 7, angles=sweep_angles(pan=24.5, tilt=10.5))
    assert result.valid
    assert metres < 0.01
    assert degrees < 0.2


def test_thermal_images_of_several_rooms_calibrate_the_fixed_camera():
    metres, degrees, _, result = run("thermal", 1, rooms=3)
    assert result.valid
    assert result.reason == ""
    assert metres < 0.005
    assert degrees < 0.2


def test_two_narrow_views_do_not_fix_everything_and_say_so():
    views, X_HC = nir_sweep(6, np.deg2rad([[-17.5, 3.5], [-10.5, 3.5]]))
    result = calibrate_from_views(views, DEPTH, NIR, X_HC, X_DN=X_DN)
    assert result.reason
    assert np.sqrt(result.covariance[3:, 3:].diagonal().max()) > 0.01


def test_an_image_without_edges_or_a_depth_image_without_depth_gives_the_guess_and_a_reason():
    flat = np.full(THERMAL.shape, 20.0) + 0.1 * np.random.default_rng(3).normal(size=THERMAL.shape)
    guess = RigidTransform([0.1, 0, 0])
    for view, reason in (
        (CalibrationView(plate_depth(), flat), "hardly any edges in the images"),
        (CalibrationView(np.full(DEPTH.shape, np.nan), flat), "only 0 points on depth edges"),
    ):
        result = calibrate_from_views([view], DEPTH, THERMAL, guess)
        assert not result.valid
        assert reason in result.reason
        np.testing.assert_array_equal(result.X_HC.GetAsMatrix4(), guess.GetAsMatrix4())
        assert np.diag(result.covariance).min() > 1
    assert calibrate_from_views([], DEPTH, THERMAL, guess).reason == "no views"


def test_images_that_do_not_fit_their_intrinsics_are_refused():
    depth, image = plate_depth(), np.zeros(THERMAL.shape)
    for view in (
        CalibrationView(depth[:-1], image),
        CalibrationView(depth, image[:, :-1]),
        CalibrationView(depth, image, brightness=np.zeros((2, 2))),
        CalibrationView(depth, np.full(THERMAL.shape, np.nan)),
    ):
        with pytest.raises(CameraError, match=r"image|brightness"):
            calibrate_from_views([view], DEPTH, THERMAL, RigidTransform())
    with pytest.raises(ConfigError, match="stages_deg"):
        calibrate_from_views([], DEPTH, THERMAL, RigidTransform(), config=EdgeCalibrationConfig(stages_deg=[0.0]))


def test_the_same_views_give_the_same_numbers():
    views, X_DC = thermal_views(2, 1)
    first, second = (calibrate_from_views(views, DEPTH, THERMAL, X_DC) for _ in range(2))
    np.testing.assert_array_equal(first.X_HC.GetAsMatrix4(), second.X_HC.GetAsMatrix4())
    np.testing.assert_array_equal(first.covariance, second.covariance)


def many(kind, seeds, **options):
    rows = [run(kind, seed, **options) for seed in range(seeds)]
    metres, degrees, nees = np.array([row[:3] for row in rows]).T
    words = [row[3].reason for row in rows]
    print(
        f"\n{kind} {options}: error mean {1e3 * metres.mean():.1f} mm {degrees.mean():.3f} deg, "
        f"max {1e3 * metres.max():.1f} mm {degrees.max():.3f} deg, NEES mean {nees.mean():.1f} max {nees.max():.1f}, "
        f"with a reason {sum(map(bool, words))}, "
        f"within 5 mm and 0.2 deg {np.mean((metres < 5e-3) & (degrees < 0.2)):.2f}"
    )
    return metres, degrees, nees


@pytest.mark.slow
def test_near_infrared_sweeps_of_two_places_reach_half_a_centimetre_and_a_fifth_of_a_degree():
    metres, degrees, nees = many("nir", 20, rooms=2)
    assert metres.mean() < 0.004
    assert np.mean((metres < 0.005) & (degrees < 0.2)) >= 0.9
    assert degrees.max() < 0.2
    assert 1 < nees.mean() < 12


@pytest.mark.slow
def test_thermal_images_of_six_places_reach_half_a_centimetre_and_a_fifth_of_a_degree():
    metres, degrees, nees = many("thermal", 20, rooms=6)
    assert metres.mean() < 0.004
    assert np.mean((metres < 0.005) & (degrees < 0.2)) >= 0.9
    assert 1 < nees.mean() < 12


def test_a_distorted_lens_does_no_harm():
    camera = CameraModel.from_fov(160, 120, np.deg2rad(45), np.deg2rad(34), (-0.25, 0.05, 0.002, 0.0, 0.0))
    views, X_DC = thermal_views(1, 2, camera)
    result = calibrate_from_views(views, DEPTH, camera, changed(X_DC, small_change(np.random.default_rng(6))))
    change = change_between(X_DC, result.X_HC)
    assert result.valid
    assert np.linalg.norm(change[3:]) < 0.006
    assert np.rad2deg(np.linalg.norm(change[:3])) < 0.2
