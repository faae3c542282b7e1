"""Learning of routes: how fast, how good, and against what else there is.

    python -m tests.benchmarks.learning --scene speed|paper|optimality|reuse|dqn|physics|dqn_physics|all
        [--maps N] [--json FILE]

`speed`: Q-steps a second on one core, ours and the same in Python and numpy; value iteration on 60 × 60 cells.
`paper`: the paper's 130 episodes with its parameters. `optimality`: N maps learnt until certified, halls and mazes.
`reuse`: episodes until the greedy policy reaches a goal up to 1 m from an earlier one, on a map with another origin
and size, from the earlier policy and from each kind of start values. `dqn`: Stable-Baselines3 on the same task with as
many motions. `physics`: the 130 episodes with the crawler in a MultibodyPlant, two at a time; `dqn_physics`: DQN there,
with as many motions.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from naraha.systems.routes import (
    FREE,
    LearningConfig,
    RewardConfig,
    RouteGrid,
    RoutePolicy,
    RouteTask,
    advance,
    begin,
    expected_motions,
    learn,
    optimality_gap,
    paper_learning,
    paper_rewards,
    reuse_values,
    roll_out,
    slipping,
    solve,
)
from naraha.systems.routes.grid_route import example_task

from ..routes.maps import hall_map, maze_map, water_map
from .learning_peers import dqn, numpy_q_learning, python_q_learning
from .learning_physics import dqn_in_physics, physics
from .report import print_table, time_in_turns, use_one_core, write_json

Results = dict[str, object]
MAPS = (hall_map, water_map, maze_map)


def speed(maps: int) -> Results:
    """Steps a second of the same learning, and times of value iteration."""
    grid, start, goal = hall_map(1, (60, 60))
    results: Results = {}
    for name, motion in (("", {}), ("spread_", {"motion": slipping()})):
        task = RouteTask(grid, goal, **motion)  # type: ignore[arg-type]
        config = LearningConfig()
        first = begin(task, task.state_of(start), config)
        seconds = time_in_turns({"q": lambda t=task, f=first: advance(t, f, LearningConfig(), 2_000_000)}, repeats=5)
        results[f"naraha_{name}steps_per_s"] = 2_000_000 / seconds["q"]
        task.transitions, task.reachable  # noqa: B018 - the table is made once for a map
        results[f"naraha_{name}value_iteration_ms"] = (
            1e3 * time_in_turns({"v": lambda t=task: solve(t)}, repeats=9)["v"]
        )
        results[f"naraha_{name}table_and_value_iteration_ms"] = (
            1e3 * time_in_turns({"v": lambda t=task: solve(replace(t))}, repeats=9)["v"]
        )
    task, s, config = RouteTask(grid, goal, paper_rewards()), 0, paper_learning()
    s = task.state_of(start)
    for peer, run in (("python", python_q_learning), ("numpy", numpy_q_learning)):
        begun = time.perf_counter()
        steps, _ = run(task, s, config, 3, 0)
        results[f"{peer}_loop_steps_per_s"] = steps / (time.perf_counter() - begun)
    return results


def paper(maps: int) -> Results:
    """The paper's 130 episodes with its parameters on a room of 24 × 24 cells, ten seeds."""
    example, pose = example_task()
    task, config = RouteTask(example.grid, example.goal, paper_rewards()), paper_learning()
    start = task.state_of(pose)
    advance(task, begin(task, start, config), config, 1000)
    times, curves, rewards = [], [], []
    for seed in range(10):
        begun = time.perf_counter()
        after = advance(task, begin(task, start, config, seed=seed), config, 10**8, most_episodes=130)
        times.append(time.perf_counter() - begun)
        curves.append(np.abs(after.curve_motions))
        rewards.append(after.curve_rewards)
    begun = time.perf_counter()
    python_q_learning(task, start, config, 130, 0)
    python_s = time.perf_counter() - begun
    return {
        "paper_episodes": 130,
        "naraha_paper_130_episodes_ms": 1e3 * float(np.median(times)),
        "python_loop_paper_130_episodes_ms": 1e3 * python_s,
        "paper_motions_first_13": float(np.median(np.array(curves)[:, :13])),
        "paper_motions_last_13": float(np.median(np.array(curves)[:, -13:])),
        "paper_reward_first_13": float(np.median(np.array(rewards)[:, :13])),
        "paper_reward_last_13": float(np.median(np.array(rewards)[:, -13:])),
        "paper_published_hours": 140.0,
    }


