"""What else learns the same task: Q-learning in plain Python and with numpy arrays, and DQN of Stable-Baselines3."""

import random
import time
from typing import Any

import gymnasium as gym
import numpy as np
from naraha.systems.routes import LearningConfig, RouteTask


def python_q_learning(task: RouteTask, start: int, config: LearningConfig, episodes: int, seed: int) -> tuple[int, Any]:
    """Eq. 8 with a dictionary and lists, as tutorials write it. Returns motions and values (S, 4)."""
    successor, reward = (table[:, :, 0].tolist() for table in task.transitions)
    alpha, epsilon, gamma = config.learning_rate, config.exploration, task.rewards.discount
    rng, q, steps = random.Random(seed), {}, 0
    for _ in range(episodes):
        s = start
        for _ in range(config.most_motions):
            values = q.setdefault(s, [0.0] * 4)
            if rng.random() < epsilon:
                a = rng.randrange(4)
            else:
                best = max(values)
                a = rng.choice([k for k in range(4) if values[k] == best])
            n, gain = successor[s][a], reward[s][a]
            target = gain if n < 0 else gain + gamma * max(q.get(n, (0.0,)))
            values[a] += alpha * (target - values[a])
            steps += 1
            if n < 0:
                break
            s = n
    table = np.zeros((task.states, 4))
    for s, values in q.items():
        table[s] = values
    return steps, table


def numpy_q_learning(task: RouteTask, start: int, config: LearningConfig, episodes: int, seed: int) -> tuple[int, Any]:
    """Eq. 8 on an array. Returns motions and values (S, 4)."""
    successor, reward = (table[:, :, 0] for table in task.transitions)
    alpha, epsilon, gamma = config.learning_rate, config.exploration, task.rewards.discount
    rng, q, steps = np.random.default_rng(seed), np.zeros((task.states, 4)), 0
    for _ in range(episodes):
        s = start
        for _ in range(config.most_motions):
            greedy = rng.random() >= epsilon
            a = rng.choice(np.flatnonzero(q[s] == q[s].max())) if greedy else rng.integers(4)
            n, gain = successor[s, a], reward[s, a]
            target = gain if n < 0 else gain + gamma * q[n].max()
            q[s, a] += alpha * (target - q[s, a])
            steps += 1
            if n < 0:
                break
            s = n
    return steps, q


def train_dqn(env: gym.Env, steps: int, seed: int) -> Any:
    """DQN as shipped, one thread, after `steps` motions in `env`; why not, in words, where it is not installed."""
    try:
        import torch
        from stable_baselines3 import DQN
    except ImportError as error:
        return f"not installed: {error.name}"
    torch.set_num_threads(1)
    agent = DQN("MlpPolicy", env, learning_starts=500, seed=seed, device="cpu")
    return agent.learn(steps)


def dqn(task: RouteTask, start: np.ndarray, steps: int, seed: int) -> dict[str, object]:
    """DQN on `naraha/GridRoute-v0`; {"dqn_skipped": why} where it is not installed."""
    # What the network is given is scaled to [0, 1], which is to its advantage against raw cell numbers.
    env = gym.wrappers.RescaleObservation(
        _AsBox(gym.make("naraha/GridRoute-v0", task=task, start=start)), np.float32(0), np.float32(1)
    )
    begin = time.perf_counter()
    agent = train_dqn(env, steps, seed)
    if isinstance(agent, str):
        return {"dqn_skipped": agent}
    seconds = time.perf_counter() - begin
    nx, ny = task.grid.shape
    cells = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), np.arange(8), indexing="ij"), axis=-1).reshape(-1, 3)
    actions, _ = agent.predict((cells / [nx - 1, ny - 1, 7]).astype(np.float32), deterministic=True)
    return {"dqn_actions": actions, "dqn_steps_per_s": steps / seconds, "dqn_s": seconds}


class _AsBox(gym.ObservationWrapper):
    """The cell numbers as a box of float32."""

    def __init__(self, env: gym.Env):
        super().__init__(env)
        high = (env.observation_space.nvec - 1).astype(np.float32)  # type: ignore[attr-defined]
        self.observation_space = gym.spaces.Box(np.zeros(3, np.float32), high)

    def observation(self, observation: np.ndarray) -> np.ndarray:
        return observation.astype(np.float32)
