"""Risk of every cell of a map by the rules that a robot drives by: what routes are learnt and planned on."""

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import binary_dilation

from ..config import check_config, quantity
from ..errors import InputError
from .ability import Ability
from .mamdani import Mamdani
from .risk_kernels import bounds, window_features
from .surface_cells import find_steps, find_surface
from .terrain_config import SurfaceConfig

# A grid with more cells comes from a stray point kilometres away.
_MOST_CELLS = 25_000_000
# Risk where a limit is exceeded: far above any that is inferred.
IMPASSABLE = 1e3
# [cells] So far the end of a step is followed: where noise is large it would lead across the floor.
_LONGEST_END = 5


@dataclass(kw_only=True)
class RiskMapConfig:
    """Cells of the map, and the window around each that a plane is laid through."""

    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    # [m] Edge of the window: about what the robot stands on.
    window: float = quantity(0.7, unit="m", above=0)
    # [m] What is higher than this in the map is not ground.
    ceiling: float = quantity(5.0, unit="m", above=0)
    # [m] Border around the points.
    margin: float = quantity(0.0, unit="m", low=0)


@dataclass(frozen=True, eq=False)
class RiskMap:
    """The ground in cells, (nx, ny) float32 each. Read-only. NaN where too little was seen.

    Attributes:
        risk: r = 1/τ, worst over all headings; `IMPASSABLE` where a limit of the robot is exceeded.
        height: of the surface [m]. slope: of the plane around the cell [rad]. roughness: of the window [m²].
        step: largest step at the cell [m]. coverage: share of the window that was seen.
        origin: (2,) [m], of the corner of cell (0, 0). cell: [m].
    """

    risk: np.ndarray
    height: np.ndarray
    slope: np.ndarray
    roughness: np.ndarray
    step: np.ndarray
    coverage: np.ndarray
    origin: np.ndarray
    cell: float

    def __deepcopy__(self, memo: dict) -> "RiskMap":
        return self

    @property
    def seen(self) -> np.ndarray:
        """Where the risk is known, (nx, ny) bool."""
        return np.isfinite(self.risk)

    def at(self, xy: np.ndarray) -> np.ndarray:
        """Risk at points (N, 2) [m], (N,); NaN where it is not known and outside."""
        index = np.floor((np.asarray(xy, float).reshape(-1, 2) - self.origin) / self.cell)
        inside = ((index >= 0) & (index < self.risk.shape)).all(axis=1)
        risk = np.full(len(index), np.nan, np.float32)
        i, j = index[inside].astype(int).T
        risk[inside] = self.risk[i, j]
        return risk


def make_risk_map(
    points: np.ndarray,
    ability: Ability,
    config: RiskMapConfig | None = None,
    *,
    origin: np.ndarray | None = None,
    shape: tuple[int, int] | None = None,
) -> RiskMap:
    """Judges the ground that points show, cell by cell, as `ability` judges rectangles.

    Around every cell a plane is laid through a window (least squares, over the surface's cells after a median of three
    by three that takes out what single cells say); its slope counts once all as pitch, once all as roll and once half
    of each way, and the worst of the three is kept. Roughness is the variance of the distances to the plane (Eq. 4).
    A cell at a step above `step_threshold` is `IMPASSABLE`: the step itself, not the window around it, whose plane and
    roughness leave such cells out; so is one above `step_limit` that is joined to it by others of that kind, at most
    five cells away. A cell whose window was seen by less than `min_coverage`, or that was itself not seen nor lies
    between two that were, is NaN.

    Args:
        points: (N, 3) [m], z up.
        origin, shape: of the grid; around the points when not given.

    Raises:
        ConfigError: a value of `config` is out of range.
        InputError: the points reach too far for a grid.
    """
    config = config or RiskMapConfig()
    check_config(config, where="risk map")
    cell = config.surface.cell
    points = np.asarray(points, np.float32).reshape(-1, 3)
    if origin is None or shape is None:
        x0, x1, y0, y1 = bounds(points)
        first = np.floor((np.array([x0, y0]) - config.margin) / cell)
        count = np.floor((np.array([x1, y1]) + config.margin) / cell) - first + 1
        if count.prod() > _MOST_CELLS:
            reach, valid = (count * cell).round(1).tolist(), f"at most {_MOST_CELLS} cells of {cell:g} m"
            raise InputError("the points reach too far", where="risk map", value=reach, valid=valid)
        origin, shape = first * cell, (int(count[0]), int(count[1]))
    surface = find_surface(points, origin, shape, cell, clearance=config.surface.clearance, ceiling=config.ceiling)
    half = max(1, round(0.5 * (config.window / cell - 1)))
    step = find_steps(surface, config.surface)
    stepped = too_high(step, ability)
    slope, roughness, coverage, height = window_features(surface.low, surface.high, stepped, cell, half)
    inference, zero = Mamdani(ability.fuzzy), np.zeros(slope.size)
    flat, rough = slope.ravel().astype(float), roughness.ravel().astype(float)
    known = np.isfinite(flat)
    diagonal = np.arcsin(np.sin(flat) * np.sqrt(0.5))
    worst = np.full(slope.size, np.nan, np.float32)
    for pitch, roll in ((flat, zero), (zero, flat), (diagonal, diagonal)):
        features = np.column_stack([pitch, roll, rough])[known]
        worst[known] = np.fmax(worst[known], inference.infer(features).risk)
    risk = worst.reshape(slope.shape)
    risk[stepped] = IMPASSABLE
    risk[(coverage < ability.min_coverage) | ~np.isfinite(height)] = np.nan
    return RiskMap(risk, height, slope, roughness, step, coverage, np.asarray(origin, float), cell)


def too_high(step: np.ndarray, ability: Ability) -> np.ndarray:
    """Where steps are too high for the robot, (nx, ny) bool, by two thresholds as Canny's edges: a single cell above
    the lower one may be noise, a row of them that goes on from a step that is surely too high is its end."""
    high = step > ability.step_threshold
    if ability.step_limit is None:
        return high
    low = step > ability.step_limit
    return binary_dilation(high, structure=np.ones((3, 3), bool), iterations=_LONGEST_END, mask=high | low)
