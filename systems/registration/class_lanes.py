"""Clouds cut into lanes along a motion: cells that the motion moves into each other, and which of them meet.

Every motion of a rigid body that goes on for ever moves its points along lines, circles or helices. A lane is a bundle
of them. Along its lane a point has one coordinate, and the motion adds the same to all of them.
"""

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# A turn so slow that it moves the points less than this share of the shift is left to the geometry: straight lanes.
_STRAIGHT = 0.05
# Bounds between the levels of confidence that are told apart within a class.
_BOUNDS = np.array([0.5, 0.7, 0.85, 0.95])
LEVELS = len(_BOUNDS) + 1


@dataclass(frozen=True, eq=False)
class LaneGrid:
    """Lanes along one motion.

    Attributes:
        motion: (6,), turn [rad] and shift [m] of the point `centre` for a unit offset.
        centre: (3,) [m].
        straight: its turn is so slow that it is left out.
        width: of a lane, in both directions across [m].
        starts: where lanes begin across, (2,) as a share of the width.
        lows, shape: first lane and number of lanes in both directions, (2,).
    """

    motion: Floats
    centre: Floats
    straight: bool
    width: float
    starts: Floats
    lows: Ints
    shape: Ints

    @property
    def period(self) -> float:
        """Offset after which a turn is back where it began; inf for a straight motion."""
        return np.inf if self.straight else 2 * np.pi / float(np.linalg.norm(self.motion[:3]))

    def coordinates(self, points: Floats) -> Floats:
        """Coordinates (N, 3) of points: offset along the motion, which it adds to, and two [m] that it leaves alone.

        A straight motion has planes across it, a turn has radius and height, a helix the height less its rise.
        """
        turn, shift = self.motion[:3], self.motion[3:]
        lever = points - self.centre
        if self.straight:
            speed = float(np.linalg.norm(shift))
            return np.ascontiguousarray(lever @ np.column_stack([shift / speed**2, *_across(shift / speed)]))
        rate = float(np.linalg.norm(turn))
        axis = turn / rate
        lever = lever - np.cross(turn, shift) / rate**2
        first, second = _across(axis)
        x, y, height = (lever @ np.column_stack([first, second, axis])).T
        angle = np.arctan2(y, x)
        return np.column_stack([angle / rate, np.hypot(x, y), height - self.rise * angle])

    @property
    def rise(self) -> float:
        """What a turn goes along its own axis [m/rad]."""
        rate = float(np.linalg.norm(self.motion[:3]))
        return 0.0 if self.straight else float(self.motion[3:] @ self.motion[:3]) / rate**2

    def lanes(self, coordinates: Floats) -> Ints:
        """Lane of every point (N,), -1 outside the grid."""
        return _lanes(coordinates, self.width, self.starts, self.lows, self.shape)


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of one cloud, sorted by lane and by place along it.

    Attributes:
        lane, place: number of the lane and mean coordinate along it [m], (C,).
        code: class and level of confidence of its probabilities, (C,) = class · LEVELS + level.
        prob: class probabilities from all points nearby, (C, K).
        point: mean position of its points, (C, 3).
    """

    lane: Ints
    place: Floats
    code: Ints
    prob: Floats
    point: Floats


def _across(axis: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors that make a right-handed frame with `axis`, as (first, second, axis)."""
    first = np.eye(3)[int(np.abs(axis).argmin())]
    first = first - axis * (first @ axis)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def lane_grid(points: Floats, motion: Floats, centre: Floats, width: float) -> LaneGrid:
    """Lanes along `motion` (6,) that hold `points` (N, 3), with their bounds where few are: a wall stays in one."""
    lever = points - centre
    radius = float(np.sqrt(np.einsum("ij,ij", lever, lever) / len(lever)))
    straight = float(np.linalg.norm(motion[:3])) * radius <= _STRAIGHT * float(np.linalg.norm(motion[3:]))
    starts, lows, shape = np.zeros(2), np.zeros(2, np.int64), np.ones(2, np.int64)
    coordinates = LaneGrid(motion, centre, straight, width, starts, lows, shape).coordinates(points)
    for axis in range(2):
        values = coordinates[:, 1 + axis] / width
        some = values[:: 1 + len(values) // 5000]
        parts = np.bincount(((some - np.floor(some)) * 16).astype(np.int64) % 16, minlength=16)
        starts[axis] = int((parts + np.roll(parts, 1)).argmin()) / 16  # between the two parts that have fewest
        lows[axis] = np.floor(values.min() - starts[axis])
        shape[axis] = np.floor(values.max() - starts[axis]) + 1 - lows[axis]
    return LaneGrid(motion, centre, straight, width, starts, lows, shape)


def cells_of(
    lane: Ints,
    place: Floats,
    points: Floats,
    prob: Floats,
    shares: Floats,
    *,
    cell: float,
    reach: float,
    power: float,
    error: float,
) -> Cells:
    """Gathers points (N, 3) with class probabilities (N, K) in cells of length `cell` [m].

    A cell takes the opinion of all n points of its lane within `reach`: log probabilities are averaged and count as
    n^power independent opinions, as neighbours err together.

    Args:
        lane: of every point, (N,); points with -1 are left out.
        place: coordinate of every point along its lane, (N,).
        shares: of the classes, (K,), which a label that is wrong, the share `error` of them, has as its probabilities.
    """
    start = float(place.min()) if len(place) else 0.0
    step = np.floor((place - start) * (1 / cell)).astype(np.int64)
    steps = int(step.max(initial=0)) + 1
    bits = max(len(lane).bit_length(), 1)
    # Number of the cell and of the point in one integer: sorting these is faster than sorting indices.
    order = np.sort((((lane * steps + step) << bits) | np.arange(len(lane)))[lane >= 0])
    key, index = order >> bits, order & ((1 << bits) - 1)
    first = np.flatnonzero(np.diff(key, prepend=-1))
    means = _means(first, index, np.ascontiguousarray(place), points, prob, shares, error)
    smooth, code = _opinions(key[first] // steps, *means[:3], reach, power, _BOUNDS)
    return Cells(key[first] // steps, means[1], code, smooth, means[3])


@numba.njit(cache=True)
def _lanes(coordinates: Floats, width: float, starts: Floats, lows: Ints, shape: Ints) -> Ints:
    lane = np.empty(len(coordinates), np.int64)
    for i in range(len(coordinates)):
        row = int(np.floor(coordinates[i, 1] / width - starts[0])) - lows[0]
        column = int(np.floor(coordinates[i, 2] / width - starts[1])) - lows[1]
        inside = 0 <= row < shape[0] and 0 <= column < shape[1]
        lane[i] = row * shape[1] + column if inside else -1
    return lane


@numba.njit(cache=True)
def _means(
    first: Ints, index: Ints, place: Floats, points: Floats, prob: Floats, shares: Floats, error: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Number of points, mean place, log of the mean probability times number, and mean position of every cell."""
    count, classes = len(first), prob.shape[1]
    number, mean_place, logs, mean = np.zeros(count), np.zeros(count), np.zeros((count, classes)), np.zeros((count, 3))
    for cell in range(count):
        end = first[cell + 1] if cell + 1 < count else len(index)
        number[cell] = end - first[cell]
        for i in range(first[cell], end):
            point = index[i]
            mean_place[cell] += place[point] / number[cell]
            for k in range(classes):
                logs[cell, k] += prob[point, k] / number[cell]
            for axis in range(3):
                mean[cell, axis] += points[point, axis] / number[cell]
        for k in range(classes):
            logs[cell, k] = number[cell] * np.log((1 - error) * logs[cell, k] + error * shares[k])
    return number, mean_place, logs, mean


@numba.njit(cache=True)
def _opinions(
    lane: Ints, number: Floats, place: Floats, logs: Floats, reach: float, power: float, bounds: Floats
) -> tuple[Floats, Ints]:
    """Probabilities of every cell from the cells of its lane within `reach`, and its code."""
    count, classes = logs.shape
    prob, code = np.zeros((count, classes)), np.zeros(count, np.int64)
    total, points = np.zeros(classes), 0.0
    low = high = 0  # the cells from low to high - 1 are summed
    for i in range(count):
        while high < count and (lane[high] < lane[i] or (lane[high] == lane[i] and place[high] <= place[i] + reach)):
            points += number[high]
            total += logs[high]
            high += 1
        while lane[low] < lane[i] or place[low] < place[i] - reach:
            points -= number[low]
            total -= logs[low]
            low += 1
        scale = points ** (power - 1)
        best = 0
        for k in range(1, classes):
            if total[k] > total[best]:
                best = k
        whole = 0.0
        for k in range(classes):
            prob[i, k] = np.exp((total[k] - total[best]) * scale)
            whole += prob[i, k]
        for k in range(classes):
            prob[i, k] /= whole
        level = 0
        while level < len(bounds) and prob[i, best] >= bounds[level]:
            level += 1
        code[i] = best * (len(bounds) + 1) + level
    return prob, code


@numba.njit(cache=True)
def meetings(
    lane_S: Ints,
    place_S: Floats,
    code_S: Ints,
    block_S: Ints,
    lane_T: Ints,
    place_T: Floats,
    code_T: Ints,
    table: Floats,
    power_S: Floats,
    power_T: Floats,
    reach: float,
    span: float,
    step: float,
    blocks: int,
) -> tuple[Floats, Floats]:
    """What meets at every offset k · step - span, k = 0 … 2 span / step.

    A cell of T stands for its lane up to halfway to its neighbours, at most `reach` to either side; a cell of S, moved
    by the offset, meets the one that it falls on.

    Returns:
        Sums of `table[code of S, code of T]` in every block of S, (B, bins); and over all blocks sums of its square, of
        `power_S` of the code of S and of `power_T` of the code of T, (3, bins).
    """
    bins = int(np.round(2 * span / step)) + 1
    for b in block_S:
        blocks = max(blocks, b + 1)
    score, sums = np.zeros((blocks, bins + 1)), np.zeros((3, bins + 1))
    start = 0
    count = len(lane_T)
    left, right = np.full(count, reach), np.full(count, reach)
    for j in range(1, count):
        if lane_T[j] == lane_T[j - 1]:
            half = min(0.5 * (place_T[j] - place_T[j - 1]), reach)
            left[j], right[j - 1] = half, half
    for i in range(len(lane_S)):
        low, high = place_S[i] - span - reach, place_S[i] + span + reach
        while start < count and (lane_T[start] < lane_S[i] or (lane_T[start] == lane_S[i] and place_T[start] < low)):
            start += 1
        j = start
        while j < count and lane_T[j] == lane_S[i] and place_T[j] <= high:
            offset = place_T[j] - place_S[i] + span
            enter = min(max(int(np.ceil((offset - left[j]) / step)), 0), bins)
            leave = min(max(int(np.ceil((offset + right[j]) / step)), 0), bins)
            if leave > enter:
                a, b = code_S[i], code_T[j]
                value = table[a, b]
                score[block_S[i], enter] += value
                score[block_S[i], leave] -= value
                sums[0, enter] += value * value
                sums[0, leave] -= value * value
                sums[1, enter] += power_S[a]
                sums[1, leave] -= power_S[a]
                sums[2, enter] += power_T[b]
                sums[2, leave] -= power_T[b]
            j += 1
    for k in range(1, bins):
        for row in range(3):
            sums[row, k] += sums[row, k - 1]
    for block in range(blocks):
        for k in range(1, bins):
            score[block, k] += score[block, k - 1]
    return score[:, :bins].copy(), sums[:, :bins].copy()
