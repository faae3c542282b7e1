"""Reader of CARMEN logs: laser scans and wheel odometry of real robots, such as those of the Radish collection."""

import bz2
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from .laser_scan import LaserScan
from .planar import between


class CarmenLogError(InputError):
    """A CARMEN log cannot be read, or a line of it is broken."""


@dataclass(frozen=True, eq=False)
class CarmenLog:
    """Scans of the front laser and where odometry was at each.

    Attributes:
        scans: in the order of the log. odometry: X_OB of each, (n, 3) [m, m, rad].
        X_BS: pose of the laser on the robot, (3,).
    """

    scans: tuple[LaserScan, ...]
    odometry: np.ndarray
    X_BS: np.ndarray


def read_carmen_log(path: Path | str, *, range_max: float = 80.0, most: int | None = None) -> CarmenLog:
    """Reads the FLASER lines of a log, packed with bzip2 when its name ends in .bz2.

    A line is FLASER, n, n ranges [m], pose of the laser by odometry, that of the robot (x, y, heading each), time
    stamp [s], host, time since the start of the log [s]. The beams go over 180° from the right: by 180° / n, or
    180° / (n - 1) when n is odd.

    Args:
        range_max: [m]; ranges from there on are no returns. A SICK LMS says 81.83 m.
        most: reads only so many scans.

    Raises:
        CarmenLogError: there is no such file, a line is broken, or there is no scan.
    """
    path = Path(path)
    if not path.is_file():
        raise CarmenLogError("no such file", where=path)
    scans: list[LaserScan] = []
    odometry: list[np.ndarray] = []
    X_BS = np.zeros(3)
    opener = bz2.open if path.suffix == ".bz2" else open
    try:
        with opener(path, "rt", errors="replace") as lines:
            for number, line in enumerate(lines, 1):
                if not line.startswith("FLASER "):
                    continue
                ranges, poses, time = _parse(line, path, number)
                n = len(ranges)
                angles = -0.5 * np.pi + np.pi * np.arange(n) / (n - n % 2)
                if not scans:
                    X_BS = between(poses[3:], poses[:3])
                scans.append(LaserScan(ranges, angles, range_max, time, index=len(scans)))
                odometry.append(poses[3:])
                if most is not None and len(scans) >= most:
                    break
    except (OSError, EOFError) as error:
        raise CarmenLogError(f"cannot be read: {error}", where=path) from None
    if not scans:
        raise CarmenLogError("holds no scan", where=path, valid="lines that start with FLASER")
    return CarmenLog(tuple(scans), np.array(odometry), X_BS)


def _parse(line: str, path: Path, number: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Ranges, the six numbers of the two poses, and the time since the start of the log."""
    words = line.split()
    try:
        n = int(words[1])
        numbers = np.array(words[2 : n + 8], float)
        time = float(words[n + 10])
        if n < 2 or len(numbers) != n + 6 or not np.isfinite(numbers).all() or (numbers[:n] < 0).any():
            raise ValueError
    except (ValueError, IndexError):
        valid = "FLASER n r1 … rn x y heading x y heading stamp host time"
        raise CarmenLogError("broken line", where=path, key=f"line {number}", valid=valid) from None
    return numbers[:n], numbers[n:], time
