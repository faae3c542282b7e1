"""A scan of a 2D laser as it travels between systems, and where simulated ones come from."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem

from ..errors import ConfigError, InputError
from ..ports import eval_typed, weak_method
from ..sensing import Scan, ScanPattern


class LaserScanError(InputError):
    """A 2D laser scan is not usable."""


@dataclass(frozen=True, eq=False)
class LaserScan:
    """One scan of a 2D laser, in the sensor frame S: x forward, y left, the scan in the plane z = 0. Read-only.

    Attributes:
        ranges: (n,) [m]; infinite where nothing came back.
        angles: (n,) [rad], about z from x.
        range_max: farthest distance that is reported [m].
        time: end of the scan [s]; a pose that is estimated from it is that of S at this moment.
        ages: (n,) [s], how long before `time` every beam was fired; zero when not given, as for a scan that was taken
            at one instant.
        index: number of the scan since the start, -1 before the first.

    Raises:
        LaserScanError: lengths differ, a number is not one, a range is negative, or an age is.
    """

    ranges: np.ndarray
    angles: np.ndarray
    range_max: float
    time: float
    ages: np.ndarray = field(default_factory=lambda: np.zeros(0))
    index: int = 0

    def __post_init__(self) -> None:
        ranges = np.array(self.ranges, np.float64).reshape(-1)
        angles = np.array(self.angles, np.float64).reshape(-1)
        ages = np.array(self.ages, np.float64).reshape(-1)
        ages = ages if len(ages) else np.zeros(len(ranges))
        if not len(ranges) == len(angles) == len(ages):
            found = (len(ranges), len(angles), len(ages))
            raise LaserScanError("lengths differ", where="laser scan", value=found, valid="one angle, one age a range")
        if not (np.isfinite(angles).all() and np.isfinite(ages).all() and (ages >= 0).all()):
            raise LaserScanError("angles and ages", where="laser scan", valid="finite, ages not negative")
        if not (ranges >= 0).all():  # NaN compares false
            raise LaserScanError("ranges", where="laser scan", valid=">= 0 m, infinite where nothing came back")
        if not (np.isfinite(self.range_max) and self.range_max > 0 and np.isfinite(self.time)):
            value, valid = (self.range_max, self.time), "range_max > 0 m, finite time"
            raise LaserScanError("range_max and time", where="laser scan", value=value, valid=valid)
        ranges[ranges >= self.range_max] = np.inf
        for name, array in (("ranges", ranges), ("angles", angles), ("ages", ages)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __deepcopy__(self, memo: dict) -> "LaserScan":
        return self

    @property
    def returned(self) -> np.ndarray:
        """Which beams came back, (n,) bool."""
        return np.isfinite(self.ranges)

    @property
    def p_SP(self) -> np.ndarray:
        """What the returned beams met, each in S at its own instant, (m, 2) [m]."""
        kept = self.returned
        r, a = self.ranges[kept], self.angles[kept]
        return np.stack([r * np.cos(a), r * np.sin(a)], axis=1)


def no_scan(range_max: float = 1.0) -> LaserScan:
    """What is on a port before the first scan: no beam, index -1."""
    return LaserScan(np.zeros(0), np.zeros(0), range_max, 0.0, index=-1)


def ring_to_laser_scan(scan: Scan, pattern: ScanPattern, ring: int = 0) -> LaserScan:
    """One ring of a LiDAR's scan as a 2D laser scan, with a beam for every column, also those that did not return.

    A ring that is not level gives the distance along the floor. What is seen is not moved: every beam has its `ages`.

    Raises:
        LaserScanError: the scan has no attribute `column`, or columns that the pattern has not.
    """
    column = scan.attribute("column")
    rings = scan.attribute("ring")
    if column is None or (rings is None and pattern.rings > 1):
        raise LaserScanError("needs the attributes of a simulated scan", where="scan_S", valid="`column` and `ring`")
    kept = np.ones(len(column), bool) if rings is None else rings == ring
    column = column[kept].astype(np.int64)
    if len(column) and column.max() >= pattern.columns:
        valid = f"columns 0 to {pattern.columns - 1}"
        raise LaserScanError("does not fit the pattern", where="scan_S", value=int(column.max()), valid=valid)
    ranges = np.full(pattern.columns, np.inf)
    ranges[column] = np.linalg.norm(scan.p_SP[kept, :2].astype(np.float64), axis=1)
    duration = scan.end_time - scan.start_time
    ages = duration - pattern.times * (duration / pattern.period)
    return LaserScan(ranges, pattern.azimuths, pattern.max_range, scan.end_time, np.maximum(ages, 0.0), scan.index)


class LaserRing(LeafSystem):
    """
    .. pydrake_system::

        name: LaserRing
        input_ports:
        - scan_S
        output_ports:
        - laser_scan

    Takes one ring of a simulated LiDAR as the scan of a 2D laser.

    - `scan_S` (`Scan`): with the attributes `column` and `ring` of a simulated LiDAR.
    - `laser_scan` (`LaserScan`): a beam for every column, infinite where nothing came back; before the first scan one
      without beams, with index -1.

    Args:
        pattern: of the LiDAR, as `Lidar.pattern`.
        ring: which of its rings.

    Raises:
        ConfigError: the pattern has no such ring.
        PortError: `scan_S` is not connected or carries something else.
    """

    def __init__(self, pattern: ScanPattern, *, ring: int = 0):
        super().__init__()
        if not 0 <= ring < pattern.rings:
            raise ConfigError(
                "no such ring", where="LaserRing", key="ring", value=ring, valid=f"0 to {pattern.rings - 1}"
            )
        self._pattern, self._ring = pattern, ring
        scan_port = self.DeclareAbstractInputPort("scan_S", AbstractValue.Make(object()))
        self.DeclareAbstractOutputPort(
            "laser_scan", lambda: AbstractValue.Make(no_scan()), weak_method(self._CalcLaserScan), {scan_port.ticket()}
        )

    def _CalcLaserScan(self, context: Context, output: AbstractValue) -> None:
        scan = eval_typed(self, context, "scan_S", Scan)
        empty = scan.index < 0
        made = no_scan(self._pattern.max_range) if empty else ring_to_laser_scan(scan, self._pattern, self._ring)
        output.set_value(made)
