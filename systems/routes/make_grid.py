"""From a semantic map to the grid that routes are planned on (S0-h)."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from open3d.t.geometry import PointCloud
from scipy.ndimage import (
    binary_dilation,
    binary_fill_holes,
    binary_opening,
    distance_transform_edt,
    label,
)

from ..config import check_config
from ..errors import InputError
from ..hazards.classes import HEAT
from ..hazards.classes import WATER as WATER_POINT
from ..traversability import IMPASSABLE, Ability, Mamdani, RiskMap, make_risk_map, too_high
from .gaps import close_gaps
from .route_grid import DOSE, FENCE, FREE, HOT, OCCUPIED, UNKNOWN, WATER, RouteGrid
from .world_config import VoxelWorldConfig

FLAT, SLOPE, STEPS, ROUGH = range(4)
# [m] Between places farther apart it is not known how the robot has come.
_LEAP = 2.0


@dataclass(frozen=True, eq=False)
class MapPoints:
    """Arrays over the points of a semantic map in M; NaN or 0 where an attribute is not there.

    Attributes:
        xyz: (N, 3) [m]. label: (N,) class ids. dose_rate: (N,) [µSv/h], NaN where not known.
    """

    xyz: np.ndarray
    label: np.ndarray
    dose_rate: np.ndarray


def map_points(cloud: PointCloud) -> MapPoints:
    """Reads a semantic map; points that are not finite are left out."""
    xyz = cloud.point.positions.numpy() if "positions" in cloud.point else np.zeros((0, 3), np.float32)

    def values(name: str, default: float) -> np.ndarray:
        there = name in cloud.point
        return cloud.point[name].numpy().reshape(-1) if there else np.full(len(xyz), default, np.float32)

    finite = np.isfinite(xyz).all(axis=1)
    return MapPoints(xyz[finite], values("label", 0)[finite].astype(np.uint8), values("dose_rate", np.nan)[finite])


def make_route_grid(
    cloud: PointCloud,
    ability: Ability | None = None,
    config: VoxelWorldConfig | None = None,
    *,
    risk: RiskMap | None = None,
    stood: np.ndarray | None = None,
) -> RouteGrid:
    """Makes the grid of a semantic map with `label` and `dose_rate`, either of which may be missing.

    With `ability` a cell is open when its step is low enough and its risk, driven straight up or down, is below the
    limit, so that a stair is a way for a robot that climbs it. Without, the floor is flat as in the paper and what
    rises above `step` is an obstacle. Water, hot surfaces and dose rates close cells as well. Obstacles and hazards
    grow by the robot; a cell that they close has the kind of the nearest of them. Cells beside unseen ground are a
    fence. What is unknown all around is cut off. Where the robot has come through itself it comes through again: there
    obstacles grow by no more than half its width.

    Args:
        risk: as of `make_risk_map` for these points and this ability, when it is there already.
        stood: (K, 2) x, y in M [m] where the robot stood, one place after the other: unseen ground around is taken for
            ground, and the ways between them are those it has come.

    Raises:
        ConfigError: a value of `config` is out of range.
        InputError: the cloud has no point, or reaches too far.
    """
    config = config or VoxelWorldConfig()
    check_config(config, key="voxel_world")
    points = map_points(cloud)
    if not len(points.xyz):
        raise InputError("the map has no point", where="make_route_grid")
    if risk is None:
        risk = _flat_ground(points.xyz, config) if ability is None else make_risk_map(points.xyz, ability, config.risk)
    robot = ability or Ability()
    seen, stepped, straight = _judged(risk, ability, config)
    over = straight >= robot.risk_limit
    solid = np.where(stepped | (over & seen), OCCUPIED, FREE).astype(np.uint8)
    hazard, rate = _hazards(points, risk, config)
    solid = np.where(hazard != FREE, hazard, solid)
    known = seen | stepped
    ground = known | _bridged(known, solid, risk, config, stood)
    steep = np.nan_to_num(risk.slope, nan=0.0) > config.steep
    slopes = _near_slopes(steep, seen & ~over & ~stepped, risk.cell, config)
    trail = _trail(risk, stood)
    kind = _grown(solid, ground, slopes, trail, robot.footprint, risk.cell, config)
    flat_risk = robot_risk(robot)
    scaled = np.clip((np.nan_to_num(straight, nan=flat_risk) - flat_risk) / (robot.risk_limit - flat_risk), 0, 1)
    cost = 1 + config.risk_weight * scaled + config.dose_weight * np.clip(rate / config.max_dose_rate, 0, 1)
    cost = np.where(ground & ~known, np.maximum(cost, config.unseen_cost), cost)
    terrain = np.where(np.nan_to_num(risk.roughness) > config.rough, ROUGH, FLAT)
    terrain = np.where(steep, np.where(np.nan_to_num(risk.step) > 0.05, STEPS, SLOPE), terrain)
    height = np.where(seen, risk.height, np.nan)
    # Stray points far away, such as mirror images, must not make the grid large.
    known_at = np.argwhere(kind != UNKNOWN)
    if len(known_at):
        low, high = known_at.min(axis=0), known_at.max(axis=0) + 1
        part = tuple(slice(max(a - 1, 0), b + 1) for a, b in zip(low, high, strict=True))
        kind, cost, height, rate, terrain = (layer[part] for layer in (kind, cost, height, rate, terrain))
        origin = risk.origin + np.maximum(low - 1, 0) * risk.cell
    else:
        origin = risk.origin
    return RouteGrid.from_kind(
        kind, risk.cell, origin, cost=cost, height=height, dose_rate=rate, terrain=terrain.astype(np.uint8)
    )


def robot_risk(ability: Ability) -> float:
    """Risk of flat and smooth ground."""
    return float(Mamdani(ability.fuzzy).infer(np.zeros((1, 3))).risk[0])


def _judged(risk: RiskMap, ability: Ability | None, config: VoxelWorldConfig) -> tuple[np.ndarray, ...]:
    """Where the ground is known, where a step is too high, and the risk straight up or down the slope."""
    seen = np.isfinite(risk.risk)
    if ability is None:
        return seen, seen & (risk.risk >= IMPASSABLE), np.where(seen & (risk.risk < IMPASSABLE), risk.risk, np.nan)
    stepped = too_high(risk.step, ability)
    straight = np.full(risk.risk.shape, np.nan)
    known = np.isfinite(risk.slope) & np.isfinite(risk.roughness)
    features = np.column_stack([risk.slope[known], np.zeros(known.sum()), risk.roughness[known]]).astype(float)
    straight[known] = Mamdani(ability.fuzzy).infer(features).risk
    return seen & known, stepped, straight


def _flat_ground(xyz: np.ndarray, config: VoxelWorldConfig) -> RiskMap:
    """The paper's rule as a risk map: a flat floor at the height that most points of the lowest metre have."""
    cell = config.risk.surface.cell
    z = xyz[:, 2].astype(float)
    near = z[z < np.percentile(z, 1) + 1.0]
    counts, edges = np.histogram(near, bins=np.arange(near.min(), near.max() + 0.1, 0.05))
    floor = float(edges[np.argmax(counts)] + 0.025)
    origin = np.floor(xyz[:, :2].min(axis=0).astype(float) / cell) * cell
    index = np.floor((xyz[:, :2] - origin) / cell).astype(int)
    shape = tuple(index.max(axis=0) + 1)
    low = z < floor + config.step
    tall = ~low & (z < floor + config.robot_height)
    risk = np.full(shape, np.nan, np.float32)
    risk[tuple(index[low].T)] = robot_risk(Ability())
    risk[tuple(index[tall].T)] = IMPASSABLE
    flat = np.where(np.isfinite(risk), np.float32(0), np.float32(np.nan))
    height = flat + np.float32(floor)
    return RiskMap(risk, height, flat, flat, flat, np.isfinite(risk).astype(np.float32), origin, cell)


