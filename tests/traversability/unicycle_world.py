"""A unicycle among boxes on flat ground, seen by a LiDAR that sees all around: the whole chain without physics."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from naraha.models import MODELS_DIR
from naraha.systems.tracking import KanayamaConfig, KanayamaTracking
from naraha.systems.traversability import (
    Ability,
    FuzzyTraversability,
    FuzzyVfhController,
    PolarRiskHistogram,
    RiskMemory,
    RiskMemoryConfig,
    TerrainConfig,
    TerrainFeatures,
    VfhConfig,
    read_ability,
)
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

Box = tuple[float, float, float, float]  # x0, y0, x1, y1 [m]
_HEIGHT = 0.8
_AZIMUTHS = np.deg2rad(np.arange(0, 360, 0.75))
_RANGES = np.arange(0.05, 4.5, 0.08)
_HEIGHTS = np.arange(0, _HEIGHT, 0.06)


@cache
def pioneer() -> Ability:
    return read_ability(MODELS_DIR / "pioneer" / "ability.yaml")


def scan(boxes: list[Box], pose: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """Points (N, 3) in the heading frame on the ground and on the first box in every direction."""
    angles = _AZIMUTHS + pose[2]
    ray = np.column_stack([np.cos(angles), np.sin(angles)])
    with np.errstate(divide="ignore"):
        inverse = 1 / np.where(np.abs(ray) < 1e-12, 1e-12, ray)
    nearest = np.full(len(angles), np.inf)
    for x0, y0, x1, y1 in boxes:
        a, b = (np.array([x0, y0]) - pose[:2]) * inverse, (np.array([x1, y1]) - pose[:2]) * inverse
        enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
        hit = (enter <= leave) & (enter > 0)
        nearest = np.where(hit, np.minimum(nearest, enter), nearest)
    direction = np.column_stack([np.cos(_AZIMUTHS), np.sin(_AZIMUTHS)])
    k, r = np.nonzero(nearest[:, None] > _RANGES)
    ground = np.column_stack([direction[k] * _RANGES[r, None], np.zeros(len(k))])
    k, h = np.nonzero((nearest < _RANGES[-1])[:, None] & (_HEIGHTS >= 0))
    wall = np.column_stack([direction[k] * (nearest[k, None] + 0.005), _HEIGHTS[h]])
    points = np.concatenate([ground, wall])
    return (points + noise * np.random.default_rng(seed).normal(size=points.shape)).astype(np.float32)


class BoxWorld(LeafSystem):
    """The robot's pose and its scan. What is `unseen` stops the robot, and the LiDAR does not see it."""

    def __init__(self, boxes: list[Box], start: np.ndarray, noise: float, unseen: list[Box], seed: int):
        super().__init__()
        self.boxes, self._unseen, self._noise, self._seed = boxes, unseen, noise, seed
        self.DeclareVectorInputPort("twist_command", 2)
        self.DeclareDiscreteState(start)
        cloud = self.DeclareAbstractState(AbstractValue.Make(PointCloud(scan(boxes, start, noise, seed))))
        self.DeclarePeriodicDiscreteUpdateEvent(0.02, 0.0, self._Move)
        self.DeclarePeriodicUnrestrictedUpdateEvent(0.1, 0.0, self._See)
        self.DeclareAbstractOutputPort("X_MB", lambda: Value(RigidTransform()), self._CalcPose, {self.xd_ticket()})
        by_state = {self.abstract_state_ticket(cloud)}
        self.DeclareAbstractOutputPort("cloud_H", lambda: AbstractValue.Make(object()), self._CalcCloud, by_state)

    def pose(self, context):
        return context.get_discrete_state(0).value().copy()

    def _Move(self, context, state):
        v, omega = self.GetInputPort("twist_command").Eval(context)
        pose = self.pose(context)
        middle = pose[2] + 0.01 * omega
        moved = pose + 0.02 * np.array([v * np.cos(middle), v * np.sin(middle), omega])
        if any(touches(moved, box, pioneer().footprint) for box in self._unseen):
            moved[:2] = pose[:2]
        state.set_value(0, moved)

    def _See(self, context, state):
        cloud = PointCloud(
            scan(self.boxes, self.pose(context), self._noise, self._seed + round(10 * context.get_time()))
        )
        state.get_mutable_abstract_state(0).set_value(cloud)
        return EventStatus.Succeeded()

    def _CalcPose(self, context, output):
        x, y, theta = self.pose(context)
        output.set_value(RigidTransform(RollPitchYaw(0, 0, theta), [x, y, 0]))

    def _CalcCloud(self, context, output: AbstractValue):
        output.set_value(context.get_abstract_state(0).get_value())


