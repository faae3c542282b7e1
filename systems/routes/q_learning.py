"""Q-learning of a route (row S0-h, Eq. 8), compiled, stopped when value iteration certifies the result."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ..config import check_config, quantity
from ..errors import InputError
from .motion_model import HEADINGS
from .q_learning_kernels import q_steps
from .route_task import RouteTask
from .value_iteration import Solution, optimality_gap, solve

# Episodes of which the learning curve is kept; the first are what it is looked at for.
_CURVE = 10_000


@dataclass(kw_only=True)
class LearningConfig:
    """How Eq. 8 is run. The defaults are ours; `paper_learning` is the paper's setting."""

    # α of Eq. 8 at the first update of a value.
    learning_rate: float = quantity(0.5, above=0, high=1)
    # After n updates of a value its α is learning_rate / (1 + decay n): without, chance outcomes never average out.
    decay: float = quantity(0.02, low=0)
    # ε: share of the motions that are random.
    exploration: float = quantity(0.1, low=0, high=1)
    # Share of the episodes that start anywhere instead of at the start: a robot that drifts meets those states.
    anywhere: float = quantity(0.5, low=0, high=1)
    # Motions after which an episode ends without the goal.
    most_motions: int = quantity(2000, low=1)
    # "zero"; "straight": what each motion is worth if the straight line leads from its end to the goal; "distance": if
    # the best way over the cells does, without turning. Both are never too little, so that the optimum stays the same,
    # as with a potential (Ng et al. 1999, Wiewiora 2003).
    start_values: str = quantity("distance", choices=("zero", "straight", "distance"))


def paper_learning() -> LearningConfig:
    """α 0.5, ε 0.1, values start at zero, all episodes at the start (row S0-h, section 3.3.1)."""
    return LearningConfig(decay=0.0, anywhere=0.0, most_motions=100_000, start_values="zero")


@dataclass(frozen=True, eq=False)
class Learning:
    """A learner between two of its steps; read-only, so that it can be kept in a context or continued elsewhere.

    Attributes:
        q: (nx, ny, 8, 4) values of the motions. visits: (nx, ny, 8, 4) updates so far, when the rate decays.
        start: the state where episodes begin.
        steps: motions learnt from. episodes: that began at the start and ended.
        curve_motions, curve_rewards: (E,) of the first of those; motions are negative without the goal.
        counters, earned, rng: where in an episode, and in its random numbers, the learner is.
    """

    q: np.ndarray
    visits: np.ndarray
    start: int
    steps: int
    episodes: int
    curve_motions: np.ndarray
    curve_rewards: np.ndarray
    counters: np.ndarray
    earned: np.ndarray
    rng: np.ndarray

    def __deepcopy__(self, memo: dict) -> "Learning":
        return self


@dataclass(frozen=True, eq=False)
class Learned:
    """What learning came to.

    Attributes:
        learning: where it stopped; can be continued.
        gap: what the learnt route loses more than the best one (`optimality_gap`); inf when it may not arrive, or when
            the learning was interrupted before it was looked at.
        solution: the best one, by value iteration.
        status: "certified" (gap within the limit), "budget" (steps or episodes used up), "interrupted" or
            "unreachable" (no way leads to the goal).
    """

    learning: Learning
    gap: float
    solution: Solution
    status: str


def start_values(task: RouteTask, kind: str) -> np.ndarray:
    """(nx, ny, 8, 4) values to start from, see `LearningConfig.start_values`."""
    if kind == "zero":
        return np.zeros(task.q_shape)
    bound = task.bound if kind == "distance" else task.straight_bound
    return look_ahead(task, np.repeat(bound.ravel(), HEADINGS))


def look_ahead(task: RouteTask, value: np.ndarray) -> np.ndarray:
    """(nx, ny, 8, 4) values of the motions when the states that they lead to are worth `value` (S,)."""
    successor, reward = task.transitions
    padded = np.append(value, 0.0)  # successor -1 is the goal
    probability = task.motion.probability[np.repeat(task.grid.terrain.ravel(), HEADINGS)]
    return (probability * (reward + task.rewards.discount * padded[successor])).sum(axis=2).reshape(task.q_shape)


