"""Which way the beams of a spinning LiDAR point, and when."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..errors import ConfigError


@dataclass(frozen=True, eq=False, kw_only=True)
class ScanPattern:
    """Beams of one revolution: R rings × C columns, N = R·C rays in ring-major order (ray = ring·C + column).

    Sensor frame S: x forward, z up along the axis of rotation. The beam of a ring at elevation e and height h, fired
    at azimuth a, starts at (0, 0, h) and runs along (cos e cos a, cos e sin a, sin e). All rings of a column fire at
    one instant.

    Attributes:
        elevations: (R,) [rad], from the lowest ring up.
        azimuths: (C,) [rad], about z, in the order of firing.
        times: (C,) [s], when each column fires, since the start of the revolution; rising and below `period`.
        heights: (R,) [m], where each ring's beam starts on the axis; zero when not given.
        period: [s] of a revolution.
        min_range, max_range: [m], what the sensor reports.
        range_noise: standard deviation of a distance [m].
        detection_range: [m], at which half of the shots at a white wall, square on, come back.

    Raises:
        ConfigError: the arrays do not fit each other, or a number is out of range.
    """

    elevations: np.ndarray
    azimuths: np.ndarray
    times: np.ndarray
    heights: np.ndarray = field(default_factory=lambda: np.zeros(0))
    period: float
    min_range: float
    max_range: float
    range_noise: float
    detection_range: float

    def __post_init__(self) -> None:
        if not len(self.heights):
            object.__setattr__(self, "heights", np.zeros(len(self.elevations)))
        if not 1 <= len(self.elevations) <= 256:
            raise ConfigError("number of rings", where="scan pattern", value=len(self.elevations), valid="1 to 256")
        if not 1 <= len(self.azimuths) <= 65536:
            raise ConfigError("number of columns", where="scan pattern", value=len(self.azimuths), valid="1 to 65536")
        if np.shape(self.heights) != np.shape(self.elevations) or np.shape(self.times) != np.shape(self.azimuths):
            raise ConfigError("lengths differ", where="scan pattern", valid="one height a ring, one time a column")
        if self.times[0] < 0 or self.times[-1] >= self.period or np.any(np.diff(self.times) < 0):
            raise ConfigError(
                "times are not rising within the period", where="scan pattern", valid="0 <= time < period"
            )
        if not 0 <= self.min_range < self.max_range:
            valid = "0 <= min_range < max_range"
            raise ConfigError("range", where="scan pattern", value=(self.min_range, self.max_range), valid=valid)
        if self.range_noise < 0 or self.detection_range <= 0:
            valid = "range_noise >= 0, detection_range > 0"
            raise ConfigError(
                "model", where="scan pattern", value=(self.range_noise, self.detection_range), valid=valid
            )

    @property
    def rings(self) -> int:
        return len(self.elevations)

    @property
    def columns(self) -> int:
        return len(self.azimuths)

    @property
    def rays(self) -> int:
        return self.rings * self.columns

    @cached_property
    def ring(self) -> np.ndarray:
        """Ring of every ray, (N,) uint8."""
        return np.repeat(np.arange(self.rings, dtype=np.uint8), self.columns)

    @cached_property
    def column(self) -> np.ndarray:
        """Column of every ray, (N,) uint16."""
        return np.tile(np.arange(self.columns, dtype=np.uint16), self.rings)

    @cached_property
    def time(self) -> np.ndarray:
        """Instant of every ray since the start of the revolution, (N,) float32 [s]."""
        return np.tile(self.times.astype(np.float32), self.rings)

    @cached_property
    def p_SR(self) -> np.ndarray:
        """Where every ray starts, in S, (N, 3) float32 [m]."""
        return np.repeat(np.outer(self.heights, [0, 0, 1]), self.columns, axis=0).astype(np.float32)

    @cached_property
    def d_S(self) -> np.ndarray:
        """Unit direction of every ray, in S at its own instant, (N, 3) float32."""
        elevation, azimuth = np.meshgrid(self.elevations, self.azimuths, indexing="ij")
        level = np.cos(elevation)
        return (
            np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], -1)
            .reshape(-1, 3)
            .astype("f4")
        )


def vlp16() -> ScanPattern:
    """Velodyne VLP-16 at 10 Hz: 16 rings of ±15° in steps of 2°, 1800 columns, clockwise seen from above.

    A revolution is cut behind the sensor. Beams start off the centre by the vertical corrections of the manual
    (63-9243 Rev. D, table 9-1). Real heads fire the rings of a column within 37 µs (0.13° of the turn), here at once.
    Noise: 8 mm, as in the VLP-16 model of ToyotaResearchInstitute/velodyne_simulator. The detection range is assumed:
    half as far again as the 100 m of the data sheet.
    """
    columns = 1800
    heights = np.array([11.2, 9.7, 8.1, 6.6, 5.1, 3.7, 2.2, 0.7])
    return ScanPattern(
        elevations=np.radians(np.arange(-15, 16, 2)),
        azimuths=np.pi - 2 * np.pi * np.arange(columns) / columns,
        times=0.1 * np.arange(columns) / columns,
        heights=1e-3 * np.concatenate([heights, -heights[::-1]]),
        period=0.1,
        min_range=0.4,
        max_range=100.0,
        range_noise=0.008,
        detection_range=150.0,
    )


def utm30lx() -> ScanPattern:
    """Hokuyo UTM-30LX at 40 Hz: one level ring of 270° in steps of 0.25°, from right to left.

    The mirror turns a full 360° in a period, so the last beam is fired at three quarters of it. The data sheet
    guarantees 30 m and repeats within 10 mm up to 10 m; it detects up to 60 m.
    """
    columns = 1081
    return ScanPattern(
        elevations=np.zeros(1),
        azimuths=np.radians(np.linspace(-135, 135, columns)),
        times=0.025 * np.arange(columns) / 1440,
        period=0.025,
        min_range=0.1,
        max_range=30.0,
        range_noise=0.01,
        detection_range=60.0,
    )


def utm30lx_10hz() -> ScanPattern:
    """Every fourth scan of a `utm30lx`, as its protocol can be asked for: the beams are those of the period's last
    25 ms."""
    pattern = utm30lx()
    return replace(pattern, times=0.075 + pattern.times, period=0.1)
