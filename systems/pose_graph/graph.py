"""The data of a pose graph, and how well poses fit it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import InputError
from .rigid import inverse, logarithm

ODOMETRY, REGISTRATION, LOOP, ATTITUDE = range(4)
KINDS = ("odometry", "registration", "loop", "attitude")
# Of [roll, pitch, yaw, x, y, z], what a planar graph has.
PLANAR = np.array([2, 3, 4])


class PoseGraphError(InputError):
    """A pose graph, or the file of one, is not usable."""


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """Poses and what was measured between them. Read-only: its arrays are frozen.

    Attributes:
        poses: X_WK of every pose K, (N, 4, 4).
        i, j: ends of every edge, (E,) int64. An attitude has i = j.
        X_ij: measured pose of j in i, (E, 4, 4); of an attitude only the rotation R_WK counts, and of it what gravity
            says, roll and pitch.
        information: inverse covariance of the error ξ in X_ij Exp(ξ) = truth, ξ = [roll, pitch, yaw, x, y, z], (E, 6,
            6). In a planar graph only yaw, x and y count. Of an attitude only the first two rows and columns do: turns
            about W's x and y axes.
        kind: ODOMETRY, REGISTRATION, LOOP or ATTITUDE, (E,) int64. Only loops can be refused.
        planar: all poses lie in the plane z = 0 and turn about z.
    """

    poses: np.ndarray
    i: np.ndarray
    j: np.ndarray
    X_ij: np.ndarray
    information: np.ndarray
    kind: np.ndarray
    planar: bool = False

    def __post_init__(self) -> None:
        count = np.size(self.i)
        shapes = {
            "poses": (-1, 4, 4), "i": (count,), "j": (count,), "X_ij": (count, 4, 4), "information": (count, 6, 6),
            "kind": (count,),
        }  # fmt: skip
        for name, shape in shapes.items():
            dtype = np.int64 if name in ("i", "j", "kind") else np.float64
            try:
                # A copy: a frozen view of an array that the caller goes on writing to would change all the same.
                array = np.array(getattr(self, name), dtype).reshape(shape)
            except ValueError:
                found = np.shape(getattr(self, name))
                raise PoseGraphError("wrong shape", where="PoseGraph", key=name, value=found, valid=shape) from None
            if not np.isfinite(array).all():
                raise PoseGraphError("not finite", where="PoseGraph", key=name)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        for name in ("i", "j"):
            ends = getattr(self, name)
            if count and (ends.min() < 0 or ends.max() >= len(self.poses)):
                raise PoseGraphError("no such pose", where="PoseGraph", key=name, valid=f"0 to {len(self.poses) - 1}")
        if (wrong := (self.i == self.j) != (self.kind == ATTITUDE)).any():
            raise PoseGraphError("only an attitude has one end", where="PoseGraph", key=f"edge {int(wrong.argmax())}")

    def __deepcopy__(self, memo: dict) -> "PoseGraph":
        return self

    @cached_property
    def loops(self) -> np.ndarray:
        """Indices of the edges that are loops."""
        return np.flatnonzero(self.kind == LOOP)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Inverse of `information`, (E, 6, 6); in a planar graph 1 for what it has not."""
        if not self.planar:
            return np.linalg.inv(self.information)
        result = np.tile(np.eye(6), (len(self.i), 1, 1))
        block = np.ix_(np.arange(len(self.i)), PLANAR, PLANAR)
        result[block] = np.linalg.inv(self.information[block])
        return result

    def with_poses(self, poses: np.ndarray) -> "PoseGraph":
        """The same edges between other poses, (N, 4, 4)."""
        return replace(self, poses=poses)

    def with_edges(self, keep: np.ndarray) -> "PoseGraph":
        """The same poses with only these edges, a mask (E,) or indices."""
        return replace(
            self, i=self.i[keep], j=self.j[keep], X_ij=self.X_ij[keep], information=self.information[keep],
            kind=self.kind[keep],
        )  # fmt: skip


def residuals(graph: PoseGraph, poses: np.ndarray | None = None) -> np.ndarray:
    """Errors of the edges, (E, 6): ξ = Log(X_ij⁻¹ X_Wi⁻¹ X_Wj) or, of an attitude, turns about W's x and y axes."""
    X = graph.poses if poses is None else poses
    error = logarithm(inverse(graph.X_ij) @ inverse(X[graph.i]) @ X[graph.j])
    tilted = graph.kind == ATTITUDE
    if tilted.any():
        # Where the measured up points in W with the estimated pose: (0, 0, 1) when both agree.
        up_K = graph.X_ij[tilted, 2, :3]
        up_W = np.einsum("nij,nj->ni", X[graph.i[tilted], :3, :3], up_K)
        error[tilted] = 0.0
        error[tilted, 0], error[tilted, 1] = -up_W[:, 1], up_W[:, 0]
    return error


def chi_squared(graph: PoseGraph, poses: np.ndarray | None = None) -> np.ndarray:
    """ξᵀ Ω ξ of every edge, (E,); their sum is what the optimum makes smallest (gtsam's BetweenFactor, times two)."""
    error = residuals(graph, poses)
    used = PLANAR if graph.planar else np.arange(6)
    information = graph.information[:, used[:, None], used]
    return np.einsum("ni,nij,nj->n", error[:, used], information, error[:, used])


def chain(graph: PoseGraph) -> np.ndarray:
    """Index of the odometry or registration edge from pose k to k + 1, (N − 1,); the most certain where there are two.

    Raises:
        PoseGraphError: two successive poses are not joined.
    """
    steps = np.flatnonzero((graph.j - graph.i == 1) & ((graph.kind == ODOMETRY) | (graph.kind == REGISTRATION)))
    used = PLANAR if graph.planar else np.arange(6)
    _, weight = np.linalg.slogdet(graph.information[steps][:, used[:, None], used])
    result = np.full(max(len(graph.poses) - 1, 0), -1)
    order = np.argsort(weight, kind="stable")
    result[graph.i[steps[order]]] = steps[order]
    if (result < 0).any():
        k = int((result < 0).argmax())
        raise PoseGraphError(f"no odometry from pose {k} to {k + 1}", where="PoseGraph")
    return result


def dead_reckoning(graph: PoseGraph) -> np.ndarray:
    """Poses from the first one and the `chain` alone, (N, 4, 4)."""
    steps = graph.X_ij[chain(graph)]
    poses = np.empty((len(graph.poses), 4, 4))
    poses[:1] = graph.poses[:1]
    for k, step in enumerate(steps):
        poses[k + 1] = poses[k] @ step
    # Rounding of thousands of products; one Newton step towards a rotation is enough.
    R = poses[:, :3, :3]
    poses[:, :3, :3] = 1.5 * R - 0.5 * R @ np.swapaxes(R, -1, -2) @ R
    return poses


def kind_names(kind: np.ndarray) -> Sequence[str]:
    """The words for an array of kinds."""
    return [KINDS[k] for k in kind]
