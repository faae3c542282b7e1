"""Edge points of depth images matched with edge pixels of other images, for `edge_calibration`."""

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from scipy.spatial import cKDTree

from ..sensing.camera_model import CameraModel
from .calibration import pixels_per_ray
from .edge_points import ImageEdges
from .pose_fit import point_jacobian, ray_jacobian

# Width at which Cauchy's kernel keeps 95 % of the efficiency of least squares.
_CAUCHY = 2.385
# [-] Share of the error variance that points on one straight piece of edge have in common.
_ALIKE = 0.05


@dataclass(frozen=True, eq=False)
class EdgeProblem:
    """Edge points of all views in the head's frame, and the image edges that they are compared with."""

    camera: CameraModel
    view: np.ndarray
    p_HP: np.ndarray
    t_HP: np.ndarray
    group: np.ndarray
    images: list[ImageEdges]

    def project(self, X_HC: RigidTransform) -> tuple[np.ndarray, ...]:
        """Points in C, pixels, unit directions of the edges in the image, and which of them are in the image."""
        R_HC = X_HC.rotation().matrix()
        p_CP = (self.p_HP - X_HC.translation()) @ R_HC
        uv, inside = self.camera.project(p_CP)
        other, _ = self.camera.project(p_CP + self.t_HP @ R_HC)
        along = other - uv
        length = np.linalg.norm(along, axis=1)
        inside &= length > 1e-6
        return p_CP, uv, along / np.maximum(length, 1e-6)[:, None], inside


@dataclass(frozen=True, eq=False)
class EdgeMatch:
    """M pairs of edge points: index of the point, error across the image's edge [px], derivative (M, 6), weight."""

    point: np.ndarray
    error: np.ndarray
    J: np.ndarray
    weight: np.ndarray


class EdgeMatcher:
    """Finds for projected edge points the nearest edge pixel of the same view with a similar direction."""

    def __init__(self, problem: EdgeProblem):
        self.problem = problem
        self._uv = np.vstack([edges.uv for edges in problem.images])
        self._normal = np.vstack([edges.normal for edges in problem.images])
        view = np.repeat(np.arange(len(problem.images)), [len(edges.uv) for edges in problem.images])
        self._far = 10.0 * max(problem.camera.shape)
        self._flat = np.column_stack([self._uv[:, 0] + self._far * view, self._uv[:, 1]])
        # cos and sin of twice the angle: edges have no front.
        n = self._normal
        self._turn = np.column_stack([n[:, 0] ** 2 - n[:, 1] ** 2, 2 * n[:, 0] * n[:, 1]])
        self._trees: dict[float, cKDTree] = {}

    def match(self, X_HC: RigidTransform, reach_px: float) -> EdgeMatch:
        """Pairs that are at most `reach_px` apart; a turn of 30° alone counts as that much too."""
        problem = self.problem
        if reach_px not in self._trees:
            self._trees[reach_px] = cKDTree(np.hstack([self._flat, reach_px * self._turn]))
        p_CP, uv, along, inside = problem.project(X_HC)
        points = np.flatnonzero(inside)
        along, at = (
            along[points],
            uv[points] + np.column_stack([self._far * problem.view[points], np.zeros(len(points))]),
        )
        turn = np.column_stack([along[:, 1] ** 2 - along[:, 0] ** 2, -2 * along[:, 0] * along[:, 1]])
        _, nearest = self._trees[reach_px].query(np.hstack([at, reach_px * turn]), distance_upper_bound=reach_px)
        found = nearest < len(self._uv)
        points, nearest = points[found], nearest[found]
        normal = self._normal[nearest]
        error = ((uv[points] - self._uv[nearest]) * normal).sum(axis=1)
        px = pixels_per_ray(problem.camera, p_CP[points, :2] / p_CP[points, 2:])
        across = np.einsum("ni,nij,njk->nk", normal, px, ray_jacobian(p_CP[points]))
        J = np.einsum("nk,nkl->nl", across, point_jacobian(p_CP[points]))
        spread = max(float(np.median(np.abs(error))) / 0.6745, 0.2) if len(error) else 1.0
        return EdgeMatch(points, error, J, 1 / (1 + (error / (_CAUCHY * spread)) ** 2))

    def score(self, X_HC: RigidTransform) -> float:
        """Number of points with a partner within two pixels, near ones counting more, those of one piece less."""
        match = self.match(X_HC, 2.0)
        return float((_piece_share(self.problem, match) * (1 - np.minimum((match.error / 2) ** 2, 1))).sum())


def piece_weight(problem: EdgeProblem, match: EdgeMatch) -> np.ndarray:
    """Weight of every match when points on one straight piece of edge share a part of their error, (M,)."""
    return np.asarray(match.weight * _piece_share(problem, match))


def _piece_share(problem: EdgeProblem, match: EdgeMatch) -> np.ndarray:
    group = problem.group[match.point]
    return np.asarray(1 / (1 + _ALIKE * np.bincount(group)[group]))


def information_of(problem: EdgeProblem, match: EdgeMatch, scale: np.ndarray) -> np.ndarray:
    """Inverse covariance of what the matches alone say, with errors that points on one straight piece of edge share.

    The covariance is the mean of two estimates: that of leaving out one piece after the other, and that of a common
    variance of all pieces.
    """
    slopes = match.J * scale
    weight = piece_weight(problem, match)
    _, piece, size = np.unique(problem.group[match.point], return_inverse=True, return_counts=True)
    count = len(size)
    shared = np.bincount(piece, match.weight * match.error) / np.bincount(piece, match.weight)
    own = float(np.average((match.error - shared[piece]) ** 2, weights=match.weight))
    common = float(np.average(shared**2, weights=size / (1 + _ALIKE * size))) * count / max(count - 6, 1)
    parts, leans, pulls = np.zeros((count, 6, 6)), np.zeros((count, 6)), np.zeros((count, 6))
    np.add.at(parts, piece, weight[:, None, None] * slopes[:, :, None] * slopes[:, None, :])
    np.add.at(leans, piece, slopes * weight[:, None])
    np.add.at(pulls, piece, slopes * (weight * match.error)[:, None])
    # A direction that one piece alone holds is known as well as the guess once that is left out.
    A = parts.sum(axis=0) + max(own, 1e-4) * np.eye(6)
    moved = np.linalg.solve(A - parts, pulls[:, :, None])[:, :, 0]
    inverse = np.linalg.inv(A)
    noise = common * leans.T @ leans + own * (slopes.T * weight**2) @ slopes + max(own, 1e-4) * np.eye(6)
    covariance = (moved.T @ moved + inverse @ noise @ inverse) / 2
    return np.asarray(np.linalg.inv(covariance) / np.outer(scale, scale))
