import numpy as np
import pytest
from naraha.systems.calibration.calibration import CalibrationConfig, calibrate_from_correspondences, pixel_errors
from naraha.systems.calibration.calibration import _checked_pairs as checked_pairs
from naraha.systems.calibration.pose_fit import change_between, changed, head_rotations
from naraha.systems.errors import CameraError, ConfigError
from naraha.systems.sensing.camera_model import CameraModel
from pydrake.math import RigidTransform, RollPitchYaw

DISTORTED = CameraModel.from_fov(640, 480, 1.2, 0.95, (-0.2, 0.05, 0.001, -0.002, 0.0))
NIR = CameraModel.from_fov(128, 128, np.deg2rad(8), np.deg2rad(8))
# Optical axes of a camera that looks along x of a frame with z up.
LOOK_X = RollPitchYaw(-np.pi / 2, 0, -np.pi / 2)


def some_change(rng, metres=0.03, degrees=2.0):
    """A change of that length and angle in a random direction."""
    w, t = rng.normal(size=(2, 3))
    return np.concatenate([np.deg2rad(degrees) * w / np.linalg.norm(w), metres * t / np.linalg.norm(t)])


def errors(X_AB, X_AB_true):
    change = change_between(X_AB_true, X_AB)
    return np.linalg.norm(change[3:]), np.rad2deg(np.linalg.norm(change[:3]))


def seen_by(camera, X_DC, p_DP, rng, sigma):
    p_CP = (p_DP - X_DC.translation()) @ X_DC.rotation().matrix()
    uv, inside = camera.project(p_CP)
    return p_DP[inside], uv[inside] + sigma * rng.normal(size=(int(inside.sum()), 2))


def fixed_camera(seed, *, camera=DISTORTED, count=200, sigma=0.5, planar=False):
    """Points 1 to 4 m ahead, their pixels, and the pose of a camera a hand's breadth from D."""
    rng = np.random.default_rng(seed)
    X_DC = changed(RigidTransform([0.1, -0.05, 0.02]), some_change(rng, 0.02, 5))
    p_DP = rng.uniform([-1.2, -0.9, 1.0], [1.2, 0.9, 4.0], (count, 3))
    if planar:
        p_DP[:, 2] = 2.0 + 0.5 * p_DP[:, 0]
    return *seen_by(camera, X_DC, p_DP, rng, sigma), X_DC, rng


def swept_camera(seed, sigma=0.5, X_DN=None, per_view=25):
    """Correspondences of a narrow camera on a pan-tilt whose mount is 10 cm above D, over a sweep of 5 × 4 views."""
    rng = np.random.default_rng(seed)
    X_DN = X_DN or RigidTransform(LOOK_X.ToRotationMatrix().inverse(), [0.03, -0.1, 0.0])
    X_HC = changed(RigidTransform(LOOK_X, [0.04, 0.02, 0.03]), some_change(rng, 0.02, 3))
    angles = np.array([[p, t] for p in np.deg2rad([-28, -14, 0, 14, 28]) for t in np.deg2rad([-15, -5, 5, 15])])
    p_DP, uv, view = [], [], []
    for i, R_NH in enumerate(head_rotations(angles)):
        X_DC = X_DN @ RigidTransform(changed(RigidTransform(), np.zeros(6)).rotation(), [0, 0, 0])
        X_DC = X_DC @ RigidTransform(np.block([[R_NH, np.zeros((3, 1))], [0, 0, 0, 1]])) @ X_HC
        z = rng.uniform(1, 4, per_view)
        p_CP = np.column_stack([rng.uniform(-0.065, 0.065, (per_view, 2)), np.ones(per_view)]) * z[:, None]
        points, pixels = seen_by(NIR, X_DC, p_CP @ X_DC.rotation().matrix().T + X_DC.translation(), rng, sigma)
        p_DP.append(points)
        uv.append(pixels)
        view.append(np.full(len(points), i))
    return np.vstack(p_DP), np.vstack(uv), np.concatenate(view), angles, X_DN, X_HC, rng


