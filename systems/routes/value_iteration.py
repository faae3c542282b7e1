"""The optimum of a route task by value iteration, and how far a policy is from it."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from .motion_model import HEADINGS
from .route_task import RouteTask
from .value_kernels import action_values, follow, sweep

# What no policy is worse than where the sweeps begin; a fence or two a metre over the whole map.
_WORST = -1e3


@dataclass(frozen=True, eq=False)
class Solution:
    """Attributes:
    value: (nx, ny, 8) optimal value, -inf where the goal cannot be reached; `goal` itself has 0.
    q: (nx, ny, 8, 4) optimal values of the motions, -inf likewise.
    sweeps: over all states.
    residual: largest change of a value in the last sweep, in parts of the value; 0 means exact up to rounding.
    """

    value: np.ndarray
    q: np.ndarray
    sweeps: int
    residual: float


def solve(task: RouteTask, *, tolerance: float = 1e-7, most_sweeps: int = 100_000) -> Solution:
    """Solves Bellman's equation for the values to which Eq. 8 (row S0-h) converges.

    The sweeps follow the cells by their distance from the goal, so that news travels over the whole map in one, and
    leave out cells around which nothing has changed. A motion that leaves the state as it is, is solved for. Values
    rise from below; from above those of corners without a cheap way out would sink by a turn a sweep. With certain
    outcomes the solution is exact after a finite number of sweeps.

    Args:
        tolerance: the sweeps end when no value changes by more, in parts of the value.
        most_sweeps: gives up after these; then `residual` is above `tolerance`.
    """
    successor, reward = task.transitions
    probability = task.motion.probability
    value = np.full(task.states, -np.inf)
    value.reshape(-1, HEADINGS)[task.reachable] = _WORST
    value.reshape(-1, HEADINGS)[task.goal_cells.ravel()] = 0.0
    order = task.reachable[~task.goal_cells.ravel()[task.reachable]]
    terrain = task.grid.terrain.ravel()
    gamma = task.rewards.discount
    # With a discount values become tiny far from the goal, without one they may pass through zero.
    floor = 1e-3 if gamma == 1 else 1e-300
    sweeps, residual = sweep(
        value,
        order,
        np.isin(np.arange(task.grid.kind.size), order),
        task.grid.shape,
        int(task.motion.cells.max()),
        (successor, reward, probability, terrain, gamma),
        (tolerance, floor, most_sweeps),
    )
    q = action_values(value, order, (successor, reward, probability, terrain, gamma))
    nx, ny = task.grid.shape
    return Solution(value.reshape(nx, ny, HEADINGS), q.reshape(task.q_shape), sweeps, residual)


def optimality_gap(task: RouteTask, q: np.ndarray, start: int, solution: Solution) -> float:
    """How much more the greedy policy of `q` (nx, ny, 8, 4) loses on the way from `start` than the best one.

    0.05 means 5 % more: of what is lost on the way (way, turns, bumps) without discount, of the expected number of
    motions with one. inf when the policy may never get to the goal.
    """
    actions = q.reshape(-1, 4).argmax(axis=1)
    if task.rewards.discount == 1:
        best = task.rewards.goal - float(solution.value.flat[start])
        return max(0.0, (task.rewards.goal - expected_sum(task, actions, start)) / best - 1)
    motions = expected_motions(task, actions, start)
    best = expected_motions(task, solution.q.reshape(-1, 4).argmax(axis=1), start)
    return max(0.0, motions / best - 1)


def expected_sum(task: RouteTask, actions: np.ndarray, start: int) -> float:
    """Expected sum of rewards (without discount) of the policy `actions` (S,) from `start`, -inf if it may not end."""
    chain = _chain(task, actions, start)
    return -np.inf if chain is None else float(_solve_chain(*chain))


def expected_motions(task: RouteTask, actions: np.ndarray, start: int) -> float:
    """Expected number of motions of the policy `actions` (S,) from `start` to the goal, inf if it may never end."""
    chain = _chain(task, actions, start)
    return np.inf if chain is None else float(_solve_chain(chain[0], np.ones_like(chain[1])))


def _chain(task: RouteTask, actions: np.ndarray, start: int) -> tuple[sp.csr_matrix, np.ndarray] | None:
    """Transition matrix (K, K) between the states that a policy meets from `start` (first), and their rewards (K,)."""
    successor, reward = task.transitions
    probability = task.motion.probability
    states, rows, columns, weights, earned, leads = follow(
        successor, reward, probability, task.grid.terrain.ravel(), actions.astype(np.int64), start
    )
    if not leads:
        return None
    return sp.csr_matrix((weights, (rows, columns)), shape=(len(states), len(states))), earned


def _solve_chain(matrix: sp.csr_matrix, earned: np.ndarray) -> float:
    if matrix.nnz and len(earned) > 1:
        return spsolve((sp.identity(len(earned), format="csc") - matrix).tocsc(), earned)[0]
    return earned[0] / (1 - matrix.sum())
