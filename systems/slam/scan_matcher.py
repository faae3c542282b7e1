"""Where the robot is, from LiDAR scans and odometry."""

from dataclasses import dataclass, replace
from typing import Any

from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config
from ..point_classes import ClassModel
from ..ports import eval_typed, weak_method
from ..sensing import Scan
from .keyframe import KeyframePoses
from .motion import interpolate
from .scan_tracking import ScanMatcherConfig, Track, correct_track, track_scan

# Odometry is remembered for this many periods; a scan that started earlier is de-skewed with the oldest pose.
_HISTORY = 50

History = tuple[tuple[float, RigidTransform], ...]


@dataclass(frozen=True, eq=False)
class _Matcher:
    """Abstract state; read-only, so that Drake may share it instead of copying it at every update."""

    track: Track
    history: History = ()

    def __deepcopy__(self, memo: dict) -> "_Matcher":
        return self


class ScanMatcher(LeafSystem):
    """
    .. pydrake_system::

        name: ScanMatcher
        input_ports:
        - scan_S
        - X_OB
        - keyframe_poses
        - class_model
        output_ports:
        - X_MB
        - keyframe
        - health

    Registers scans to a local map of the last keyframes, or to the last one alone (S0-g, Eq. 7 with `method:
    point_to_point`).

    Every `period` it notes the odometry and looks at `scan_S` (`Scan`, sensor frame S). A new scan that ended at
    or before now is de-skewed and thinned, and its pose at its end is found by ICP from a guess: the odometry
    since the last keyframe or, without odometry, the last velocity. Where the scan began and ended, odometry is
    interpolated at constant twist between the notes.

    - `X_OB` (`RigidTransform`): odometry, pose of the base B in O; this optional port is there with `with_odometry`.
      Scans closer to the last attempt than `keyframe_distance` and `keyframe_angle_deg` are then not registered.
    - `keyframe_poses` (`KeyframePoses`): where a pose graph finds the keyframes to be; this optional port is there
      with `with_corrections`. The local map and the robot move with them.
    - `class_model` (`ClassModel`): classes that scans are registered by, beside their geometry; this optional port is
      there with `with_classes`.
    - `X_MB` (`RigidTransform`): pose of B in the map M, now: X_MB = X_MO X_OB(now) with X_MO from the last keyframe.
      Without odometry it is the pose at the end of the last registered scan.
    - `keyframe` (`Keyframe`): the last registered scan; index -1 and an empty cloud before there is one.
    - `health` (`PoseHealth`): whether the last registration succeeded, when it was measured, and what was skipped.

    The first usable scan is placed where the odometry says, from X_MB0 at the first update, and starts the map;
    without odometry it is placed at X_MB0 and stays as skewed as it was. A scan with fewer than
    `registration.min_points` usable points, or whose registration fails or jumps, is counted and skipped: the pose
    goes on with the odometry and `health` says why. After `max_failures` in a row a new local map is started there.
    Scans with index -1, before the first revolution of a LiDAR, do not count.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(
        self,
        config: ScanMatcherConfig | None = None,
        *,
        X_BS: RigidTransform | None = None,
        X_MB0: RigidTransform | None = None,
        with_odometry: bool = True,
        with_corrections: bool = False,
        with_classes: bool = False,
    ):
        """
        Args:
            X_BS: pose of the sensor in the base; identity when not given.
            X_MB0: pose of the base in the map at the first update; identity when not given.
        """
        super().__init__()
        self._config = config or ScanMatcherConfig()
        check_config(self._config)
        self._X_BS = X_BS or RigidTransform()
        self._with_odometry = with_odometry
        self.DeclareAbstractInputPort("scan_S", AbstractValue.Make(object()))
        if with_odometry:
            self.DeclareAbstractInputPort("X_OB", AbstractValue.Make(RigidTransform()))
        self._with_corrections = with_corrections
        if with_corrections:
            self.DeclareAbstractInputPort("keyframe_poses", AbstractValue.Make(KeyframePoses()))
        self._with_classes = with_classes
        if with_classes:
            self.DeclareAbstractInputPort("class_model", AbstractValue.Make(object()))
        start = _Matcher(Track(X_MB0 or RigidTransform()))
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._Match)
        pose_needs = (
            {state, self.input_port_ticket(self.GetInputPort("X_OB").get_index())} if with_odometry else {state}
        )
        self.DeclareAbstractOutputPort(
            "X_MB", lambda: AbstractValue.Make(RigidTransform()), weak_method(self._CalcPose), pose_needs
        )
        self.DeclareAbstractOutputPort(
            "keyframe", lambda: AbstractValue.Make(start.track.keyframe), weak_method(self._CalcKeyframe), {state}
        )
        self.DeclareAbstractOutputPort(
            "health", lambda: AbstractValue.Make(start.track.health), weak_method(self._CalcHealth), {state}
        )

    def _Match(self, context: Context, state: State) -> EventStatus:
        scan = eval_typed(self, context, "scan_S", Scan)
        matcher = self._matcher(context)
        track, history = matcher.track, matcher.history
        if self._with_corrections:
            poses = eval_typed(self, context, "keyframe_poses", KeyframePoses)
            track = correct_track(track, poses, self._config)
        span = None
        if self._with_odometry:
            # A copy: what the port gives is a reference to its cache, which will hold the next pose.
            X_OB = RigidTransform(eval_typed(self, context, "X_OB", RigidTransform))
            history = (*history, (context.get_time(), X_OB))[-_HISTORY:]
            if track.X_OB is None:
                track = replace(track, X_OB=X_OB)
            span = odometry_at(history, scan.start_time), odometry_at(history, scan.end_time)
        model = eval_typed(self, context, "class_model", ClassModel) if self._with_classes else None
        track = track_scan(track, scan, self._X_BS, self._config, span, model)
        state.get_mutable_abstract_state(0).set_value(_Matcher(track, history))
        return EventStatus.Succeeded()

    @staticmethod
    def _matcher(context: Context) -> _Matcher:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _CalcPose(self, context: Context, output: AbstractValue) -> None:
        track = self._matcher(context).track
        if track.X_OB is not None:
            output.set_value(track.X_MO @ eval_typed(self, context, "X_OB", RigidTransform))
        else:
            output.set_value(track.X_MB)

    def _CalcKeyframe(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._matcher(context).track.keyframe)

    def _CalcHealth(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._matcher(context).track.health)


def odometry_at(history: History, time: float) -> RigidTransform:
    """Odometry at `time` [s], at constant twist between notes, and held before the first and after the last."""
    times = [noted for noted, _ in history]
    if time <= times[0]:
        return history[0][1]
    if time >= times[-1]:
        return history[-1][1]
    after = next(i for i, noted in enumerate(times) if noted >= time)
    (t0, X0), (t1, X1) = history[after - 1], history[after]
    return interpolate(X0, X1, (time - t0) / (t1 - t0))
