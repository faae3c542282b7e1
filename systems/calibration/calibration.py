"""Extrinsic calibration of a camera from points of the depth camera and their pixels, by least squares on SE(3)."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform

from ..config import check_config, quantity
from ..errors import CameraError
from ..sensing.camera_model import CameraModel
from .linear_pose import linear_pose
from .pose_fit import (
    Calibration,
    HoldConfig,
    change_between,
    changed,
    covariance_of,
    head_rotations,
    held_directions,
    point_jacobian,
    ray_jacobian,
    unfitted,
    unheld_in_words,
)

# Of a Gaussian in two dimensions: median distance, and the distance that one in 500 exceeds, over the deviation.
_MEDIAN, _OUTLIER = 1.1774, 3.5
# Width at which Cauchy's kernel keeps 95 % of the efficiency of least squares.
_CAUCHY = 2.385


@dataclass(kw_only=True)
class CalibrationConfig:
    """How a pose is fitted to pairs of points and pixels."""

    # [pairs] Fewer usable ones are not enough: six numbers are sought and each pair gives two.
    min_pairs: int = quantity(6, unit="pairs", low=4)
    # [-] Share of the pairs that has to agree with the result.
    min_inliers: float = quantity(0.5, unit="-", above=0, high=1)
    # [px] A larger root mean square error of those that agree means that the pairs belong to no pose.
    max_rms_px: float = quantity(10.0, unit="px", above=0)
    # [iterations] Each is one change of the error's scale with at most ten steps of Levenberg and Marquardt.
    iterations: int = quantity(12, unit="iterations", low=1)
    hold: HoldConfig = field(default_factory=HoldConfig)


@dataclass(frozen=True, eq=False)
class Pairs:
    """N points seen by the depth camera D and their pixels in V images.

    Attributes:
        p_DP: (N, 3) [m].
        xy: where the rays of the pixels meet the plane z = 1 of the camera, (N, 2).
        px: how the pixel moves with that, d(u, v) / d(x, y), (N, 2, 2) [px].
        R_NH: rotation of the pan-tilt's head for every pair, (N, 3, 3).
    """

    p_DP: np.ndarray
    xy: np.ndarray
    px: np.ndarray
    R_NH: np.ndarray

    def __getitem__(self, chosen: np.ndarray) -> "Pairs":
        return Pairs(self.p_DP[chosen], self.xy[chosen], self.px[chosen], self.R_NH[chosen])


def calibrate_from_correspondences(
    p_DP: np.ndarray,
    uv: np.ndarray,
    camera: CameraModel,
    X_HC_guess: RigidTransform | None = None,
    *,
    sigma_px: float = 0.5,
    view: np.ndarray | None = None,
    pan_tilt: np.ndarray | None = None,
    X_DN: RigidTransform | None = None,
    estimate_mount: bool = False,
    config: CalibrationConfig | None = None,
) -> Calibration:
    """Pose of a camera from points in the depth camera's frame D and the pixels where it sees them.

    Eq. 1 of S0-a is m ≅ A X_CD p_D with X_DC = X_DN R_NH(pan, tilt) X_HC, in which the pan-tilt's angles give R_NH.
    The sum of squared pixel errors is made least over X_HC, and over the mount X_DN as well with `estimate_mount`, by
    Levenberg and Marquardt on SE(3) with analytic derivatives. Cauchy's kernel, whose width follows the median
    error, takes care of up to about 40 % of wrong pairs; the last steps use the pairs that agree, with equal weights.

    A direction that the pairs hold less firmly than `config.hold` says keeps the guess (the linear start if there is
    none); `reason` names it and the covariance shows it. Points on a line leave the turn about that line open,
    a narrow bundle of rays to points at one depth the shift along it. Telling X_DN from X_HC takes both angles.

    Args:
        p_DP: points, (N, 3) [m]. Pairs with a number that is not finite are left out.
        uv: their pixels, (N, 2).
        X_HC_guess: camera in the head, or in D for a fixed camera. Without it, a linear solution is the start.
        sigma_px: standard deviation of a pixel coordinate [px]; the fit may show a larger one, which then counts.
        view: image of every pair, (N,), index into `pan_tilt`; the only one when not given.
        pan_tilt: angles of the pan-tilt at every image, (V, 2), pan left + and tilt down + [rad]; zero when not given.
        X_DN: mount in D, as a guess when it is estimated; identity when not given.

    Raises:
        CameraError: shapes do not fit each other, `view` is out of range or `sigma_px` is not positive.
        ConfigError: a value of the configuration is out of range.
    """
    config = config or CalibrationConfig()
    check_config(config)
    X_DN = X_DN or RigidTransform()
    size = 12 if estimate_mount else 6
    pairs = _checked_pairs(p_DP, uv, camera, view, pan_tilt, sigma_px)
    if len(pairs.p_DP) < config.min_pairs:
        reason = f"only {len(pairs.p_DP)} usable pairs, needs {config.min_pairs}"
        return unfitted(X_HC_guess or RigidTransform(), X_DN, size, config.hold, reason)
    if X_HC_guess is None:
        X_HC_guess = linear_pose(_in_head(X_DN, pairs), pairs.xy)
        if X_HC_guess is None:
            reason = "no guess, and no linear solution: the points are on a line or inconsistent"
            return unfitted(RigidTransform(), X_DN, size, config.hold, reason)
    return _fit((X_HC_guess, X_DN), pairs, sigma_px, size, config)


def pixel_errors(X_HC: RigidTransform, X_DN: RigidTransform, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
    """Errors (N, 2) [px], predicted less seen, and their derivatives (N, 2, 12) after the changes of X_HC and X_DN.

    Errors of points that are not in front of the camera are infinite, their derivatives zero.
    """
    p_NP = (pairs.p_DP - X_DN.translation()) @ X_DN.rotation().matrix()
    p_HP = np.einsum("nji,nj->ni", pairs.R_NH, p_NP)
    R_HC = X_HC.rotation().matrix()
    p_CP = (p_HP - X_HC.translation()) @ R_HC
    ahead = p_CP[:, 2] > 1e-3
    p_CP[~ahead] = [0, 0, 1]
    error = np.einsum("nij,nj->ni", pairs.px, p_CP[:, :2] / p_CP[:, 2:] - pairs.xy)
    J_C = pairs.px @ ray_jacobian(p_CP)
    R_CN = np.einsum("ji,nkj->nik", R_HC, pairs.R_NH)
    J = np.concatenate([J_C @ point_jacobian(p_CP), J_C @ R_CN @ point_jacobian(p_NP)], axis=2)
    error[~ahead], J[~ahead] = np.inf, 0
    return error, J


def _fit(
    guess: tuple[RigidTransform, RigidTransform], pairs: Pairs, sigma: float, size: int, config: CalibrationConfig
) -> Calibration:
    scale = config.hold.scale(size)
    X, spread = guess, np.inf
    for _ in range(config.iterations):
        before, spread = spread, _spread(pixel_errors(*X, pairs)[0], sigma)
        X = _descend(X, pairs, _CAUCHY * spread, sigma, scale)
        if abs(before - spread) < 1e-3 * spread:
            break
    for _ in range(3):
        distance = np.linalg.norm(pixel_errors(*X, pairs)[0], axis=1)
        spread = _spread(distance, sigma)
        agree = distance <= _OUTLIER * spread
        # Directions that were thought to be held, before the errors were known to be so large, go back to the guess.
        information = _information(X, pairs[agree], size) / spread**2
        values, directions = held_directions(information, scale)
        change = np.concatenate([change_between(a, b) for a, b in zip(guess, X, strict=True)])[:size]
        unheld = directions[:, values < 1]
        X = _moved(X, -scale * (unheld @ (unheld.T @ (change / scale))))
        X = _descend(X, pairs[agree], np.inf, spread, scale)
    error = np.linalg.norm(pixel_errors(*X, pairs)[0], axis=1)
    agree = error <= _OUTLIER * spread
    count = int(agree.sum())
    rms = float(np.sqrt(np.mean(error[agree] ** 2))) if count else float("inf")
    if count < max(config.min_pairs, config.min_inliers * len(error)):
        return unfitted(*guess, size, config.hold, f"only {count} of {len(error)} pairs agree with a pose")
    if rms > config.max_rms_px:
        return unfitted(*guess, size, config.hold, f"no pose fits: {rms:.0f} px, allowed {config.max_rms_px:g} px")
    excess = max(1.0, rms * np.sqrt(count / (2 * count - size)) / sigma)
    information = _information(X, pairs[agree], size) / (excess * sigma) ** 2
    reason = unheld_in_words(*held_directions(information, scale))
    return Calibration(*X, covariance_of(information, scale), rms, count, True, reason)


def _descend(
    X: tuple[RigidTransform, RigidTransform], pairs: Pairs, width: float, sigma: float, scale: np.ndarray
) -> tuple[RigidTransform, RigidTransform]:
    """At most ten steps of Levenberg and Marquardt along the directions that errors of `sigma` leave held."""
    size = len(scale)
    damping = 1e-6
    error, J = pixel_errors(*X, pairs)
    for _ in range(10):
        seen = np.isfinite(error[:, 0])
        e, slopes = error[seen], J[seen, :, :size] * scale
        weight = 1 / (1 + (e**2).sum(axis=1) / width**2)
        information = np.einsum("n,nij,nik->jk", weight, slopes, slopes)
        gradient = np.einsum("n,nij,ni->j", weight, slopes, e)
        values, directions = np.linalg.eigh(information)
        held = values >= sigma**2
        directions, values = directions[:, held], values[held]
        accepted = False
        while not accepted and damping < 1e6:
            step = -directions @ ((directions.T @ gradient) / (values * (1 + damping)))
            X_new = _moved(X, scale * step)
            error_new, J_new = pixel_errors(*X_new, pairs)
            accepted = _cost(error_new, width) <= _cost(error, width)
            damping = damping / 10 if accepted else max(damping, 1e-3) * 10
        if not accepted:
            return X
        X, error, J = X_new, error_new, J_new
        if np.abs(step).max(initial=0) < 1e-7:
            return X
    return X


def _cost(error: np.ndarray, width: float) -> float:
    """Sum of Cauchy's kernel, or of squares for an infinite width; a point behind the camera counts as 1000 widths."""
    square = np.minimum((error**2).sum(axis=1), 1e6 * width**2 if np.isfinite(width) else 1e12)
    return float((width**2 * np.log1p(square / width**2)).sum() if np.isfinite(width) else square.sum())