def touches(pose: np.ndarray, box: Box, footprint: list[float]) -> bool:
    """Whether the robot's outline, as points 5 cm apart, is in the box."""
    length, width = footprint
    side, end = np.arange(-length / 2, length / 2 + 0.01, 0.05), np.arange(-width / 2, width / 2 + 0.01, 0.05)
    outline = np.concatenate(
        [np.column_stack([side, np.full(len(side), w)]) for w in (-width / 2, width / 2)]
        + [np.column_stack([np.full(len(end), x), end]) for x in (-length / 2, length / 2)]
    )
    c, s = np.cos(pose[2]), np.sin(pose[2])
    at = pose[:2] + outline @ np.array([[c, s], [-s, c]])
    return bool(((at > box[:2]) & (at < box[2:])).all(axis=1).any())


@dataclass
class Run:
    """What happened every 0.1 s: poses (n, 3), times (n,) and statuses, and whether the robot touched a box."""

    poses: np.ndarray
    times: np.ndarray
    statuses: list[str]
    touched: bool


def build(
    boxes: list[Box],
    goal: tuple[float, float],
    *,
    start=(0.0, 0.0, 0.0),
    noise: float = 0.0,
    seed: int = 0,
    memory: bool = True,
    unseen: list[Box] | None = None,
    config: VfhConfig | None = None,
) -> Diagram:
    """World → features → τ → histogram → controller → tracking → world, with or without the memory."""
    ability, builder = pioneer(), DiagramBuilder()
    terrain = TerrainConfig(start=ability.footprint[0] / 2)
    config = config or VfhConfig()
    tracking = KanayamaConfig(
        k_x=(1 - config.reference_share) * ability.max_speed / (terrain.start + terrain.depth),
        max_speed=ability.max_speed,
        max_yaw_rate=ability.max_yaw_rate,
        risk_limit=ability.risk_limit,
    )
    world = builder.AddNamedSystem("world", BoxWorld(boxes, np.array(start, float), noise, unseen or [], seed))
    features = builder.AddSystem(TerrainFeatures(terrain))
    fuzzy = builder.AddSystem(FuzzyTraversability(ability))
    histogram = builder.AddSystem(PolarRiskHistogram(ability))
    controller = builder.AddNamedSystem("controller", FuzzyVfhController(ability, config))
    law = builder.AddSystem(KanayamaTracking(tracking))
    goal_source = builder.AddSystem(ConstantVectorSource(np.array(goal, float)))

    def connect(a, out, b, into):
        builder.Connect(a.GetOutputPort(out), b.GetInputPort(into))

    connect(world, "cloud_H", features, "cloud_H")
    connect(features, "features", fuzzy, "features")
    connect(features, "features", histogram, "features")
    connect(fuzzy, "traversability", histogram, "traversability")
    connect(histogram, "histogram", controller, "histogram")
    connect(world, "X_MB", controller, "X_MB")
    builder.Connect(goal_source.get_output_port(), controller.GetInputPort("goal"))
    if memory:
        held = builder.AddSystem(RiskMemory(ability, RiskMemoryConfig(reach=4.0)))
        connect(world, "cloud_H", held, "cloud_H")
        connect(world, "X_MB", held, "X_MB")
        connect(held, "risk_memory", controller, "risk_memory")
    connect(world, "X_MB", law, "X_MB")
    for name in ("reference_pose", "reference_twist", "risk"):
        connect(controller, name, law, name)
    connect(law, "twist_command", world, "twist_command")
    connect(law, "twist_command", controller, "twist_command")
    return builder.Build()


def run(boxes: list[Box], goal: tuple[float, float], *, duration=60.0, until=("arrived", "no way"), **rest) -> Run:
    """Drives to the goal, until a status of `until` or for `duration` [s]; the rest is as `build` takes it."""
    diagram = build(boxes, goal, **rest)
    world, controller = (diagram.GetSubsystemByName(name) for name in ("world", "controller"))
    simulator = Simulator(diagram)
    context, poses, statuses, touched = simulator.get_context(), [], [], False
    while context.get_time() < duration and not (statuses and statuses[-1] in until):
        simulator.AdvanceTo(context.get_time() + 0.1)
        poses.append(world.pose(world.GetMyContextFromRoot(context)))
        statuses.append(controller.GetOutputPort("status").Eval(controller.GetMyContextFromRoot(context)))
        touched |= any(touches(poses[-1], box, pioneer().footprint) for box in boxes)
    return Run(np.array(poses), 0.1 * np.arange(1, len(poses) + 1), statuses, touched)
