"""Learning in physics: the crawler's motions in a MultibodyPlant, by Q-learning and by DQN, on one task."""

import os
import time
from typing import Any

import gymnasium as gym
import naraha.diagrams.crawler_route as crawler_route
import numpy as np
from naraha.systems.routes import (
    FENCE,
    HEADINGS,
    WATER,
    LearningConfig,
    RouteGrid,
    RouteTask,
    advance,
    begin,
    expected_motions,
    paper_learning,
    paper_rewards,
    solve,
)

from .learning_peers import train_dqn

# Motions after which an episode of the learnt policy has failed; the best way takes 14.
_MOST = 100
# Motions of DQN: as many as the 130 episodes of ours take.
_BUDGET = 2600
# Published for 130 episodes in Choreonoid and AGX Dynamics on 40 threads (section 3.3.1) [s].
_PAPER_S = 140 * 3600.0


def room() -> tuple[RouteTask, np.ndarray]:
    """A fenced room of 16 × 12 cells of 0.5 m with water between start and goal, and the start pose (3,)."""
    kind = np.zeros((16, 12), np.uint8)
    kind[[0, -1]] = kind[:, [0, -1]] = FENCE
    kind[6:10, 4:8] = WATER
    return RouteTask(RouteGrid.from_kind(kind, 0.5), (6.75, 3.25)), np.array([1.25, 3.25, 0.0])


def make_env(**more: Any) -> gym.Env:
    task, start = room()
    return gym.make(f"{crawler_route.__name__}:{crawler_route.NAME}", task=task, start=start, **more)


def numbers_of(task: RouteTask, cells: np.ndarray) -> np.ndarray:
    """States of observations (..., 3) ix, iy, heading."""
    return (cells[..., 0] * task.grid.shape[1] + cells[..., 1]) * HEADINGS + cells[..., 2]


class CpuClock:
    """Seconds of the processor that this process and its ended children have used, and those that went by."""

    def __init__(self) -> None:
        self._begun = (self._cpu(), time.perf_counter())

    @staticmethod
    def _cpu() -> float:
        t = os.times()
        return t.user + t.system + t.children_user + t.children_system

    def read(self) -> tuple[float, float]:
        return self._cpu() - self._begun[0], time.perf_counter() - self._begun[1]


def learn_in_physics(task: RouteTask, episodes: int, robots: int, seed: int) -> dict[str, Any]:
    """Eq. 8 with our start values on one table, fed by `robots` crawlers at a time, each in a process of its own.

    Returns:
        `q` (S, 4), `motions` and `rewards` (E,) of every episode, `simulated_s`, `cpu_s`, `wall_s`.
    """
    config = LearningConfig(anywhere=0.0)
    q = begin(task, 0, config).q.reshape(-1, 4).copy()
    visits = np.zeros(q.shape, int)
    rng = np.random.default_rng(seed)
    clock = CpuClock()
    envs = gym.vector.AsyncVectorEnv([make_env] * robots)
    cells, _ = envs.reset(seed=seed)
    states = numbers_of(task, cells)
    counts, totals, starting = np.zeros(robots, int), np.zeros(robots), np.zeros(robots, bool)
    times, simulated = np.zeros(robots), 0.0
    motions: list[int] = []
    rewards: list[float] = []
    while len(motions) < episodes:
        random = rng.random(robots) < config.exploration
        actions = np.where(random, rng.integers(0, 4, robots), q[states].argmax(axis=1))
        cells, gains, terminated, truncated, info = envs.step(actions)
        following = numbers_of(task, cells)
        for i in np.flatnonzero(~starting):
            s, a = states[i], actions[i]
            target = gains[i] + (0.0 if terminated[i] else task.rewards.discount * q[following[i]].max())
            q[s, a] += config.learning_rate / (1 + config.decay * visits[s, a]) * (target - q[s, a])
            visits[s, a] += 1
            counts[i] += 1
            totals[i] += gains[i]
            times[i] = info["time"][i]
            if terminated[i] or truncated[i]:
                motions.append(int(counts[i]) if terminated[i] else -int(counts[i]))
                rewards.append(float(totals[i]))
                simulated += times[i]
                counts[i], totals[i] = 0, 0.0
        starting = terminated | truncated
        states = following
    envs.close()
    cpu, wall = clock.read()
    return {
        "q": q,
        "motions": np.array(motions[:episodes]),
        "rewards": np.array(rewards[:episodes]),
        "simulated_s": simulated,
        "cpu_s": cpu,
        "wall_s": wall,
    }


