"""Pairs of recorded scans with an accepted pose, from the folder of shared data beside the checkout.

The accepted poses come from other people's software, not from a surveyor, so each pair has a tolerance within which
results are equally good; the READMEs of the data say where each pose is from.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d
from naraha.systems.sensing.scan_files import read_scan
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from scipy.spatial.transform import Rotation

from .registration_scenes import Pair

DATA = Path(__file__).parents[3] / "shared" / "data"


@dataclass(frozen=True, eq=False)
class Recording:
    """A recorded pair: its name, the tolerance of its pose [m], [deg], and to what the peers thin it [m]."""

    name: str
    pair: Pair
    metres: float
    degrees: float
    voxel: float


def recorded_pairs() -> list[Recording]:
    """Every pair with an accepted pose; empty where the data are not there."""
    if not DATA.is_dir():
        print(f"the recorded data are not there: {DATA}")
        return []
    return [*_street(), *_two_sensors(), *_outdoor(), *_car(), *_room(), *_hand_held()]


def small_gicp_suite() -> list[Pair]:
    """The cases of small_gicp's `registration_test.cpp`: its pair forwards and backwards and two shifted copies of the
    source (up to 2 m a direction, 0 to 180°), each from the accepted pose of the copy and from three guesses off by
    up to 0.5 m a direction and 10°. It asks for 0.2 m and 2.5°.

    The random poses are drawn here; those of the original depend on the C++ library.
    """
    folder = DATA / "small_gicp_pair"
    if not folder.is_dir():
        print(f"the recorded data are not there: {folder}")
        return []
    source, target = read_scan(folder / "source.ply"), read_scan(folder / "target.ply")
    X_TS = _pose(np.loadtxt(folder / "T_target_source.txt"))
    rng = np.random.default_rng(0)

    def random_pose(metres: float, low: float, high: float) -> RigidTransform:
        axis = rng.uniform(-1, 1, 3)
        turn = Rotation.from_rotvec(np.deg2rad(rng.uniform(low, high)) * axis / np.linalg.norm(axis))
        return RigidTransform(RotationMatrix(turn.as_matrix()), rng.uniform(-metres, metres, 3))

    noises = [RigidTransform(), *(random_pose(0.5, -10, 10) for _ in range(3))]
    shifts = [random_pose(2.0, 0, 180) for _ in range(2)]
    pairs = []
    for noise in noises:
        pairs.append(Pair(source, target, X_TS, noise))
        pairs.append(Pair(target, source, X_TS.inverse(), noise))
        for X_SC in shifts:
            copy = source.clone().transform(X_SC.inverse().GetAsMatrix4())
            pairs.append(Pair(copy, target, X_TS @ X_SC, X_SC @ noise))
    return pairs


def consecutive_scans(step: int = 1) -> list[Pair]:
    """Neighbours of the hand-held sequence, which moves 0.42 m and 9.8° a scan; the guess is the identity."""
    folder = DATA / "balm_hku"
    if not folder.is_dir():
        print(f"the recorded data are not there: {folder}")
        return []
    scans = [read_scan(file) for file in sorted((folder / "scans").glob("*.pcd"))]
    poses = _tum_poses(folder / "poses_tum.txt")
    return [
        Pair(scans[i + 1], scans[i], poses[i].inverse() @ poses[i + 1], RigidTransform())
        for i in range(0, len(scans) - 1, step)
    ]


def _pose(matrix: np.ndarray) -> RigidTransform:
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(matrix[:3, :3]), matrix[:3, 3])


def _tum_poses(path: Path) -> list[RigidTransform]:
    rows = np.loadtxt(path)
    return [RigidTransform(RotationMatrix(Rotation.from_quat(row[4:8]).as_matrix()), row[1:4]) for row in rows]


def _image(path: Path) -> PointCloud:
    """A scan of an Ouster, with the names that Naraha's LiDAR gives to what it has measured."""
    cloud = read_scan(path)
    cloud.point["column"] = cloud.point["col_destaggered"]
    cloud.point["intensity"] = cloud.point["reflectivity"].to(o3d.core.float32)
    return cloud


