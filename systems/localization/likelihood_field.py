"""How far the nearest surface of a map is: what scans are compared with."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from .grid_kernels import NOBODY, PLAN, look_up, spread_elements, surface_elements
from .occupancy_grid import OccupancyGrid, OccupancyGridError


@dataclass(frozen=True, eq=False)
class LikelihoodField:
    """Distance to the nearest surface at the centres of a grid's cells, cut off at `reach`. Read-only.

    Attributes:
        signed: (nx, ny) float32 [cells], negative behind a surface.
        owner: (nx, ny) int32, number of the scan that hit the nearest surface first, `PLAN` where a plan gave it,
            `NOBODY` where there is none within reach.
        origin: (2,) [m]. resolution: [m]. reach: [m].
        planned: as `signed`, of the cells of a plan alone; plan_cells: how many there were.
    """

    signed: np.ndarray
    owner: np.ndarray
    origin: np.ndarray
    resolution: float
    reach: float
    planned: np.ndarray
    plan_cells: int

    def __post_init__(self) -> None:
        for array in (self.signed, self.owner, self.origin, self.planned):
            array.setflags(write=False)

    def __deepcopy__(self, memo: dict) -> "LikelihoodField":
        return self

    def distance(self, p_MP: np.ndarray) -> np.ndarray:
        """Signed distance at points (n, 2) [m], bilinear, (n,) [m]; `reach` outside."""
        x, y = ((np.asarray(p_MP, float).reshape(-1, 2) - self.origin) / self.resolution).T
        reach = self.reach / self.resolution
        found = [look_up(self.signed, a, b, reach)[0] for a, b in zip(x, y, strict=True)]
        return np.array(found, float) * self.resolution


def make_field(
    grid: OccupancyGrid,
    reach: float = 0.5,
    *,
    before: LikelihoodField | None = None,
    changed: tuple[np.ndarray, np.ndarray] | None = None,
) -> LikelihoodField:
    """The field of a grid.

    Cells that beams ended in give the surface to a fraction of a cell: mean hits, and the normals of lines through
    them. Occupied cells of a plan have their surface at their faces: distance between centres less half a cell.

    Args:
        reach: where the distance is cut off [m].
        before, changed: field of the grid before it was changed within the box from low to high, (2,) [m] each: only
            the cells within reach of it are made anew.
    """
    if reach < grid.resolution:
        raise OccupancyGridError("reach of a field", where="likelihood field", value=reach, valid=">= one cell [m]")
    cells = reach / grid.resolution
    nx, ny = grid.shape
    signed, owner = np.empty((nx, ny), np.float32), np.empty((nx, ny), np.int32)
    i0, i1, j0, j1 = 0, nx, 0, ny
    plan = grid.occupied & (grid.owner == PLAN)
    plan_cells = int(plan.sum())
    kept = None
    if before is not None and before.reach == reach and min(before.signed.shape) > 0:
        shift = np.round((before.origin - grid.origin) / grid.resolution).astype(int)
        kept = tuple(slice(s, s + n) for s, n in zip(shift, before.signed.shape, strict=True))
    if before is not None and kept is not None and before.plan_cells == plan_cells:
        # Cells of a plan only ever go.
        planned = np.full((nx, ny), cells, np.float32)
        planned[kept] = before.planned
    else:
        planned = _distance_to_plan(plan, cells)
    if before is not None and kept is not None and changed is not None and before.plan_cells == plan_cells:
        signed[...], owner[...] = planned, np.where(np.abs(planned) < cells, PLAN, NOBODY)
        signed[kept], owner[kept] = before.signed, before.owner
        wide = math.ceil(cells) + 3
        low, high = grid.cells_of(changed[0]).astype(int) - wide, grid.cells_of(changed[1]).astype(int) + wide + 1
        i0, j0 = np.clip(low, 0, (nx, ny))
        i1, j1 = np.clip(high, 0, (nx, ny))
    near = planned[i0:i1, j0:j1]
    signed[i0:i1, j0:j1], owner[i0:i1, j0:j1] = near, np.where(np.abs(near) < cells, PLAN, NOBODY)
    # Elements beyond the edge of what is made anew reach into it.
    wide = math.ceil(cells) + 1
    e0, e1, f0, f1 = max(i0 - wide, 0), min(i1 + wide, nx), max(j0 - wide, 0), min(j1 + wide, ny)
    elements = surface_elements(grid.log_odds, grid.hits, e0, e1, f0, f1)
    spread_elements(elements, grid.owner, signed, owner, cells, i0, i1, j0, j1)
    return LikelihoodField(signed, owner, grid.origin.copy(), grid.resolution, reach, planned, plan_cells)


def _distance_to_plan(plan: np.ndarray, cells: float) -> np.ndarray:
    """Signed distance to the faces of a plan's cells, (nx, ny) float32 [cells], cut off at `cells`."""
    if not plan.any():
        return np.full(plan.shape, cells, np.float32)
    outside, inside = distance_transform_edt(~plan), distance_transform_edt(plan)
    return np.clip(np.where(plan, 0.5 - inside, outside - 0.5), -cells, cells).astype(np.float32)