def success(policy: Any, episodes: int, **more: Any) -> tuple[float, float]:
    """Share of episodes in physics in which `policy`(observation) reaches the goal, and motions in those (median)."""
    env = make_env(max_episode_steps=_MOST, **more)
    reached: list[int] = []
    for episode in range(episodes):
        observation, _ = env.reset(seed=1000 + episode)
        terminated, truncated, count = False, False, 0
        while not (terminated or truncated):
            observation, _, terminated, truncated, _ = env.step(int(policy(observation)))
            count += 1
        reached += [count] if terminated else []
    return len(reached) / episodes, float(np.median(reached)) if reached else float("nan")


def physics(episodes: int = 130, robots: int = 2, tries: int = 10) -> dict[str, object]:
    """The paper's 130 episodes with the crawler in physics; the time is the processor's, shared by two cores."""
    task, pose = room()
    found = learn_in_physics(task, episodes, robots, 0)
    count, motions = int(np.abs(found["motions"]).sum()), np.abs(found["motions"])
    share, median = success(lambda cells: found["q"][numbers_of(task, cells)].argmax(), tries)
    # What the paper's own setting would take: its motions are counted on the grid, their cost is the one measured here.
    paper = RouteTask(task.grid, task.goal, paper_rewards())
    config = paper_learning()
    first = begin(paper, paper.state_of(pose), config)
    grid_motions = int(np.abs(advance(paper, first, config, 10**8, most_episodes=130).curve_motions).sum())
    best = expected_motions(task, solve(task).q.reshape(-1, 4).argmax(axis=1), task.state_of(pose))
    return {
        "physics_episodes": episodes,
        "physics_best_motions_on_grid": best,
        "naraha_physics_motions": count,
        "naraha_physics_cpu_s": found["cpu_s"],
        "naraha_physics_cpu_ms_per_motion": 1e3 * found["cpu_s"] / count,
        "naraha_physics_minutes_on_2_cores": found["cpu_s"] / 2 / 60,
        "naraha_physics_wall_s": found["wall_s"],
        "naraha_physics_simulated_s": found["simulated_s"],
        "naraha_physics_motions_first_13": float(np.median(motions[:13])),
        "naraha_physics_motions_last_13": float(np.median(motions[-13:])),
        "naraha_physics_reward_first_13": float(np.median(found["rewards"][:13])),
        "naraha_physics_reward_last_13": float(np.median(found["rewards"][-13:])),
        "naraha_physics_success": share,
        "naraha_physics_motions_to_goal": median,
        "paper_published_hours": _PAPER_S / 3600,
        "physics_times_faster_than_published_on_2_cores": _PAPER_S / (found["cpu_s"] / 2),
        "paper_setting_motions_on_grid": grid_motions,
        "paper_setting_simulated_hours": grid_motions * found["simulated_s"] / count / 3600,
    }


def dqn_in_physics(motions: int = _BUDGET, tries: int = 10) -> dict[str, object]:
    """Stable-Baselines3's DQN with as many motions in physics; what it sees is the vector of the pose."""
    clock = CpuClock()
    agent = train_dqn(make_env(observation="vector"), motions, 0)
    if isinstance(agent, str):
        return {"dqn_physics_skipped": agent}
    cpu, wall = clock.read()
    share, median = success(lambda vector: agent.predict(vector, deterministic=True)[0], tries, observation="vector")
    return {
        "dqn_physics_motions": motions,
        "dqn_physics_cpu_s": cpu,
        "dqn_physics_wall_s": wall,
        "dqn_physics_success": share,
        "dqn_physics_motions_to_goal": median,
    }
