"""A path on the ground and what follows from its points: length, direction, curvature."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..errors import InputError

# [m] A corner of a path is turned within this distance before and behind it.
_BLEND = 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class Path:
    """Points to be driven through in order, in the map frame M. Read-only. No point at all means that nothing is to do.

    Attributes:
        xy: (K, 2) [m].

    Raises:
        InputError: `xy` is not (K, 2) or not finite, is a single point, or a point repeats the one before.
    """

    xy: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        xy, where = np.array(self.xy, float), type(self).__name__
        if xy.ndim != 2 or xy.shape[1] != 2 or not np.isfinite(xy).all():
            raise InputError("not a path", where=where, key="xy", value=xy.shape, valid="(K, 2) finite")
        if len(xy) == 1:
            raise InputError("not a path", where=where, key="xy", value=xy.tolist(), valid="no or at least two points")
        repeated = np.linalg.norm(np.diff(xy, axis=0), axis=1) < 1e-9
        if repeated.any():
            at = int(np.argmax(repeated)) + 1
            raise InputError("point repeats the one before", where=where, key=f"xy[{at}]", value=xy[at].tolist())
        xy.flags.writeable = False
        object.__setattr__(self, "xy", xy)

    def __deepcopy__(self, memo: dict) -> "Path":
        return self

    @property
    def length_m(self) -> float:
        """[m], 0 without points."""
        return float(self.arc_length[-1]) if len(self.xy) else 0.0

    @cached_property
    def arc_length(self) -> np.ndarray:
        """(K,) [m] from the first point."""
        return np.append(0.0, np.cumsum(self._steps)) if len(self.xy) else np.zeros(0)

    @cached_property
    def curvature(self) -> np.ndarray:
        """(K,) [1/m], positive to the left, 0 at both ends: turn at a point by the length within which it is made.

        That is half of both sides where points lie close together, and less than 0.1 m of each at a lone corner.
        """
        curvature = np.zeros(len(self.xy))
        if len(self.xy) > 2:
            reach = np.minimum(0.5 * self._steps, _BLEND)
            curvature[1:-1] = np.diff(self._directions) / (reach[:-1] + reach[1:])
        return curvature

    @cached_property
    def _steps(self) -> np.ndarray:
        return np.asarray(np.linalg.norm(np.diff(self.xy, axis=0), axis=1))

    @cached_property
    def _directions(self) -> np.ndarray:
        return np.asarray(np.unwrap(np.arctan2(*np.diff(self.xy, axis=0).T[::-1])))

    @cached_property
    def _heading_knots(self) -> tuple[np.ndarray, np.ndarray]:
        """Arc lengths and headings: constant along a side but near its ends."""
        reach = np.minimum(0.5 * self._steps, _BLEND)
        knots = np.column_stack([self.arc_length[:-1] + reach, self.arc_length[1:] - reach])
        return knots.ravel(), np.repeat(self._directions, 2)

    @cached_property
    def _curvature_knots(self) -> tuple[np.ndarray, np.ndarray]:
        """Arc lengths and curvatures: those of the points, and zero in between where they are far apart."""
        apart = np.flatnonzero(self._steps > 2 * _BLEND)
        zeros = np.concatenate([self.arc_length[apart] + _BLEND, self.arc_length[apart + 1] - _BLEND])
        s = np.append(self.arc_length, zeros)
        order = np.argsort(s, kind="stable")
        return s[order], np.append(self.curvature, np.zeros(len(zeros)))[order]

    def at(self, s: float) -> np.ndarray:
        """(4,) x, y, heading and curvature at arc length `s` [m], which is clipped to the path [m, m, rad, 1/m]."""
        x, y = (np.interp(s, self.arc_length, values) for values in self.xy.T)
        return np.array([x, y, np.interp(s, *self._heading_knots), np.interp(s, *self._curvature_knots)])

    def nearest(self, xy: np.ndarray, low: float = 0.0, high: float = np.inf) -> tuple[float, float]:
        """Arc length of the point nearest to `xy` (2,) between `low` and `high` [m], and its distance [m]."""
        a, b, start = self.xy[:-1], self.xy[1:], self.arc_length[:-1]
        low, high = float(np.clip(low, 0.0, self.length_m)), float(np.clip(high, 0.0, self.length_m))
        share = ((xy - a) * (b - a)).sum(axis=1) / self._steps**2
        share = np.clip(share, np.clip((low - start) / self._steps, 0, 1), np.clip((high - start) / self._steps, 0, 1))
        distance = np.linalg.norm(a + share[:, None] * (b - a) - xy, axis=1)
        outside = (start + self._steps < low) | (start > high)
        best = int(np.argmin(np.where(outside, np.inf, distance)))
        return float(start[best] + share[best] * self._steps[best]), float(distance[best])