def _spread(error: np.ndarray, sigma: float) -> float:
    """Standard deviation of a pixel coordinate, from the median error of the pairs; not less than `sigma`."""
    distance = np.linalg.norm(error, axis=1) if error.ndim == 2 else error
    median = float(np.median(distance))
    return max(sigma, median / _MEDIAN) if np.isfinite(median) else 1e3 * sigma


def _information(X: tuple[RigidTransform, RigidTransform], pairs: Pairs, size: int) -> np.ndarray:
    slopes = pixel_errors(*X, pairs)[1][:, :, :size]
    return np.asarray(np.einsum("nij,nik->jk", slopes, slopes))


def _moved(X: tuple[RigidTransform, RigidTransform], change: np.ndarray) -> tuple[RigidTransform, RigidTransform]:
    return changed(X[0], change[:6]), changed(X[1], change[6:]) if len(change) == 12 else X[1]


def _in_head(X_DN: RigidTransform, pairs: Pairs) -> np.ndarray:
    p_NP = (pairs.p_DP - X_DN.translation()) @ X_DN.rotation().matrix()
    return np.asarray(np.einsum("nji,nj->ni", pairs.R_NH, p_NP))


def _checked_pairs(
    p_DP: np.ndarray,
    uv: np.ndarray,
    camera: CameraModel,
    view: np.ndarray | None,
    pan_tilt: np.ndarray | None,
    sigma_px: float,
) -> Pairs:
    p_DP, uv = np.asarray(p_DP, float), np.asarray(uv, float)
    angles = np.zeros((1, 2)) if pan_tilt is None else np.asarray(pan_tilt, float)
    view = np.zeros(len(p_DP), int) if view is None else np.asarray(view, int)
    where = "calibration"
    if p_DP.ndim != 2 or p_DP.shape[1] != 3:
        raise CameraError("wrong shape", where=where, key="p_DP", value=p_DP.shape, valid="(N, 3)")
    if uv.shape != (len(p_DP), 2):
        raise CameraError("wrong shape", where=where, key="uv", value=uv.shape, valid=f"({len(p_DP)}, 2)")
    if angles.ndim != 2 or angles.shape[1] != 2 or not np.isfinite(angles).all():
        raise CameraError("not angles", where=where, key="pan_tilt", value=angles.shape, valid="finite, (V, 2)")
    if view.shape != (len(p_DP),) or not ((view >= 0) & (view < len(angles))).all():
        raise CameraError("no such image", where=where, key="view", valid=f"({len(p_DP)},) in 0 … {len(angles) - 1}")
    if not (np.isfinite(sigma_px) and sigma_px > 0):
        raise CameraError("out of range", where=where, key="sigma_px", value=sigma_px, valid="> 0 px")
    usable = np.isfinite(p_DP).all(axis=1) & np.isfinite(uv).all(axis=1)
    p_DP, uv, view = p_DP[usable], uv[usable], view[usable]
    xy = camera.undistort(uv)
    return Pairs(p_DP, xy, pixels_per_ray(camera, xy), head_rotations(angles)[view])


def pixels_per_ray(camera: CameraModel, xy: np.ndarray) -> np.ndarray:
    """d(u, v) / d(x, y) of a camera at rays through (x, y, 1), (N, 2, 2) [px], by central differences."""
    columns = []
    for step in 1e-5 * np.eye(2):
        ends = [camera.project(np.column_stack([xy + s * step, np.ones(len(xy))]))[0] for s in (1, -1)]
        columns.append((ends[0] - ends[1]) / 2e-5)
    return np.stack(columns, axis=2)
