"""`naraha/CrawlerRoute-v0`: the task of `naraha/GridRoute-v0` with the crawler's motions in physics (row S0-h).

Importing this module registers it; `gymnasium.make("naraha.diagrams.crawler_route:naraha/CrawlerRoute-v0")` does both.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from naraha.models.worlds import World
from naraha.systems.config import check_config, quantity
from naraha.systems.drive import MotionPrimitivesConfig
from naraha.systems.drive.motion_primitives import Motion
from naraha.systems.errors import InputError
from naraha.systems.ports import weak_method
from naraha.systems.routes import ACTIONS, FENCE, FREE, HEADINGS, KINDS, RouteTask
from naraha.systems.routes.grid_route import example_task
from naraha.systems.tracking import planar_pose
from pydrake.gym import DrakeGymEnv
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, EventStatus

from .grid_world import world_of
from .motions import make_motions
from .station import RobotConfig, StationConfig
from .wiring import subsystem

NAME = "naraha/CrawlerRoute-v0"
# Motions after which `gymnasium.make` truncates an episode.
MOST_MOTIONS = 1000
# [s] No motion takes longer: a diagonal step that has lost its patience takes 10 s.
_LONGEST = 60.0
OBSERVATIONS = ("cell", "vector")


@dataclass(kw_only=True)
class CrawlerRouteConfig:
    """How the crawler is simulated."""

    # "cell": ix, iy, heading of 45°, as `GridRoute-v0`; "vector": x and y as shares of the grid, cos and sin of the
    # heading, all float32 in [-1, 1], for learners that approximate functions.
    observation: str = quantity("cell", choices=OBSERVATIONS)
    # "truth" closes the motions on the simulated pose, as the paper's learning does, in place of SLAM; "odometry" on
    # encoders and IMU, which drift from the grid.
    localisation: str = quantity("truth", choices=("truth", "odometry"))
    # [m], [deg] How far the robot is off the middle of its cell and its heading at the start, at most; no more than
    # 0.4 cells.
    start_offset: float = quantity(0.1, unit="m", low=0)
    start_heading_deg: float = quantity(5.0, unit="deg", low=0, high=22)
    # [s] The robot settles on the ground this long before an episode.
    settle: float = quantity(0.1, unit="s", low=0)
    # [s] Time step of the physics; on a floor 23 motions end within 2 mm of where they do with 0.004 s.
    time_step: float = quantity(0.02, unit="s", above=0)
    # Speeds and tolerances of the motions; their step is the cell of the grid.
    motions: MotionPrimitivesConfig = field(default_factory=MotionPrimitivesConfig)


def _motions_in(world: World, start: np.ndarray, cell: float, config: CrawlerRouteConfig) -> Diagram:
    """The crawler at `start` in `world`, with motions of a cell."""
    station = StationConfig(
        robot=RobotConfig(start_xyz=start[:2].tolist(), start_yaw_deg=float(np.rad2deg(start[2]))),
        plant=MultibodyPlantConfig(time_step=config.time_step, discrete_contact_approximation="lagged"),
        lidar=None,
    )
    # With the truth it is only the flippers that look at it.
    station.imu.period = 0.02 if config.localisation == "odometry" else 0.04
    motions = MotionPrimitivesConfig(**{**vars(config.motions), "step": cell})
    return make_motions(station, motions, seed=0, world=world, localisation=config.localisation)


class CrawlerRouteEnv(DrakeGymEnv):
    """`naraha/CrawlerRoute-v0`: a `RouteTask` whose motions the crawler drives in a MultibodyPlant.

    A step is one motion of `MotionPrimitives`, about 2 s of simulated time. Action and the observation "cell" are those
    of `naraha/GridRoute-v0`, so that a policy of the one is one of the other; so are the rewards, with the metres that
    the robot has truly made. When its reference point leaves the free cells, or something holds the robot up, the
    motion is over, costs what that kind of cell costs, and the robot is put back to where the motion began, as on the
    grid. An episode is terminated in a cell of the goal. `info` holds `pose` (3) [m, m, rad], `time` [s, simulated],
    `reached` and `bumped`, the kind of cell that was run into ("" if none).

    Args:
        task: what to learn; the example room of `GridRoute-v0` without it. start: (3,) pose where episodes begin
            [m, m, rad]; `reset(options={"start": pose})` overrides it once.
        world: in which the grid is true; `world_of(task.grid)` without it.
        config: how it is simulated. observation: short for the entry of `config`.

    Raises:
        InputError: the start is not free or at the goal, or an action is not one of the four.
        ConfigError, WorldError: a value is out of range, the robot does not fit there.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - gymnasium's own name and form

    def __init__(
        self,
        task: RouteTask | None = None,
        start: np.ndarray | None = None,
        *,
        world: World | None = None,
        config: CrawlerRouteConfig | None = None,
        observation: str | None = None,
        render_mode: None = None,
    ):
        if task is None:
            task, example = example_task()
            start = example if start is None else start
        elif start is None:
            raise InputError("a task needs a start", where=NAME, key="start", valid="x, y, heading [m, m, rad]")
        config = config or CrawlerRouteConfig()
        check_config(config, key="crawler_route")
        self.task, self.config = task, config
        self._kind = observation or config.observation
        if self._kind not in OBSERVATIONS:
            raise InputError("unknown observation", where=NAME, value=self._kind, valid=OBSERVATIONS)
        self._start = self._usable(start)
        self._next_start = self._start
        self._bumped, self._before = "", np.zeros(3)
        simulator = Simulator(_motions_in(world or world_of(task.grid), self._start, task.grid.cell, config))
        self._look_up(simulator)
        space = (
            gym.spaces.MultiDiscrete([*task.grid.shape, HEADINGS])
            if self._kind == "cell"
            else gym.spaces.Box(-1.0, 1.0, (4,), np.float32)
        )
        super().__init__(
            simulator,
            time_step=_LONGEST,
            action_space=gym.spaces.Box(-1.0, 3.0, (1,)),  # of the port; the environment's own is below
            observation_space=space,
            reward=lambda system, context: 0.0,
            action_port_id="action",
            observation_port_id="cheat.X_WB",
            reset_handler=weak_method(self._place),
        )
        self.metadata = {"render_modes": []}  # the base class fills in what this environment does not have
        self.render_mode = render_mode
        self.action_space = gym.spaces.Discrete(len(ACTIONS))
        self._driving = False
        self._held = simulator.get_context().Clone()
        simulator.set_monitor(weak_method(self._watch))

    def _look_up(self, simulator: Simulator) -> None:
        """Keeps what is asked for again and again."""
        diagram, context = simulator.get_system(), simulator.get_mutable_context()
        self._plant = subsystem(diagram, "station", "plant")
        self._plant_context = self._plant.GetMyMutableContextFromRoot(context)
        self._motions_context = subsystem(diagram, "primitives").GetMyMutableContextFromRoot(context)
        self._base = self._plant.GetBodyByName("base", self._plant.GetModelInstanceByName("robot"))
        self._base_height = RobotConfig().known_model().base_height
        diagram.GetInputPort("action").FixValue(context, [-1.0])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        given = (options or {}).get("start")
        self._next_start = self._start if given is None else self._usable(given)
        X_WB, _ = super().reset(seed=seed)
        self._bumped = ""
        return self._observation(planar_pose(X_WB)), self._info(planar_pose(X_WB), False)

    def step(self, action: np.int64) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if not self.action_space.contains(np.int64(action)):
            raise InputError("not an action", where="CrawlerRouteEnv", value=action, valid=ACTIONS)
        context = self.simulator.get_mutable_context()
        self._before, self._bumped, self._driving = self._pose(), "", True
        self._held.SetTimeStateAndParametersFrom(context)
        X_WB, _, _, truncated, _ = super().step(np.array([float(action)]))
        self._driving = False
        pose = planar_pose(X_WB)
        if self._read("status") != "done" and not self._bumped and not self._at_goal(pose):
            self._bumped = "occupied"  # held up by something
        reached = self._at_goal(pose) and not self._bumped
        reward = self._reward(pose, int(action), reached)
        if self._bumped:
            # All of it: what the robot believes must go back with it.
            now = context.get_time()
            context.SetTimeStateAndParametersFrom(self._held)
            context.SetTime(now)
            pose = self._pose()
        # The next step is not over because this one is; and one that was broken off does not go on.
        self._motions_context.SetDiscreteState(Motion().to_state())
        return self._observation(pose), reward, reached, truncated, self._info(pose, reached)

    def _place(self, simulator: Simulator, context: Context, seed: int | None) -> None:
        """Puts the robot to its start, a little off, and lets it settle."""
        config = self.config
        x, y, heading = self._next_start
        offset = min(config.start_offset, 0.4 * self.task.grid.cell)
        x, y = np.array([x, y]) + offset * self.np_random.uniform(-1, 1, 2)
        heading += np.deg2rad(config.start_heading_deg) * self.np_random.uniform(-1, 1)
        X_WB = RigidTransform(RollPitchYaw(0, 0, heading), np.array([x, y, self._base_height]))
        self._plant.SetFreeBodyPose(self._plant_context, self._base, X_WB)
        self.simulator.get_system().GetInputPort("action").FixValue(context, [-1.0])
        # The base class has initialised before it set the default state: drivers and encoders must do so again.
        self._driving = False
        simulator.Initialize()
        simulator.AdvanceTo(config.settle)

    def _watch(self, context: Context) -> EventStatus:
        """Ends the step when the motion has ended, the robot has left the free cells, or is at the goal."""
        if not self._driving:
            return EventStatus.DidNothing()
        if self._read("status") in ("done", "failed"):
            return EventStatus.ReachedTermination(self.simulator.get_system(), "the motion has ended")
        # Looked at in every time step of the physics: no more than floors and a look-up.
        grid = self.task.grid
        x, y, _ = self._read("cheat.X_WB").translation()
        i, j = math.floor((x - grid.origin[0]) / grid.cell), math.floor((y - grid.origin[1]) / grid.cell)
        kind = int(grid.kind[i, j]) if 0 <= i < grid.shape[0] and 0 <= j < grid.shape[1] else FENCE
        if kind != FREE:
            self._bumped = KINDS[kind]
            return EventStatus.ReachedTermination(self.simulator.get_system(), f"ran into {self._bumped}")
        if self.task.goal_cells[i, j]:
            return EventStatus.ReachedTermination(self.simulator.get_system(), "at the goal")
        return EventStatus.DidNothing()

    def _reward(self, pose: np.ndarray, action: int, reached: bool) -> float:
        rewards = self.task.rewards
        bumps = {"": 0.0, "fence": rewards.fence, "water": rewards.water}
        total = bumps.get(self._bumped, rewards.obstacle)
        if self._bumped or action >= 2:
            total -= rewards.per_turn
        else:
            way = float(np.hypot(*(pose - self._before)[:2]))
            total -= rewards.per_metre * way * 0.5 * (self._cost(self._before) + self._cost(pose))
        return total + (rewards.goal if reached else 0.0)

    def _cost(self, pose: np.ndarray) -> float:
        grid = self.task.grid
        return float(grid.cost[tuple(grid.index_of(pose[:2]))])

    def _at_goal(self, pose: np.ndarray) -> bool:
        grid = self.task.grid
        return bool(grid.contains(pose[:2]) and self.task.goal_cells[tuple(grid.index_of(pose[:2]))])

    def _read(self, port: str) -> Any:
        return self.simulator.get_system().GetOutputPort(port).Eval(self.simulator.get_context())

    def _pose(self) -> np.ndarray:
        return planar_pose(self._read("cheat.X_WB"))

    def _usable(self, pose: np.ndarray) -> np.ndarray:
        pose = np.asarray(pose, float)
        state = self.task.state_of(pose)
        if self.task.goal_cells.flat[state // HEADINGS]:
            raise InputError("is at the goal already", where="start", value=pose.tolist())
        return pose

    def _observation(self, pose: np.ndarray) -> np.ndarray:
        grid = self.task.grid
        if self._kind == "cell":
            xy = np.clip(pose[:2], grid.origin, grid.origin + (np.array(grid.shape) - 0.5) * grid.cell)
            return np.array([*grid.index_of(xy), round(pose[2] / (np.pi / 4)) % HEADINGS])
        share = (pose[:2] - grid.origin) / (np.array(grid.shape) * grid.cell)
        vector = np.array([*share, np.cos(pose[2]), np.sin(pose[2])], np.float32)
        return np.clip(vector, -1, 1)

    def _info(self, pose: np.ndarray, reached: bool) -> dict[str, Any]:
        time = float(self.simulator.get_context().get_time())
        return {"pose": pose, "time": time, "reached": reached, "bumped": self._bumped}


def register() -> None:
    """Makes the environment known to gymnasium; does nothing when it is already."""
    if NAME not in gym.registry:
        gym.register(NAME, entry_point=f"{__name__}:CrawlerRouteEnv", max_episode_steps=MOST_MOTIONS)


register()