def test_derivatives_are_those_of_finite_differences():
    p_DP, uv, view, angles, X_DN, X_HC, _ = swept_camera(1)
    camera = CameraModel.from_fov(128, 128, 0.14, 0.14, (0.3, 0.0, 0.01, 0.02, 0.0))
    pairs = checked_pairs(p_DP[:40], uv[:40], camera, view[:40], angles, 1.0)
    _, J = pixel_errors(X_HC, X_DN, pairs)
    for k, step in enumerate(1e-6 * np.eye(12)):
        ends = [pixel_errors(changed(X_HC, s * step[:6]), changed(X_DN, s * step[6:]), pairs)[0] for s in (1, -1)]
        np.testing.assert_allclose(J[:, :, k], (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-3)


def test_a_change_is_undone_by_its_difference():
    rng = np.random.default_rng(0)
    X, change = changed(RigidTransform(), rng.normal(size=6)), rng.normal(size=6)
    np.testing.assert_allclose(change_between(X, changed(X, change)), change, atol=1e-12)


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("guessed", [False, True])
def test_exact_pairs_give_the_exact_pose_also_with_distortion(planar, guessed):
    p_DP, uv, X_DC, rng = fixed_camera(3, sigma=0, planar=planar)
    guess = changed(X_DC, some_change(rng)) if guessed else None
    result = calibrate_from_correspondences(p_DP, uv, DISTORTED, guess)
    assert result.valid
    assert result.reason == ""
    assert result.inliers == len(p_DP)
    np.testing.assert_allclose(result.camera_pose().GetAsMatrix4(), X_DC.GetAsMatrix4(), atol=1e-6)


@pytest.mark.parametrize("guessed", [False, True])
def test_a_quarter_of_wrong_pairs_does_no_harm(guessed):
    p_DP, uv, X_DC, rng = fixed_camera(4)
    wrong = np.arange(len(uv)) % 4 == 0
    uv[wrong] = rng.uniform([0, 0], [640, 480], (int(wrong.sum()), 2))
    guess = changed(X_DC, some_change(rng)) if guessed else None
    result = calibrate_from_correspondences(p_DP, uv, DISTORTED, guess)
    metres, degrees = errors(result.X_HC, X_DC)
    assert metres < 0.005
    assert degrees < 0.1
    assert abs(result.inliers - int((~wrong).sum())) <= 3


def test_the_head_of_a_pan_tilt_is_found_from_several_narrow_views_from_a_guess_and_without():
    p_DP, uv, view, angles, X_DN, X_HC, rng = swept_camera(5)
    for guess in (changed(X_HC, some_change(rng)), None):
        result = calibrate_from_correspondences(p_DP, uv, NIR, guess, view=view, pan_tilt=angles, X_DN=X_DN)
        metres, degrees = errors(result.X_HC, X_HC)
        assert metres < 0.005
        assert degrees < 0.05
        assert result.reason == ""


def test_the_mount_is_found_together_with_the_camera():
    p_DP, uv, view, angles, X_DN, X_HC, rng = swept_camera(6, sigma=0.2, per_view=60)
    result = calibrate_from_correspondences(
        p_DP, uv, NIR, changed(X_HC, some_change(rng)), sigma_px=0.2,
        view=view, pan_tilt=angles, X_DN=changed(X_DN, some_change(rng)), estimate_mount=True,
    )  # fmt: skip
    assert result.valid
    assert result.covariance.shape == (12, 12)
    # What matters is where the camera is in D; the shares of mount and head are told apart less well.
    for pan, tilt in angles:
        X_true = X_DN @ RigidTransform(np.block([[head_rotations([[pan, tilt]])[0], np.zeros((3, 1))], [0, 0, 0, 1]]))
        metres, degrees = errors(result.camera_pose(pan, tilt), X_true @ X_HC)
        assert metres < 0.01
        assert degrees < 0.05


def test_without_turns_of_the_head_the_mount_keeps_its_guess_and_is_named():
    p_DP, uv, X_DC, rng = fixed_camera(7)
    result = calibrate_from_correspondences(p_DP, uv, DISTORTED, changed(X_DC, some_change(rng)), estimate_mount=True)
    assert "the data do not hold" in result.reason
    assert "of the mount" in result.reason
    assert np.linalg.eigvalsh(result.covariance)[-1] > 1.0
    metres, degrees = errors(result.camera_pose(), X_DC)
    assert metres < 0.005
    assert degrees < 0.1


def test_points_on_a_line_leave_the_turn_about_it_at_the_guess():
    rng = np.random.default_rng(8)
    X_DC = RigidTransform()
    p_DP = np.column_stack([np.linspace(-1, 1, 100), np.zeros(100), np.full(100, 2.0)])
    p_DP, uv = seen_by(DISTORTED, X_DC, p_DP, rng, 0.1)
    # About the line at z = 2: the camera goes up and looks down, and the pixels stay as they are.
    angle = np.deg2rad(1.0)
    about_line = RigidTransform(RollPitchYaw(angle, 0, 0), [0, 0, 0])
    X_turned = RigidTransform([0, 0, 2.0]) @ about_line @ RigidTransform([0, 0, -2.0])
    result = calibrate_from_correspondences(p_DP, uv, DISTORTED, X_turned, sigma_px=0.1)
    assert result.valid
    assert "the data do not hold" in result.reason
    assert errors(result.X_HC, X_turned)[1] < 0.1
    free = np.linalg.eigh(result.covariance / np.outer([0.035] * 3 + [0.03] * 3, [0.035] * 3 + [0.03] * 3))
    assert free[0][-1] > 100
    assert calibrate_from_correspondences(p_DP, uv, DISTORTED).valid is False


def test_one_depth_in_a_tiny_field_of_view_leaves_the_distance_at_the_guess():
    rng = np.random.default_rng(9)
    p_DP = np.column_stack([rng.uniform(-0.01, 0.01, (60, 2)), np.full(60, 2.0)])
    p_DP, uv = seen_by(NIR, RigidTransform(), p_DP, rng, 0.5)
    guess = RigidTransform([0.0, 0.0, 0.02])
    result = calibrate_from_correspondences(p_DP, uv, NIR, guess)
    assert "shift along z" in result.reason
    assert abs(result.X_HC.translation()[2] - 0.02) < 0.005
    assert np.sqrt(result.covariance[5, 5]) > 0.03


def test_pairs_that_agree_with_no_pose_are_reported():
    p_DP, _, X_DC, rng = fixed_camera(10)
    uv = rng.uniform([0, 0], [640, 480], (len(p_DP), 2))
    result = calibrate_from_correspondences(p_DP, uv, DISTORTED, X_DC)
    assert not result.valid
    assert "no pose fits" in result.reason
    np.testing.assert_array_equal(result.X_HC.GetAsMatrix4(), X_DC.GetAsMatrix4())
    few = calibrate_from_correspondences(p_DP[:5], uv[:5], DISTORTED, X_DC)
    assert not few.valid
    assert few.reason == "only 5 usable pairs, needs 6"
    np.testing.assert_array_equal(few.X_HC.GetAsMatrix4(), X_DC.GetAsMatrix4())


def test_numbers_that_are_not_finite_are_left_out():
    p_DP, uv, X_DC, rng = fixed_camera(11)
    p_DP[3, 2], uv[7, 0] = np.nan, np.inf
    result = calibrate_from_correspondences(p_DP, uv, DISTORTED, changed(X_DC, some_change(rng)))
    assert result.inliers <= len(p_DP) - 2
    assert errors(result.X_HC, X_DC)[0] < 0.005


def test_points_behind_the_guessed_camera_do_not_stop_it():
    p_DP, uv, X_DC, _ = fixed_camera(12)
    p_DP[:20, 2] *= -1
    result = calibrate_from_correspondences(p_DP, uv, DISTORTED, X_DC)
    assert errors(result.X_HC, X_DC)[0] < 0.005


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"p_DP": np.zeros((8, 2))}, "p_DP"),
        ({"uv": np.zeros((7, 2))}, "uv"),
        ({"view": np.ones(8, int)}, "view"),
        ({"pan_tilt": np.zeros((1, 3))}, "pan_tilt"),
        ({"sigma_px": 0.0}, "sigma_px"),
    ],
)
def test_input_that_does_not_fit_is_named(change, key):
    arguments = {"p_DP": np.ones((8, 3)), "uv": np.ones((8, 2)), "camera": NIR, **change}
    with pytest.raises(CameraError, match=key):
        calibrate_from_correspondences(**arguments)


