"""How a tracked robot turns: quasi-static skid steering with Coulomb friction.

A track that turns must drag its ends sideways over the ground. Below, the ground has isotropic Coulomb friction, the
motion is slow (no inertia) and every contact slips. Friction then acts against the slip velocity with a size that
does not depend on speed, so neither the coefficient nor the weight enters the motion.

**Uniform load.** A track of length L at lateral distance B/2 runs with v_t while the robot turns on the spot with ω.
At a distance x along it the ground slips past the belt with (v_t − ω B/2, −ω x) = ω (a, −x), a = v_t/ω − B/2.
With the friction per length q, the belt's forward force is q a/√(a² + x²) and its lateral one q x/√(a² + x²) against
the turn; their moments about the middle of the robot balance when

    ∫ ((B/2) a − x²) / √(a² + x²) dx = 0,   x from −L/2 to L/2.

Both integrals are elementary, with h = L/2: ∫ dx/√ = 2 asinh(h/a), ∫ x² dx/√ = h √(h² + a²) − a² asinh(h/a), so

    a (B + a) asinh(h/a) = h √(h² + a²).

a is the distance from a track to its instantaneous centre of rotation on the ground (the ICR of Martínez et al.,
"Approximating kinematics for tracked mobile robots", IJRR 2005). When the robot also moves forward, the two belts'
longitudinal forces cancel exactly when their slips are +aω and −aω with the same a: hence
v_right − v_left = ω (B + 2a) for every turn, and B + 2a is the **effective gauge**.

**Given contact points.** The dissipated power Σ N_i |s_i| (loads N_i, slip velocities s_i) is convex in the planar
twist, and its gradient is the sum of friction forces and moments: the quasi-static twist is its minimum.
"""

import math

import numpy as np
from scipy.optimize import brentq

from ..errors import InputError


def slip_offset(length: float, gauge: float) -> float:
    """Distance a [m] from a track's middle line out to its instantaneous centre of rotation on the ground.

    Args:
        length: length L of track on the ground [m]. gauge: distance B of the two tracks' middle lines [m].

    Raises:
        InputError: a length is not positive.
    """
    for key, value in (("length", length), ("gauge", gauge)):
        if not value > 0 or not math.isfinite(value):
            raise InputError("must be positive", where="slip_offset", key=key, value=value, valid="> 0 m")
    beta = 2 * gauge / length

    def imbalance(u: float) -> float:  # u = a/h, the equation divided by h²
        return u * (beta + u) * math.asinh(1 / u) - math.hypot(1, u)

    # Positive for large u, where it tends to beta − 2/(3u), and negative for u → 0.
    return 0.5 * length * float(brentq(imbalance, 1e-9, 1 / beta + 1e3, xtol=1e-13))


def effective_gauge(length: float, gauge: float) -> float:
    """Gauge [m] with which `twist_to_track_speeds` gives the twist that tracks of uniform load really drive: B + 2a."""
    return gauge + 2 * slip_offset(length, gauge)


def turn_rate(track_speed: float, length: float, gauge: float) -> float:
    """Yaw rate [rad/s] of turning on the spot with the right track at `track_speed` [m/s] and the left at its negative.

    Both tracks have length `length` [m], distance `gauge` [m] and uniform load.
    """
    return track_speed / (slip_offset(length, gauge) + gauge / 2)


def quasi_static_twist(points: np.ndarray, loads: np.ndarray, surface_speeds: np.ndarray) -> np.ndarray:
    """Planar twist of a body that stands on driven contact points with Coulomb friction.

    Args:
        points: (N, 2) contact points x (forward), y (left) in the body frame [m].
        loads: (N,) normal force on each [N]; only their ratios matter.
        surface_speeds: (N,) speed of the belt at each point, positive drives the body forward [m/s].

    Returns:
        (v_x, v_y, ω): velocity of the body's origin [m/s] and yaw rate [rad/s], in the body frame.

    Raises:
        InputError: shapes do not match, or fewer than two points carry load.
    """
    points, loads, speeds = (np.asarray(a, dtype=float) for a in (points, loads, surface_speeds))
    if points.ndim != 2 or points.shape[1] != 2 or loads.shape != (len(points),) or speeds.shape != loads.shape:
        shapes = f"{points.shape}, {loads.shape}, {speeds.shape}"
        raise InputError("wrong shapes", where="quasi_static_twist", value=shapes, valid="(N, 2), (N,), (N,)")
    if np.count_nonzero(loads > 0) < 2:
        raise InputError("needs two loaded contact points", where="quasi_static_twist", key="loads")
    # The slip of point i is J_i twist − d_i. Iteratively reweighted least squares on the sum of lengths (Weiszfeld).
    x, y = points.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    J = np.stack([np.stack([one, zero, -y], 1), np.stack([zero, one, x], 1)], 1)
    d = np.stack([speeds, zero], 1)
    sticking = 1e-12 * (1.0 + np.abs(speeds).max())
    twist = np.zeros(3)
    weights = loads / loads.sum()
    for _ in range(20_000):
        normal_matrix = np.einsum("n,nki,nkj->ij", weights, J, J)
        step = np.linalg.solve(normal_matrix, np.einsum("n,nki,nk->i", weights, J, d)) - twist
        twist = twist + step
        if np.abs(step).max() < 1e-3 * sticking:
            break
        weights = loads / np.maximum(np.linalg.norm(J @ twist - d, axis=1), sticking)
    return twist
