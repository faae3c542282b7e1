"""The decision problem that is learnt or solved: a grid, a goal, what the motions lead to and what they earn."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..config import check_config, quantity
from ..errors import ConfigError, InputError
from .motion_model import HEADINGS, MotionModel, deterministic
from .route_grid import FENCE, KINDS, WATER, RouteGrid
from .task_kernels import distance_field, transition_table


@dataclass(kw_only=True)
class RewardConfig:
    """What the robot earns. The rewards at the goal, fence and water are the paper's (row S0-h, section 3.3.1)."""

    # For reaching the goal.
    goal: float = quantity(1.0, above=0)
    # For running into a fence or the edge of the map; the robot stays where it is and the episode goes on.
    fence: float = quantity(-5.0, high=0)
    # For driving to the edge of water; the robot does not enter it.
    water: float = quantity(-5.0, high=0)
    # For running into anything else that is not free.
    obstacle: float = quantity(-5.0, high=0)
    # [1/m] Lost on every metre through cells of cost 1. Small against a bump: 250 m of detour are worth none.
    per_metre: float = quantity(0.02, unit="1/m", low=0)
    # Lost by every turn of 45° and every motion that fails: what 0.3 m of way cost, the time of a turn.
    per_turn: float = quantity(0.006, low=0)
    # γ of Eq. 8; 1 makes the value the expected sum of the rewards.
    discount: float = quantity(1.0, above=0, high=1)

    def __post_init__(self) -> None:
        if self.discount == 1 and not (self.per_metre > 0 and self.per_turn > 0):
            problem = "without a discount every motion must cost something"
            raise ConfigError(problem, key="per_metre", value=self.per_metre, valid="> 0, and per_turn > 0")


def paper_rewards() -> RewardConfig:
    """The paper's setting: goal 1, fence and water −5, nothing for a step, discount 0.1.

    The paper gives "α = 0.5, r_t = 0.1" and no γ. A reward of 0.1 a step is ruled out by its learning curve, whose
    sum of rewards tends to 1 on a way without bumps, so 0.1 is taken for γ, the only parameter of Eq. 8 that is
    otherwise missing.
    """
    return RewardConfig(per_metre=0.0, per_turn=0.0, discount=0.1)


