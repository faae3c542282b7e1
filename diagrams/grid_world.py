"""A world in which a grid of routes is true, to drive in."""

from typing import Any

import numpy as np
from naraha.models.worlds import Solid, World, surfaces
from naraha.systems.routes import FENCE, FREE, KINDS, WATER, RouteGrid, merge_voxels

# [m] Height and thickness of the walls around the grid.
_WALL = (1.0, 0.2)


def world_of(grid: RouteGrid, *, growth: float = 0.5) -> World:
    """A flat world in which the grid is true: walls around it, boxes where it is blocked, pools where it is water.

    Args:
        growth: by how much the grid's obstacles and pools have been grown by the robot, and are made smaller here [m].
    """
    low, high = grid.origin, grid.origin + np.array(grid.shape) * grid.cell
    (x, y), (lx, ly) = 0.5 * (low + high), high - low
    height, thick = _WALL
    wall: dict[str, Any] = {"surface": "wall", "rgb": [0.72, 0.71, 0.68]}
    solids = [Solid(name="floor", box=[lx + 2, ly + 2, 0.2], xyz=[x, y, -0.1], surface="floor", rgb=[0.5, 0.5, 0.48])]
    for name, size, at in (
        ("west", [thick, ly, height], [low[0] - thick / 2, y]),
        ("east", [thick, ly, height], [high[0] + thick / 2, y]),
        ("south", [lx, thick, height], [x, low[1] - thick / 2]),
        ("north", [lx, thick, height], [x, high[1] + thick / 2]),
    ):
        solids.append(Solid(name=f"wall_{name}", box=size, xyz=[*at, height / 2], **wall))
    for number, name in enumerate(KINDS):
        if number in (FREE, FENCE):  # a fence is a line that must not be crossed, and nothing to see
            continue
        cells = np.argwhere(grid.kind == number)
        boxes = merge_voxels(np.column_stack([cells, np.zeros(len(cells), int)]))
        for i, box in enumerate(boxes):
            size = (box[3:5] - box[:2]) * grid.cell - 2 * growth
            if (size <= 0.01).any():  # nothing is left of what only the growth has made
                continue
            middle = grid.origin + 0.5 * (box[:2] + box[3:5]) * grid.cell
            pool = number == WATER
            solids.append(
                Solid(
                    name=f"{name}_{i}",
                    box=[*size.tolist(), 0.01 if pool else 0.5],
                    xyz=[*middle.tolist(), 0.005 if pool else 0.25],
                    surface="water" if pool else "wall",
                    rgb=[0.3, 0.5, 0.8] if pool else [0.6, 0.5, 0.4],
                    collides=not pool,
                )
            )
    return World(
        solids=solids,
        surfaces={"floor": surfaces.CONCRETE_FLOOR, "wall": surfaces.CONCRETE_WALL, "water": surfaces.WATER},
    )
