"""A hall whose crates are moved, added and taken away between two surveys, what the scans saw, and the score."""

from dataclasses import dataclass

import numpy as np
from naraha.diagrams.change_metrics import box_distance
from naraha.models.worlds import Solid, World
from naraha.models.worlds.stair_hall import FREE_WAY, LANDING_X, STAIR_Y, clearance
from naraha.systems.changes.seen_space import free_voxels, voxel_keys
from naraha.systems.changes.sight import Rays, SeenSpaceConfig
from naraha.systems.clouds import voxel_filter
from naraha.systems.noise import generator_at
from naraha.systems.sensing import LidarConfig
from naraha.systems.sensing.lidar import configured_pattern, make_cloud, simulate_returns, sweep_rays
from naraha.systems.slam import Keyframe
from pydrake.math import RigidTransform, RollPitchYaw

P_BS = np.array([0.0, 0.0, 0.22])  # [m] S is 0.30 m over the floor
LIDAR = LidarConfig()
NEAR = 0.15  # [m] a point this near to a solid is of it
ENOUGH = 15  # voxels of 0.1 m


@dataclass(frozen=True)
class Change:
    kind: str
    solid: Solid


def footprint(solid: Solid) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of the box around a solid along the axes of W."""
    size = solid.box or [2 * (solid.cylinder or solid.sphere)[0]] * 2 + [(solid.cylinder or [0, 0])[1]]
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = solid.X_WG().multiply((signs * np.array(size) / 2).T).T
    return corners.min(axis=0), corners.max(axis=0)


def changed_hall(
    world: World, seed: int, moved: int = 10, added: int = 5, removed: int = 5
) -> tuple[World, World, list[Change]]:
    """`world` before and after, and what changed; a moved crate is one that vanished and one that appeared.

    Crates are put on free floor, 0.4 m clear of everything before and after, 1.1 m clear of the way. If there are
    fewer than `moved` + `removed` crates, the hall gets more of them first.
    """
    rng = np.random.default_rng([seed, 77])
    taken = [footprint(s) for s in world.solids if s.surface != "floor" and footprint(s)[0][2] < 1.3]

    def place(size: np.ndarray, name: str) -> Solid:
        radius = np.hypot(*size[:2]) / 2
        for attempt in range(20000):
            gap = 0.4 if attempt < 10000 else 0.25
            xy = rng.uniform([-9.4, -6.4], [9.4, 6.2])
            if clearance(xy[None], FREE_WAY)[0] < 0.7 + radius:
                continue
            distances = [np.linalg.norm(np.maximum(np.maximum(lo[:2] - xy, xy - hi[:2]), 0)) for lo, hi in taken]
            if min(distances) > radius + gap:
                xyz = [float(xy[0]), float(xy[1]), float(size[2] / 2)]
                yaw = float(rng.uniform(0, 90))
                crate = Solid(
                    name=name, box=size.tolist(), xyz=xyz, rpy_deg=[0.0, 0.0, yaw], surface="crate", rgb=[0.6, 0.4, 0.2]
                )
                taken.append(footprint(crate))
                return crate
        raise AssertionError("no room for another crate")

    def new_size() -> np.ndarray:
        return rng.uniform([0.4, 0.4, 0.3], [0.8, 0.8, 1.1])

    solids = list(world.solids)
    crates = [s for s in solids if s.surface == "crate"]
    while len(crates) < moved + removed:
        crate = place(new_size(), f"more_crate_{len(crates)}")
        crates.append(crate)
        solids.append(crate)
    chosen = [crates[i] for i in rng.permutation(len(crates))[: moved + removed]]
    changes = [Change("vanished", crate) for crate in chosen]
    arrivals = [place(np.array(crate.box), crate.name) for crate in chosen[:moved]]
    arrivals += [place(new_size(), f"added_crate_{i}") for i in range(added)]
    changes += [Change("appeared", crate) for crate in arrivals]
    gone = {crate.name for crate in chosen}
    after = [s for s in solids if s.name not in gone] + arrivals
    return World(solids=solids, surfaces=world.surfaces), World(solids=after, surfaces=world.surfaces), changes


def tour(count: int) -> list[RigidTransform]:
    """`count` poses X_WB, evenly along the free way and across the landing of the stair."""
    steps = np.linalg.norm(np.diff(FREE_WAY, axis=0), axis=1)
    s = np.concatenate([[0], np.cumsum(steps)])
    poses = []
    for at in np.linspace(0, s[-1], count, endpoint=False):
        leg = np.searchsorted(s, at, side="right") - 1
        along = (FREE_WAY[leg + 1] - FREE_WAY[leg]) / steps[leg]
        xy = FREE_WAY[leg] + (at - s[leg]) * along
        z = 0.08
        if abs(xy[1] - STAIR_Y) < 0.7 and abs(xy[0] - LANDING_X) < 2.5:
            xy, z = np.array([LANDING_X, STAIR_Y]), 1.16
        poses.append(RigidTransform(RollPitchYaw(0, 0, np.arctan2(along[1], along[0])), [*xy, z]))
    return poses


@dataclass(frozen=True)
class Survey:
    """Keyframes with the errors of their poses, and what was really seen, (voxel keys in W).

    Attributes:
        hit: voxels of 0.1 m that were hit on each solid.
        free: voxels of 0.1 m through which rays really passed.
    """

    keyframes: tuple[Keyframe, ...]
    hit: dict[str, np.ndarray]
    free: np.ndarray


def scan_tour(world: World, poses: list[RigidTransform], seed: int, sigma_m=0.025, sigma_deg=0.3) -> Survey:
    scene = world.ray_scene()
    pattern = configured_pattern(LIDAR)
    keyframes, names, ends, free = [], [], [], []
    for i, X_WB in enumerate(poses):
        rng = generator_at(seed, i)
        X_WS = X_WB.GetAsMatrix4()
        X_WS[:3, 3] += X_WS[:3, :3] @ P_BS
        rays = sweep_rays(pattern, X_WS, X_WS)
        returns = simulate_returns(*rays, scene, rng, config=LIDAR, pattern=pattern)
        cloud = make_cloud(pattern, returns)
        cloud.point.positions = cloud.point.positions + P_BS.astype(np.float32)
        error = RigidTransform(
            RollPitchYaw(np.deg2rad(sigma_deg) * rng.standard_normal(3)), sigma_m * rng.standard_normal(3)
        )
        keyframes.append(Keyframe(i, 10.0 * i, X_WB @ error, None, voxel_filter(cloud, 0.1), 1.0))
        p_WP = X_WB.multiply(cloud.point.positions.numpy().astype(float).T).T
        geometry = scene.cast(rays[0][returns.ray], rays[1][returns.ray]).geometry
        names.append(np.array(scene.names)[geometry])
        ends.append(p_WP)
        truth = Rays(X_WS[:3, 3], p_WP.astype(np.float32), 0.0)
        free.append(free_voxels(truth, SeenSpaceConfig(stop_short=0.05)))
    name, keys = np.concatenate(names), voxel_keys(np.concatenate(ends), 0.1)
    hit = {str(n).rpartition("::")[2]: np.unique(keys[name == n]) for n in np.unique(name)}
    return Survey(tuple(keyframes), hit, np.unique(np.concatenate(free)))


def among(keys: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Whether each key is among the `known` ones, which are sorted."""
    return known[np.minimum(np.searchsorted(known, keys), len(known) - 1)] == keys