def optimality(maps: int) -> Results:
    """How near the learnt routes are to value iteration, with motions that are certain and that may fail."""
    results: Results = {"maps": maps}
    for name, motion, most in (("", {}, 50_000_000), ("spread_", {"motion": slipping()}, 50_000_000)):
        gaps, seconds, steps, episodes = [], [], [], []
        for seed in range(maps):
            grid, start, goal = MAPS[seed % len(MAPS)](seed)
            task = RouteTask(grid, goal, **motion)  # type: ignore[arg-type]
            s = task.state_of(start)
            begun = time.perf_counter()
            learned = learn(task, begin(task, s, seed=seed), most_steps=most)
            seconds.append(time.perf_counter() - begun)
            gaps.append(optimality_gap(task, learned.learning.q, s, solve(task)))
            steps.append(learned.learning.steps)
            episodes.append(learned.learning.episodes)
        results |= {
            f"naraha_{name}certified": int(np.sum(np.array(gaps) <= 0.05)),
            f"naraha_{name}gap_median": float(np.median(gaps)),
            f"naraha_{name}gap_max": float(np.max(gaps)),
            f"naraha_{name}learning_ms_median": 1e3 * float(np.median(seconds)),
            f"naraha_{name}learning_ms_max": 1e3 * float(np.max(seconds)),
            f"naraha_{name}steps_median": float(np.median(steps)),
            f"naraha_{name}episodes_median": float(np.median(episodes)),
        }
    return results


def episodes_to_the_goal(task: RouteTask, start: int, config: LearningConfig, seed: int, q: np.ndarray | None) -> int:
    """Episodes until the best motions lead to the goal; 5000 where they do not by then."""
    learning = begin(task, start, config, seed=seed, q=q)
    while learning.episodes < 5000 and not roll_out(task, learning.q, start).reached:
        learning = advance(task, learning, config, 10**7, most_episodes=learning.episodes + 1)
    return learning.episodes


def earlier_policy(grid: RouteGrid, start: np.ndarray, goal: tuple[float, float], seed: int) -> RoutePolicy:
    """Learnt on a local map that is cut off on two sides, to a goal 0.3 to 1 m from `goal`."""
    part = RouteGrid.from_kind(grid.kind[1:-1, 1:], grid.cell, grid.origin + np.array([1, 1]) * grid.cell)
    centres = part.centre_of(np.argwhere(part.kind == FREE))
    away = np.hypot(*(centres - np.array(goal)).T)
    rng = np.random.default_rng(seed)
    for xy in rng.permutation(centres[(away > 0.3) & (away < 1.0)]):
        task = RouteTask(part, (float(xy[0]), float(xy[1])))
        if task.can_reach(task.state_of(start)):
            learned = learn(task, begin(task, task.state_of(start), seed=seed))
            return RoutePolicy.of(task, learned.learning.q)
    raise RuntimeError("no place for an earlier goal")


