"""Pairs of scans of a furnished flat whose true pose is known, for benchmarks of registration.

A flat of 24 × 16 × 4 m has inner walls, up to 60 boxes and up to 12 columns; a LiDAR of 16 rings × 1 800 columns stands
0.6 m above the floor. Rays are cast by Open3D and carry 0.02 m of noise. Everything follows from one seed: layout 0 is
that of the tables in the README, other seeds furnish the flat anew and turn the sensor elsewhere.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud, RaycastingScene, TriangleMesh
from pydrake.math import RigidTransform, RotationMatrix

RINGS, COLUMNS = 16, 1800
RANGE_NOISE = 0.02  # [m]
MIN_RANGE, MAX_RANGE = 0.3, 40.0  # [m]
SIZE = (24.0, 16.0, 4.0)  # [m] of the flat, its middle at x = y = 0
HEIGHT = 0.6  # [m] of the sensor
# Where the sensor stands [m]; furniture keeps away from these places.
PLACES = [(-8, -4), (-3, -4), (-4, 5), (5, -5), (5, 4), (9, -2), (-9, 4), (2, -1.5)]
# Target's and source's place of the distant pairs [m]. Nothing keeps furniture away from the last one.
VIEWS = [
    ((-3, -4), (2, -1.5)),
    ((2, -1.5), (5, -5)),
    ((-4, 5), (-9, 4)),
    ((-8, -4), (-3, -4)),
    ((9, -2), (5, -5)),
    ((-3, -4), (-4, -1)),
]
PAIRS = 24  # in every set
# A sensor that stands in or against a box loses what is nearer than its least range.
ILL_POSED_BELOW = 0.9  # of all rays


@dataclass(frozen=True, eq=False)
class Pair:
    """Two scans and what a registration of them is told and should find.

    Attributes:
        source, target: clouds in their sensors' frames S and T; attributes `intensity` (N, 1) float32 in [0, 1],
            `ring` (N, 1) uint8, `column` (N, 1) uint16.
        X_TS: true pose of the source in the target.
        X_TS_guess: what is known beforehand; the identity where nothing is.
        ill_posed: one of the two scans was taken from so near a box that it shows little else.
    """

    source: PointCloud
    target: PointCloud
    X_TS: RigidTransform
    X_TS_guess: RigidTransform
    ill_posed: bool = False


@dataclass(frozen=True, eq=False)
class FlatPairs:
    """The sets of 24 pairs in one layout.

    Attributes:
        near: 0.5 m and 10° apart, 1° of roll and pitch; the guess is the identity.
        partial: 3.2 to 5.6 m and 40° apart, so that they share a part of the view only; the guess is off by 0.5 m
            and 10°. In layout 0 four of them are ill-posed.
        apart: the pairs of `partial` without a guess.
        same_place: 0.5 m apart, turned by any angle, without a guess.
    """

    near: tuple[Pair, ...]
    partial: tuple[Pair, ...]
    apart: tuple[Pair, ...]
    same_place: tuple[Pair, ...]


def yaw_pose(x: float, y: float, z: float, yaw: float, roll: float = 0.0, pitch: float = 0.0) -> RigidTransform:
    """Turned by yaw [rad] about z, then by pitch and roll about the fixed axes; standing at (x, y, z) [m]."""
    turn = RotationMatrix.MakeXRotation(roll) @ RotationMatrix.MakeYRotation(pitch) @ RotationMatrix.MakeZRotation(yaw)
    return RigidTransform(turn, [x, y, z])


def ray_directions() -> np.ndarray:
    """Unit vectors (16 · 1800, 3) in the sensor frame, ring by ring from the lowest, from azimuth −π on."""
    elevation, azimuth = np.meshgrid(
        np.deg2rad(np.linspace(-15, 15, RINGS)),
        np.linspace(-np.pi, np.pi, COLUMNS, endpoint=False),
        indexing="ij",
    )
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], -1).reshape(-1, 3)


class Flat:
    """The furnished flat of one layout, to cast rays into."""

    def __init__(self, seed: int = 0):
        rng = np.random.default_rng(seed)
        self.scene = RaycastingScene()
        width, depth, height = SIZE
        middle = height / 2
        for z in (-0.05, height + 0.05):
            self._add_box((0, 0, z), (width, depth, 0.1))
        for x in (-width / 2, width / 2):
            self._add_box((x, 0, middle), (0.1, depth, height))
        for y in (-depth / 2, depth / 2):
            self._add_box((0, y, middle), (width, 0.1, height))
        self._add_box((0, -5, middle), (0.15, 6, height))
        self._add_box((0, 4, middle), (0.15, 8, height))
        self._add_box((6, 0, middle), (8, 0.15, height))
        self._add_box((-7, 1, middle), (6, 0.15, height))
        bodies = 10
        for _ in range(60):
            size = rng.uniform(0.2, 1.2, 3)
            size[2] = rng.uniform(0.3, 2.2)
            x, y = self._spot(rng)
            if _is_clear(x, y):
                self._add_box((x, y, size[2] / 2), tuple(size), yaw=rng.uniform(0, np.pi))
                bodies += 1
        for _ in range(12):
            column = TriangleMesh.create_cylinder(rng.uniform(0.08, 0.25), 3.5, 24)
            x, y = self._spot(rng)
            if _is_clear(x, y):
                self.scene.add_triangles(column.translate([x, y, 1.75]))
                bodies += 1
        # Its own generator, so that the furniture is the same however much is painted.
        paint = np.random.default_rng([seed, 1])
        self.reflectivity = paint.choice([0.1, 0.25, 0.4, 0.6, 0.85], bodies)

    def _add_box(self, centre: tuple[float, ...], size: tuple[float, ...], yaw: float = 0.0) -> None:
        box = TriangleMesh.create_box(*size).translate(-np.array(size) / 2)
        self.scene.add_triangles(box.transform(yaw_pose(*centre, yaw=yaw).GetAsMatrix4()))

    @staticmethod
    def _spot(rng: np.random.Generator) -> tuple[float, float]:
        x = rng.uniform(-SIZE[0] / 2 + 0.5, SIZE[0] / 2 - 0.5)
        return x, rng.uniform(-SIZE[1] / 2 + 0.5, SIZE[1] / 2 - 0.5)

    def scan(self, X_WS: RigidTransform, rng: np.random.Generator) -> PointCloud:
        """What a LiDAR at X_WS sees; its columns start anywhere within one column's width."""
        jitter = RotationMatrix.MakeZRotation(rng.uniform(0, 0.2 / 57.3))
        d_S = ray_directions() @ jitter.matrix().T
        d_W = d_S @ X_WS.rotation().matrix().T
        rays = np.concatenate([np.broadcast_to(X_WS.translation(), d_W.shape), d_W], axis=1).astype(np.float32)
        hits = self.scene.cast_rays(o3d.core.Tensor(rays), nthreads=1)
        distance = hits["t_hit"].numpy()
        ray = np.flatnonzero((distance > MIN_RANGE) & (distance < MAX_RANGE))
        points = d_S[ray] * (distance[ray] + rng.normal(0, RANGE_NOISE, len(ray)))[:, None]
        square_on = np.abs((hits["primitive_normals"].numpy()[ray] * d_W[ray]).sum(axis=1))
        body = hits["geometry_ids"].numpy()[ray]
        cloud = PointCloud(o3d.core.Tensor(points.astype(np.float32)))
        cloud.point["intensity"] = o3d.core.Tensor((self.reflectivity[body] * square_on).astype(np.float32)[:, None])
        cloud.point["ring"] = o3d.core.Tensor((ray // COLUMNS).astype(np.uint8)[:, None])
        cloud.point["column"] = o3d.core.Tensor((ray % COLUMNS).astype(np.uint16)[:, None])
        return cloud


def _is_clear(x: float, y: float) -> bool:
    return min(np.hypot(x - u, y - v) for u, v in PLACES) >= 1.2


@lru_cache(maxsize=2)
def flat_pairs(seed: int = 0) -> FlatPairs:
    """All pairs of the layout `seed`; scans take their noise from one generator in a fixed order."""
    flat = Flat(seed)
    rng = np.random.default_rng(seed + 1)

    def scanned(X_WT: RigidTransform, X_WS: RigidTransform, X_TS_guess: RigidTransform) -> Pair:
        target, source = flat.scan(X_WT, rng), flat.scan(X_WS, rng)
        fewest = min(len(target.point.positions), len(source.point.positions))
        ill_posed = fewest < ILL_POSED_BELOW * RINGS * COLUMNS
        return Pair(source, target, X_WT.inverse() @ X_WS, X_TS_guess, ill_posed)

    def half_metre(*, roll_and_pitch: bool) -> RigidTransform:
        """0.5 m in any direction and 10° to either side."""
        bearing = rng.uniform(0, 2 * np.pi)
        yaw = np.deg2rad(10) * rng.choice([-1, 1])
        roll, pitch = np.deg2rad(1) * rng.normal(size=2) if roll_and_pitch else (0.0, 0.0)
        return yaw_pose(0.5 * np.cos(bearing), 0.5 * np.sin(bearing), 0, yaw, roll, pitch)

    near = []
    for i in range(PAIRS):
        X_WT = yaw_pose(*PLACES[i % len(PLACES)], HEIGHT, rng.uniform(-3, 3))
        near.append(scanned(X_WT, X_WT @ half_metre(roll_and_pitch=True), RigidTransform()))
    partial = []
    for i in range(PAIRS):
        place_T, place_S = VIEWS[i % len(VIEWS)]
        yaw = rng.uniform(-3, 3)
        X_WT = yaw_pose(*place_T, HEIGHT, yaw)
        X_WS = yaw_pose(*place_S, HEIGHT, yaw + np.deg2rad(40) * rng.choice([-1, 1]))
        guess = X_WT.inverse() @ X_WS @ half_metre(roll_and_pitch=False)
        partial.append(scanned(X_WT, X_WS, guess))
    same_place = []
    for i in range(PAIRS):
        X_WT = yaw_pose(*PLACES[i % len(PLACES)], HEIGHT, rng.uniform(-3, 3))
        same_place.append(scanned(X_WT, X_WT @ yaw_pose(0.4, 0.3, 0, rng.uniform(-3.1, 3.1)), RigidTransform()))
    apart = [Pair(pair.source, pair.target, pair.X_TS, RigidTransform(), pair.ill_posed) for pair in partial]
    return FlatPairs(tuple(near), tuple(partial), tuple(apart), tuple(same_place))
