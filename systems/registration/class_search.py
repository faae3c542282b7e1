"""Looks for offsets along one or two motions at which the classes of two clouds agree."""

from dataclasses import dataclass, replace

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from .class_lanes import LEVELS, Cells, Floats, Ints, LaneGrid, cells_of, lane_grid
from .class_peak import (
    ClassCorrelationConfig,
    Peak,
    Profile,
    block_numbers,
    class_profile,
    evidence_table,
    find_peak,
    lead,
    leads,
)

# [m] Interval of the last searches along each of two motions.
_FINE_SPAN = 0.4


@dataclass(frozen=True, eq=False)
class Found:
    """Offsets (m,) [m], their covariance (m, m), contrast, evidence and reason as in `ClassFix`."""

    offsets: Floats
    covariance: Floats
    contrast: float
    evidence: float
    reason: str


def pose_along(motion: np.ndarray, offset: float, centre: np.ndarray) -> RigidTransform:
    """`motion` (6,) of the point `centre` gone along for `offset`: turns stay turns, turn and shift make a helix."""
    turn, shift = offset * motion[:3], offset * motion[3:]
    angle = float(np.linalg.norm(turn))
    R = Rotation.from_rotvec(turn).as_matrix()
    if angle > 1e-9:  # the centre goes along a helix
        axis = turn / angle
        across = np.cross(axis, shift)
        shift = (
            axis * (axis @ shift)
            + np.sin(angle) / angle * (shift - axis * (axis @ shift))
            + (1 - np.cos(angle)) / angle * across
        )
    return RigidTransform(RotationMatrix(R), centre - R @ centre + shift)


@dataclass(frozen=True, eq=False)
class Search:
    """The two clouds and the motions, `twists` (m, 6), along which offsets are in metres; see `correlate_classes`.

    `means` and `weights` (m,) are the offsets by the guess [m] and the inverse of their variances.
    """

    prob_S: Floats
    p_TT: Floats
    prob_T: Floats
    shares: Floats
    twists: Floats
    centre: Floats
    weights: Floats
    means: Floats
    config: ClassCorrelationConfig

    def cells(self, grid: LaneGrid, points: Floats, prob: Floats, wrap: float = 0.0) -> Cells:
        """Cells of points in the lanes of `grid`; those within `wrap` of the end of a turn count again beyond it."""
        c = self.config
        coordinates = grid.coordinates(points)
        if wrap > 0 and np.isfinite(grid.period):
            once = np.array([-grid.period, 0.0, 2 * np.pi * grid.rise])
            first, last = (np.flatnonzero(side * coordinates[:, 0] > 0.5 * grid.period - wrap) for side in (-1, 1))
            coordinates = np.concatenate([coordinates, coordinates[first] - once, coordinates[last] + once])
            points, prob = (np.concatenate([v, v[first], v[last]]) for v in (points, prob))
        return cells_of(
            grid.lanes(coordinates),
            coordinates[:, 0],
            points,
            prob,
            self.shares,
            cell=c.cell,
            reach=c.opinion_reach,
            power=c.opinion_power,
            error=c.label_error,
        )

    def peak(self, i: int, points: Floats, span: float, done: float = 0.0) -> Peak:
        """The best offset along motion i for the source's points (N, 3), which have gone `done` [m] along it."""
        target_grid = lane_grid(self.p_TT, self.twists[i], self.centre, self.config.lane)
        span = min(span, 0.5 * target_grid.period)
        source = self.cells(target_grid, points, self.prob_S)
        target = self.cells(target_grid, self.p_TT, self.prob_T, wrap=span + self.config.reach)
        if not len(source.lane) or not len(target.lane):
            return Peak(reason="the clouds do not overlap")
        table = evidence_table(source, target, self.shares)
        blocks = block_numbers(source.point, self.config.block)
        prior = (self.means[i] - done, self.weights[i])
        return find_peak(class_profile(source, target, blocks, table, span, prior, self.config), self.config)

    def moved(self, points: Floats, i: int, offset: float) -> Floats:
        X = pose_along(self.twists[i], offset, self.centre)
        return points @ X.rotation().matrix().T + X.translation()


def search_one(search: Search, p_TS: Floats, span: float) -> Found:
    """The best offset along the only motion, within ±span [m]."""
    peak = search.peak(0, p_TS, span)
    return Found(np.array([peak.offset]), np.array([[peak.variance]]), peak.contrast, peak.evidence, peak.reason)


