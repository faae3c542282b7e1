"""Points around a robot from many scans: the newest of each voxel, forgotten with time and way."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from ..config import quantity

# A voxel's three indices are packed in 63 bits, that of the height last.
KEY_BITS = 21
_HALF = 1 << (KEY_BITS - 1)
# Directions are compared in bins on the faces of a cube, so many along an edge: 0.6° in the middle, 4 cm at 4 m.
_EDGE = 180
# [m], [-] What is seen this far behind a point, and this share of its distance more, was seen through it: near the
# horizon the ground within one bin is that long.
_BEHIND, _BEHIND_SHARE = 0.2, 0.1
# [m] A turn of one radian spoils odometry about as much as this much way.
WAY_OF_TURN = 0.5

# Rotations (K, 3, 3) and positions (K, 3) [m] of the sensor in O, at K instants from the start to the end of a scan.
Sweep = tuple[np.ndarray, np.ndarray]


@dataclass(kw_only=True)
class LocalCloudConfig:
    """What is kept of the scans, and how long. The defaults give about 30 000 points in a room."""

    # [s] Interval at which a new scan is looked for; that of the LiDAR or shorter.
    period: float = quantity(0.025, unit="s", above=0)
    # [m] Points are kept within this distance of the robot, seen from above.
    radius: float = quantity(4.0, unit="m", above=0)
    # [m] Height window over the ground below the robot.
    min_height: float = quantity(-1.0, unit="m")
    max_height: float = quantity(1.5, unit="m")
    # [m] One point a voxel, the newest.
    voxel: float = quantity(0.04, unit="m", above=0)
    # [s] Points are forgotten when they are older than this. A LiDAR that cannot see the ground near the robot, such
    # as a VLP-16, needs them for as long as the robot may stand and turn.
    memory: float = quantity(60.0, unit="s", above=0)
    # [m] Points are forgotten after the robot has come this far since: odometry has drifted by then. A turn counts
    # 0.5 m a radian.
    memory_way: float = quantity(12.0, unit="m", above=0)
    # [scans] A point is removed when so many scans have seen through it since it was last measured; 0 never does.
    clear_after: int = quantity(3, unit="scans", low=0, high=255)
    # [m] Points of a scan that are nearer to the sensor are the robot itself.
    min_range: float = quantity(0.1, unit="m", low=0)
    # [m] Shots whose range differs by more from all beside them in their ring came back from dust, and are left out;
    # null keeps them, as where the air is clear.
    dust_gap: float | None = quantity(None, unit="m", above=0)
    # [rad/s] A scan during which roll and pitch change faster than this is left out: poses that are a few hundredths of
    # a second late put its points centimetres too high or too low, and the ground seems to have steps.
    max_swing_rate: float = quantity(0.4, unit="rad/s", above=0)
    # [s] Time constant with which the height of the robot follows the ground that was seen before, so that the drift of
    # odometry makes no steps between old points and new ones; null leaves the height to `X_OB`.
    height_time: float | None = quantity(0.5, unit="s", above=0)
    # [m] Around the robot, when its first scan arrives, the ground is taken for level up to this distance: a LiDAR that
    # looks over it would never show where the robot stands. 0 takes nothing for granted.
    level_radius: float = quantity(0.0, unit="m", low=0)
    # [m] Height of the base's origin over the ground that the robot stands on, square to it.
    base_height: float = quantity(0.08, unit="m", low=0)


@dataclass(frozen=True, eq=False)
class LocalPoints:
    """Points in the odometry frame O, sorted by voxel. Read-only.

    Attributes:
        keys: (N,) int64, of the voxels.
        p_O: (N, 3) float32 [m].
        time, way: (N,) float64, when it was measured [s] and the way that the robot had come by then [m].
        seen_through: (N,) uint8, number of scans since that saw what is behind it.
    """

    keys: np.ndarray
    p_O: np.ndarray
    time: np.ndarray
    way: np.ndarray
    seen_through: np.ndarray

    def __deepcopy__(self, memo: dict) -> "LocalPoints":
        return self


def no_points() -> LocalPoints:
    """Nothing, as before the first scan."""
    return LocalPoints(
        np.zeros(0, np.int64), np.zeros((0, 3), np.float32), np.zeros(0), np.zeros(0), np.zeros(0, np.uint8)
    )


def level_ground(radius: float, spacing: float) -> np.ndarray:
    """Points (N, 3) [m] of a level disc around the origin."""
    line = np.arange(-radius, radius + spacing, spacing)
    x, y = (part.ravel() for part in np.meshgrid(line, line))
    inside = np.hypot(x, y) <= radius
    return np.column_stack([x, y, np.zeros(len(x))])[inside]


def heading_frame(X_OB: np.ndarray, base_height: float) -> np.ndarray:
    """Pose X_OH (4, 4) of the heading frame: on the ground below the base, z up, x ahead as seen from above.

    The ground is taken to be the plane that the robot stands on, `base_height` [m] from the base's origin along its
    z axis; straight below the origin it is base_height / cos(tilt) deep, at most twice that height.

    Args:
        X_OB: pose of the base, (4, 4), O with z up.
    """
    heading = math.atan2(X_OB[1, 0], X_OB[0, 0])
    c, s = math.cos(heading), math.sin(heading)
    X_OH = np.array([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    X_OH[:3, 3] = X_OB[:3, 3]
    X_OH[2, 3] -= base_height / max(X_OB[2, 2], 0.5)
    return X_OH


def place_scan(
    p_SP: np.ndarray, fraction: np.ndarray, sweep: Sweep, p_OH: np.ndarray, config: LocalCloudConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Keys (M,) of voxels and the points (M, 3) float32 of one scan in them; see `add_scan`."""
    return _placed(p_SP, fraction, sweep, p_OH, config, np.zeros(0, np.float32))


