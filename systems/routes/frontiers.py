"""Where to go next in a survey: the looks that tell most for the time that they and the way to them take."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, minimum_filter

from ..config import check_config, quantity
from .ground import make_ground
from .islands import find_islands
from .route_config import RoutesConfig
from .route_grid import RouteGrid
from .search_kernels import tree
from .view_kernels import mark_view, unseen_sectors
from .voxels import Voxels

_SECTORS, _RAYS = 36, 4
# [m] The lowest ground within this distance is that which things stand on.
_LOWEST = 1.0


@dataclass(kw_only=True)
class FrontierConfig:
    """What one look shows, and when it is worth its time."""

    # [m] Distance up to which a look settles what is on the ground; and a suspicion, of more than 1 bit, which it may
    # not answer from afar, where near-infrared is weak and much is hidden.
    view_range: float = quantity(5.0, unit="m", above=0)
    sure_range: float = quantity(3.0, unit="m", above=0)
    # [m] Nearer ground is below what the sensors see.
    near_range: float = quantity(1.0, unit="m", low=0)
    # [deg] Field of view of a look: that of the depth camera (D415), which the sweep of the other cameras covers.
    fov_deg: float = quantity(69.0, unit="deg", above=0, high=360)
    # [bit m²], [bit m²/s] What a look must tell to be worth it, in all and for its time. Unseen ground tells 1 bit/m².
    min_gain: float = quantity(1.0, unit="bit m²", above=0)
    min_value: float = quantity(0.03, unit="bit m²/s", low=0)
    # [bit] Ground with less interest is as good as known.
    min_interest: float = quantity(0.3, unit="bit", low=0)
    # [m] What stands between these heights over the ground hides what is behind; lower things throw short shadows.
    hides_from: float = quantity(0.3, unit="m", low=0)
    hides_to: float = quantity(0.9, unit="m", above=0)
    # [m] Ground is expected up to this far from where the map knows some.
    beyond: float = quantity(2.5, unit="m", low=0)
    # [m] Distance of the places that are compared.
    spacing: float = quantity(0.5, unit="m", above=0)
    # [m] Clearance of the places to look from, where the robot turns on the spot.
    room: float = quantity(0.0, unit="m", low=0)
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
        view: where from. gain: what it tells, interest times area [bit m²].
        way: to there, weighted by the cost of the cells [m].
        value: gain for the time of way, turn and look [bit m²/s].
    """

    view: View
    gain: float
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
    # The lowest ground around: the top of a crate is ground in its own cell, and hides all the same.
    reach = 2 * round(_LOWEST / grid.cell) + 1
    low = minimum_filter(np.nan_to_num(grid.height, nan=np.inf), reach)
    ground = np.where(np.isfinite(low), low, float(np.nanmedian(grid.height)))[tuple(index.T)]
    stands = (z - ground > config.hides_from) & (z - ground < config.hides_to)
    hiding[tuple(index[stands].T)] = True
    return hiding


def seen_cells(
    grid: RouteGrid, hiding: np.ndarray, views: Sequence[View], config: FrontierConfig, reach: float | None = None
) -> np.ndarray:
    """Cells that the views show up to `reach` [m], the view range when not given, (nx, ny) bool."""
    seen, half = np.zeros(grid.shape, bool), 0.5 * np.deg2rad(config.fov_deg)
    near, far = config.near_range / grid.cell, (config.view_range if reach is None else reach) / grid.cell
    for view in views:
        x, y = (np.array([view.x, view.y]) - grid.origin) / grid.cell
        mark_view(seen, hiding, float(x), float(y), view.heading - half, view.heading + half, near, far)
    return seen


@dataclass(frozen=True, eq=False)
class Questions:
    """What looks could still tell of each cell [bit], (nx, ny) float32 each.

    Attributes:
        near: when they are taken from within the sure range. far: from farther away.
    """

    near: np.ndarray
    far: np.ndarray


