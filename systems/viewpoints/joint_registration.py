"""Poses of several overlapping views at once, by point-to-plane least squares over all of their pairs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from ..clouds import transform_points
from ..config import quantity
from .viewpoint import Viewpoint


@dataclass(kw_only=True)
class JointRegistrationConfig:
    """How the poses of several views are refined together."""

    # [m] Largest distance of a point to the plane of its partner in the other view, stage by stage.
    max_distances: list[float] = quantity([0.6, 0.2, 0.06, 0.04], unit="m", above=0)
    # [m] A plane goes on this far around a point that has a normal: rings on a floor lie metres apart.
    reach: float = quantity(0.6, unit="m", above=0)
    # [-] Gauss-Newton steps of each stage at most; it ends earlier when nothing moves by `tolerance`.
    max_iterations: int = quantity(12, unit="iterations", low=1)
    # [m], [rad] Step below which a stage has converged.
    tolerance: float = quantity(1e-4, unit="m", above=0)
    # [-] Every how many-th point of a view looks for a partner.
    stride: int = quantity(1, unit="points", low=1)
    # [deg] Normals of a point and its partner that differ by more belong to different surfaces.
    max_normal_angle_deg: float = quantity(35.0, unit="deg", above=0, high=90)
    # [deg] Standard deviation of a view's levelling.
    tilt_deviation_deg: float = quantity(0.5, unit="deg", above=0)
    # [m] Standard deviation of one view's floor from the plane of another's, where the surfaces say less.
    floor_deviation: float = quantity(0.02, unit="m", above=0)
    # [m] Floors farther apart than this are different floors.
    floor_gate: float = quantity(0.3, unit="m", above=0)
    # [points] How many pairs have their errors in common: neighbours share a normal. With this, the squared error over
    # the covariance averages 1.1 a degree of freedom in 40 simulated stair halls, but in one a height is 6 sigma off.
    pairs_per_sample: float = quantity(20.0, unit="points", above=0)


@dataclass(frozen=True, eq=False)
class JointRegistration:
    """The result of `register_jointly`.

    Attributes:
        poses: X_MV of every view; the first given is held.
        covariances: (6, 6) of every view, of small turns about and shifts along M's axes at the view's origin, in the
            order roll, pitch, yaw, x, y, z [rad, m]; zero for the one that is held.
        pairs: number of point pairs within the last distance.
        rmse: their weighted root mean square distance to the planes [m].
    """

    poses: dict[int, RigidTransform]
    covariances: dict[int, np.ndarray]
    pairs: int
    rmse: float


def register_jointly(
    views: Mapping[int, Viewpoint],
    poses: Mapping[int, RigidTransform],
    edges: Sequence[tuple[int, int]],
    config: JointRegistrationConfig | None = None,
) -> JointRegistration:
    """Refines the poses X_MV of `views`, starting at `poses`; the first key of `poses` is held.

    Minimises Σ w (n·(X_i p − X_j q))² over all points p of view i and the planes (q, n) nearest to them in view j, for
    both directions of every edge, with Tukey's weights w that end at the distance of the stage; and weakly that views
    stay level, and that two floors near to one plane are one, because views metres apart share little of it. Partners
    are found anew at every Gauss-Newton step. Points of which the normals disagree are no partners, so the far side of
    a thin wall does not pull.

    Args:
        edges: pairs of views that overlap.
    """
    config = config or JointRegistrationConfig()
    keys = list(poses)
    X = dict(poses)
    H = np.eye(6 * len(keys))
    pairs, rmse = 0, float("inf")
    for distance in config.max_distances:
        for _ in range(config.max_iterations):
            H, g, pairs, rmse = _normal_equations(views, X, edges, keys, distance, config)
            step = np.zeros(6 * len(keys))
            step[6:] = -np.linalg.solve(H[6:, 6:], g[6:])
            for index, key in enumerate(keys):
                turn, shift = step[6 * index : 6 * index + 3], step[6 * index + 3 : 6 * index + 6]
                R = RotationMatrix(Rotation.from_rotvec(turn).as_matrix())
                p_MV = X[key].translation()
                X[key] = RigidTransform(
                    RotationMatrix.ProjectToRotationMatrix((R @ X[key].rotation()).matrix()), p_MV + shift
                )
            if np.abs(step).max() < config.tolerance:
                break
    covariance = np.linalg.inv(H[6:, 6:])
    covariances = {keys[0]: np.zeros((6, 6))}
    for index, key in enumerate(keys[1:]):
        covariances[key] = covariance[6 * index : 6 * index + 6, 6 * index : 6 * index + 6]
    return JointRegistration(X, covariances, pairs, rmse)


def _normal_equations(
    views: Mapping[int, Viewpoint],
    X: Mapping[int, RigidTransform],
    edges: Sequence[tuple[int, int]],
    keys: list[int],
    distance: float,
    config: JointRegistrationConfig,
) -> tuple[np.ndarray, np.ndarray, int, float]:
    """Hessian and gradient of minus the log-likelihood, over turns and shifts of every view about its own origin."""
    size = 6 * len(keys)
    H, g = np.zeros((size, size)), np.zeros(size)
    pairs, total, error = 0, 0.0, 0.0
    directed = [way for edge in edges for way in (edge, edge[::-1])]

    def add(i: int, j: int, r: np.ndarray, normals: np.ndarray, p_M: np.ndarray, w: np.ndarray) -> None:
        """Adds Σ w r², r = n·(p − q), where p moves with view i, and the plane (q, n) with view j."""
        a, b = (slice(6 * keys.index(key), 6 * keys.index(key) + 6) for key in (i, j))
        J = {
            place: sign * np.hstack([np.cross(p_M - X[key].translation(), normals), normals])
            for place, key, sign in ((a, i, 1.0), (b, j, -1.0))
        }
        for row, J_row in J.items():
            weighted = (J_row * w[:, None]).T
            g[row] += weighted @ r
            for column, J_column in J.items():
                H[row, column] += weighted @ J_column

    for i, j in directed:
        r, normals, p_M = _partners(views[i], views[j], X[i], X[j], distance, config)
        w = np.square(1 - np.square(r / distance))
        add(i, j, r, normals, p_M, w)
        pairs, total, error = pairs + len(r), total + float(w.sum()), error + float((w * r * r).sum())
    variance = max(error / max(total, 1.0), 1e-8)
    H /= variance * config.pairs_per_sample
    g /= variance * config.pairs_per_sample
    for i, j in directed:
        r, normals, p_M = _floor_gaps(views[i], views[j], X[i], X[j], config)
        add(i, j, r, normals, p_M, np.full(len(r), config.floor_deviation**-2 / max(len(r), 1)))
    tilt = np.deg2rad(config.tilt_deviation_deg) ** -2
    for k, key in enumerate(keys):
        up = X[key].rotation().matrix()[:, 2]
        # The ones, deviations of 1 rad and 1 m, only keep it solvable where two views have no partners.
        H[range(6 * k, 6 * k + 6), range(6 * k, 6 * k + 6)] += [tilt, tilt, 1.0, 1.0, 1.0, 1.0]
        g[6 * k : 6 * k + 2] += [-tilt * up[1], tilt * up[0]]  # a turn (a, b) about x and y moves z by (b, -a)
    return H, g, pairs, float(np.sqrt(variance)) if total > 0 else float("inf")


def _floor_gaps(
    source: Viewpoint, target: Viewpoint, X_MS: RigidTransform, X_MT: RigidTransform, config: JointRegistrationConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `_partners`, for four points of the source's floor 2 m around its origin and the plane of the target's."""
    if source.floor_plane is None or target.floor_plane is None:
        return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))
    x, y = 2.0 * np.array([[1, 0, -1, 0], [0, 1, 0, -1]])
    a, b, c = source.floor_plane
    p_M = transform_points(X_MS.GetAsMatrix4(), np.column_stack([x, y, a * x + b * y + c]))
    a, b, c = target.floor_plane
    n_T = np.array([-a, -b, 1.0]) / np.sqrt(a * a + b * b + 1)
    r = (transform_points(X_MT.inverse().GetAsMatrix4(), p_M) - [0, 0, c]) @ n_T
    if np.abs(r).max() > config.floor_gate:
        return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))
    return r, np.tile(X_MT.rotation().matrix() @ n_T, (4, 1)), p_M


