"""Policy reuse: what was learnt on earlier maps and for other goals as a start for the next route (row S0-h)."""

from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from .motion_model import HEADINGS
from .policy import RoutePolicy
from .q_learning import look_ahead
from .route_task import RewardConfig, RouteTask


def reuse_values(task: RouteTask, policies: Sequence[RoutePolicy], *, start_values: str = "distance") -> np.ndarray:
    """Start values (nx, ny, 8, 4) for `task` from the policies of earlier tasks, for `begin(..., q=...)`.

    An earlier goal serves as a landmark: a way from s to the new goal g loses at least |L(s) - L(g)|, where L is what
    the way to the earlier goal loses (triangle inequality; the bound of the ALT search, Goldberg and Harrelson 2005;
    motions can be undone at the same price). The largest of these bounds and of that of `start_values` is taken, so
    that the start values lead along the earlier routes and then on to the new goal. The best heading is taken for L(g):
    a value may be too little by the turns at the goal, which `optimality_gap` shows. Where an obstacle has gone since,
    the values are too little as well, and exploration has to find the way through.

    The grids may have another origin, size and cell: the values are looked up by their place in M. Policies whose
    grid does not hold the new goal, or that know nothing there, add nothing.

    Args:
        start_values: "distance" or "straight", see `LearningConfig.start_values`: what is known without a policy.

    Raises:
        InputError: a policy was learnt for other rewards, so that its values mean something else.
    """
    bound = task.straight_bound if start_values == "straight" else task.bound
    least = loss_of(bound, task.rewards)[:, :, None] * np.ones(HEADINGS)
    for policy in policies:
        if policy.rewards != task.rewards:
            raise InputError("policy for other rewards", where="reuse_values", value=policy.rewards, valid=task.rewards)
        least = np.fmax(least, _landmark_bound(task, policy))
    least[task.goal_cells] = 0.0
    return look_ahead(task, task.value_of(least).ravel())


def loss_of(value: np.ndarray, rewards: RewardConfig) -> np.ndarray:
    """What ways from states of `value` (...) lose, the inverse of `RouteTask.value_of`; NaN where nothing is known."""
    if rewards.discount == 1:
        return rewards.goal - value
    known = value > 0
    return np.where(known, np.log(np.where(known, value, 1.0) / rewards.goal) / np.log(rewards.discount), np.nan)


def _landmark_bound(task: RouteTask, policy: RoutePolicy) -> np.ndarray:
    """(nx, ny, 8) what ways to the goal of `task` lose at least, seen from that of `policy`; NaN where unknown."""
    nx, ny = task.grid.shape
    none = np.full((nx, ny, HEADINGS), np.nan)
    loss = loss_of(policy.q.max(axis=3), policy.rewards)
    loss[~policy.free] = np.nan
    cells = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), axis=-1)
    ij = np.floor((task.grid.centre_of(cells) - policy.origin) / policy.cell).astype(int)
    inside = ((ij >= 0) & (ij < policy.free.shape)).all(axis=-1)
    there = none.copy()
    there[inside] = loss[tuple(ij[inside].T)]
    # The earlier goal itself is terminal and has no values; the way to it loses nothing from there.
    goal = np.floor((np.array(policy.goal) - policy.origin) / policy.cell).astype(int)
    away = policy.origin + (ij + 0.5) * policy.cell - np.array(policy.goal)
    at_earlier = (ij == goal).all(axis=-1) | (np.hypot(away[..., 0], away[..., 1]) <= policy.goal_radius)
    there[inside & at_earlier] = 0.0
    at_goal = there[task.goal_cells]
    if not np.isfinite(at_goal).any():
        return none
    return np.abs(there - np.nanmin(at_goal))
