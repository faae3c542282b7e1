"""Water in the map, from near-infrared brightness and LiDAR shots."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config
from ..ports import eval_typed, weak_method
from ..sensing import Scan, ScanPattern
from ..slam.motion import distance_and_angle
from ..slam.scan_matcher import History, odometry_at
from .lidar_water import RayMemory, floor_height, ray_distances, shots_at_floor
from .shot_grid import ShotGrid
from .water import WaterConfig, cloud_attribute, cloud_points, find_puddles, water_probability

# Poses are remembered for this many periods; scans that started earlier are left out.
_HISTORY = 50
# [m] Scans nearer to the last one that was counted tell nothing new (a turn of 1 rad counts as 1 m).
_MIN_STEP = 0.02
# [m], [rad] A scan during which the pose moved farther is left out: the pose has jumped.
_MAX_MOTION = 0.5
# [m], [rad] A robot that stands higher above the lowest place where it stood, or tilted more, is on a step or a ramp:
# what is below it is not the floor.
_MAX_RISE, _MAX_TILT = 0.15, 0.05
# [s] Instants this near to each other are one.
_CLOCK = 1e-6


@dataclass(frozen=True, eq=False)
class _Seen:
    """Abstract state; read-only, so that Drake may share it instead of copying it at every update.

    Attributes:
        counted_at: pose of B at the end of the last scan that was counted, None before there is one.
        z_floor: lowest height at which the robot has stood [m], NaN before.
    """

    shots: ShotGrid
    memory: RayMemory
    history: History = ()
    last_index: int = -1
    counted_at: RigidTransform | None = None
    z_floor: float = np.nan

    def __deepcopy__(self, memo: dict) -> "_Seen":
        return self


class WaterDetector(LeafSystem):
    """
    .. pydrake_system::

        name: WaterDetector
        input_ports:
        - map_M
        - scan_S
        - X_MB
        output_ports:
        - shots
        - water_probability
        - puddles

    Finds water in the map (S0-c): near-infrared threshold, range filter and tilt filter as in the source, and LiDAR
    shots that go missing or are mirrored as second evidence.

    Every `period` it notes the pose and looks at `scan_S`. A new scan that has ended is sorted by `shots_at_floor` and
    added to the grid, once, if the robot has moved since the last one. Where the sensor was when the scan began and
    ended is interpolated between the notes. Scans from a stair or a ramp tell nothing of the floor. The other outputs
    are computed when they are asked for, and only then is `map_M` evaluated.

    - `map_M` (`open3d.t.geometry.PointCloud`): points in M with the attributes `nir`, `nir_range` [m] and `tilt` [rad],
      each NaN where not known; a missing attribute is not known anywhere.
    - `scan_S` (`Scan`): with `ring` and `column` of the pattern; a scan without them is not counted.
    - `X_MB` (`RigidTransform`): pose of the base in the map, whose z points up, now. It is not noted when it is not
      finite. A scan that the notes do not cover, or during which the pose moves by more than 0.5 m or 0.5 rad, is not
      counted.
    - `shots` (`ShotGrid`): what the LiDAR has seen of the floor.
    - `water_probability` (array (N,)): for the points of `map_M`, NaN where not known; see `water_probability`.
    - `puddles` (tuple of `Region`): groups of points that are probably water, the largest first.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected, of another type, or a scan does not fit the pattern.
    """

    def __init__(
        self,
        config: WaterConfig | None = None,
        *,
        X_BS: RigidTransform,
        pattern: ScanPattern,
        base_height: float = 0.08,
    ):
        """
        Args:
            X_BS: pose of the sensor in the base.
            pattern: rays of the LiDAR.
            base_height: of B above the floor when the robot stands level [m].
        """
        super().__init__()
        self._config = config or WaterConfig()
        check_config(self._config, where="water")
        self._X_BS, self._pattern, self._base_height = X_BS, pattern, base_height
        self.DeclareAbstractInputPort("map_M", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("scan_S", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        never = RayMemory(0.0, np.full(pattern.rays, -np.inf, np.float32))
        start = _Seen(ShotGrid(self._config.shots), never)
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._CountShots)
        needs = {state, self.input_port_ticket(self.GetInputPort("map_M").get_index())}
        self.DeclareAbstractOutputPort(
            "shots", lambda: AbstractValue.Make(start.shots), weak_method(self._CalcShots), {state}
        )
        self.DeclareAbstractOutputPort(
            "water_probability", lambda: AbstractValue.Make(np.zeros(0)), weak_method(self._CalcProbability), needs
        )
        self.DeclareAbstractOutputPort("puddles", lambda: AbstractValue.Make(()), weak_method(self._CalcPuddles), needs)

    def _CountShots(self, context: Context, state: State) -> EventStatus:
        scan = eval_typed(self, context, "scan_S", Scan)
        # A copy: what the port gives is a reference to its cache, which will hold the next pose.
        X_MB = RigidTransform(eval_typed(self, context, "X_MB", RigidTransform))
        seen = self._seen(context)
        if np.isfinite(X_MB.GetAsMatrix4()).all():
            seen = replace(seen, history=(*seen.history, (context.get_time(), X_MB))[-_HISTORY:])
        if scan.index >= 0 and scan.index != seen.last_index and scan.end_time <= context.get_time() + _CLOCK:
            seen = self._with_scan(replace(seen, last_index=scan.index), scan)
        state.get_mutable_abstract_state(0).set_value(seen)
        return EventStatus.Succeeded()

    def _with_scan(self, seen: _Seen, scan: Scan) -> _Seen:
        """`seen` with one more scan, unchanged where it does not count."""
        distance = ray_distances(scan, self._pattern)
        covered = seen.history and seen.history[0][0] <= scan.start_time + _CLOCK
        if distance is None or not covered or seen.history[-1][0] < scan.end_time - _CLOCK:
            return seen
        X_MB0, X_MB1 = odometry_at(seen.history, scan.start_time), odometry_at(seen.history, scan.end_time)
        if max(distance_and_angle(X_MB0.inverse() @ X_MB1)) > _MAX_MOTION:
            return seen
        step = 0.0
        if seen.counted_at is not None:
            step = sum(distance_and_angle(seen.counted_at.inverse() @ X_MB1))
            if step < _MIN_STEP:
                return seen
        memory = seen.memory.after(distance, step)
        z_floor = float((X_MB1 @ np.array([0, 0, -self._base_height]))[2])
        lowest = float(np.fmin(seen.z_floor, z_floor))
        if z_floor > lowest + _MAX_RISE or X_MB1.rotation().matrix()[2, 2] < np.cos(_MAX_TILT):
            return replace(seen, z_floor=lowest, counted_at=X_MB1, memory=memory)
        X_MS0, X_MS1 = ((X_MB @ self._X_BS).GetAsMatrix4() for X_MB in (X_MB0, X_MB1))
        shots = shots_at_floor(
            self._pattern, distance, X_MS0, X_MS1, z_floor, self._config.shots, memory.hidden(self._config.shots)
        )
        return replace(
            seen,
            shots=seen.shots.add(shots),
            memory=memory,
            counted_at=X_MB1,
            z_floor=lowest,
        )

    @staticmethod
    def _seen(context: Context) -> _Seen:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _CalcShots(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._seen(context).shots)

    def _CalcProbability(self, context: Context, output: AbstractValue) -> None:
        map_M, seen = eval_typed(self, context, "map_M", PointCloud), self._seen(context)
        points, tilt = cloud_points(map_M), cloud_attribute(map_M, "tilt")
        output.set_value(
            water_probability(
                points,
                nir=cloud_attribute(map_M, "nir"),
                nir_range=cloud_attribute(map_M, "nir_range"),
                tilt=tilt,
                shots=seen.shots,
                z_floor=floor_height(points, tilt, near=seen.z_floor),
                config=self._config,
            )
        )

    def _CalcPuddles(self, context: Context, output: AbstractValue) -> None:
        probability: Any = self.GetOutputPort("water_probability").Eval(context)
        points = cloud_points(eval_typed(self, context, "map_M", PointCloud))
        output.set_value(find_puddles(points, probability, self._config))
