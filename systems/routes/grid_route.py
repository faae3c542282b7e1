"""Gymnasium environments of a route on a grid: one robot, or a batch of them stepped at once."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from ..errors import InputError
from .motion_model import ACTIONS, HEADINGS
from .route_grid import FENCE, WATER, RouteGrid
from .route_task import RouteTask

# Motions after which an episode is truncated.
MOST_MOTIONS = 2000


def example_task() -> tuple[RouteTask, np.ndarray]:
    """A fenced room of 24 × 24 cells of 0.5 m with water between start and goal, and the start pose (3,)."""
    kind = np.zeros((24, 24), np.uint8)
    kind[[0, -1]] = kind[:, [0, -1]] = FENCE
    kind[9:15, 8:16] = WATER
    grid = RouteGrid.from_kind(kind, 0.5)
    return RouteTask(grid, (11.25, 6.25)), np.array([1.25, 6.25, 0.0])


class GridRouteEnv(gym.Env[np.ndarray, np.int64]):
    """`naraha/GridRoute-v0`: a `RouteTask` as an environment (row S0-h).

    Observation: cell ix, iy and heading of 45°, `MultiDiscrete([nx, ny, 8])`. Action: forward, back, turn +45°,
    turn −45° (`ACTIONS`). Reward: as `RewardConfig` of the task has it. An episode is terminated at the goal;
    running into something leaves the robot where it is and goes on. `gymnasium.make` truncates after 2000 motions.
    `info` holds `pose`, (3,) x, y, heading in M [m, m, rad], and `state`, its number.

    Args:
        task: what to learn; an example room without it.
        start: (3,) pose where episodes begin [m, m, rad]; `reset(options={"start": pose})` overrides it once.

    Raises:
        InputError: the start is not free or at the goal, or an action is not one of the four.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - gymnasium's own name and form

    def __init__(self, task: RouteTask | None = None, start: np.ndarray | None = None, render_mode: None = None):
        self.task, self._start = _given_or_example(task, start)
        self.render_mode = render_mode
        self.observation_space = gym.spaces.MultiDiscrete([*self.task.grid.shape, HEADINGS])
        self.action_space = gym.spaces.Discrete(len(ACTIONS))
        self._state = self._start

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        given = (options or {}).get("start")
        self._state = self._start if given is None else _start_state(self.task, given)
        return _observation(self.task, np.array(self._state)), self._info(False)

    def step(self, action: np.int64) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if not self.action_space.contains(np.int64(action)):
            raise InputError("not an action", where="GridRouteEnv", value=action, valid=ACTIONS)
        successor, reward = self.task.transitions
        row = self.task.motion.probability[self.task.grid.terrain.flat[self._state // HEADINGS], action]
        o = 0 if row[0] == 1 else int(self.np_random.choice(len(row), p=row / row.sum()))
        earned, n = float(reward[self._state, action, o]), int(successor[self._state, action, o])
        # The goal is one terminal state; what is shown of it is the last state before.
        self._state = self._state if n < 0 else n
        return _observation(self.task, np.array(self._state)), earned, n < 0, False, self._info(n < 0)

    def _info(self, reached: bool) -> dict[str, Any]:
        return {"pose": self.task.pose_of(np.array(self._state)), "state": self._state, "reached": reached}


class GridRouteVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`gymnasium.make_vec("naraha/GridRoute-v0", ...)`: many robots on one task, stepped by array operations.

    An episode that has ended begins anew at the next step, whose action is ignored (`AutoresetMode.NEXT_STEP`).

    Args:
        num_envs: robots. most_motions: after which an episode is truncated. Else as `GridRouteEnv`.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 - as above

    def __init__(
        self,
        num_envs: int = 1,
        task: RouteTask | None = None,
        start: np.ndarray | None = None,
        most_motions: int = MOST_MOTIONS,
        max_episode_steps: int | None = None,
        render_mode: None = None,
    ):
        self.task, self._start = _given_or_example(task, start)
        self.num_envs, self.render_mode = num_envs, render_mode
        self._most = max_episode_steps or most_motions
        self.single_observation_space = gym.spaces.MultiDiscrete([*self.task.grid.shape, HEADINGS])
        self.single_action_space = gym.spaces.Discrete(len(ACTIONS))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._states = np.full(num_envs, self._start)
        self._motions = np.zeros(num_envs, np.int64)
        self._ended = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self._states[:], self._motions[:], self._ended[:] = self._start, 0, False
        return _observation(self.task, self._states), {"state": self._states.copy()}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        actions = np.asarray(actions)
        if actions.shape != (self.num_envs,) or (actions < 0).any() or (actions >= len(ACTIONS)).any():
            raise InputError("not actions of all robots", where="GridRouteVectorEnv", value=actions, valid=ACTIONS)
        successor, reward = self.task.transitions
        outcome = np.zeros(self.num_envs, int)
        if successor.shape[2] > 1:
            rows = self.task.motion.probability[self.task.grid.terrain.ravel()[self._states // HEADINGS], actions]
            drawn = self.np_random.random((self.num_envs, 1))
            outcome = np.minimum((drawn >= rows.cumsum(axis=1)).sum(axis=1), rows.shape[1] - 1)
        following = successor[self._states, actions, outcome].astype(np.int64)
        earned = np.where(self._ended, 0.0, reward[self._states, actions, outcome])
        terminated = (following < 0) & ~self._ended
        states = np.where(terminated, self._states, following)
        self._states = np.where(self._ended, self._start, states)
        self._motions = np.where(self._ended, 0, self._motions + 1)
        truncated = (self._motions >= self._most) & ~terminated
        self._ended = terminated | truncated
        return (
            _observation(self.task, self._states),
            earned,
            terminated,
            truncated,
            {"state": self._states.copy(), "reached": terminated},
        )


def _given_or_example(task: RouteTask | None, start: np.ndarray | None) -> tuple[RouteTask, int]:
    if task is None:
        task, example = example_task()
        start = example if start is None else start
    elif start is None:
        raise InputError("a task needs a start", where="GridRoute-v0", key="start", valid="x, y, heading [m, m, rad]")
    return task, _start_state(task, start)


def _start_state(task: RouteTask, pose: np.ndarray) -> int:
    state = task.state_of(np.asarray(pose))
    if task.goal_cells.flat[state // HEADINGS]:
        raise InputError("is at the goal already", where="start", value=np.asarray(pose).tolist())
    return state


def _observation(task: RouteTask, states: np.ndarray) -> np.ndarray:
    """(..., 3) ix, iy, heading of states (...)."""
    cells, headings = states // HEADINGS, states % HEADINGS
    ny = task.grid.shape[1]
    return np.stack([cells // ny, cells % ny, headings], axis=-1)


def register_environments() -> None:
    """Makes `naraha/GridRoute-v0` known to gymnasium; does nothing when it is already."""
    if "naraha/GridRoute-v0" not in gym.registry:
        gym.register(
            "naraha/GridRoute-v0",
            entry_point=f"{__name__}:GridRouteEnv",
            vector_entry_point=f"{__name__}:GridRouteVectorEnv",
            max_episode_steps=MOST_MOTIONS,
            nondeterministic=False,
        )