def reuse(maps: int) -> Results:
    """Episodes to the goal with and without the policy of an earlier map and goal."""
    counts: dict[str, list[int]] = {}
    for seed in range(maps):
        grid, start, goal = MAPS[seed % len(MAPS)](seed)
        task = RouteTask(grid, goal)
        s = task.state_of(start)
        kinds: dict[str, Callable[[], np.ndarray] | None] = {"zero": None, "straight": None, "distance": None}
        policy = earlier_policy(grid, start, goal, seed)
        for kind in kinds:
            config = LearningConfig(anywhere=0.0, start_values=kind)
            counts.setdefault(kind, []).append(episodes_to_the_goal(task, s, config, seed, None))
        for kind in ("straight", "distance"):
            q = reuse_values(task, [policy], start_values=kind)
            found = episodes_to_the_goal(task, s, LearningConfig(anywhere=0.0), seed, q)
            counts.setdefault(f"reuse_{kind}", []).append(found)
    results: Results = {"maps": maps}
    for kind, values in counts.items():
        results[f"naraha_{kind}_episodes_median"] = float(np.median(values))
        results[f"naraha_{kind}_episodes_max"] = int(np.max(values))
    for kind, of in (("straight", "zero"), ("straight", "straight"), ("distance", "zero"), ("distance", "distance")):
        ratio = np.array(counts[of]) / np.maximum(counts[f"reuse_{kind}"], 1)
        results[f"reuse_{kind}_fewer_than_{of}_median"] = float(np.median(ratio))
    return results


def arrived_share(task: RouteTask, actions: np.ndarray) -> float:
    """Share of the states from which there is a way, and from which the motions `actions` (S,) lead to the goal."""
    successor = np.append(task.transitions[0][np.arange(task.states), actions, 0], -1)
    away = task.reachable[~task.goal_cells.ravel()[task.reachable]]
    states = (away[:, None] * 8 + np.arange(8)).ravel()
    for _ in range(1000):
        states = successor[states]  # the goal, -1, leads to itself
    return float((states < 0).mean())


def deep(maps: int) -> Results:
    """DQN and ours with 20 000 motions each on the example room, and ours until certified."""
    task, pose = example_task()
    start, budget = task.state_of(pose), 20_000
    begun = time.perf_counter()
    learned = learn(task, begin(task, start))
    results: Results = {
        "naraha_dqn_task_s": time.perf_counter() - begun,
        "naraha_dqn_task_gap": learned.gap,
        "naraha_dqn_task_steps": learned.learning.steps,
    }
    results["dqn_budget"] = budget
    # Start values know the way over the cells; zeros know nothing, as a network does.
    for name, config in (("", LearningConfig()), ("zero_", LearningConfig(start_values="zero"))):
        begun = time.perf_counter()
        ours = advance(task, begin(task, start, config), config, budget).q.reshape(-1, 4).argmax(axis=1)
        results |= {
            f"naraha_{name}budget_s": time.perf_counter() - begun,
            f"naraha_{name}budget_arrived_share": arrived_share(task, ours),
            f"naraha_{name}budget_motions_to_goal": expected_motions(task, ours, start),
        }
    measured = dqn(task, pose, budget, 0)
    actions = measured.pop("dqn_actions", None)
    if actions is not None:
        results["dqn_arrived_share"] = arrived_share(task, np.asarray(actions))
        results["dqn_motions_to_goal"] = expected_motions(task, np.asarray(actions), start)
    return results | measured


SCENES: dict[str, Callable[[int], Results]] = {
    "speed": speed,
    "paper": paper,
    "optimality": optimality,
    "reuse": reuse,
    "dqn": deep,
    "physics": lambda maps: physics(),
    "dqn_physics": lambda maps: dqn_in_physics(),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=(*SCENES, "all"), default="all")
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    parser.add_argument("--maps", type=int, default=50)
    arguments = parser.parse_args()
    if arguments.scene != "physics":  # it has a process for each robot
        use_one_core()
    results: Results = {"discount": RewardConfig().discount}
    for name, run in SCENES.items():
        if arguments.scene in (name, "all"):
            measured = run(arguments.maps)
            print_table(name, ("value", "measured"), list(measured.items()))
            results |= measured
    write_json(arguments.json, results)


if __name__ == "__main__":
    main()
