"""A learnt policy as a table, and the route that follows from it."""

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .motion_model import HEADINGS, STEPS
from .route_grid import RouteGrid
from .route_task import RewardConfig, RouteTask, heading_of


@dataclass(frozen=True, eq=False)
class RoutePolicy:
    """Values of the motions in every cell and heading, with what is needed to look them up in the map.

    Attributes:
        q: (nx, ny, 8, 4) values; in cells that are not free they mean nothing.
        free: (nx, ny) bool.
        origin: (2,) corner of cell (0, 0) in M [m]. cell: edge of a cell [m].
        goal: (2,) x, y in M [m]. goal_radius: [m].
        rewards: that the values are made of.
        fingerprint: of the grid (`RouteGrid.fingerprint`).
    """

    q: np.ndarray
    free: np.ndarray
    origin: np.ndarray
    cell: float
    goal: tuple[float, float]
    goal_radius: float
    rewards: RewardConfig
    fingerprint: str

    def __deepcopy__(self, memo: dict) -> "RoutePolicy":
        return self

    @classmethod
    def of(cls, task: RouteTask, q: np.ndarray) -> "RoutePolicy":
        """The policy of values `q` (nx, ny, 8, 4) for `task`."""
        q = np.array(q, float)
        if q.shape != task.q_shape:
            raise InputError("values do not fit the grid", where="q", value=q.shape, valid=str(task.q_shape))
        q.flags.writeable = False
        grid = task.grid
        goal = (float(task.goal[0]), float(task.goal[1]))
        return cls(q, ~grid.blocked, grid.origin, grid.cell, goal, task.goal_radius, task.rewards, grid.fingerprint)

    @classmethod
    def nothing(cls, rewards: RewardConfig) -> "RoutePolicy":
        """The policy on a map without cells."""
        no_cells = np.zeros((0, 0), bool)
        return cls(np.zeros((0, 0, HEADINGS, 4)), no_cells, np.zeros(2), 1.0, (0.0, 0.0), 0.0, rewards, "")

    def fits(self, grid: RouteGrid) -> bool:
        """Whether the policy was made for exactly this grid."""
        return self.fingerprint == grid.fingerprint

    def action_of(self, pose: np.ndarray) -> int | None:
        """The best motion (index into `ACTIONS`) at a pose (3,) x, y, heading in M [m, m, rad].

        None outside the grid or in a cell that is not free: what the table says there was not learnt.
        """
        pose = np.asarray(pose, float)
        ij = np.floor((pose[:2] - self.origin) / self.cell)
        if not np.isfinite(pose).all() or (ij < 0).any() or (ij >= self.free.shape).any():
            return None
        i, j = ij.astype(int)
        return int(self.q[i, j, heading_of(pose[2])].argmax()) if self.free[i, j] else None


@dataclass(frozen=True, eq=False)
class RollOut:
    """What a policy does from a start.

    Attributes:
        poses: (K + 1, 3) x, y, heading in M [m, m, rad], the start and after every motion.
        actions: (K,) index into `ACTIONS`.
        rewards: (K,).
        reached: whether the last pose is at the goal.
        reason: "goal", "circle" (it came back to a state it had left: it would go on for ever) or "limit".
    """

    poses: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    reached: bool
    reason: str

    @property
    def length(self) -> float:
        """Of the way over the ground [m]."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())


def roll_out(
    task: RouteTask,
    q: np.ndarray,
    start: int,
    *,
    rng: np.random.Generator | None = None,
    most_motions: int = 10_000,
) -> RollOut:
    """Follows the best motions of `q` (nx, ny, 8, 4) from state `start`.

    Args:
        rng: draws the outcomes; without it every motion has its likeliest one.
    """
    successor, reward = task.transitions
    actions = q.reshape(-1, 4).argmax(axis=1)
    states = [start]
    done: list[int] = []
    earned: list[float] = []
    seen = {start}
    reason = "goal" if task.goal_cells.flat[start // HEADINGS] else "limit"
    while reason == "limit" and len(done) < most_motions:
        s = states[-1]
        a = int(actions[s])
        chances = task.motion.probability[task.grid.terrain.flat[s // HEADINGS], a]
        o = int(chances.argmax()) if rng is None else int(rng.choice(len(chances), p=chances / chances.sum()))
        n = int(successor[s, a, o])
        done.append(a)
        earned.append(float(reward[s, a, o]))
        states.append(_goal_after(task, s, a, o) if n < 0 else n)
        if n < 0:
            reason = "goal"
        elif rng is None and n in seen:
            reason = "circle"
        seen.add(n)
    poses = task.pose_of(np.array(states))
    return RollOut(poses, np.array(done, int), np.array(earned), reason == "goal", reason)


def _goal_after(task: RouteTask, state: int, action: int, outcome: int) -> int:
    """The state at the goal in which outcome `outcome` of a motion from `state` ends."""
    ny = task.grid.shape[1]
    cell, heading = divmod(state, HEADINGS)
    terrain = task.grid.terrain.flat[cell]
    motion = task.motion
    along = STEPS[(heading + motion.veer[terrain, action, outcome]) % HEADINGS]
    ij = np.array(divmod(cell, ny))
    while not task.goal_cells[tuple(ij)]:
        ij = ij + along
    return int((ij[0] * ny + ij[1]) * HEADINGS + (heading + motion.turn[terrain, action, outcome]) % HEADINGS)
