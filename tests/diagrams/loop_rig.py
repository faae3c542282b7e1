"""The loop of a survey with a robot that moves as it is told and maps that are given: all but physics and sensors."""

from collections.abc import Callable
from typing import Any

import numpy as np
from naraha.diagrams.operator import Operator
from naraha.diagrams.survey_loop import LoopStages, add_loop
from naraha.diagrams.wiring import DiagramReader, export_outputs
from naraha.systems.slam import Keyframe
from naraha.systems.tracking import KanayamaConfig, KanayamaTracking
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

# A map: the cloud that is known when the robot has been at poses (K, 3), the last of them now, at a time.
MapOf = Callable[[np.ndarray, float], PointCloud]
_PERIOD = 0.05


class Unicycle(LeafSystem):
    """A robot that turns and drives as it is told, and knows where it is."""

    def __init__(self, pose: np.ndarray):
        super().__init__()
        self.DeclareVectorInputPort("twist_command", 2)
        state = self.DeclareDiscreteState(np.asarray(pose, float))
        self.DeclarePeriodicDiscreteUpdateEvent(_PERIOD, 0.0, self._Move)
        self.DeclareAbstractOutputPort(
            "X_MB", lambda: AbstractValue.Make(RigidTransform()), self._CalcPose, {self.discrete_state_ticket(state)}
        )

    def _Move(self, context: Any, discrete_state: Any) -> None:
        x, y, heading = context.get_discrete_state_vector().value()
        v, omega = self.GetInputPort("twist_command").Eval(context)
        middle = heading + 0.5 * omega * _PERIOD
        moved = [x + v * np.cos(middle) * _PERIOD, y + v * np.sin(middle) * _PERIOD, heading + omega * _PERIOD]
        discrete_state.get_mutable_vector().SetFromVector(moved)

    def _CalcPose(self, context: Any, output: AbstractValue) -> None:
        x, y, heading = context.get_discrete_state_vector().value()
        output.set_value(RigidTransform(RollPitchYaw(0, 0, heading), [x, y, 0.08]))


class GivenMap(LeafSystem):
    """The map that `map_of` gives, looked at every second, with a keyframe for every look."""

    def __init__(self, map_of: MapOf, period: float = 1.0):
        super().__init__()
        self._map_of = map_of
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        self.DeclareAbstractState(AbstractValue.Make(()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._Look)
        self.DeclareAbstractOutputPort("semantic_M", lambda: AbstractValue.Make(PointCloud()), self._CalcMap)
        self.DeclareAbstractOutputPort("keyframes", lambda: AbstractValue.Make(()), self._CalcKeyframes)

    def _Look(self, context: Any, state: Any) -> None:
        keyframes = context.get_abstract_state(0).get_value()
        X_MB = RigidTransform(self.GetInputPort("X_MB").Eval(context))
        poses = [k.X_MB for k in keyframes] + [X_MB]
        stood = np.array([[*X.translation()[:2], RollPitchYaw(X.rotation()).yaw_angle()] for X in poses])
        cloud = self._map_of(stood, context.get_time())
        keyframe = Keyframe(len(keyframes), context.get_time(), X_MB, None, cloud, 0.0)
        state.get_mutable_abstract_state(0).set_value((*keyframes, keyframe))

    def _CalcMap(self, context: Any, output: AbstractValue) -> None:
        keyframes = context.get_abstract_state(0).get_value()
        output.set_value(keyframes[-1].cloud_B if keyframes else PointCloud())

    def _CalcKeyframes(self, context: Any, output: AbstractValue) -> None:
        output.set_value(context.get_abstract_state(0).get_value())


class LoopRig(DiagramReader):
    """The running loop. `operator` says what the operator says; `step` goes on."""

    def __init__(self, map_of: MapOf, stages: LoopStages, pose=(0.0, 0.0, 0.0), *, map_period: float = 1.0):
        builder = DiagramBuilder()
        robot = builder.AddNamedSystem("robot", Unicycle(np.asarray(pose, float)))
        known = builder.AddNamedSystem("given_map", GivenMap(map_of, map_period))
        builder.Connect(robot.GetOutputPort("X_MB"), known.GetInputPort("X_MB"))
        tracking = builder.AddNamedSystem("tracking", KanayamaTracking(KanayamaConfig()))
        builder.Connect(robot.GetOutputPort("X_MB"), tracking.GetInputPort("X_MB"))
        add_loop(
            builder,
            stages,
            model="crawler",
            station=robot,
            slam=robot,
            survey_map=known,
            semantic_map=known,
            tracking=tracking,
        )
        export_outputs(builder)
        super().__init__(builder.Build())
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        self.operator = Operator(self.diagram, self.context)
        self.simulator.Initialize()

    @property
    def time(self) -> float:
        return self.context.get_time()

    @property
    def pose(self) -> np.ndarray:
        """x, y, heading."""
        X_MB = self.read("robot.X_MB")
        return np.array([*X_MB.translation()[:2], RollPitchYaw(X_MB.rotation()).yaw_angle()])

    @property
    def state(self):
        return self.read("loop.survey")

    def step(self, seconds: float = 0.1) -> None:
        self.simulator.AdvanceTo(self.time + seconds)

    def until(self, *phases: str, limit: float = 300.0):
        """Goes on until the loop is in one of the phases, and returns its state."""
        end = self.time + limit
        while self.time < end:
            if self.state.phase in phases:
                return self.state
            self.step()
        raise AssertionError(f"not {phases} within {limit} s but {self.state.phase}")
