"""The survey without a tour, as a part of the survey: map → grid → goal → learnt and offered routes → drive."""

from dataclasses import dataclass, field, replace

import numpy as np
from naraha.models.worlds import Solid, World
from naraha.systems.config import quantity
from naraha.systems.display import RouteDisplay
from naraha.systems.drive import ModeSwitch, ModeSwitchConfig
from naraha.systems.hazards import SemanticMap
from naraha.systems.routes import (
    DistinctRoutes,
    LoopState,
    RouteLearner,
    RouteLearnerConfig,
    RoutesConfig,
    SurveyLoop,
    SurveyLoopConfig,
    VoxelWorld,
    VoxelWorldConfig,
)
from naraha.systems.tracking import PathFollower, PathFollowerConfig
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System
from pydrake.systems.primitives import ZeroOrderHold
from scipy.ndimage import binary_dilation, label
from scipy.spatial import KDTree

from .obstacle_distance import top_of
from .robot_files import robot_ability
from .semantic_metrics import in_plan, solids_labelled
from .wiring import connect, subsystem

_DRIVABLE = ("floor", "ramp", "stair", "water")
# [m] Lower things may be driven over; higher ones are hung above the robot. [N] Weaker contacts do not count.
_LOW, _HIGH, _FORCE = 0.2, 0.6, 5.0
# [m] Edge of the cells in which the floor is counted, and distance from which on a point of the map shows a cell.
_CELL, _NEAR = 0.1, 0.15


@dataclass(kw_only=True)
class LoopStages:
    """The stages of a survey that finds its own way."""

    # What the robot can drive over: the name of a file beside its model, or a YAML file.
    ability: str = "ability"
    # [m] Steps that are driven over, in place of those of the ability; null keeps these. On a narrow piece of debris
    # higher than the belly clears (0.045 m) a robot gets stuck that climbs a wide step four times as high.
    max_step: float | None = quantity(None, unit="m", above=0)
    survey: SurveyLoopConfig = field(default_factory=SurveyLoopConfig)
    # Decisions need a map as old as this at most, and every look at it takes as long as some scans do.
    world: VoxelWorldConfig = field(default_factory=lambda: VoxelWorldConfig(period=3.0))
    # [s] How old the dose field may be that ways are chosen by: its estimate takes longer than the rest of the map.
    dose_period: float = quantity(10.0, unit="s", above=0)
    learner: RouteLearnerConfig = field(default_factory=RouteLearnerConfig)
    routes: RoutesConfig = field(default_factory=RoutesConfig)
    follower: PathFollowerConfig = field(default_factory=PathFollowerConfig)
    mode_switch: ModeSwitchConfig = field(default_factory=ModeSwitchConfig)


def add_loop_map(
    builder: DiagramBuilder,
    semantic_map: SemanticMap,
    *,
    survey_map: System,
    map_source: tuple[System, str],
    period: float,
) -> System:
    """Adds `semantic_map` as `loop_map`: what the detectors found, with a dose field taken every `period` [s]."""
    loop_map = builder.AddNamedSystem("loop_map", semantic_map)
    held = builder.AddNamedSystem("dose_hold", ZeroOrderHold(period, AbstractValue.Make(object())))
    builder.Connect(builder.GetSubsystemByName("dose").GetOutputPort("dose_field"), held.get_input_port())
    builder.Connect(held.get_output_port(), loop_map.GetInputPort("dose_field"))
    connect(builder, *map_source, loop_map, "map_M")
    connect(builder, survey_map, "keyframes", loop_map)
    connect(builder, builder.GetSubsystemByName("water"), "water_probability", loop_map)
    connect(builder, builder.GetSubsystemByName("heat"), "heat_probability", loop_map)
    return loop_map


def add_loop(
    builder: DiagramBuilder,
    config: LoopStages,
    *,
    model: str,
    station: Diagram,
    slam: System,
    survey_map: System,
    semantic_map: System,
    tracking: System,
    meshcat: Meshcat | None = None,
) -> System:
    """Adds `world`, `learner`, `routes`, `follower`, `loop`, `mode_switch`, and `route_display` with a `meshcat`.

    What the operator says comes in by inputs of the diagram, see `Operator`: `mode_command`, `teleoperation_twist`,
    `teleoperation_time` and `choice`. Returns `loop`.
    """
    ability = robot_ability(model, config.ability)
    if config.max_step is not None:
        ability = replace(ability, step_threshold=config.max_step)
    world = builder.AddNamedSystem("world", VoxelWorld(config.world, ability=ability))
    learner = builder.AddNamedSystem("learner", RouteLearner(config.learner))
    routes = builder.AddNamedSystem("routes", DistinctRoutes(config.routes))
    follower = builder.AddNamedSystem("follower", PathFollower(config.follower))
    loop = builder.AddNamedSystem("loop", SurveyLoop(config.survey, routes=config.routes))
    switch = builder.AddNamedSystem("mode_switch", ModeSwitch(config.mode_switch))

    connect(builder, semantic_map, "semantic_M", world)
    connect(builder, survey_map, "keyframes", world)
    for system in (learner, routes):
        connect(builder, world, "route_grid", system)
        connect(builder, loop, "start", system)
        connect(builder, loop, "goal", system)
    connect(builder, world, "route_grid", loop)
    connect(builder, world, "voxels", loop)
    connect(builder, world, "interest", loop)
    connect(builder, slam, "X_MB", loop)
    connect(builder, learner, "learning", loop)
    connect(builder, routes, "routes", loop)
    connect(builder, loop, "route", follower)
    connect(builder, slam, "X_MB", follower)
    for output, name in (
        ("status", "follower_status"),
        ("reference_pose", "follower_pose"),
        ("reference_twist", "follower_twist"),
    ):
        connect(builder, follower, output, loop, name)
    connect(builder, loop, "reference_pose", tracking)
    connect(builder, loop, "reference_twist", tracking)
    connect(builder, tracking, "twist_command", switch, "autonomous_twist")
    for name in ("mode_command", "teleoperation_twist", "teleoperation_time"):
        builder.ExportInput(switch.GetInputPort(name), name)
    builder.ExportInput(loop.GetInputPort("choice"), "choice")
    connect(builder, switch, "twist_command", station)
    connect(builder, switch, "mode", loop)
    if station.HasInputPort("flipper_preset"):
        connect(builder, loop, "flipper_preset", station)
    if meshcat is not None:
        display = builder.AddNamedSystem("route_display", RouteDisplay(meshcat=meshcat))
        connect(builder, loop, "offers", display, "routes")
        connect(builder, loop, "chosen", display)
    return loop