def _hazards(points: MapPoints, risk: RiskMap, config: VoxelWorldConfig) -> tuple[np.ndarray, np.ndarray]:
    """Kind of the hazard of each cell, FREE where none, and dose rate, 0 where not known."""
    shape = risk.risk.shape
    index = np.floor((points.xyz[:, :2] - risk.origin) / risk.cell).astype(int)
    inside = ((index >= 0) & (index < shape)).all(axis=1)
    points = replace(points, **{name: getattr(points, name)[inside] for name in ("xyz", "label", "dose_rate")})
    i, j = index[inside].T
    floor = np.where(np.isfinite(risk.height), risk.height, np.nanmedian(risk.height) if risk.seen.any() else 0.0)
    low = points.xyz[:, 2] - floor[i, j] < config.robot_height
    hazard = np.zeros(shape, np.uint8)
    rate, count = np.zeros(shape), np.zeros(shape)
    measured = low & np.isfinite(points.dose_rate)
    np.add.at(rate, (i[measured], j[measured]), points.dose_rate[measured])
    np.add.at(count, (i[measured], j[measured]), 1)
    rate = np.divide(rate, count, out=np.zeros(shape), where=count > 0)
    hazard[rate > config.max_dose_rate] = DOSE
    for number, kind in ((HEAT.id, HOT), (WATER_POINT.id, WATER)):
        found = low & (points.label == number)
        mask = np.zeros(shape, bool)
        mask[i[found], j[found]] = True
        if kind == WATER:  # a puddle sends few rays back: its middle may not have been seen
            mask = binary_fill_holes(close_gaps(mask, config.max_gap, risk.cell))
        hazard[mask] = kind
    return hazard, rate


