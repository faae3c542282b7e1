"""Voxel maps: points per second, agreement with OctoMap, growth, bytes a voxel and export, on one core in one run.

A VLP-16 of 28 800 rays stands at 20 places in a furnished room of 24 × 16 × 4 m; range noise is 0.02 m and everything
is seeded. All get the same points, rounded to float32 as OctoMap keeps them, whole rays, voxels of 0.1 m and the same
log-odds. OctoMap's lazy variants bring their inner nodes up to date once, at the end.

Growth: a drive through ever new rooms, each 26 m on and seen by the same four scans, so that only the size of the map
differs; then the map as it was after a twentieth of the drive and the whole one go on in turns.

Agreement: of all voxels known to ours or to OctoMap's plain insertion, the share with the same state.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
from naraha.systems.sensing import LidarConfig
from naraha.systems.sensing.lidar import configured_pattern
from naraha.systems.voxel_map import (
    CHANNELS,
    SubmapCollection,
    SubmapConfig,
    VoxelMap,
    VoxelMapConfig,
    write_octomap,
)
from naraha.systems.voxel_map.octomap_files import read_leaves
from naraha.systems.voxel_map.octree import morton_codes
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw

from .report import print_table, time_in_turns, use_one_core, write_json

ROOM = np.array([24.0, 16.0, 4.0])
CLASSES = 6
CONFIG = VoxelMapConfig(max_range=100.0)
ROOM_STEP = 26.0  # [m]
Scan = tuple[np.ndarray, np.ndarray]


def furnished_room(rng: np.random.Generator) -> o3d.t.geometry.RaycastingScene:
    """Walls of `ROOM` with 60 boxes and 12 cylinders in it."""
    scene = o3d.t.geometry.RaycastingScene()

    def add(mesh: Any, place: np.ndarray, yaw: float = 0.0) -> None:
        X = RigidTransform(RollPitchYaw(0, 0, yaw), place).GetAsMatrix4()
        scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh.transform(X)))

    add(o3d.geometry.TriangleMesh.create_box(*ROOM), np.append(-ROOM[:2] / 2, 0.0))
    for _ in range(60):
        size = rng.uniform([0.3, 0.3, 0.4], [1.2, 1.2, 2.0])
        add(o3d.geometry.TriangleMesh.create_box(*size), _place(rng, 0.0), rng.uniform(0, np.pi))
    for _ in range(12):
        height = rng.uniform(1.0, 4.0)
        add(o3d.geometry.TriangleMesh.create_cylinder(rng.uniform(0.1, 0.3), height), _place(rng, height / 2))
    return scene


def _place(rng: np.random.Generator, z: float) -> np.ndarray:
    return np.append(rng.uniform(-ROOM[:2] / 2 + 0.5, ROOM[:2] / 2 - 0.5), z)


def make_scans(count: int, seed: int = 0) -> list[Scan]:
    """Points (N, 3) and origin (3,) of `count` scans in the room."""
    rng = np.random.default_rng(seed)
    scene = furnished_room(rng)
    directions = configured_pattern(LidarConfig()).d_S
    scans = []
    while len(scans) < count:
        start = np.append(rng.uniform(-0.4, 0.4, 2) * ROOM[:2], rng.uniform(0.6, 1.2))
        X_WS = RigidTransform(RollPitchYaw(*rng.normal(0, 0.03, 2), rng.uniform(-np.pi, np.pi)), start)
        along = X_WS.rotation().multiply(directions.T.astype(float)).T
        rays = np.concatenate([np.broadcast_to(start, along.shape), along], axis=1).astype(np.float32)
        distance = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy().astype(float)
        if np.median(distance) < 1.5:  # inside a box
            continue
        distance += rng.normal(0, 0.02, len(distance))
        points = start + distance[:, None] * along
        scans.append((_float32(points[np.isfinite(points).all(axis=1)]), _float32(start)))
    return scans


def _float32(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32).astype(float)


def ours(scans: list[Scan]) -> VoxelMap:
    voxels = VoxelMap(CONFIG)
    for points, origin in scans:
        voxels.insert(points, origin)
    return voxels


def ours_with_attributes(scans: list[Scan], attributes: list[dict[str, Any]]) -> VoxelMap:
    voxels = VoxelMap(CONFIG, classes=CLASSES)
    for (points, origin), more in zip(scans, attributes, strict=True):
        voxels.insert(points, origin, **more)
    return voxels


def attributes_of(scans: list[Scan]) -> list[dict[str, Any]]:
    """Random class probabilities and values of every channel for each scan."""
    rng = np.random.default_rng(1)
    made = []
    for points, _ in scans:
        p = rng.dirichlet(np.ones(CLASSES), len(points)).astype(np.float32)
        made.append({"class_probabilities": p, "channels": {name: rng.random(len(points)) for name in CHANNELS}})
    return made


def peers(scans: list[Scan]) -> dict[str, Callable[[], Any]]:
    """Insertion of all scans by each library that is installed, in its three ways."""
    made: dict[str, Callable[[], Any]] = {}
    for library in ("octomap", "pyoctomap"):
        try:
            module = __import__(library)
        except ImportError:
            continue

        def insert(module: Any, lazy: bool, discretize: bool) -> Any:
            tree = module.OcTree(CONFIG.voxel_size)
            for points, origin in scans:
                tree.insertPointCloud(points, origin, -1.0, lazy, discretize)
            if lazy:
                tree.updateInnerOccupancy()
            return tree

        for name, lazy, discretize in (("", False, False), ("_lazy", True, False), ("_lazy_discretized", True, True)):
            made[library + name] = lambda m=module, lz=lazy, d=discretize: insert(m, lz, d)  # type: ignore[misc]
    return made


def state_of_tree(tree: Any, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Morton codes of the voxels that OctoMap's tree knows, rising, and whether each is occupied."""
    path = folder / "tree.ot"
    tree.write(str(path).encode())
    leaves = read_leaves(path)
    indices, leaf = leaves.expanded()
    return _sorted(indices, leaves.log_odds[leaf] >= 0)


