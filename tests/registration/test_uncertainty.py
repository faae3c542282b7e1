"""How exact a result says it is, and how it weighs what surfaces, classes and the guess say."""

import numpy as np
import pytest
from naraha.systems.registration import RegistrationConfig, register
from naraha.systems.registration.alignment import Alignment
from naraha.systems.registration.class_correlation import ClassFix
from naraha.systems.registration.constraint import Hold, motion_from, moved
from naraha.systems.registration.verdict import judge
from pydrake.math import RigidTransform

from tests.registration.scans import CORRIDOR, ROOM, scan
from tests.rooms import pose

# Six motions about and along the axes of (1, 2, 3), of points 2 m around it, all but the first felt well.
HOLD = Hold(np.array([0.0, 0.1, 0.1, 0.1, 0.3, 0.3]), np.eye(6)[:, [3, 0, 1, 2, 4, 5]], np.array([1.0, 2.0, 3.0]), 2.0)
X_TS = pose(0.1, 0.2, 0.3, 0.02, 0.01, 0.05)
VARIANCE = 1e-4


def alignment(**changes):
    return Alignment(X_TS, 0.9, 0.01, 500, 500, HOLD, **{"variance": VARIANCE, **changes})


def fix(offset, deviation):
    return ClassFix(np.array([offset]), np.array([[deviation**2]]), True, 5.0, 10.0)


def error(X_true, result):
    """[roll, pitch, yaw, x, y, z] of the true pose from the result, as its covariance has it."""
    turn = (X_true.rotation() @ result.X_TS.rotation().inverse()).ToAngleAxis()
    return np.concatenate([turn.angle() * turn.axis(), X_true.translation() - result.X_TS.translation()])


def normalised(X_true, result):
    e = error(X_true, result)
    return e @ np.linalg.solve(result.covariance, e)


def test_motions_and_shares_are_each_others_inverse():
    shares = np.array([0.1, 0.002, -0.001, 0.003, -0.05, 0.07])
    X = moved(X_TS, HOLD, shares)
    np.testing.assert_allclose(motion_from(X_TS, X, HOLD), shares, atol=1e-5)
    assert moved(X, HOLD, motion_from(X, X_TS, HOLD)).IsNearlyEqualTo(X_TS, 1e-5)


def test_variances_are_the_residuals_over_the_part_that_is_felt():
    result = judge(alignment(), X_TS, None, RegistrationConfig())
    np.testing.assert_allclose([axis.deviation for axis in result.axes][1:], np.sqrt(VARIANCE / HOLD.values[1:]))
    assert result.axes[0].deviation == pytest.approx(RegistrationConfig().free_deviation)
    # About the centre turns and shifts are independent; a turn there shifts the origin of the source by its lever arm.
    R = np.sqrt(VARIANCE / 0.1) / 2.0  # [rad]
    np.testing.assert_allclose(np.diag(result.covariance)[:3], R**2)
    lever = X_TS.translation() - HOLD.centre
    expected = VARIANCE / 0.3 + R**2 * (lever[0] ** 2 + lever[2] ** 2)
    assert result.covariance[4, 4] == pytest.approx(expected)
    np.testing.assert_allclose(result.covariance, result.covariance.T, rtol=1e-9, atol=1e-15)


def test_a_motion_that_nothing_holds_is_the_guess_and_has_its_variance():
    guess = moved(X_TS, HOLD, np.array([0.25, 0.001, 0.0, 0.0, 0.02, 0.0]))
    result = judge(alignment(), guess, None, RegistrationConfig())
    np.testing.assert_allclose(motion_from(X_TS, result.X_TS, HOLD), [0.25, 0, 0, 0, 0, 0], atol=1e-4)
    assert result.axes[0].fixed_by == "guess"
    assert result.reason == "the geometry does not hold x: taken from the guess"
    told = judge(alignment(), guess, np.diag([1e-2] * 3 + [0.04] * 3), RegistrationConfig())
    assert told.axes[0].deviation == pytest.approx(0.2, rel=0.3)
    assert told.covariance[3, 3] > 0.2**2 * 0.5