def visible(change: Change, before: Survey, after: Survey) -> bool:
    """Whether both surveys could tell: one hit at least 15 voxels of the solid, and rays of the other went through
    at least 15 of these same voxels."""
    there, gone = (after, before) if change.kind == "appeared" else (before, after)
    hit = there.hit.get(change.solid.name, np.zeros(0, np.int64))
    return bool(among(hit, gone.free).sum() >= ENOUGH)


@dataclass(frozen=True)
class Score:
    visible: int
    found: int
    reported: int
    correct: int
    missed: list[str]
    false: list[str]
    unseen_points: int


def near_free(points: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Whether a ray really passed one of the 27 voxels around each point."""
    around = np.array([[x, y, z] for x in (-0.1, 0, 0.1) for y in (-0.1, 0, 0.1) for z in (-0.1, 0, 0.1)])
    return among(voxel_keys((points[:, None] + around).reshape(-1, 3), 0.1), free).reshape(-1, 27).any(axis=1)


def score(objects, changes: list[Change], before: Survey, after: Survey, X_WM: RigidTransform) -> Score:
    """Counts objects, not points.

    A reported one is correct when half of its points or more are within 0.15 m of solids that changed in this way. A
    solid is found when a correct one has 8 points or more within 0.15 m of it; it counts if it is `visible`.
    """
    correct, false, unseen = [], [], 0
    for thing in objects:
        points = X_WM.multiply(thing.points.astype(float).T).T
        distances = [box_distance(c.solid, points) for c in changes if c.kind == thing.kind]
        if distances and np.mean(np.min(distances, axis=0) <= NEAR) >= 0.5:
            correct.append((thing.kind, points))
        else:
            false.append(f"{thing.kind} at {np.round(thing.centre, 2)} {np.round(thing.extent, 2)} n={len(points)}")
        unseen += int((~near_free(points, (before if thing.kind == "appeared" else after).free)).sum())
    counted = [c for c in changes if visible(c, before, after)]
    missed = []
    for change in counted:
        near = [(box_distance(change.solid, p) <= NEAR).sum() for kind, p in correct if kind == change.kind]
        if max(near, default=0) < 8:
            missed.append(f"{change.kind} {change.solid.name} at {np.round(change.solid.xyz, 2)}")
    return Score(len(counted), len(counted) - len(missed), len(objects), len(correct), missed, false, unseen)