class TouchCount:
    """How often the robot has begun to touch what it must not, and to stand in water, by the truth."""

    def __init__(self, diagram: Diagram, world: World, footprint: list[float]):
        self._diagram = diagram
        self._plant, scene_graph = (subsystem(diagram, "station", name) for name in ("plant", "scene_graph"))
        self._inspector = scene_graph.model_inspector()
        self._obstacles = {solid.name for solid in _obstacles(world)}
        self._pools = solids_labelled(world, "water")
        share = np.linspace(-0.5, 0.5, 11)
        self._inside = np.array([(a, b, 0.0) for a in share for b in share]) * [*footprint, 0.0]
        self.collisions, self.water_entries = 0, 0
        self.touched: set[str] = set()
        self._touching: set[str] = set()
        self._wet = False

    def step(self, context: Context, X_WB: RigidTransform) -> None:
        """Looks at the contacts of now."""
        results = self._plant.get_contact_results_output_port().Eval(self._plant.GetMyContextFromRoot(context))
        touching = set()
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            if np.linalg.norm(info.contact_force()) < _FORCE:
                continue
            for id in (info.point_pair().id_A, info.point_pair().id_B):
                touching.add(self._inspector.GetName(id).split("::")[-1].removesuffix("_collision"))
        touching &= self._obstacles
        self.collisions += len(touching - self._touching)
        self.touched |= touching
        self._touching = touching
        p_WQ = (X_WB @ self._inside.T).T
        # Over a pool that is under the landing the robot stands dry.
        wet = bool(X_WB.translation()[2] < 0.3 and any(in_plan(pool, p_WQ).any() for pool in self._pools))
        self.water_entries += wet and not self._wet
        self._wet = wet


def coverage(world: World, start_xy: np.ndarray, width: float, points: np.ndarray) -> float:
    """Share of the floor that the robot can truly get to, or beside, in which the map has points of the ground.

    Cells that a robot `width` [m] wide reaches from `start_xy` (2) [m] without leaving the floor, and what lies within
    half of `width` of them. Without the stair.

    Args:
        points: (N, 3) of the map [m].
    """
    floor = next(solid for solid in world.solids if solid.name == "floor")
    assert floor.box
    half = 0.5 * np.array(floor.box[:2])
    axes = [np.arange(-h + 0.5 * _CELL, h, _CELL) for h in half]
    plan = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    flat = np.column_stack([plan.reshape(-1, 2) + floor.xyz[:2], np.zeros(plan[..., 0].size)])
    taken = np.zeros(len(flat), bool)
    for solid in [*_obstacles(world), *(s for s in solids_labelled(world, "stair"))]:
        if solid.xyz[2] - 0.5 * (solid.box or [0, 0, 0])[2] < _HIGH:
            taken |= in_plan(solid, flat)
    free = ~taken.reshape(plan.shape[:2])
    reach = max(round(0.5 * width / _CELL), 1)
    wide = ~binary_dilation(~free, iterations=reach)
    wide[:reach] = wide[-reach:] = wide[:, :reach] = wide[:, -reach:] = False
    parts, _ = label(wide)
    first = np.argmin(np.where(wide.ravel(), np.linalg.norm(flat[:, :2] - start_xy, axis=1), np.inf))
    reachable = binary_dilation(parts == parts.ravel()[first], iterations=reach) & free
    low = points[np.abs(points[:, 2]) < _NEAR]
    if not len(low):
        return 0.0
    seen = KDTree(low[:, :2]).query(flat[reachable.ravel(), :2])[0] <= _NEAR
    return float(seen.mean())


def loop_metrics(state: LoopState, touches: TouchCount) -> dict[str, float]:
    """Counts of legs and routes, of what was touched, and whether the robot is back."""
    return {
        "legs": state.legs,
        "looks": state.looks,
        "goals_passed": state.passed,
        "takeovers": state.held,
        "stalled": state.stalled,
        "routes_offered": state.offered,
        "routes_closed": state.closed,
        "returned_home": int(state.returned),
        "collisions": touches.collisions,
        "water_entries": touches.water_entries,
    }


def _obstacles(world: World) -> list[Solid]:
    """What is too high to be driven over."""
    return [
        solid
        for solid in world.solids
        if solid.collides and world.surfaces[solid.surface].label not in _DRIVABLE and top_of(solid) > _LOW
    ]