def begin(
    task: RouteTask, start: int, config: LearningConfig | None = None, *, seed: int = 0, q: np.ndarray | None = None
) -> Learning:
    """A learner before its first step.

    Args:
        start: state, as `RouteTask.state_of` gives it.
        q: (nx, ny, 8, 4) values to start from instead of those of the configuration, for example of `reuse_values`.

    Raises:
        InputError: the start is at the goal, or `q` does not fit the grid or is not finite.
        ConfigError: a parameter is out of range.
    """
    config = config or LearningConfig()
    check_config(config, key="learning")
    if task.goal_cells.flat[start // HEADINGS]:
        raise InputError("is at the goal already", where="start", value=task.pose_of(np.array(start)).tolist())
    values = start_values(task, config.start_values) if q is None else np.array(q, float)
    if values.shape != task.q_shape or not np.isfinite(values).all():
        raise InputError("start values do not fit the grid", where="q", value=values.shape, valid=str(task.q_shape))
    # Seeds next to each other must not give numbers next to each other.
    rng = np.random.SeedSequence(seed).generate_state(1, np.uint64) | np.uint64(1)
    visits = np.zeros(task.q_shape, np.int32)
    empty = np.zeros(0, np.int64)
    counters = np.array([start, 0, 1])
    return Learning(values, visits, start, 0, 0, empty, np.zeros(0), counters, np.zeros(1), rng)


def advance(
    task: RouteTask, learning: Learning, config: LearningConfig, steps: int, *, most_episodes: int | None = None
) -> Learning:
    """The learner after `steps` more motions, or after `most_episodes` in all if that comes first.

    Many short calls learn exactly what one long call does.
    """
    successor, reward = task.transitions
    cumulative = np.cumsum(task.motion.probability, axis=2)
    cumulative[..., -1] = 1.0
    away = task.reachable[~task.goal_cells.ravel()[task.reachable]]
    anywhere = (away[:, None] * HEADINGS + np.arange(HEADINGS)).ravel()
    q, visits = learning.q.reshape(-1, 4).copy(), learning.visits.reshape(-1, 4).copy()
    counters, earned, rng = learning.counters.copy(), learning.earned.copy(), learning.rng.copy()
    episodes = learning.episodes
    room = steps if most_episodes is None else max(0, most_episodes - episodes)
    motions, rewards = np.zeros(min(room, steps), np.int64), np.zeros(min(room, steps))
    ended, done = q_steps(
        q,
        visits,
        (successor, reward, cumulative, task.grid.terrain.ravel()),
        learning.start,
        anywhere,
        (config.learning_rate, config.decay, task.rewards.discount),
        (config.exploration, config.anywhere if len(anywhere) else 0.0, config.most_motions),
        steps,
        counters,
        earned,
        rng,
        motions,
        rewards,
    )
    space = max(0, min(ended, _CURVE - len(learning.curve_motions)))
    return replace(
        learning,
        q=q.reshape(task.q_shape),
        visits=visits.reshape(task.q_shape),
        steps=learning.steps + done,
        episodes=episodes + ended,
        curve_motions=np.append(learning.curve_motions, motions[:space]),
        curve_rewards=np.append(learning.curve_rewards, rewards[:space]),
        counters=counters,
        earned=earned,
        rng=rng,
    )


def learn(
    task: RouteTask,
    learning: Learning,
    config: LearningConfig | None = None,
    *,
    gap: float = 0.05,
    most_steps: int = 50_000_000,
    most_episodes: int | None = None,
    progress: Callable[[Learning, float], None] | None = None,
) -> Learned:
    """Goes on with a learner until its route is within `gap` of the best one, or the budget is used up.

    Ctrl-C ends it between two looks at the gap and keeps what was learnt.

    Args:
        learning: from `begin`, or from an earlier call.
        gap: 0.05 is 5 %; a negative one is never met, so that the budget is used.
        most_steps, most_episodes: of the learner in all, those of earlier calls included.
        progress: called with the learner and its gap after every look.
    """
    config = config or LearningConfig()
    check_config(config, key="learning")
    solution = solve(task)
    if not task.can_reach(learning.start):
        return Learned(learning, np.inf, solution, "unreachable")
    now = np.inf
    try:
        while True:
            now = optimality_gap(task, learning.q, learning.start, solution)
            if progress is not None:
                progress(learning, now)
            if now <= gap:
                return Learned(learning, now, solution, "certified")
            if learning.steps >= most_steps or (most_episodes is not None and learning.episodes >= most_episodes):
                return Learned(learning, now, solution, "budget")
            # A look costs as much as some 100 000 steps, so that they become rarer.
            steps = min(max(20_000, learning.steps // 4), most_steps - learning.steps, 2_000_000)
            learning, now = advance(task, learning, config, steps, most_episodes=most_episodes), np.inf
    except KeyboardInterrupt:
        return Learned(learning, now, solution, "interrupted")


def learn_many(
    task: RouteTask,
    start: int,
    seeds: Sequence[int],
    config: LearningConfig | None = None,
    *,
    workers: int | None = None,
    **limits: float | None,
) -> list[Learned]:
    """`learn` with every seed, `workers` at a time; the compiled loop leaves Python's lock to the others.

    Args:
        limits: `gap`, `most_steps`, `most_episodes` of `learn`.
    """
    task.transitions, task.reachable  # noqa: B018 - computed once, before the threads share them

    def one(seed: int) -> Learned:
        return learn(task, begin(task, start, config, seed=seed), config, **limits)  # type: ignore[arg-type]

    with ThreadPoolExecutor(max_workers=workers) as pool:
        return list(pool.map(one, seeds))