def test_a_configuration_out_of_range_is_refused():
    with pytest.raises(ConfigError, match="min_pairs"):
        calibrate_from_correspondences(np.ones((8, 3)), np.ones((8, 2)), NIR, config=CalibrationConfig(min_pairs=2))


def mean_nees(make, runs):
    """Mean of eᵀ C⁻¹ e over the six numbers of X_HC; 6 when the covariance C is right."""
    values = []
    for seed in range(runs):
        result, X_HC = make(seed)
        change = change_between(X_HC, result.X_HC)
        values.append(change @ np.linalg.solve(result.covariance[:6, :6], change))
    return float(np.mean(values))


def test_the_covariance_says_how_large_the_errors_are():
    def fixed(seed):
        p_DP, uv, X_DC, rng = fixed_camera(100 + seed, count=60)
        return calibrate_from_correspondences(p_DP, uv, DISTORTED, changed(X_DC, some_change(rng))), X_DC

    def swept(seed):
        p_DP, uv, view, angles, X_DN, X_HC, rng = swept_camera(100 + seed)
        guess = changed(X_HC, some_change(rng))
        return calibrate_from_correspondences(p_DP, uv, NIR, guess, view=view, pan_tilt=angles, X_DN=X_DN), X_HC

    # The mean of 40 values of χ² with six degrees of freedom lies in 6 ± 1.9 in 99.9 % of the cases.
    for make in (fixed, swept):
        nees = mean_nees(make, 40)
        print(f"mean NEES {make.__name__}: {nees:.2f}")
        assert 4.1 < nees < 7.9
