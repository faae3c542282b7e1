"""`naraha learn`: routes on a semantic map, learnt, certified and written as CSV."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from naraha.systems.config import quantity
from naraha.systems.errors import ScenarioError
from naraha.systems.routes import (
    Learned,
    Learning,
    LearningConfig,
    RewardConfig,
    RoutePolicy,
    RoutesConfig,
    RouteTask,
    VoxelWorldConfig,
    begin,
    deterministic,
    find_routes,
    learn,
    make_route_grid,
    motion_model,
    paper_learning,
    paper_rewards,
    read_policy,
    reuse_values,
    write_policy,
    write_routes,
)
from naraha.systems.sensing import read_scan

from .mission import Ending, Mission, Options, stop_flag
from .robot_files import robot_ability, robot_primitives
from .scenario import load_scenario


@dataclass(kw_only=True)
class LearnScenario:
    """How routes are learnt on a map."""

    description: str = ""
    seed: int = quantity(0, low=0)
    # Robot whose ability says what ground it drives over; an empty name takes the floor as flat, as the paper does.
    robot: str = "crawler"
    # "measured": what motions lead to is what they came to for the robot in physics (`naraha calibrate --kind
    # primitives`); "exact": every motion does what it says, as in the paper.
    motions: str = quantity("exact", choices=("exact", "measured"))
    # x, y [m] and heading [deg] at the start, and x, y of the goal [m], in the frame of the map.
    start: list[float] = quantity([], unit="m, m, deg")
    goal: list[float] = quantity([], unit="m")
    # Policies of earlier maps or goals, as CSV, from which learning starts.
    reuse: list[str] = field(default_factory=list)
    # [-] Learning ends when the route loses at most this share more than the best one, by value iteration.
    gap: float = quantity(0.05, unit="-", low=0)
    # Motions and episodes after which it ends anyway; null sets no limit on episodes.
    most_steps: int = quantity(50_000_000, low=1)
    most_episodes: int | None = quantity(None, low=1)
    # "ours" or "paper": rewards, α, ε and start values of the source, until the episodes are used up.
    preset: str = quantity("ours", choices=("ours", "paper"))
    world: VoxelWorldConfig = field(default_factory=VoxelWorldConfig)
    rewards: RewardConfig = field(default_factory=RewardConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)
    routes: RoutesConfig = field(default_factory=RoutesConfig)


def load_learn(
    name: str,
    start: Sequence[float] | None,
    goal: Sequence[float] | None,
    settings: Sequence[str] = (),
    seed: int | None = None,
) -> LearnScenario:
    """Reads a scenario, with start and goal of the command line. Raises `ScenarioError`, `ConfigError`."""
    scenario = load_scenario(LearnScenario, name, settings, seed)
    scenario.start = list(start) if start is not None else scenario.start
    scenario.goal = list(goal) if goal is not None else scenario.goal
    for key, value, valid in (
        ("start", scenario.start, "x,y,heading: two lengths [m] and an angle [deg]"),
        ("goal", scenario.goal, "x,y: two lengths [m]"),
    ):
        if len(value) != valid.split(":")[0].count(",") + 1 or not np.isfinite(value).all():
            raise ScenarioError("not a place", where=f"--{key}", value=value, valid=valid)
    return scenario


def learn_routes(map_file: Path, scenario: LearnScenario, options: Options) -> int:
    """Runs the mission, writes `policy_0.csv` and `routes.csv`, and returns the exit code."""
    mission = Mission("learn", scenario, options)
    task, pose = _task_on(map_file, scenario)
    grid = task.grid
    with mission.timed(), stop_flag() as stopped:
        learned = _learn(task, pose, scenario, stopped)
    known_way = learned.status != "unreachable"
    routes = find_routes(grid, pose, np.array(scenario.goal), scenario.routes) if known_way else ()

    def write_metrics() -> None:
        learning = learned.learning
        mission.metrics |= {
            "episodes": learning.episodes,
            "steps": learning.steps,
            "steps_per_s": learning.steps / max(mission.wall_time, 1e-9),
            "optimality_gap": learned.gap,
            "routes": len(routes),
            "distinct_routes": len({route.signature for route in routes}),
            "grid_cells": int(grid.kind.size),
            "shortest_route_m": min((route.length_m for route in routes), default=float("nan")),
        }

    def write_policies() -> None:
        write_policy(mission.path("policy_0.csv"), RoutePolicy.of(task, learned.learning.q))

    def write_offers() -> None:
        write_routes(mission.path("routes.csv"), routes, grid)
        for i, route in enumerate(routes, 1):
            options.console.print(f"route {i}: {route.label}", markup=False, highlight=False)

    return mission.finish(_ending(learned), write_metrics, write_policies, write_offers)


def _task_on(map_file: Path, scenario: LearnScenario) -> tuple[RouteTask, np.ndarray]:
    """What is to be learnt on the map, and the pose at the start, (3,) [m, m, rad]."""
    ability = robot_ability(scenario.robot) if scenario.robot else None
    grid = make_route_grid(read_scan(map_file), ability, scenario.world)
    measured = scenario.motions == "measured"
    motion = motion_model(robot_primitives(scenario.robot), grid.cell) if measured else deterministic()
    rewards = paper_rewards() if scenario.preset == "paper" else scenario.rewards
    task = RouteTask(grid, (scenario.goal[0], scenario.goal[1]), rewards, motion)
    x, y, heading = scenario.start
    return task, np.array([x, y, np.deg2rad(heading)])


def _learn(task: RouteTask, pose: np.ndarray, scenario: LearnScenario, stopped: Callable[[], bool]) -> Learned:
    """Learns until the route is certified, the budget is used up, or somebody stops it."""
    paper = scenario.preset == "paper"
    config = paper_learning() if paper else scenario.learning
    state = task.state_of(pose)
    reused = [read_policy(path) for path in scenario.reuse]

    def tell(learning: Learning, gap: float) -> None:
        if stopped():
            raise KeyboardInterrupt

    values = reuse_values(task, reused) if reused else None
    return learn(
        task,
        begin(task, state, config, seed=scenario.seed, q=values),
        config,
        gap=-1.0 if paper else scenario.gap,
        most_steps=scenario.most_steps,
        most_episodes=scenario.most_episodes or (130 if paper else None),
        progress=tell,
    )


def _ending(learned: Learned) -> Ending:
    gap = f"the route loses at most {100 * max(learned.gap, 0):.1f} % more than the best one"
    return {
        "certified": Ending("done", gap),
        "budget": Ending("done", "all steps are used"),
        "unreachable": Ending("failed", "no way leads from the start to the goal"),
        "interrupted": Ending("interrupted", f"interrupted after {learned.learning.steps} steps"),
    }[learned.status]