def _sorted(indices: np.ndarray, occupied: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    codes = morton_codes(indices)
    order = np.argsort(codes)
    return codes[order], occupied[order]


def agreement(ours: VoxelMap, tree: Any, folder: Path) -> dict[str, float]:
    """Share of the voxels known to either that agree in state, and what the others are."""
    indices, log_odds = ours.known()
    a, a_occupied = _sorted(indices, log_odds >= 0)
    b, b_occupied = state_of_tree(tree, folder)
    _, in_a, in_b = np.intersect1d(a, b, assume_unique=True, return_indices=True)
    either = len(a) + len(b) - len(in_a)
    same = a_occupied[in_a] == b_occupied[in_b]
    occupied = a_occupied.sum() + b_occupied.sum() - (a_occupied[in_a] & b_occupied[in_b]).sum()
    return {
        "agreement": float(same.sum() / either),
        "agreement_occupied_iou": float((a_occupied[in_a] & b_occupied[in_b]).sum() / occupied),
        "only_naraha_knows": float((len(a) - len(in_a)) / either),
        "only_octomap_knows": float((len(b) - len(in_b)) / either),
        "other_state": float((~same).sum() / either),
    }


def growth(scans: list[Scan], rooms: int) -> dict[str, object]:
    """Times of scans after a drive through `rooms` rooms and after a twentieth of it."""
    attributes = attributes_of(scans)

    def see(voxels: VoxelMap, room: int) -> float:
        shift = np.array([ROOM_STEP * room, 0.0, 0.0])
        start = time.perf_counter()
        for (points, origin), more in zip(scans, attributes, strict=True):
            voxels.insert(points + shift, origin + shift, **more)
        return (time.perf_counter() - start) / len(scans)

    drive, early = VoxelMap(CONFIG, classes=CLASSES), VoxelMap(CONFIG, classes=CLASSES)
    for room in range(rooms):
        see(drive, room)
        if room < rooms // 20:
            see(early, room)
    grown, known = drive.nbytes / early.nbytes, len(drive.known()[1])
    bytes_a_voxel = drive.nbytes / known
    # In turns, each in ever new rooms: whatever else the machine does falls on both.
    times = np.array([(see(early, 10 * rooms + k), see(drive, 10 * rooms + k)) for k in range(12)])
    return {
        "growth": grown,
        "growth_scan_ms_small": 1e3 * float(np.median(times[:, 0])),
        "growth_scan_ms_large": 1e3 * float(np.median(times[:, 1])),
        "growth_large_by_small": float(np.median(times[:, 1] / times[:, 0])),
        "drive_voxels": known,
        "drive_bytes_per_voxel": bytes_a_voxel,
    }


def submaps(scans: list[Scan]) -> dict[str, object]:
    """Times of the sub-maps of the same scans, five each."""
    clouds = [(PointCloud((points - origin).astype(np.float32)), RigidTransform(origin)) for points, origin in scans]
    collection = SubmapCollection(SubmapConfig(voxels=CONFIG, scans=5, distance=100.0))
    for k, (cloud, X) in enumerate(clouds):
        collection = collection.insert(k, cloud, X, np.zeros(3))
    turn = RigidTransform(RollPitchYaw(0.002, -0.001, 0.05), [0.23, -0.11, 0.02])
    moved = {s.anchor: turn @ clouds[s.anchor][1] for s in collection.submaps}
    voxels = sum(len(s.voxels.known()[1]) for s in collection.submaps)

    def compose(collection: SubmapCollection) -> None:
        fresh = SubmapCollection(collection.config)
        fresh.submaps = collection.submaps
        fresh.compose()

    cloud, X = clouds[0]
    times = time_in_turns(
        {
            "insert": lambda: collection.insert(99, cloud, X, np.zeros(3)),
            "compose": lambda: compose(collection),
            "recompose": lambda: compose(collection.correct(moved)),
            "compose_again": collection.compose,
        },
        repeats=5,
    )
    return {
        "submaps": len(collection.submaps),
        "submap_voxels": voxels,
        "submap_insert_ms": 1e3 * times["insert"],
        "submap_compose_ns_per_voxel": 1e9 * times["compose"] / voxels,
        "submap_recompose_ns_per_voxel": 1e9 * times["recompose"] / voxels,
        "submap_compose_again_ms": 1e3 * times["compose_again"],
    }


def export(ours: VoxelMap, tree: Any, folder: Path) -> dict[str, object]:
    calls: dict[str, Callable[[], object]] = {"naraha": lambda: write_octomap(folder / "ours.bt", ours)}
    if tree is not None:
        calls["octomap"] = lambda: tree.writeBinary(str(folder / "theirs.bt").encode())
    times = time_in_turns(calls, repeats=5)
    return {f"{name}_bt_export_ms": 1e3 * value for name, value in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    parser.add_argument("--scans", type=int, default=20)
    parser.add_argument("--rooms", type=int, default=80, help="of the drive; 20 or more")
    parser.add_argument("--repeats", type=int, default=3, help="of every measurement, whose median counts")
    arguments = parser.parse_args()
    use_one_core()
    scans = make_scans(arguments.scans)
    total = sum(len(points) for points, _ in scans)
    attributes = attributes_of(scans)
    rivals = peers(scans)
    contestants: Mapping[str, Callable[[], object]] = {
        "naraha": lambda: ours(scans),
        "naraha_attributes": lambda: ours_with_attributes(scans, attributes),
        **rivals,
    }
    times = time_in_turns(contestants, repeats=arguments.repeats)
    results: dict[str, object] = {"scans": len(scans), "points": total}
    results |= {f"{name}_points_per_s": total / seconds for name, seconds in times.items()}
    if rivals:
        best = min(times[name] for name in rivals)
        results["ratio_to_best_peer"] = best / times["naraha"]
        results["ratio_to_best_peer_with_attributes"] = best / times["naraha_attributes"]
    voxels, rich = ours(scans), ours_with_attributes(scans, attributes)
    known = len(voxels.known()[1])
    results |= {"known_voxels": known, "occupied_voxels": len(voxels.occupied())}
    results["naraha_bytes_per_voxel"] = voxels.nbytes / known
    results["naraha_bytes_per_voxel_attributes"] = rich.nbytes / known
    tree = rivals["octomap"]() if "octomap" in rivals else None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if tree is not None:
            results["octomap_bytes_per_voxel"] = tree.memoryUsage() / known
            results |= agreement(voxels, tree, folder)
        results |= export(voxels, tree, folder)
    results |= submaps(scans)
    results |= growth(scans[:4], max(20, arguments.rooms))
    rows = [(name, total / s / 1e6, 1e3 * s / len(scans), times["naraha"] / s) for name, s in times.items()]
    columns = ("insert", "million points/s", "ms a scan", "of naraha's rate")
    print_table(f"{total} points of {len(scans)} scans, one core", columns, rows)
    print_table("everything", ("value", "measured"), [(k, v) for k, v in results.items() if "points_per_s" not in k])
    write_json(arguments.json, results)


if __name__ == "__main__":
    main()
