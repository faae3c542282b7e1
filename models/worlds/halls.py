"""Halls from floor plans: walls extruded, boxes as added landmarks, lamps under the ceiling and windows (S4)."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from naraha.systems.config import check_config, quantity
from naraha.systems.placement import FloorPlan
from naraha.systems.sensing import Lamp, Surface, Window

from ..plans import load_floor_plan
from . import surfaces
from .world import Solid, World

WALL_HEIGHT = 2.6
"""[m]; drawn low, so that one sees into the hall. Lamps may hang higher."""

_CARDBOARD = Surface(label="crate", lidar_reflectivity=0.6, nir_reflectance=0.6, attenuation=1.0)


@dataclass(kw_only=True)
class HallConfig:
    """What a hall has besides its plan."""

    # [m] side and height of the boxes that are put up as landmarks. Those of the paper are cardboard boxes.
    box_side: float = quantity(0.5, unit="m", above=0)
    box_height: float = quantity(0.9, unit="m", above=0)
    # Lamps; null hangs them in rows, see below. A hall without any cannot be measured.
    lamps: list[Lamp] | None = None
    windows: list[Window] = field(default_factory=list)
    # [m] distance of the rows and of the lamps in a row, and height, of lamps that are hung in rows.
    lamp_spacing: float = quantity(7.0, unit="m", above=0)
    lamp_height: float = quantity(5.0, unit="m", above=0)
    # [cd] straight down; a lamp of 20 000 lm that shines as a disc has 6 400.
    lamp_intensity: float = quantity(6400.0, unit="cd", low=0)
    # Standard deviation of the intensity between lamps, relative: they are not of one age. Assumed.
    lamp_spread: float = quantity(0.1, unit="-", low=0, high=0.3)


def hang_lamps(plan: FloorPlan, config: HallConfig, seed: int = 0) -> list[Lamp]:
    """Lamps in rows over all of the floor that is free, spaced alike, half a spacing from the edges; `seed` is that of
    their intensities."""
    counts = np.maximum(np.round(plan.size / config.lamp_spacing), 1).astype(int)
    xs, ys = (plan.origin[i] + plan.size[i] * (np.arange(n) + 0.5) / n for i, n in enumerate(counts))
    places = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
    free = places[~plan.is_occupied(places)]
    spread = np.clip(np.random.default_rng(seed).standard_normal(len(free)), -3, 3)
    intensities = config.lamp_intensity * (1 + config.lamp_spread * spread)
    return [
        Lamp(xyz=[float(x), float(y), config.lamp_height], intensity=float(intensity))
        for (x, y), intensity in zip(free, intensities, strict=True)
    ]


def build_hall(
    plan: FloorPlan, sites: np.ndarray | None = None, config: HallConfig | None = None, seed: int = 0
) -> World:
    """The world of a plan. Frame W is that of the plan, the floor is at z = 0.

    Args:
        sites: (k, 2) middles of the boxes that are added as landmarks [m]; put where `FloorPlan.with_boxes` draws them.
        seed: of lamps that are hung in rows.

    Raises:
        ConfigError: a value of `config` is out of range.
    """
    config = config or HallConfig()
    check_config(config, key="hall")
    size, middle = plan.size, plan.origin + plan.size / 2
    wall: dict[str, Any] = {"surface": "wall", "rgb": [0.74, 0.73, 0.7]}
    floor = [float(size[0]) + 0.4, float(size[1]) + 0.4, 0.2]
    solids = [
        Solid(name="floor", box=floor, xyz=[float(middle[0]), float(middle[1]), -0.1], surface="floor", rgb=[0.55] * 3)
    ]
    for i, (x0, y0, x1, y1) in enumerate(plan.wall_boxes().tolist(), 1):
        box, place = [x1 - x0, y1 - y0, WALL_HEIGHT], [(x0 + x1) / 2, (y0 + y1) / 2, WALL_HEIGHT / 2]
        solids.append(Solid(name=f"wall_{i}", box=box, xyz=place, **wall))
    for i, (x, y) in enumerate(snapped(plan, sites, config.box_side).tolist(), 1):
        box, place = [config.box_side, config.box_side, config.box_height], [x, y, config.box_height / 2]
        solids.append(Solid(name=f"landmark_{i}", box=box, xyz=place, surface="cardboard", rgb=[0.78, 0.55, 0.3]))
    return World(
        solids=solids,
        surfaces={"floor": surfaces.CONCRETE_FLOOR, "wall": surfaces.CONCRETE_WALL, "cardboard": _CARDBOARD},
        lamps=hang_lamps(plan, config, seed) if config.lamps is None else config.lamps,
        windows=config.windows,
    )


def snapped(plan: FloorPlan, sites: np.ndarray | None, side: float) -> np.ndarray:
    """Middles (k, 2) [m] of boxes on `sites` (k, 2) whose sides lie on the plan's grid, as `FloorPlan.with_boxes` draws
    them."""
    middles = np.zeros((0, 2)) if sites is None else np.asarray(sites, float).reshape(-1, 2)
    corner = np.round((middles - side / 2 - plan.origin) / plan.resolution) * plan.resolution + plan.origin
    return corner + side / 2


def build(name: str, seed: int = 0) -> World:
    """The hall of a shipped plan, without added landmarks."""
    return build_hall(load_floor_plan(name), seed=seed)
