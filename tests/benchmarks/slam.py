"""The paper's SLAM against ours, where frames are few, metres apart and half hidden from each other (S2-d).

    python -m tests.benchmarks.slam [--scene hall|recorded|all] [--seeds 10] [--json FILE]

`hall`: fourteen frames around `stair_hall` and over its stair (`hall_frames`), nothing known of the motion. `icp` and
`attributes` are the source's pipeline: FPFH and SAC-IA for every frame in the one before (S2-b), from there
point-to-point ICP (Eq. 1) or attribute ICP (Eq. 2), chained. `naraha` finds every frame in the three before it and in
all that are old enough to close a loop, registers those that are not ambiguous, and leaves the rest to a pose graph.
`odometry` is what slipping tracks say, which none of them sees.

`recorded`: the hand-held sequence through the systems of `naraha map`, against GICP from one scan to the next.
"""

import argparse
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from naraha.diagrams.cli import main as naraha
from naraha.systems.clouds import VoxelCloud
from naraha.systems.point_classes import ClassCounts, class_probabilities, fit_class_model
from naraha.systems.pose_graph import LOOP, REGISTRATION, PoseGraph, decide_loops
from naraha.systems.registration import IcpConfig, RegistrationConfig, register
from naraha.systems.registration.coarse import View, find_pose
from naraha.systems.registration.coarse.feature_alignment import align_features
from naraha.systems.slam import map_error
from open3d.core import Tensor
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform

from .hall_frames import Frame, hall_frames
from .report import print_table, write_json

VOXEL = 0.1  # [m] of the maps that are compared
NEIGHBOURS = 3  # frames before each that it is looked for in
WEAK = np.diag([9.0, 9.0, 9.0, 100.0, 100.0, 100.0])  # [rad², m²] of a step that nothing is known of
# Every result is taken, as the source's pipeline does.
TAKE_ALL = {
    "min_fitness": 0.0,
    "min_constraint": 0.0,
    "max_correction": 1000.0,
    "max_correction_deg": 180.0,
    "retry_yaws_deg": [],
}
ICP = RegistrationConfig(
    method="point_to_point", icp=IcpConfig(max_distances=[1.0], source_voxel=0.2, max_iterations=60), **TAKE_ALL
)
ATTRIBUTES = RegistrationConfig(method="attributes", **TAKE_ALL)
OURS = RegistrationConfig(min_fitness=0.2, retry_yaws_deg=[])
Poses = list[RigidTransform]


def with_classes(frames: list[Frame]) -> list[PointCloud]:
    """The clouds with class probabilities, the thresholds from the histograms of all (S2-a)."""
    counts = ClassCounts()
    for frame in frames:
        counts = counts.add(frame.cloud_S)
    model = fit_class_model(counts)
    clouds = []
    for frame in frames:
        cloud = PointCloud()
        for name, values in frame.cloud_S.point.items():
            cloud.point[name] = values
        cloud.point["class_probabilities"] = Tensor(class_probabilities(cloud, model))
        clouds.append(cloud)
    return clouds


def chain(clouds: list[PointCloud], starts: Poses, config: RegistrationConfig) -> Poses:
    """Every frame registered to the one before, from `starts`."""
    poses = [RigidTransform()]
    for (before, cloud), start in zip(pairwise(clouds), starts, strict=True):
        poses.append(poses[-1] @ register(cloud, before, start, config).X_TS)
    return poses


def graph_slam(clouds: list[PointCloud]) -> Poses:
    """Ours: frames found in frames, registered, and put together by a pose graph that refuses what does not fit."""
    views = [View(cloud) for cloud in clouds]
    edges: list[tuple[int, int, np.ndarray, np.ndarray, int]] = []
    poses = [np.eye(4)]
    for j in range(1, len(clouds)):
        found: dict[int, np.ndarray] = {}
        for i in range(j - 1, -1, -1):
            if NEIGHBOURS < j - i < 8:
                continue
            candidates = find_pose(views[j], views[i])
            if not candidates or candidates[0].ambiguous:
                continue
            result = register(clouds[j], clouds[i], candidates[0].X_TS, OURS)
            if result.valid:
                found[i] = result.X_TS.GetAsMatrix4()
                kind = REGISTRATION if i == j - 1 else LOOP
                # Registration gives a small motion in the target's axes, the graph wants one in the source's.
                R = np.kron(np.eye(2), result.X_TS.rotation().matrix().T)
                edges.append((i, j, found[i], R @ result.covariance @ R.T + 1e-6 * np.eye(6), kind))
        nearest = max(found, default=j - 1)
        poses.append(poses[nearest] @ found.get(nearest, np.eye(4)))
        if nearest != j - 1:
            edges.append((j - 1, j, np.linalg.inv(poses[j - 1]) @ poses[j], WEAK, REGISTRATION))
    i, j, X_ij, covariance, kind = zip(*edges, strict=True)
    information = np.linalg.inv(np.array(covariance))
    graph = PoseGraph(np.array(poses), np.array(i), np.array(j), np.array(X_ij), information, np.array(kind))
    return [RigidTransform(X) for X in decide_loops(graph).poses]