def _partners(
    source: Viewpoint,
    target: Viewpoint,
    X_MS: RigidTransform,
    X_MT: RigidTransform,
    distance: float,
    config: JointRegistrationConfig,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances (K,) of source points to the planes of their partners, the planes' normals and the points, in M."""
    X_TS = X_MT.inverse() @ X_MS
    p_S, n_S = source.points[:: config.stride], source.normals[:: config.stride]
    p_T = transform_points(X_TS.GetAsMatrix4(), p_S)
    apart, partner = target.tree.query(p_T, distance_upper_bound=max(distance, config.reach))
    keep = np.flatnonzero(np.isfinite(apart))
    p_T, partner = p_T[keep], partner[keep]
    n_T, own = target.normals[partner], n_S[keep] @ X_TS.rotation().matrix().T
    angle = np.cos(np.deg2rad(config.max_normal_angle_deg))
    plane = (n_T != 0).any(axis=1) & (~(own != 0).any(axis=1) | ((n_T * own).sum(axis=1) > angle))
    p_T, n_T, q_T = p_T[plane], n_T[plane], target.points[partner[plane]]
    r = ((p_T - q_T) * n_T).sum(axis=1)
    near = np.abs(r) < distance
    return r[near], n_T[near] @ X_MT.rotation().matrix().T, transform_points(X_MT.GetAsMatrix4(), p_T[near])
