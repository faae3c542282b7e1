"""Plays recorded scans back at the rate of a LiDAR."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from ..errors import ConfigError, ScanFileError
from ..ports import weak_method
from .scan import Scan
from .scan_files import read_scan

# Names under which recorders keep the time of a point: Naraha, Velodyne, ROS drivers, Ouster.
TIME_ATTRIBUTES = ("time", "t", "timestamp", "time_stamp", "col_t")
# A mechanical LiDAR turns at 5 Hz or faster, accumulated scans take up to about half a second; longer spans mean
# that the column is not a time in seconds (floats) or nanoseconds (integers).
MAX_SPAN = 1.0  # [s]


@dataclass(frozen=True)
class _Replay:
    """Abstract state; read-only, so that Drake may share it instead of copying it at every update."""

    next_index: int
    scan: Scan
    skipped: tuple[str, ...]

    def __deepcopy__(self, memo: dict) -> "_Replay":
        return self


class ScanReplay(LeafSystem):
    """
    .. pydrake_system::

        name: ScanReplay
        output_ports:
        - scan_S
        - scans_skipped
        - skipped

    Reads the next of `paths` at 0, `period`, 2 `period`, ... and holds it at `scan_S` (`Scan`, sensor frame S).
    `Scan.index` is the place in `paths`; before the first update it is -1 and the cloud is empty. After the last
    scan that one stays.

    A scan ends when it is published: `end_time` is the replay time, or `times[i]` [s] if recorded times are given. A
    file with a time for each point (`time`, `t`, `timestamp`, `time_stamp` or `col_t`; floats in seconds, integers in
    nanoseconds, any origin) gets `start_time` earlier by their span and an attribute `time` [s] since then, so that it
    can be de-skewed; any other scan is taken as de-skewed, `start_time == end_time`.

    A file that cannot be read is skipped and the scan before it stays at the port: `scans_skipped` (1) counts these,
    `skipped` (tuple of str) says which and why.

    Raises:
        ConfigError: no paths, a period that is not positive, or `times` that do not fit.
    """

    def __init__(
        self,
        paths: Sequence[str | os.PathLike[str]],
        times: Sequence[float] | np.ndarray | None = None,
        period: float = 0.1,
    ):
        super().__init__()
        self._paths = [Path(path) for path in paths]
        self._times = None if times is None else np.asarray(times, dtype=float)
        self._period = period
        if not self._paths:
            raise ConfigError("nothing to replay", where="ScanReplay", key="paths")
        if not (np.isfinite(period) and period > 0):
            raise ConfigError("out of range", where="ScanReplay", key="period", value=period, valid="> 0 s")
        if self._times is not None and self._times.shape != (len(self._paths),):
            raise ConfigError(
                "must be one a scan", where="ScanReplay", key="times", value=len(self._times), valid=len(self._paths)
            )
        nothing = Scan(PointCloud(o3d.core.Tensor(np.zeros((0, 3), np.float32))), 0.0, 0.0, -1)
        state = self.DeclareAbstractState(AbstractValue.Make(_Replay(0, nothing, ())))
        ticket = self.abstract_state_ticket(state)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._ReadNext)
        self.DeclareAbstractOutputPort(
            "scan_S",
            lambda: AbstractValue.Make(nothing),
            weak_method(self._CalcScan),
            prerequisites_of_calc={ticket},
        )
        self.DeclareVectorOutputPort("scans_skipped", 1, self._CalcCount, prerequisites_of_calc={ticket})
        self.DeclareAbstractOutputPort(
            "skipped", lambda: AbstractValue.Make(()), weak_method(self._CalcSkipped), prerequisites_of_calc={ticket}
        )

    @property
    def duration(self) -> float:
        """Time at which the last scan has been at the port for one period [s]."""
        return len(self._paths) * self._period

    def _ReadNext(self, context: Context, state: State) -> EventStatus:
        replay = self._replay(context)
        index = replay.next_index
        if index >= len(self._paths):
            return EventStatus.DidNothing()
        end_time = context.get_time() if self._times is None else float(self._times[index])
        path = self._paths[index]
        try:
            scan = timed_scan(read_scan(path), end_time, index, path)
            replay = replace(replay, next_index=index + 1, scan=scan)
        except ScanFileError as error:
            replay = replace(replay, next_index=index + 1, skipped=(*replay.skipped, str(error)))
        state.get_mutable_abstract_state(0).set_value(replay)
        return EventStatus.Succeeded()

    @staticmethod
    def _replay(context: Context) -> _Replay:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _CalcScan(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._replay(context).scan)

    def _CalcCount(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, len(self._replay(context).skipped))

    def _CalcSkipped(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._replay(context).skipped)


def timed_scan(cloud: PointCloud, end_time: float, index: int, where: object = "") -> Scan:
    """Makes a `Scan` that ends at `end_time` [s] from a recorded cloud, see `ScanReplay` for the times of its points.

    Raises:
        ScanFileError: the column of times spans more than a scan can take.
    """
    name = next((name for name in TIME_ATTRIBUTES if name in cloud.point), None)
    if name is None:
        return Scan(cloud, end_time, end_time, index)
    raw = cloud.point[name].numpy()[:, 0]
    offsets = (raw - raw.min()).astype(float) * (1e-9 if raw.dtype.kind in "iu" else 1.0)
    span = float(offsets.max())
    if not span <= MAX_SPAN:
        raise ScanFileError(
            "times of the points span too long",
            where=where,
            key=name,
            value=span,
            valid=f"<= {MAX_SPAN:g} s, floats in seconds or integers in nanoseconds",
        )
    timed = cloud.clone()
    if name != "time":
        del timed.point[name]
    timed.point["time"] = o3d.core.Tensor(offsets.astype(np.float32)[:, None])
    return Scan(timed, end_time - span, end_time, index)
