"""The ground around a robot as its LiDAR has seen it while it drove, in the heading frame."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config
from ..errors import ConfigError
from ..ports import eval_typed, weak_method
from ..sensing import Scan, interpolate_pose
from ..sensing.deskew import rotation_vector
from .dust import without_dust
from .height_drift import height_offset
from .local_points import (
    WAY_OF_TURN,
    LocalCloudConfig,
    LocalPoints,
    Sweep,
    add_scan,
    heading_frame,
    in_frame,
    level_ground,
    no_points,
    place_scan,
)
from .voxel_cloud import transform_points

# [s] Poses are remembered for this long; a scan that started earlier is de-skewed with the oldest one.
_HISTORY = 0.5
# [s] After a whole period: what the other systems measured at that instant has arrived by then, and a scan and the
# poses at its end belong together.
_OFFSET = 0.001
# A scan is de-skewed with as many poses from its start to its end: 0.1 rad in a scan is then good to 2 mm at 4 m.
_INSTANTS = 128
# [m] Way is counted in steps of this length: the noise of a pose at rest is no way.
_STEP = 0.05


@dataclass(frozen=True, eq=False)
class _Note:
    """Poses (4, 4) at one time."""

    time: float
    X_OB: np.ndarray
    X_BS: np.ndarray


@dataclass(frozen=True, eq=False)
class _Memory:
    """Abstract state; read-only, so that Drake may share it instead of copying it at every update."""

    points: LocalPoints
    notes: tuple[_Note, ...] = ()
    way: float = 0.0
    # X_OB when `way` was last counted.
    counted: np.ndarray | None = None
    last_index: int = -1
    # [m] What is added to the height of X_OB.
    lift: float = 0.0

    def __deepcopy__(self, memo: dict) -> "_Memory":
        return self


class LocalCloud(LeafSystem):
    """
    .. pydrake_system::

        name: LocalCloud
        input_ports:
        - scan_S
        - X_OB
        - X_BS
        output_ports:
        - cloud_H

    Remembers what the last scans have shown around the robot: a LiDAR on a tilt unit sees one line at a time, and a
    spinning one does not see the ground near the robot.

    Every `period` it notes the poses and looks at `scan_S` (`Scan`, sensor frame S). A new scan is de-skewed to its
    end, put where the sensor was then, and thinned to one point a voxel, the newest. What is forgotten, see
    `LocalCloudConfig`: points that are old, that were measured a long way back, that are outside the window around the
    robot, and that later scans have seen through, so that what has moved away is not in the way any more.

    - `X_OB` (`RigidTransform`): pose of the base B in O, z up. Points stay where they were measured in O: odometry that
      does not jump is better here than a corrected pose, after whose jumps older points are off by as much, unless it
      drifts farther than that while they are remembered, as where tracks slide.
    - `X_BS` (`RigidTransform`): pose of the sensor in the base, now or at the end of the scan; a tilt unit moves it.
    - `cloud_H` (`open3d.t.geometry.PointCloud`): positions (N, 3) float32 [m] in the heading frame H of now: origin on
      the ground below the base's origin, z up, x ahead as seen from above, see `heading_frame`. Empty before the
      first scan.

    Between the notes poses are interpolated at constant twist. Scans without points, and points that are not finite,
    add nothing; a scan with index -1, before the first revolution of a LiDAR, does not count. Points of the robot
    itself must have been left out, as `Lidar` does.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, config: LocalCloudConfig | None = None):
        super().__init__()
        self._config = config or LocalCloudConfig()
        check_config(self._config, where="local cloud")
        if self._config.min_height >= self._config.max_height:
            raise ConfigError(
                "no window", where="local cloud", key="min_height", value=self._config.min_height, valid="< max_height"
            )
        self.DeclareAbstractInputPort("scan_S", AbstractValue.Make(object()))
        X_OB = self.DeclareAbstractInputPort("X_OB", AbstractValue.Make(RigidTransform()))
        self.DeclareAbstractInputPort("X_BS", AbstractValue.Make(RigidTransform()))
        start = _Memory(no_points())
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, _OFFSET, self._TakeIn)
        self.DeclareAbstractOutputPort(
            "cloud_H",
            lambda: AbstractValue.Make(_cloud(np.zeros((0, 3), np.float32))),
            weak_method(self._CalcCloud),
            {state, self.input_port_ticket(X_OB.get_index())},
        )

    @staticmethod
    def _memory(context: Context) -> _Memory:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _TakeIn(self, context: Context, state: State) -> EventStatus:
        poses = [eval_typed(self, context, name, RigidTransform).GetAsMatrix4() for name in ("X_OB", "X_BS")]
        # Of the whole period: nothing that was measured then has changed since.
        note = _Note(context.get_time() - _OFFSET, *poses)
        scan = eval_typed(self, context, "scan_S", Scan)
        state.get_mutable_abstract_state(0).set_value(take_in(self._memory(context), note, scan, self._config))
        return EventStatus.Succeeded()

    def _CalcCloud(self, context: Context, output: AbstractValue) -> None:
        X_OB = eval_typed(self, context, "X_OB", RigidTransform).GetAsMatrix4()
        memory = self._memory(context)
        X_OH = heading_frame(_lifted(X_OB, memory.lift), self._config.base_height)
        output.set_value(_cloud(in_frame(memory.points.p_O, X_OH)))