def _bridged(
    known: np.ndarray, solid: np.ndarray, risk: RiskMap, config: VoxelWorldConfig, stood: np.ndarray | None
) -> np.ndarray:
    """Cells that were not seen and are taken for ground all the same."""
    open_ground = known & (solid == FREE)
    bridged = close_gaps(open_ground, config.max_gap, risk.cell)
    for place in np.zeros((0, 2)) if stood is None else np.asarray(stood, float).reshape(-1, 2):
        x, y = (risk.origin[axis] + (np.arange(known.shape[axis]) + 0.5) * risk.cell for axis in range(2))
        bridged |= (x[:, None] - place[0]) ** 2 + (y - place[1]) ** 2 <= config.blind_radius**2
    return bridged & ~known


def _trail(risk: RiskMap, stood: np.ndarray | None) -> np.ndarray:
    """Cells on the straight lines between places where the robot stood one after the other, (nx, ny) bool."""
    trail = np.zeros(risk.risk.shape, bool)
    places = np.zeros((0, 2)) if stood is None else np.asarray(stood, float).reshape(-1, 2)
    for here, there in pairwise(places):
        length = float(np.hypot(*(there - here)))
        if length > _LEAP:
            continue
        share = np.linspace(0, 1, int(np.ceil(2 * length / risk.cell)) + 1)[:, None]
        index = np.floor((here + share * (there - here) - risk.origin) / risk.cell).astype(int)
        inside = ((index >= 0) & (index < trail.shape)).all(axis=1)
        trail[tuple(index[inside].T)] = True
    # Ways over cells go round no corner.
    return np.asarray(binary_dilation(trail, np.ones((3, 3))))


def _near_slopes(steep: np.ndarray, passable: np.ndarray, cell: float, config: VoxelWorldConfig) -> np.ndarray:
    """Slopes and stairs that are driven on, and the flat ground before, between and behind them, (nx, ny) bool.

    Not the ground beside them: from there a step leads up.
    """
    # Along a wall a thin strip looks like a slope, because part of what is around is wall.
    parts, count = label(binary_opening(steep & passable, np.ones((3, 3))), np.ones((3, 3)))
    large = np.flatnonzero(np.bincount(parts.ravel(), minlength=count + 1)[1:] * cell**2 >= config.steep_area) + 1
    slopes = np.isin(parts, large)
    reach = round(config.steep_reach / cell)
    if not slopes.any() or not reach:
        return slopes
    return np.asarray(binary_dilation(slopes, np.ones((3, 3)), iterations=reach, mask=passable))


def _grown(
    solid: np.ndarray,
    ground: np.ndarray,
    slopes: np.ndarray,
    trail: np.ndarray,
    footprint: list[float],
    cell: float,
    config: VoxelWorldConfig,
) -> np.ndarray:
    """Kinds of the cells after obstacles, hazards and unseen ground have grown by the robot."""
    length, width = footprint
    wide = 0.5 * float(np.hypot(length, width)) + config.margin
    growth = config.growth + config.margin if config.growth else wide
    narrow = (config.steep_growth or 0.5 * width) + config.margin
    kind = np.where(ground | (solid != FREE), solid, UNKNOWN).astype(np.uint8)
    unseen = np.pad(kind == UNKNOWN, 1, constant_values=True)
    away = distance_transform_edt(~unseen)[1:-1, 1:-1] * cell
    kind[(kind == FREE) & ~trail & (away <= max(config.unknown_growth, cell))] = FENCE
    grown, nearest_yet = kind.copy(), np.full(kind.shape, np.inf)
    for grows, reach in ((solid == OCCUPIED, growth), (np.isin(solid, (WATER, HOT)), wide)):
        if not grows.any():
            continue
        away, nearest = distance_transform_edt(~grows, return_indices=True)
        inside = away * cell <= np.where(trail, 0.5 * width, np.where(slopes, narrow, reach))
        closed = inside & (away < nearest_yet) & np.isin(kind, (FREE, FENCE))
        grown[closed] = solid[tuple(nearest)][closed]
        nearest_yet[closed] = away[closed]
    return grown