def _street() -> Iterator[Recording]:
    folder = DATA / "ouster_sdk"
    scans = [_image(folder / f"lb_n3_{i}.npz") for i in range(3)]
    rows = np.loadtxt(folder / "OS-1-128_v2.3.0_1024x10_lb_n3_poses_kitti.txt").reshape(3, -1, 4)
    poses = [_pose(row) for row in rows]
    for i, k in ((1, 0), (2, 1), (2, 0)):
        pair = Pair(scans[i], scans[k], poses[k].inverse() @ poses[i], RigidTransform())
        yield Recording(f"street_{i}_to_{k}", pair, 0.05, 0.3, 0.25)
    whole = read_scan(folder / "OS-1-128_v2.3.0_1024x10_lb_n3_map-000.ply")
    for i in range(3):
        yield Recording(f"street_{i}_to_map", Pair(scans[i], whole, poses[i], RigidTransform()), 0.05, 0.3, 0.25)


def _two_sensors() -> Iterator[Recording]:
    folder = DATA / "ouster_sdk"
    X_TS = _pose(np.loadtxt(folder / "pose_delta_2_T_s0_s1.txt"))
    source, target = _image(folder / "pose_delta_2_s1.npz"), _image(folder / "pose_delta_2_s0.npz")
    yield Recording("two_sensors", Pair(source, target, X_TS, RigidTransform()), 0.05, 0.3, 0.25)


def _outdoor() -> Iterator[Recording]:
    folder = DATA / "small_gicp_pair"
    X_TS = _pose(np.loadtxt(folder / "T_target_source.txt"))
    pair = Pair(read_scan(folder / "source.ply"), read_scan(folder / "target.ply"), X_TS, RigidTransform())
    # small_gicp's own test allows 0.05 m and 0.05 rad; its README's result is the accepted pose.
    yield Recording("small_gicp", pair, 0.05, 0.5, 0.25)


def _car() -> Iterator[Recording]:
    folder = DATA / "libpointmatcher"
    target = np.loadtxt(folder / "car_cloud400.csv", delimiter=",", skiprows=1, usecols=(0, 1, 2))
    source = np.loadtxt(folder / "car_cloud401.csv")
    clouds = [PointCloud(o3d.core.Tensor(points.astype(np.float32))) for points in (source, target)]
    # `validT3d` of its unit test; the list of clouds has another pose, 0.02 m and 0.3° away.
    X_TS = np.array(
        [
            [0.982304, 0.166685, -0.0854066, 0.0446816],
            [-0.150189, 0.973488, 0.172524, 0.191998],
            [0.111899, -0.156644, 0.981296, -0.0356313],
        ]
    )
    yield Recording("car", Pair(*clouds, _pose(X_TS), RigidTransform()), 0.05, 0.5, 0.1)


def _room() -> Iterator[Recording]:
    folder = DATA / "pcl_data"
    X_TS = _pose(np.loadtxt(folder / "T_scan1_scan2_ourref.txt"))
    odometry = RigidTransform(RollPitchYaw(0, 0, 0.6931), [1.79387, 0.720047, 0])
    source, target = read_scan(folder / "room_scan2.pcd"), read_scan(folder / "room_scan1.pcd")
    yield Recording("room_scan", Pair(source, target, X_TS, odometry), 0.03, 0.3, 0.1)


def _hand_held() -> Iterator[Recording]:
    folder = DATA / "balm_hku"
    poses = _tum_poses(folder / "poses_tum.txt")
    for i, k in ((40, 39), (140, 150)):
        X_TS = poses[k].inverse() @ poses[i]
        # Scans 140 and 150 are 3.3 m and 65° apart: with a guess that is wrong by 0.5 m and 10°.
        guess = RigidTransform() if abs(i - k) == 1 else X_TS @ RigidTransform(RollPitchYaw(0, 0, 0.1745), [0.5, 0, 0])
        source, target = read_scan(folder / f"raw_full{i}.npz"), read_scan(folder / f"raw_full{k}.npz")
        yield Recording(f"hand_held_{i}_to_{k}", Pair(source, target, X_TS, guess), 0.05, 0.3, 0.15)