def take_in(memory: _Memory, note: _Note, scan: Scan, config: LocalCloudConfig) -> _Memory:
    """The memory with a note added, and with `scan` if it is a new one."""
    notes = (*(old for old in memory.notes if old.time >= note.time - _HISTORY), note)
    counted = note.X_OB if memory.counted is None else memory.counted
    step, way = _way(counted, note.X_OB), memory.way
    if step >= _STEP:
        way, counted = way + step, note.X_OB
    memory = replace(memory, notes=notes, way=way, counted=counted)
    if scan.index < 0 or scan.index == memory.last_index:
        return memory
    (X_OB0, X_BS0), (X_OB1, X_BS1) = (poses_at(notes, time) for time in (scan.start_time, scan.end_time))
    X_OB0, X_OB1 = (_lifted(X_OB, memory.lift) for X_OB in (X_OB0, X_OB1))
    X_OS0, X_OS1 = X_OB0 @ X_BS0, X_OB1 @ X_BS1
    if config.dust_gap is not None:
        scan = without_dust(scan, config.dust_gap)
    times, duration = scan.attribute("time"), scan.end_time - scan.start_time
    roll, pitch, _ = rotation_vector(X_OB0[:3, :3].T @ X_OB1[:3, :3])
    if memory.last_index >= 0 and math.hypot(roll, pitch) > config.max_swing_rate * duration:
        return replace(memory, last_index=scan.index)
    fraction = np.ones(len(scan.p_SP)) if times is None or duration <= 0 else times * (1 / duration)
    R, p = interpolate_pose(np.linalg.solve(X_OS0, X_OS1), np.linspace(0, 1, _INSTANTS))
    sweep = X_OS0[:3, :3] @ R, p @ X_OS0[:3, :3].T + X_OS0[:3, 3]
    p_OH = heading_frame(X_OB1, config.base_height)[:3, 3]
    local, lift = memory.points, memory.lift
    if config.height_time is not None and memory.last_index >= 0:
        rise = _rise(local, scan, fraction, sweep, p_OH, config)
        sweep, p_OH, lift = (sweep[0], sweep[1] + rise), p_OH + rise, lift + rise[2]
    if memory.last_index < 0 and config.level_radius > 0:
        X_SH = np.linalg.solve(X_OS1, heading_frame(X_OB1, config.base_height))
        ground = transform_points(X_SH, level_ground(config.level_radius, config.voxel))
        local = add_scan(local, ground, np.ones(len(ground)), sweep, p_OH, scan.end_time, way, config)
    local = add_scan(local, scan.p_SP, fraction, sweep, p_OH, scan.end_time, way, config)
    return replace(memory, points=local, last_index=scan.index, lift=lift)


def _rise(
    points: LocalPoints, scan: Scan, fraction: np.ndarray, sweep: Sweep, p_OH: np.ndarray, config: LocalCloudConfig
) -> np.ndarray:
    """What brings the scan nearer to the height of what was seen before it, (3,) [m]: a part of the offset."""
    assert config.height_time is not None
    keys, new = place_scan(scan.p_SP, fraction, sweep, p_OH, config)
    before = scan.end_time - config.height_time
    offset = height_offset(points.keys, points.p_O[:, 2], points.time, keys, new[:, 2], before=before)
    period = max(scan.end_time - scan.start_time, config.period)
    return np.array([0.0, 0.0, 0.0 if offset is None else -offset * (1 - math.exp(-period / config.height_time))])


def _lifted(X_OB: np.ndarray, lift: float) -> np.ndarray:
    X = X_OB.copy()
    X[2, 3] += lift
    return X


def poses_at(notes: tuple[_Note, ...], time: float) -> tuple[np.ndarray, np.ndarray]:
    """X_OB and X_BS (4, 4) at `time` [s], at constant twist between notes, held before the first and after the last."""
    times = [note.time for note in notes]
    after = int(np.searchsorted(times, time))
    if after == 0 or after == len(notes):
        note = notes[min(after, len(notes) - 1)]
        return note.X_OB, note.X_BS
    first, last = notes[after - 1], notes[after]
    share = np.array([(time - first.time) / (last.time - first.time)])
    return _between(first.X_OB, last.X_OB, share), _between(first.X_BS, last.X_BS, share)


def _between(X_A: np.ndarray, X_B: np.ndarray, share: np.ndarray) -> np.ndarray:
    R, p = interpolate_pose(np.linalg.solve(X_A, X_B), share)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R[0], p[0]
    return X_A @ X


def _way(X_OA: np.ndarray, X_OB: np.ndarray) -> float:
    """Way between two poses [m], with what a turn counts."""
    cosine = 0.5 * (np.trace(X_OA[:3, :3].T @ X_OB[:3, :3]) - 1)
    angle = math.acos(min(max(cosine, -1.0), 1.0))
    return float(np.linalg.norm(X_OB[:3, 3] - X_OA[:3, 3])) + WAY_OF_TURN * angle


def _cloud(p_H: np.ndarray) -> PointCloud:
    return PointCloud(o3d.core.Tensor.from_numpy(np.ascontiguousarray(p_H, np.float32)))
