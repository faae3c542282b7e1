"""Tasks with an answer known on paper."""

import numpy as np
from naraha.systems.routes import FREE, OCCUPIED, RewardConfig, RouteGrid, RouteTask


def corridor(length=10, **rewards):
    """A corridor along x, one cell wide; start at the near end facing the goal at the far end."""
    kind = np.full((length, 3), OCCUPIED)
    kind[:, 1] = FREE
    grid = RouteGrid.from_kind(kind, 0.5)
    return RouteTask(grid, ((length - 0.5) * 0.5, 0.75), RewardConfig(**rewards)), np.array([0.25, 0.75, 0.0])