def _placed(
    p_SP: np.ndarray,
    fraction: np.ndarray,
    sweep: Sweep,
    p_OH: np.ndarray,
    config: LocalCloudConfig,
    nearest: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    p_SP = np.ascontiguousarray(p_SP, np.float32).reshape(-1, 3)
    R, p = (np.ascontiguousarray(part, float) for part in sweep)
    fraction = np.ascontiguousarray(fraction, np.float32)
    return _place(p_SP, fraction, R, p, _window(p_OH, config), config.voxel, config.min_range, nearest)


def _window(p_OH: np.ndarray, config: LocalCloudConfig) -> np.ndarray:
    return np.array([*p_OH, config.radius, p_OH[2] + config.min_height, p_OH[2] + config.max_height])


def add_scan(
    points: LocalPoints,
    p_SP: np.ndarray,
    fraction: np.ndarray,
    sweep: Sweep,
    p_OH: np.ndarray,
    time: float,
    way: float,
    config: LocalCloudConfig,
) -> LocalPoints:
    """Takes in one scan, and forgets what is too old, too far behind, out of the window, or was seen through.

    Args:
        p_SP: points, each in the sensor frame at its own instant, (N, 3) [m]; what is not finite is left out.
        fraction: instant of every point, (N,), 0 at the start of the scan and 1 at its end.
        sweep: of the sensor, from the start of the scan to its end.
        p_OH: place of the robot on the ground, (3,) [m]: the window is around it.
        time, way: of the scan [s], [m].
    """
    clear = config.clear_after > 0 and len(points.keys) > 0
    nearest = np.full(6 * _EDGE**2 if clear else 0, np.inf, np.float32)
    keys, new = _placed(p_SP, fraction, sweep, p_OH, config, nearest)
    seen_through = points.seen_through
    if clear:
        seen_through = _see_through(points.p_O, seen_through, np.ascontiguousarray(sweep[1][-1], float), nearest)
    order = np.argsort(keys, kind="stable")
    limits = np.array([time, way, time - config.memory, way - config.memory_way, config.clear_after or 256])
    merged = _merge(
        points.keys, points.p_O, points.time, points.way, seen_through, keys, new, order, _window(p_OH, config), limits
    )
    return LocalPoints(*merged)


def in_frame(p_O: np.ndarray, X_OH: np.ndarray) -> np.ndarray:
    """Points (N, 3) float32 of O in the frame H, float32."""
    # The origin is taken off first: float32 is then good to micrometres around H, wherever in O that is.
    moved = p_O - X_OH[:3, 3].astype(np.float32)
    return moved @ X_OH[:3, :3].astype(np.float32)


@njit(cache=True)
def _place(
    p_S: np.ndarray,
    fraction: np.ndarray,
    R: np.ndarray,
    p: np.ndarray,
    window: np.ndarray,
    voxel: float,
    min_range: float,
    nearest: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Voxels and points in O of what is in the window; of successive points in one voxel the last.

    Fills `nearest`, where it has room: distance from the last place of the sensor by direction in O.
    """
    keys = np.empty(len(p_S), np.int64)
    points = np.empty((len(p_S), 3), np.float32)
    end = p[-1]
    count = 0
    for n in range(len(p_S)):
        x, y, z = float(p_S[n, 0]), float(p_S[n, 1]), float(p_S[n, 2])
        square = x * x + y * y + z * z
        # Written so that NaN is out.
        if not (square >= min_range * min_range and square < 1e12):
            continue
        s = int(min(max(fraction[n], 0.0), 1.0) * (len(R) - 1) + 0.5)
        a = R[s, 0, 0] * x + R[s, 0, 1] * y + R[s, 0, 2] * z + p[s, 0]
        b = R[s, 1, 0] * x + R[s, 1, 1] * y + R[s, 1, 2] * z + p[s, 1]
        c = R[s, 2, 0] * x + R[s, 2, 1] * y + R[s, 2, 2] * z + p[s, 2]
        if len(nearest):
            where = _bin(a - end[0], b - end[1], c - end[2])
            nearest[where] = min(nearest[where], math.sqrt(square))
        if _inside(a, b, c, window):
            i, j, k = math.floor(a / voxel) + _HALF, math.floor(b / voxel) + _HALF, math.floor(c / voxel) + _HALF
            key = (i << 2 * KEY_BITS) | (j << KEY_BITS) | k
            if count == 0 or keys[count - 1] != key:
                count += 1
            keys[count - 1] = key
            points[count - 1, 0], points[count - 1, 1], points[count - 1, 2] = a, b, c
    return keys[:count], points[:count]


@njit(cache=True)
def _inside(x: float, y: float, z: float, window: np.ndarray) -> bool:
    dx, dy = x - window[0], y - window[1]
    return dx * dx + dy * dy <= window[3] * window[3] and z >= window[4] and z <= window[5]


@njit(cache=True)
def _bin(x: float, y: float, z: float) -> int:
    """Bin of a direction: the face of the cube that it goes through, and where."""
    u, v, w, face = x, y, z, 4
    if abs(x) >= abs(y) and abs(x) >= abs(z):
        u, v, w, face = y, z, x, 0
    elif abs(y) >= abs(z):
        u, v, w, face = x, z, y, 2
    if w < 0:
        w, face = -w, face + 1
    half = 0.5 * _EDGE / max(w, 1e-12)
    i, j = min(int(u * half + 0.5 * _EDGE), _EDGE - 1), min(int(v * half + 0.5 * _EDGE), _EDGE - 1)
    return (face * _EDGE + i) * _EDGE + j


@njit(cache=True)
def _see_through(p_O: np.ndarray, seen_through: np.ndarray, p: np.ndarray, nearest: np.ndarray) -> np.ndarray:
    """`seen_through` with 1 added where the nearest that the scan sees in the direction of a point is behind it."""
    result = seen_through.copy()
    for n in range(len(p_O)):
        x, y, z = p_O[n, 0] - p[0], p_O[n, 1] - p[1], p_O[n, 2] - p[2]
        seen = nearest[_bin(x, y, z)]
        if seen < np.inf and result[n] < 255:
            distance = math.sqrt(x * x + y * y + z * z)
            if seen > distance * (1 + _BEHIND_SHARE) + _BEHIND:
                result[n] += 1
    return result


@njit(cache=True)
def _merge(
    keys: np.ndarray,
    points: np.ndarray,
    time: np.ndarray,
    way: np.ndarray,
    seen_through: np.ndarray,
    new_keys: np.ndarray,
    new: np.ndarray,
    order: np.ndarray,
    window: np.ndarray,
    limits: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """One sorted list of two; of equal keys the last of the new ones stays. limits: now, way, and the oldest kept."""
    size = len(keys) + len(new_keys)
    out_keys, out = np.empty(size, np.int64), np.empty((size, 3), np.float32)
    out_time, out_way, out_seen = np.empty(size), np.empty(size), np.empty(size, np.uint8)
    i = j = count = 0
    while i < len(keys) or j < len(order):
        if j < len(order) and (i == len(keys) or new_keys[order[j]] <= keys[i]):
            key = new_keys[order[j]]
            while j + 1 < len(order) and new_keys[order[j + 1]] == key:
                j += 1
            while i < len(keys) and keys[i] == key:
                i += 1
            out_keys[count], out_time[count], out_way[count], out_seen[count] = key, limits[0], limits[1], 0
            for axis in range(3):
                out[count, axis] = new[order[j], axis]
            j, count = j + 1, count + 1
            continue
        if (
            time[i] >= limits[2]
            and way[i] >= limits[3]
            and seen_through[i] < limits[4]
            and _inside(points[i, 0], points[i, 1], points[i, 2], window)
        ):
            out_keys[count], out_time[count], out_way[count] = keys[i], time[i], way[i]
            out_seen[count] = seen_through[i]
            for axis in range(3):
                out[count, axis] = points[i, axis]
            count += 1
        i += 1
    return out_keys[:count], out[:count], out_time[:count], out_way[:count], out_seen[:count]