def open_questions(
    grid: RouteGrid, hiding: np.ndarray, views: Sequence[View], interest: np.ndarray | None, config: FrontierConfig
) -> Questions:
    """What looks could still tell.

    Nothing where a view has looked already, so a look that was taken is never proposed again and a survey comes to its
    end, also where a look did not show what was hoped for; only a suspicion that was looked at from afar is still asked
    from near. Nothing behind walls, far from all ground that is known.
    """
    ground = np.isfinite(grid.height)
    if config.beyond > 0 and ground.any():
        ground = binary_dilation(ground, iterations=max(round(config.beyond / grid.cell), 1))
    worth = np.ones(grid.shape, np.float32) if interest is None else np.asarray(interest, np.float32)
    worth = np.where(ground & ~hiding & (worth >= config.min_interest), worth, np.float32(0))
    seen, seen_near = (seen_cells(grid, hiding, views, config, reach) for reach in (None, _sure(config)))
    return Questions(np.where(seen_near | (seen & (worth <= 1)), np.float32(0), worth), np.where(seen, 0, worth))


def gain_of(view: View, questions: Questions, grid: RouteGrid, hiding: np.ndarray, config: FrontierConfig) -> float:
    """What a look tells of the `open_questions` [bit m²]."""
    seen, near = (seen_cells(grid, hiding, [view], config, reach) for reach in (None, _sure(config)))
    return float(questions.near[near].sum() + questions.far[seen & ~near].sum()) * grid.cell**2


def _sure(config: FrontierConfig) -> float:
    return min(config.sure_range, config.view_range)


def find_goals(
    grid: RouteGrid,
    pose: np.ndarray,
    hiding: np.ndarray,
    views: Sequence[View],
    config: FrontierConfig | None = None,
    routes: RoutesConfig | None = None,
    interest: np.ndarray | None = None,
) -> tuple[ViewGoal, ...]:
    """Looks that are worth it, one for each reachable place, the best first; none when nothing more is to be seen.

    Of the headings at a place the one that tells most of the `open_questions` counts.

    Args:
        pose: (3,) x, y, heading in M [m, m, rad].
        hiding: (nx, ny) bool, see `hiding_cells`.
        interest: (nx, ny) what a look at each cell would tell [bit], see `make_interest`; 1 everywhere without.
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
    questions = open_questions(grid, hiding, views, interest, config)
    step = max(round(config.spacing / grid.cell), 1)
    every = np.zeros(grid.shape, bool)
    every[start[0] % step :: step, start[1] % step :: step] = True
    places = np.argwhere(every & ~grid.blocked & np.isfinite(way) & (grid.clearance >= config.room))
    if not len(places):
        return ()
    told = np.zeros((len(places), _SECTORS))
    for worth, near, reach in (
        (questions.near, config.near_range, _sure(config)),
        (questions.far, _sure(config), config.view_range),
    ):
        ranges = near / grid.cell, reach / grid.cell
        told += unseen_sectors(places + 0.5, worth, hiding, *ranges, _SECTORS, _RAYS) * grid.cell**2
    width = int(np.clip(round(config.fov_deg / 360 * _SECTORS), 1, _SECTORS))
    cyclic = np.cumsum(np.column_stack([np.zeros(len(places)), told, told[:, :width]]), axis=1)
    shown = cyclic[:, width : width + _SECTORS] - cyclic[:, :_SECTORS]
    best = shown.argmax(axis=1)
    headings = (best + 0.5 * width) * 2 * np.pi / _SECTORS
    goals = []
    for cell, heading, gain in zip(places, headings, shown.max(axis=1), strict=True):
        if gain < config.min_gain:
            continue
        x, y = pose[:2] if (cell == start).all() else grid.centre_of(cell)
        metres = float(way[tuple(cell)])
        turn = abs(float(np.angle(np.exp(1j * (heading - pose[2])))))
        time = metres / config.speed + turn / config.turn_rate + config.look_time
        if gain < config.min_value * time:
            continue
        view = View(float(x), float(y), float(np.angle(np.exp(1j * heading))))
        goals.append(ViewGoal(view, float(gain), metres, float(gain) / time))
    return tuple(sorted(goals, key=lambda goal: -goal.value))