def search_two(search: Search, p_TS: Floats, span: float) -> Found:
    """The best offsets along both motions, within ±span [m] each.

    The first is searched along its lanes at every step of the second, with those cells of the source whose class is not
    the usual one. Where they agree best, both are searched in turn with all points, and the parabolas of the first at
    either side of the peak tell how the two depend on each other. Its rivals are all others in the square.
    """
    c = search.config
    steps = c.coarse_step * np.arange(-round(span / c.coarse_step), round(span / c.coarse_step) + 1)
    grid = lane_grid(search.p_TT, search.twists[0], search.centre, c.lane)
    span_1 = min(span, 0.5 * grid.period)
    target = search.cells(grid, search.p_TT, search.prob_T, wrap=span_1 + c.reach)
    source = search.cells(grid, p_TS, search.prob_S)
    table = evidence_table(source, target, search.shares)
    kind = source.code // LEVELS
    source = _part(source, kind != np.bincount(kind).argmax())
    if not len(source.lane) or not len(target.lane):
        return Found(np.full(2, np.nan), np.eye(2), 0.0, 0.0, "the classes of a cloud do not vary")
    blocks = block_numbers(source.point, c.block)

    def profile(step: float, blocks: Ints) -> Profile:
        cells, order = _in_lanes(grid, source, search.moved(source.point, 1, step))
        prior = (search.means[0], search.weights[0])
        return class_profile(cells, target, blocks[order], table, span_1, prior, c, int(blocks.max()) + 1)

    profiles = [profile(step, np.zeros_like(blocks)) for step in steps]
    data = np.array([one.blocks[0] for one in profiles])
    spread = profile(steps[int(np.argmax(data.max(axis=1)))], blocks).spread
    guess = profiles[0].prior - 0.5 * search.weights[1] * (steps[:, None] - search.means[1]) ** 2
    total = data + spread * guess
    row, column = np.unravel_index(int(total.argmax()), total.shape)
    evidence = float(data[row, column] / spread)
    x = profiles[0].offsets
    if row in (0, len(steps) - 1) or column in (0, len(x) - 1):
        return Found(np.full(2, np.nan), np.eye(2), 0.0, evidence, "the best offset is at the end of the interval")

    # Both in turn, with everything that is known.
    offsets = np.array([x[column], steps[row]])
    peaks = [Peak(), Peak()]
    for i in (0, 1, 0, 1):
        points = search.moved(search.moved(p_TS, 1, offsets[1]), 0, offsets[0])
        peaks[i] = search.peak(i, points, _FINE_SPAN, done=offsets[i])
        if not np.isfinite(peaks[i].variance):
            return Found(np.full(2, np.nan), np.eye(2), 0.0, evidence, peaks[i].reason)
        offsets[i] += peaks[i].offset
    near = np.abs(x - x[column]) <= 1.5 * peaks[0].width + 0.03
    others = np.where(
        np.outer(np.abs(steps - steps[row]) <= 1.5 * peaks[1].width + c.coarse_step, near), -np.inf, total
    )
    other = np.unravel_index(int(others.argmax()), total.shape)
    ahead = spread * float(guess[row, column] - guess[other])
    best, rival = (profile(steps[i], blocks).blocks[:, j] for i, j in ((row, column), other))
    contrast = lead(best - rival, ahead)
    contrast = min(contrast, peaks[0].contrast, peaks[1].contrast)
    reason = peaks[0].reason or peaks[1].reason
    if not np.isfinite(others[other]):
        reason = "there is no peak within the interval"
    elif contrast < c.min_contrast or not leads(data[row, column], data[other], ahead, spread, c):
        reason = f"the next best offsets, {x[other[1]]:+.2f} m and {steps[other[0]]:+.2f} m, are about as good"
    return Found(offsets, _covariance(search, p_TS, offsets, peaks), contrast, evidence, reason)


def _covariance(search: Search, p_TS: Floats, offsets: Floats, peaks: list[Peak]) -> Floats:
    """Covariance of both offsets: their variances each with the other held, and how the first follows the second."""
    aside = max(0.3 * peaks[1].width, 0.03)
    follows = []
    for side in (-aside, aside):
        points = search.moved(search.moved(p_TS, 1, offsets[1] + side), 0, offsets[0])
        follows.append(search.peak(0, points, _FINE_SPAN, done=offsets[0]).offset)
    slope = (follows[1] - follows[0]) / (2 * aside)
    mixed = slope * np.sqrt(peaks[0].curvature / max(peaks[1].curvature, 1e-12)) if np.isfinite(slope) else 0.0
    mixed = float(np.clip(mixed, -0.95, 0.95))
    deviations = np.sqrt([peak.variance for peak in peaks])
    return np.outer(deviations, deviations) * np.array([[1.0, mixed], [mixed, 1.0]]) / (1 - mixed**2)


def _part(cells: Cells, chosen: np.ndarray) -> Cells:
    return Cells(*(value[chosen] for value in (cells.lane, cells.place, cells.code, cells.prob, cells.point)))


def _in_lanes(grid: LaneGrid, cells: Cells, points: Floats) -> tuple[Cells, Ints]:
    """Cells whose mean positions have come to `points` (C, 3), by lane and place, and which of `cells` they are."""
    coordinates = grid.coordinates(points)
    lane = grid.lanes(coordinates)
    order = np.lexsort((coordinates[:, 0], lane))
    order = order[np.searchsorted(lane[order], 0) :]
    return replace(_part(cells, order), lane=lane[order], place=coordinates[order, 0].copy()), order
