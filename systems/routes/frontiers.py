"""Where to go next in a survey: the places from which most ground is looked at for the first time, for their way."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from ..config import check_config, quantity
from .ground import make_ground
from .islands import find_islands
from .route_config import RoutesConfig
from .route_grid import RouteGrid
from .search_kernels import tree
from .view_kernels import mark_view, unseen_sectors
from .voxels import Voxels

_SECTORS, _RAYS = 36, 4


@dataclass(kw_only=True)
class FrontierConfig:
    """What one look shows, and when it is worth its time."""

    # [m] Distance up to which a look settles what is on the ground.
    view_range: float = quantity(4.0, unit="m", above=0)
    # [deg] Field of view of a look: that of the depth camera (D415), which the sweep of the other cameras covers.
    fov_deg: float = quantity(69.0, unit="deg", above=0, high=360)
    # [m²] Less unseen ground than this is not worth a look.
    min_area: float = quantity(1.0, unit="m²", above=0)
    # [m] What stands between these heights over the ground hides what is behind; lower things throw short shadows.
    hides_from: float = quantity(0.3, unit="m", low=0)
    hides_to: float = quantity(0.9, unit="m", above=0)
    # [m] Ground is looked for within this distance of where the map knows some: not on the far side of walls.
    beyond: float = quantity(1.0, unit="m", low=0)
    # [m] Distance of the places that are compared.
    spacing: float = quantity(0.5, unit="m", above=0)
    # [m/s], [rad/s], [s] Speeds on the way, and what one look takes.
    speed: float = quantity(0.3, unit="m/s", above=0)
    turn_rate: float = quantity(0.5, unit="rad/s", above=0)
    look_time: float = quantity(10.0, unit="s", above=0)


@dataclass(frozen=True)
class View:
    """A place to look from: x, y [m] and heading [rad] in M."""

    x: float
    y: float
    heading: float


@dataclass(frozen=True)
class ViewGoal:
    """A look that is worth it.

    Attributes:
        view: where from. area: unseen ground that it shows [m²]. way: to there, weighted by the cost of the cells [m].
        value: unseen ground for the time of way, turn and look [m²/s].
    """

    view: View
    area: float
    way: float
    value: float


def hiding_cells(grid: RouteGrid, voxels: Voxels, config: FrontierConfig) -> np.ndarray:
    """Cells of `grid` in which something stands that hides what is behind it, (nx, ny) bool."""
    hiding = np.zeros(grid.shape, bool)
    centres = voxels.centres
    if not len(centres) or not np.isfinite(grid.height).any():
        return hiding
    inside = grid.contains(centres[:, :2])
    index, z = grid.index_of(centres[inside, :2]), centres[inside, 2]
    ground = np.nan_to_num(grid.height[tuple(index.T)], nan=float(np.nanmedian(grid.height)))
    stands = (z - ground > config.hides_from) & (z - ground < config.hides_to)
    hiding[tuple(index[stands].T)] = True
    return hiding


def seen_cells(grid: RouteGrid, hiding: np.ndarray, views: Sequence[View], config: FrontierConfig) -> np.ndarray:
    """Cells that the views show, (nx, ny) bool."""
    seen, half = np.zeros(grid.shape, bool), 0.5 * np.deg2rad(config.fov_deg)
    for view in views:
        x, y = (np.array([view.x, view.y]) - grid.origin) / grid.cell
        reach = config.view_range / grid.cell
        mark_view(seen, hiding, float(x), float(y), view.heading - half, view.heading + half, reach)
    return seen


def find_goals(
    grid: RouteGrid,
    pose: np.ndarray,
    hiding: np.ndarray,
    views: Sequence[View],
    config: FrontierConfig | None = None,
    routes: RoutesConfig | None = None,
) -> tuple[ViewGoal, ...]:
    """Looks that are worth it, one for each reachable place, the best first; none when nothing more is to be seen.

    Ground is unseen where none of `views` shows it, known to the LiDAR or not, so a look that has been taken is never
    proposed again and a survey comes to its end, also where a look did not show what was hoped for. Of the headings at
    a place the one that shows most counts.

    Args:
        pose: (3,) x, y, heading in M [m, m, rad].
        hiding: (nx, ny) bool, see `hiding_cells`.
        routes: what ground can be driven over, as for `find_routes`.

    Raises:
        ConfigError: a value of `config` is out of range.
        InputError: the pose is outside the grid or in a cell that is not free; names the nearest free cell.
    """
    config = config or FrontierConfig()
    check_config(config, key="frontiers")
    start = grid.free_index_of(pose[:2], "pose")
    ground = make_ground(grid, routes or RoutesConfig())
    way, _, _ = tree(
        int(start[0] * grid.shape[1] + start[1]), ground.weight, ground.moves, find_islands(grid).table, False
    )
    way = way.reshape(grid.shape) * grid.cell
    near = np.isfinite(grid.height)
    if config.beyond > 0 and near.any():
        near = binary_dilation(near, iterations=max(round(config.beyond / grid.cell), 1))
    unseen = near & ~hiding & ~seen_cells(grid, hiding, views, config)
    step = max(round(config.spacing / grid.cell), 1)
    every = np.zeros(grid.shape, bool)
    every[start[0] % step :: step, start[1] % step :: step] = True
    places = np.argwhere(every & ~grid.blocked & np.isfinite(way))
    if not len(places):
        return ()
    area = unseen_sectors(places + 0.5, unseen, hiding, config.view_range / grid.cell, _SECTORS, _RAYS)
    area *= grid.cell**2
    width = int(np.clip(round(config.fov_deg / 360 * _SECTORS), 1, _SECTORS))
    cyclic = np.cumsum(np.column_stack([np.zeros(len(places)), area, area[:, :width]]), axis=1)
    shown = cyclic[:, width : width + _SECTORS] - cyclic[:, :_SECTORS]
    best = shown.argmax(axis=1)
    headings = (best + 0.5 * width) * 2 * np.pi / _SECTORS
    goals = []
    for cell, heading, gain in zip(places, headings, shown.max(axis=1), strict=True):
        if gain < config.min_area:
            continue
        x, y = pose[:2] if (cell == start).all() else grid.centre_of(cell)
        metres = float(way[tuple(cell)])
        turn = abs(float(np.angle(np.exp(1j * (heading - pose[2])))))
        time = metres / config.speed + turn / config.turn_rate + config.look_time
        view = View(float(x), float(y), float(np.angle(np.exp(1j * heading))))
        goals.append(ViewGoal(view, float(gain), metres, float(gain) / time))
    return tuple(sorted(goals, key=lambda goal: -goal.value))