def errors(poses: Poses, frames: list[Frame]) -> tuple[float, float]:
    """Mean distance of the frames from where they were, and of the points of the map from the true map [m]."""
    X_WM = frames[0].X_WS @ poses[0].inverse()
    poses = [X_WM @ pose for pose in poses]
    moved = [np.linalg.norm(X.translation() - f.X_WS.translation()) for X, f in zip(poses[1:], frames[1:], strict=True)]
    maps = []
    for X_WS in (poses, [frame.X_WS for frame in frames]):
        voxels = VoxelCloud(VOXEL)
        for X, frame in zip(X_WS, frames, strict=True):
            voxels = voxels.insert(PointCloud(frame.cloud_S.point.positions), X.GetAsMatrix4())
        maps.append(voxels.to_cloud().point.positions.numpy())
    return float(np.mean(moved)), map_error(*maps)


def hall(seeds: int) -> dict[str, float]:
    """Both errors of every method: mean, deviation and largest over the seeds."""
    table: dict[str, list[tuple[float, float, float]]] = {}
    for seed in range(seeds):
        frames = hall_frames(seed)
        clouds = with_classes(frames)
        bare = [frame.cloud_S for frame in frames]
        start = time.perf_counter()
        starts = [align_features(b, a).X_TS for a, b in pairwise(bare)]
        shared = time.perf_counter() - start
        methods: dict[str, Callable[[], Poses]] = {
            "odometry": lambda frames=frames: [frame.X_OS for frame in frames],
            "icp": lambda bare=bare, starts=starts: chain(bare, starts, ICP),
            "attributes": lambda clouds=clouds, starts=starts: chain(clouds, starts, ATTRIBUTES),
            "naraha": lambda clouds=clouds: graph_slam(clouds),
        }
        for name, run in methods.items():
            start = time.perf_counter()
            poses = run()
            seconds = time.perf_counter() - start + (shared if name in ("icp", "attributes") else 0.0)
            table.setdefault(name, []).append((*errors(poses, frames), seconds))
            print(f"seed {seed} {name}: {table[name][-1][0]:.3f} m, map {table[name][-1][1]:.3f} m", flush=True)
    results, rows = {}, []
    for name, values in table.items():
        for key, column in zip(("translation_error_m", "map_error_m", "time_s"), np.array(values).T, strict=True):
            results[f"hall_{name}_{key}"] = float(column.mean())
            results[f"hall_{name}_{key}_deviation"] = float(column.std())
            results[f"hall_{name}_{key}_max"] = float(column.max())
        shown = [
            results[f"hall_{name}_{key}{end}"]
            for key in ("translation_error_m", "map_error_m")
            for end in ("", "_deviation", "_max")
        ]
        rows.append((name, *shown, results[f"hall_{name}_time_s"]))
    for key in ("translation_error_m", "map_error_m"):
        results[f"hall_naraha_{key}_over_icp"] = results[f"hall_naraha_{key}"] / results[f"hall_icp_{key}"]
    columns = ("", "translation [m]", "deviation", "largest", "map [m]", "deviation", "largest", "time [s]")
    print_table(f"frames metres apart in stair_hall, {seeds} seeds", columns, rows)
    return results


def recorded(folder: Path, out: Path) -> dict[str, float]:
    """`naraha map` on the hand-held sequence, and GICP from scan to scan beside it."""
    import json

    if not folder.is_dir():
        print(f"recorded: left out, no such folder: {folder}")
        return {}
    arguments = [str(folder / "scans"), "--truth", str(folder / "poses_tum.txt"), "--scenario", "recorded_gicp"]
    try:
        naraha(["map", *arguments, "--out", str(out), "--set", "recording=null"])
    except SystemExit as ending:
        if ending.code:
            raise
    metrics = json.loads((out / "metrics.json").read_text())
    keys = ("trajectory_error_mean_m", "trajectory_error_max_m", "map_error_m")
    results = {
        f"recorded_{who}_{key}": metrics[f"{prefix}{key}"]
        for who, prefix in (("naraha", ""), ("gicp", "baseline_"))
        for key in keys
    }
    rows = [(who, *(results[f"recorded_{who}_{key}"] for key in keys)) for who in ("naraha", "gicp")]
    print_table("hand-held LiDAR, 177 scans", ("", "mean [m]", "largest [m]", "map [m]"), rows)
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=("hall", "recorded", "all"), default="all")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--recordings", type=Path, default=Path(__file__).parents[3] / "shared/data/balm_hku")
    parser.add_argument("--out", type=Path, default=Path("out/benchmark_map"))
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    arguments = parser.parse_args()
    results: dict[str, float] = {}
    if arguments.scene in ("hall", "all"):
        results |= hall(arguments.seeds)
    if arguments.scene in ("recorded", "all"):
        results |= recorded(arguments.recordings, arguments.out)
    write_json(arguments.json, results)


if __name__ == "__main__":
    main()