def test_a_guess_with_covariance_is_weighed_like_any_measurement():
    """Half way along what the guess knows as well as the surfaces do, and not at all where it knows nothing."""
    shares = np.array([0.0, 0.0, 0.0, 0.0, 0.02, 0.0])
    guess = moved(X_TS, HOLD, shares)
    to_origin = HOLD.at_point(X_TS.translation())
    variances = np.full(6, 100.0)
    variances[4] = VARIANCE / 0.3
    result = judge(alignment(), guess, to_origin @ np.diag(variances) @ to_origin.T, RegistrationConfig())
    np.testing.assert_allclose(motion_from(X_TS, result.X_TS, HOLD), 0.5 * shares, atol=1e-5)
    assert result.axes[4].deviation == pytest.approx(np.sqrt(0.5 * VARIANCE / 0.3))


def test_classes_count_where_the_surfaces_do_not_and_only_there():
    result = judge(alignment(fix=fix(0.3, 0.05)), X_TS @ pose(0.5, z=0), None, RegistrationConfig())
    assert result.X_TS.IsNearlyEqualTo(X_TS, 1e-9)  # the alignment has moved along already
    assert result.axes[0].fixed_by == "classes"
    assert result.axes[0].deviation == pytest.approx(0.05)
    assert result.health > 0.8
    assert judge(alignment(), X_TS, None, RegistrationConfig()).health < 0.01


def test_noise_of_the_normals_does_not_hold_anything():
    values = np.array([0.004, 0.1, 0.1, 0.1, 0.3, 0.3])
    noisy = Hold(values, HOLD.motions, HOLD.centre, HOLD.radius)
    config = RegistrationConfig()
    held = judge(Alignment(X_TS, 0.9, 0.01, 500, 500, noisy, variance=VARIANCE), X_TS, None, config)
    assert held.axes[0].fixed_by == "geometry"
    free = judge(Alignment(X_TS, 0.9, 0.01, 500, 500, noisy, tilt=0.003, variance=VARIANCE), X_TS, None, config)
    assert free.axes[0].fixed_by == "guess"


def test_a_tight_guess_along_a_corridor_is_kept_and_a_wide_one_is_told():
    rng = np.random.default_rng(0)
    target, source = (scan(CORRIDOR, pose(x, 0.1, 1.0), rng, max_range=12) for x in (0.0, 0.5))
    for deviation in (0.05, 0.8):
        covariance = np.diag([0.1] * 3 + [deviation] * 3) ** 2
        result = register(source, target, pose(0.4, z=0), None, covariance)
        assert result.axes[0].fixed_by == "guess"
        assert result.axes[0].deviation == pytest.approx(deviation, rel=0.2)
        assert result.X_TS.translation()[0] == pytest.approx(0.4, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("organised", [True, False])
@pytest.mark.parametrize("noise", [0.005, 0.02])
def test_errors_are_as_large_as_the_covariance_says(organised, noise):
    """Normalised error squared is 6 on average for six degrees of freedom; within a factor of two of it here."""
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(60):
        X_WT = pose(rng.uniform(-2, 2), rng.uniform(-1, 1), 1.0, yaw=rng.uniform(-3, 3))
        X = pose(*rng.uniform(-0.3, 0.3, 2), 0.0, *rng.uniform(-0.02, 0.02, 2), rng.uniform(-0.15, 0.15))
        target = scan(ROOM, X_WT, rng, organised=organised, noise=noise)
        result = register(scan(ROOM, X_WT @ X, rng, organised=organised, noise=noise), target, RigidTransform())
        if result.valid:  # else it stands in the furniture
            squares.append(normalised(X, result))
    print(
        f"organised {organised}, noise {noise}: {len(squares)} scans, normalised error squared {np.mean(squares):.2f}"
    )
    assert len(squares) > 50
    assert 3 < np.mean(squares) < 12
    assert np.quantile(squares, 0.95) < 3 * 12.6
