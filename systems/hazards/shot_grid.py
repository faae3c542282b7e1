"""LiDAR shots at the floor, counted by cells, and what they say about water."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import uniform_filter

from ..config import quantity

HIT, MISSING, MIRROR, BLOCKED = range(4)
# Planes of a tile: how many shots of each kind, then the summed evidence and its summed weight.
_EVIDENCE, _WEIGHT, _PLANES = 4, 5, 6
# Cells along an edge of a tile, the unit that an update copies.
_TILE = 64


@dataclass(kw_only=True)
class ShotConfig:
    """How LiDAR shots at the floor are counted and judged."""

    # [m] Edge of a cell.
    cell: float = quantity(0.1, unit="m", above=0.0)
    # [m] Shots that meet the floor farther away are left out: where they meet it depends too much on the pitch.
    max_range: float = quantity(6.0, unit="m", above=0.0)
    # [m] The floor is looked for this far above and below where the robot says it is.
    floor_search: float = quantity(0.15, unit="m", above=0.0)
    # [points] A scan with fewer points there is not counted.
    min_floor_points: int = quantity(100, unit="points", low=1)
    # [m], [m/m] A return this near the floor's height is from the floor; the second grows with the distance and
    # stands for the error of the pitch.
    tolerance: float = quantity(0.04, unit="m", above=0.0)
    tolerance_growth: float = quantity(0.01, unit="m/m", low=0.0)
    # [m] Missing shots count only in gaps of a ring that are at most this wide and have the floor on both sides.
    max_gap: float = quantity(3.0, unit="m", above=0.0)
    # [m] A missing shot counts only if its ray came back within the last so many metres of travel (a turn of 1 rad
    # counts as 1 m); otherwise the robot's own body may be in its way.
    memory: float = quantity(3.0, unit="m", above=0.0)
    # Share of shots at ground that go missing, however near and bright it is.
    missing_on_ground: float = quantity(0.02, above=0.0, high=0.5)
    # Share of shots at water that come back all the same, however far: ripples, things that float.
    return_on_water: float = quantity(0.1, above=0.0, high=0.5)
    # Diffuse reflectivity, at the LiDAR's wavelength, of the darkest ground and of the brightest water that are
    # expected: nearer than where water still returns and farther than where dark ground does, shots say little.
    dark_ground: float = quantity(0.05, above=0.0, high=1.0)
    bright_water: float = quantity(0.001, above=0.0, high=1.0)
    # How sharply detection sets in with power, see `LidarConfig.detection_steepness`.
    steepness: float = quantity(3.0, above=0.0)
    # Share of shots that come back from below the floor, at water and at ground.
    mirror_on_water: float = quantity(0.2, above=0.0, high=1.0)
    mirror_on_ground: float = quantity(0.002, above=0.0, high=1.0)
    # [shots] Shots at one cell are not independent: any number of them counts as less than this many.
    worth: float = quantity(4.0, unit="shots", above=0.0)
    # [shots] Fewer than this may have got lost by chance, at the edge of something: they count less than half.
    few: float = quantity(2.0, unit="shots", low=0.0)
    # Largest absolute log likelihood ratio of a cell.
    limit: float = quantity(6.0, above=0.0)


@dataclass(frozen=True, eq=False)
class Shots:
    """Shots of one scan whose way leads to the floor within range. Those that say nothing are among them.

    Attributes:
        xy_M: where each meets the floor, (K, 2) [m].
        kind: HIT, MISSING, MIRROR or BLOCKED, (K,) uint8.
        evidence: log likelihood ratio of water against ground of each by itself, (K,).
        weight: how much its outcome could tell, 0 to 1, (K,).
    """

    xy_M: np.ndarray
    kind: np.ndarray
    evidence: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True, eq=False)
class ShotGrid:
    """Shots at the floor counted by cells of M, without bounds.

    Read-only: `add` returns a new grid and copies only the tiles that it changes.
    """

    config: ShotConfig = field(default_factory=ShotConfig)
    tiles: Mapping[tuple[int, int], np.ndarray] = field(default_factory=dict)

    def __deepcopy__(self, memo: dict) -> "ShotGrid":
        return self

    def add(self, shots: Shots) -> "ShotGrid":
        """This grid with the shots of one more scan."""
        if not len(shots.kind):
            return self
        index = np.floor(shots.xy_M / self.config.cell).astype(np.int64)
        first, last = index.min(axis=0) // _TILE, index.max(axis=0) // _TILE
        rows, columns = ((last - first + 1) * _TILE).tolist()
        flat = (index[:, 0] - first[0] * _TILE) * columns + index[:, 1] - first[1] * _TILE
        size = rows * columns
        counts = np.bincount(shots.kind.astype(np.int64) * size + flat, minlength=4 * size)
        sums = [np.bincount(flat, values, size) for values in (shots.evidence, shots.weight)]
        planes = np.concatenate([counts, *sums]).astype(np.float32).reshape(_PLANES, rows, columns)
        tiles = dict(self.tiles)
        for i in range(rows // _TILE):
            for j in range(columns // _TILE):
                part = planes[:, i * _TILE : (i + 1) * _TILE, j * _TILE : (j + 1) * _TILE]
                if part[:4].any():
                    key = (int(first[0]) + i, int(first[1]) + j)
                    tiles[key] = tiles[key] + part if key in tiles else part.copy()
        return replace(self, tiles=tiles)

    def counts(self, xy_M: np.ndarray) -> np.ndarray:
        """Number of hits, missing, mirrored and blocked shots in the cells of points (N, 2), (N, 4) int."""
        return self._lookup(self._planes[:4], xy_M).T.astype(int)

    def log_likelihood_ratio(self, xy_M: np.ndarray) -> np.ndarray:
        """Log likelihood ratio of water against ground in the cells of points (N, 2), (N,) float32.

        Each shot is a Bernoulli trial whose chances depend on its distance (see `shot_evidence`). With the sum s of
        their log likelihood ratios and the sum n of their weights, the ratio is s w / (w + n) n / (n + f), w = `worth`
        and f = `few`: as if their mean had been seen at most w times, and less where n is small. Cells with few shots
        (n < w) take in the mean of the cells around them that have any, each as w shots at most. Cut to ±`limit`; 0
        where nothing was seen and where the point is not finite.
        """
        return self._lookup(self._ratio[None], xy_M)[0]

    @cached_property
    def _origin(self) -> np.ndarray:
        """Index of the first cell of `_planes`."""
        return np.min(list(self.tiles), axis=0) * _TILE - 1

    @cached_property
    def _planes(self) -> np.ndarray:
        """All tiles in one array with a border of one cell, (6, rows, columns)."""
        if not self.tiles:
            return np.zeros((_PLANES, 0, 0), np.float32)
        rows, columns = (np.max(list(self.tiles), axis=0) + 1) * _TILE + 1 - self._origin
        planes = np.zeros((_PLANES, rows, columns), np.float32)
        for key, tile in self.tiles.items():
            row, column = np.array(key) * _TILE - self._origin
            planes[:, row : row + _TILE, column : column + _TILE] = tile
        return planes

    @cached_property
    def _ratio(self) -> np.ndarray:
        evidence, weight = self._planes[_EVIDENCE], self._planes[_WEIGHT]
        if evidence.size:
            worth = self.config.worth
            capped = np.minimum(1, worth / np.maximum(weight, 1e-9))
            shot = weight > 0
            *around, shots = uniform_filter(
                np.stack([capped * evidence, capped * weight, shot.astype(np.float32)]), (0, 3, 3), mode="constant"
            )
            around /= np.maximum(shots, 1 / 9)
            # A cell without shots of its own says nothing: it may be hidden, and its neighbours cannot tell.
            share = np.where(shot, np.clip(1 - weight / worth, 0, 1), 0)
            evidence = evidence + share * (around[0] - evidence)
            weight = weight + share * (around[1] - weight)
        weight = np.maximum(weight, 1e-9)  # filtered values may be a little below 0
        ratio = evidence * self.config.worth / (self.config.worth + weight) * weight / (weight + self.config.few)
        return np.clip(ratio, -self.config.limit, self.config.limit)

    def _lookup(self, planes: np.ndarray, xy_M: np.ndarray) -> np.ndarray:
        xy_M = np.asarray(xy_M, float).reshape(-1, 2)
        values = np.zeros((len(planes), len(xy_M)), np.float32)
        if planes.size:
            with np.errstate(invalid="ignore"):
                index = np.floor(xy_M / self.config.cell) - self._origin
                inside = np.flatnonzero(((index >= 0) & (index < planes.shape[1:])).all(axis=1))  # False for NaN
            row, column = index[inside].astype(int).T
            values[:, inside] = planes[:, row, column]
        return values


def shot_evidence(distance: np.ndarray, height: np.ndarray, detection_range: float, config: ShotConfig) -> np.ndarray:
    """What a shot at level ground from `height` above it, over `distance` [m], tells by coming back or not.

    The LiDAR's own equation (see `simulate_returns`): from ground of diffuse reflectivity ρ comes the power
    q = ρ (h / r) R² / r² of that of a white wall at the detection range R, and a shot is detected with probability
    q^k / (1 + q^k). So near the sensor even water returns, and far away even dark ground does not.

    Returns:
        Log likelihood ratio of water against ground of a hit (never above 0) and of a missing shot (never below 0),
        and how much the outcome tells, 0 to 1, (3, N).
    """
    power = np.maximum(height, 1e-6) * np.float32(detection_range) ** 2 / np.maximum(distance, 1e-6) ** 3

    def detected(reflectivity: float) -> np.ndarray:
        return 1 / (1 + (reflectivity * power) ** -config.steepness)

    ground = (1 - config.missing_on_ground) * detected(config.dark_ground)
    water = np.minimum(np.maximum(config.return_on_water, detected(config.bright_water)), ground)
    hit, missing = np.log(water / ground), np.log((1 - water) / (1 - ground))
    most = np.log(1 - config.missing_on_ground) - np.log(config.return_on_water)
    most += np.log(1 - config.return_on_water) - np.log(config.missing_on_ground)
    return np.stack([hit, missing, np.clip((missing - hit) / most, 0, 1)])
