"""Scenes in which geometry fails: a smooth corridor whose ends are never seen, and what its surfaces are.

The corridor is 80 m long, 3 m wide and 2.6 m high; reflective patches on the walls and puddles on the floor are flush
with them, so that no distance shows them. The sensor is a VLP-16 (16 rings from -15 to 15 deg, 1800 columns) with
range noise of 0.02 m that sees 12 m far. Two channels tell the classes: `intensity` is high on reflective patches,
`nir` is low on water. Wrong labels are points whose channel has the value of the other kind, either each point by
itself or, as happens in reality, whole spots of 0.3 m that differ from scan to scan.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw

LENGTH, WIDTH, HEIGHT = 80.0, 3.0, 2.6
RANGE_NOISE, MAX_RANGE, SENSOR_HEIGHT = 0.02, 12.0, 0.6
RINGS, COLUMNS = 16, 1800
# [m] Size of the spots that are labelled wrongly together.
SPOT = 0.3


@dataclass(frozen=True, eq=False)
class Corridor:
    """The corridor, along x, its middle at x = 0, its floor at z = 0.

    Attributes:
        scene: its surfaces.
        patches: reflective ones on the walls, (n, 5): x, side (±1), z of the lower edge, width, height [m].
        puddles: (n, 3): x, y, radius [m].
    """

    scene: o3d.t.geometry.RaycastingScene
    patches: np.ndarray
    puddles: np.ndarray

    def is_reflective(self, p_WP: np.ndarray) -> np.ndarray:
        """Which of the points (N, 3) on surfaces lie on a reflective patch, (N,) bool."""
        wall = np.abs(np.abs(p_WP[:, 1]) - WIDTH / 2) < 0.03
        x, y, z = p_WP.T
        inside = np.zeros(len(p_WP), bool)
        for middle, side, low, width, height in self.patches:
            inside |= (np.sign(y) == side) & (np.abs(x - middle) < width / 2) & (z > low) & (z < low + height)
        return wall & inside

    def is_water(self, p_WP: np.ndarray) -> np.ndarray:
        """Which of the points (N, 3) on surfaces lie on a puddle, (N,) bool."""
        inside = np.zeros(len(p_WP), bool)
        for x, y, radius in self.puddles:
            inside |= (p_WP[:, 0] - x) ** 2 + (p_WP[:, 1] - y) ** 2 < radius**2
        return (p_WP[:, 2] < 0.03) & inside


@dataclass(frozen=True, eq=False)
class Chain:
    """Scans along a path.

    Attributes:
        clouds: in S, with ring, column, intensity and nir.
        X_WS: true poses.
        guesses: pose of every scan in the one before, as odometry has it; one fewer than scans.
    """

    clouds: tuple[PointCloud, ...]
    X_WS: tuple[RigidTransform, ...]
    guesses: tuple[RigidTransform, ...]

    def errors(self, steps: list[RigidTransform]) -> np.ndarray:
        """Position errors [m] after each of these `steps`, (n, 3), along the axes of W."""
        X_WS, errors = self.X_WS[0], []
        for step, truth in zip(steps, self.X_WS[1:], strict=False):
            X_WS = X_WS @ step
            errors.append(X_WS.translation() - truth.translation())
        return np.array(errors)


def corridor(seed: int = 5) -> Corridor:
    """Builds the corridor; `seed` places patches (one every 2 m) and puddles (one every 3 m)."""
    rng = np.random.default_rng(seed)
    places = [(x, side) for x in np.arange(-38, 38, 2.5) for side in (-1, 1) if rng.random() < 0.6]
    patches = [
        (x + rng.uniform(-1, 1), side, rng.uniform(0.2, 1.4), rng.uniform(0.3, 0.8), rng.uniform(0.3, 0.8))
        for x, side in places
    ]
    puddles = [
        (x + rng.uniform(-1, 1), rng.uniform(-1.2, 1.2), rng.uniform(0.25, 0.6))
        for x in np.arange(-38, 38, 2.0)
        if rng.random() < 0.7
    ]
    scene = o3d.t.geometry.RaycastingScene()
    for centre, size in (
        ((0, 0, -0.05), (LENGTH, WIDTH, 0.1)),
        ((0, 0, HEIGHT + 0.05), (LENGTH, WIDTH, 0.1)),
        ((0, WIDTH / 2 + 0.05, HEIGHT / 2), (LENGTH, 0.1, HEIGHT)),
        ((0, -WIDTH / 2 - 0.05, HEIGHT / 2), (LENGTH, 0.1, HEIGHT)),
    ):
        box = o3d.t.geometry.TriangleMesh.create_box(*size)
        scene.add_triangles(box.translate(np.subtract(centre, np.divide(size, 2)).astype(np.float32)))
    return Corridor(scene, np.array(patches), np.array(puddles))


def scan(
    world: Corridor, X_WS: RigidTransform, rng: np.random.Generator, *, flip: float = 0.02, spots: bool = False
) -> PointCloud:
    """One scan from X_WS.

    Args:
        flip: share of labels that are wrong, half of them in either channel.
        spots: wrong labels come in spots of 0.3 m rather than one by one.
    """
    elevation = np.deg2rad(np.linspace(-15, 15, RINGS))[:, None]
    azimuth = np.linspace(-np.pi, np.pi, COLUMNS, endpoint=False) + rng.uniform(0, np.deg2rad(0.2))
    level = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    d_S = np.concatenate(
        [np.cos(elevation)[..., None] * level, np.broadcast_to(np.sin(elevation)[..., None], (RINGS, COLUMNS, 1))], -1
    ).reshape(-1, 3)
    d_W = d_S @ X_WS.rotation().matrix().T
    rays = np.hstack([np.broadcast_to(X_WS.translation(), d_W.shape), d_W]).astype(np.float32)
    distance = world.scene.cast_rays(o3d.core.Tensor(rays), nthreads=1)["t_hit"].numpy().astype(float)
    ray = np.flatnonzero(np.isfinite(distance) & (distance < MAX_RANGE) & (distance > 0.3))
    p_WP = X_WS.translation() + distance[ray, None] * d_W[ray]
    bits = np.stack([world.is_reflective(p_WP), world.is_water(p_WP)])
    bits ^= _wrong(p_WP, rng, flip / 2, spots)
    measured = distance[ray] + rng.normal(0, RANGE_NOISE, len(ray))
    attributes = {
        "ring": (ray // COLUMNS).astype(np.uint8),
        "column": (ray % COLUMNS).astype(np.uint16),
        "intensity": np.where(bits[0], 0.85, 0.4).astype(np.float32),
        "nir": np.where(bits[1], 0.06, 0.4).astype(np.float32),
    }
    for name in ("intensity", "nir"):  # as an illuminated surface varies
        attributes[name] *= np.exp(rng.normal(0, 0.1, len(ray))).astype(np.float32)
    cloud = PointCloud(o3d.core.Tensor((measured[:, None] * d_S[ray]).astype(np.float32)))
    for name, values in attributes.items():
        cloud.point[name] = o3d.core.Tensor(values[:, None])
    return cloud


def _wrong(p_WP: np.ndarray, rng: np.random.Generator, rate: float, spots: bool) -> np.ndarray:
    """Which labels of the two channels are wrong, (2, N) bool."""
    if not spots:
        return rng.random((2, len(p_WP))) < rate
    cells = np.floor((p_WP + rng.uniform(0, SPOT, 3)) / SPOT)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    return (rng.random((2, int(cell.max(initial=0)) + 1)) < rate)[:, cell.ravel()]


def corridor_pose(x: float, y: float = 0.0, yaw: float = 0.0) -> RigidTransform:
    """Pose of the sensor in the corridor [m, rad]."""
    return RigidTransform(RollPitchYaw(0, 0, yaw), [x, y, SENSOR_HEIGHT])


def corridor_chain(
    world: Corridor,
    *,
    seed: int = 0,
    length: float = 40.0,
    step: float = 0.5,
    flip: float = 0.02,
    spots: bool = False,
    slip: float = 0.2,
    yaw_noise: float = np.deg2rad(2.0),
) -> Chain:
    """Scans along a winding path; odometry feels (1 - slip) of every step and errs by `yaw_noise` [rad] a step."""
    rng, odometry = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    X_WS = [
        corridor_pose(x, 0.3 * np.sin(x / 4), 0.05 * np.sin(x / 3))
        for x in np.arange(-length / 2, length / 2 + 1e-9, step)
    ]
    clouds = [scan(world, X, rng, flip=flip, spots=spots) for X in X_WS]
    guesses = []
    for before, after in pairwise(X_WS):
        true = before.inverse() @ after
        turn = RollPitchYaw(0, 0, odometry.normal(0, yaw_noise)).ToRotationMatrix()
        guesses.append(RigidTransform(true.rotation() @ turn, (1 - slip) * true.translation()))
    return Chain(tuple(clouds), tuple(X_WS), tuple(guesses))


def corridor_pairs(
    world: Corridor, step: float, count: int, *, seed: int = 0, flip: float = 0.02, spots: bool = False
) -> list[tuple[PointCloud, PointCloud, RigidTransform]]:
    """Source, target and true X_TS of `count` pairs of scans, `step` [m] apart along the corridor."""
    rng = np.random.default_rng([seed, 2])
    pairs = []
    for _ in range(count):
        X_WT = corridor_pose(rng.uniform(-25, 24), rng.uniform(-0.5, 0.5), rng.uniform(-0.1, 0.1))
        y, yaw = X_WT.translation()[1] + rng.uniform(-0.05, 0.05), rng.uniform(-0.05, 0.05)
        X_WS = corridor_pose(X_WT.translation()[0] + step, y, RollPitchYaw(X_WT.rotation()).yaw_angle() + yaw)
        target, source = (scan(world, X, rng, flip=flip, spots=spots) for X in (X_WT, X_WS))
        pairs.append((source, target, X_WT.inverse() @ X_WS))
    return pairs