@dataclass(frozen=True, eq=False)
class RouteTask:
    """The way to one goal on one grid, from anywhere. States are (ix, iy, heading), numbered in C order.

    Attributes:
        goal: (2,) x, y in M [m].
        goal_radius: cells with their centre within it are the goal too [m].

    Raises:
        InputError: the goal is outside the grid or not free (the error names the nearest free cell).
        ConfigError: a reward is out of range.
    """

    grid: RouteGrid
    goal: tuple[float, float]
    rewards: RewardConfig = field(default_factory=RewardConfig)
    motion: MotionModel = field(default_factory=deterministic)
    goal_radius: float = 0.0

    def __post_init__(self) -> None:
        check_config(self.rewards, key="rewards")
        if not (np.isfinite(self.goal_radius) and self.goal_radius >= 0):
            raise InputError("goal radius out of range", where="RouteTask", value=self.goal_radius, valid=">= 0 m")
        self.grid.free_index_of(np.array(self.goal, float), "goal")

    @property
    def states(self) -> int:
        return self.grid.kind.size * HEADINGS

    @property
    def q_shape(self) -> tuple[int, int, int, int]:
        return (*self.grid.shape, HEADINGS, 4)

    @cached_property
    def goal_cells(self) -> np.ndarray:
        """(nx, ny) bool: free cells that are the goal."""
        nx, ny = self.grid.shape
        centres = self.grid.centre_of(np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), axis=-1))
        cells = np.hypot(*np.moveaxis(centres - np.array(self.goal), -1, 0)) <= self.goal_radius
        cells[tuple(self.grid.index_of(np.array(self.goal)))] = True
        return cells & ~self.grid.blocked

    @cached_property
    def transitions(self) -> tuple[np.ndarray, np.ndarray]:
        """Successors (S, 4, O) int32, -1 for the goal, and rewards (S, 4, O) of every state, motion and outcome."""
        r = self.rewards
        bumps = [r.fence if k == FENCE else r.water if k == WATER else r.obstacle for k in range(len(KINDS))]
        rewards = np.array([r.goal, r.per_metre * self.grid.cell, r.per_turn, *bumps])
        m, grid = self.motion, self.grid
        return transition_table(grid.kind, grid.cost, self.goal_cells, m.cells, m.veer, m.turn, grid.terrain, rewards)

    @cached_property
    def _field(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return distance_field(self.grid.kind, self.grid.cost, self.goal_cells)

    @property
    def distance(self) -> np.ndarray:
        """(nx, ny): length times cost of the best way over the cells to the goal [m], inf where there is none."""
        return self._field[0] * self.grid.cell

    @property
    def reachable(self) -> np.ndarray:
        """(R,) flat cells from which there is a way to the goal, nearest first."""
        return self._field[2]

    @cached_property
    def bound(self) -> np.ndarray:
        """(nx, ny): no value of a state in the cell is larger; 0 where there is no way to the goal.

        Without discount from the length of the way over the cells, else from the number of its motions.
        """
        length, hops, _ = self._field
        if self.rewards.discount == 1:
            return np.where(hops < 0, 0.0, self.value_of(self.rewards.per_metre * self.grid.cell * length))
        return np.where(hops < 0, 0.0, self.value_of(self._motions(hops) - 1))

    @cached_property
    def straight_bound(self) -> np.ndarray:
        """(nx, ny): as `bound`, but from the straight line to the goal, as if nothing were in the way."""
        goals = self.grid.centre_of(np.argwhere(self.goal_cells))
        nx, ny = self.grid.shape
        cells = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), axis=-1)
        away = np.abs(self.grid.centre_of(cells)[:, :, None] - goals)  # (nx, ny, G, 2)
        if self.rewards.discount == 1:
            return self.value_of(self.rewards.per_metre * np.hypot(away[..., 0], away[..., 1]).min(axis=2))
        return self.value_of(self._motions(np.round(away.max(axis=3).min(axis=2) / self.grid.cell)) - 1)

    def value_of(self, loss: np.ndarray) -> np.ndarray:
        """Values of states (...) from which the way loses `loss`: rewards without discount, motions with one."""
        with np.errstate(under="ignore"):
            gamma, goal = self.rewards.discount, self.rewards.goal
            return goal - loss if gamma == 1 else goal * gamma ** np.maximum(loss, 0)

    def _motions(self, cells: np.ndarray) -> np.ndarray:
        """The fewest motions over so many cells."""
        return np.ceil(cells / max(1, int(self.motion.cells.max())))

    def state_of(self, pose: np.ndarray, what: str = "start") -> int:
        """The state of a pose (3,) x, y, heading in M [m, m, rad].

        Raises:
            InputError: not finite, outside the grid or not free.
        """
        pose = np.asarray(pose, float)
        if pose.shape != (3,) or not np.isfinite(pose).all():
            raise InputError("not a pose", where=what, value=pose.tolist(), valid="x, y, heading, finite")
        i, j = self.grid.free_index_of(pose[:2], what)
        return int((i * self.grid.shape[1] + j) * HEADINGS + heading_of(pose[2]))

    def pose_of(self, states: np.ndarray) -> np.ndarray:
        """(..., 3) x, y, heading in M [m, m, rad] of states (...)."""
        states = np.asarray(states)
        cell, heading = states // HEADINGS, states % HEADINGS
        ij = np.stack([cell // self.grid.shape[1], cell % self.grid.shape[1]], axis=-1)
        angle = np.arctan2(np.sin(heading * np.pi / 4), np.cos(heading * np.pi / 4))
        return np.concatenate([self.grid.centre_of(ij), angle[..., None]], axis=-1)

    def can_reach(self, state: int) -> bool:
        """Whether some way leads from the cell of `state` to the goal."""
        return bool(np.isfinite(self._field[0].flat[state // HEADINGS]))


def heading_of(angle: float) -> int:
    """The nearest of the 8 headings to an angle [rad]."""
    return round(float(angle) / (np.pi / 4)) % HEADINGS
