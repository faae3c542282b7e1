"""How far a round robot can go before it touches what its laser sees."""

import numpy as np


def free_ways(points: np.ndarray, directions: np.ndarray, radius: float, reach: float) -> np.ndarray:
    """Way that a disc can make from the origin in straight lines before it touches a point, (D,) [m], at most `reach`.

    A point that the disc covers already stops every line that comes nearer to it, and none that leads away.

    Args:
        points: (N, 2) [m]. directions: (D,) [rad]. radius: of the disc [m].
    """
    cosine, sine = np.cos(directions)[:, None], np.sin(directions)[:, None]
    x, y = points[:, 0], points[:, 1]
    along, across = cosine * x + sine * y, cosine * y - sine * x
    meets = (np.abs(across) < radius) & (along > 0)
    ways = np.where(meets, along - np.sqrt(np.maximum(radius**2 - across**2, 0.0)), np.inf)
    shortest: np.ndarray = np.clip(ways.min(axis=1, initial=np.inf), 0.0, reach)
    return shortest


def free_arc(points: np.ndarray, v: float, omega: float, radius: float) -> float:
    """Length of the arc that the origin of a disc makes with the twist (v ≥ 0, ω) before it touches a point [m].

    A point that the disc covers already stops it unless the motion leads away. Infinite where a whole turn is free.

    Args:
        points: (N, 2) in the frame of the disc, x forward [m]. v, omega: [m/s], [rad/s]. radius: of the disc [m].
    """
    if v <= 0 or not len(points):
        return np.inf
    if abs(omega) < 1e-6 * v:
        return float(free_ways(points, np.zeros(1), radius, np.inf)[0])
    turn = v / omega  # signed radius of the arc, its centre is at (0, turn)
    x, y = points[:, 0], np.sign(turn) * points[:, 1]
    turn = abs(turn)
    distance = np.hypot(x, y - turn)
    touched = np.hypot(points[:, 0], points[:, 1]) < radius
    meets = (np.abs(distance - turn) < radius) & (distance > 0)
    # Angle about the centre from the origin on, in the sense of the motion, where the middle of the disc is when the
    # point comes to lie on its rim.
    with np.errstate(invalid="ignore", divide="ignore"):
        half = np.arccos(np.clip((turn**2 + distance**2 - radius**2) / (2 * turn * distance), -1, 1))
    angle = np.mod(np.arctan2(x, turn - y) - half, 2 * np.pi)
    ways = np.where(meets & ~touched, angle * turn, np.inf)
    ways[touched & (x > 0)] = 0.0
    return float(ways.min())


def braked(v: float, omega: float, points: np.ndarray, radius: float, deceleration: float, delay: float) -> float:
    """The largest share of v, in steps of a tenth, from which the robot can stop on the arc before it touches [m/s].

    The yaw rate stays, so that a robot that is held up can turn away.

    Args:
        deceleration: [m/s²]. delay: during which it goes on at full speed [s].
    """
    for share in np.linspace(1.0, 0.1, 10):
        speed = share * v
        if speed * delay + speed**2 / (2 * deceleration) <= free_arc(points, speed, omega, radius):
            return float(speed)
    return 0.0
