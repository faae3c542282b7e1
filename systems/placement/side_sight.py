"""What the paper counts along ways: landmarks and sites that are seen to the left and to the right of every node."""

from dataclasses import dataclass, replace

import numpy as np

from .floor_plan import FloorPlan
from .follow_kernels import Sides
from .landmarks import LandmarkMap, sees_landmarks
from .topology import Topology


@dataclass(frozen=True, eq=False)
class SideSight:
    """What is seen from the nodes of all legs, each leg's first node left out. Read-only.

    Attributes:
        first: ((n + 1)² + 1,) where each leg's nodes begin.
        places: (m, 2) of the nodes in W [m].
        distance: (m, l + k) of the l landmarks of the plan and the k sites [m], negative to the right, infinite where
            they are not in sight.
        landmarks: l.
        reach: (m,) distance up to which a landmark counts [m].
        penalty: (m,) that a node costs for each side without a landmark.
    """

    first: np.ndarray
    places: np.ndarray
    distance: np.ndarray
    landmarks: int
    reach: np.ndarray
    penalty: np.ndarray

    def __deepcopy__(self, memo: dict) -> "SideSight":
        return self

    def sides(self) -> Sides:
        """What `sides_seen` takes."""
        near = np.abs(self.distance) <= self.reach[:, None]
        left, right = near & (self.distance >= 0), near & (self.distance < 0)
        own = self.landmarks
        bits = np.left_shift(np.int64(1), np.arange(self.distance.shape[1] - own, dtype=np.int64))
        words = [(side[:, own:] * bits).sum(axis=1).astype(np.int64) for side in (left, right)]
        return Sides(
            self.first, left[:, :own].any(axis=1), right[:, :own].any(axis=1), words[0], words[1], self.penalty
        )

    def harder(self, nodes: np.ndarray, shrink: float, penalty: float) -> "SideSight":
        """The same, but that at `nodes` (m,) bool landmarks count up to `shrink` times as far only, and a side without
        one costs `penalty` more."""
        reach = np.where(nodes, shrink * self.reach, self.reach)
        return replace(self, reach=reach, penalty=self.penalty + penalty * nodes)


def look_to_the_sides(
    plan: FloorPlan,
    topology: Topology,
    legs: list[np.ndarray],
    landmarks: LandmarkMap,
    sites: np.ndarray,
    side: float,
    reach: float,
) -> SideSight:
    """Looks for landmarks and sites from the nodes of all legs.

    Args:
        legs: nodes along each, none where there is no leg. sites: (k, 2) [m]. side: of a box [m]. reach: [m].
    """
    targets = np.vstack([landmarks.positions, sites])
    extent = np.concatenate([landmarks.extent, np.full(len(sites), side)])
    seen = sees_landmarks(plan, topology.nodes, targets, extent, reach)
    at = np.concatenate([path[1:] for path in legs if len(path)])
    before = np.concatenate([path[:-1] for path in legs if len(path)])
    places = topology.nodes[at]
    ahead, away = places - topology.nodes[before], targets[None] - places[:, None]
    to_left = ahead[:, None, 0] * away[..., 1] - ahead[:, None, 1] * away[..., 0] >= 0
    distance = np.where(seen[at], np.hypot(away[..., 0], away[..., 1]), np.inf)
    first = np.concatenate([[0], np.cumsum([max(len(path) - 1, 0) for path in legs])]).astype(np.int64)
    return SideSight(
        first,
        places,
        np.where(to_left, distance, -distance),
        len(landmarks.positions),
        np.full(len(at), reach),
        np.zeros(len(at)),
    )
