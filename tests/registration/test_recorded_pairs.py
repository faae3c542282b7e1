"""Recorded pairs of clouds, with the poses that others accept for them."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.registration import RegistrationConfig, register
from naraha.systems.slam.motion import distance_and_angle
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RotationMatrix

from tests.rooms import make_cloud, pose


def rigid(X):
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(X[:3, :3]), X[:3, 3])


def error(X_AB, X_true):
    distance, angle = distance_and_angle(X_true.inverse() @ X_AB)
    return distance, np.rad2deg(angle)


@pytest.fixture(scope="module")
def outdoors(shared_data):
    """Source, target and X_TS of small_gicp's own tests."""
    folder = shared_data / "small_gicp_pair"
    clouds = [o3d.t.io.read_point_cloud(str(folder / f"{name}.ply")) for name in ("source", "target")]
    source, target = (make_cloud(cloud.point.positions.numpy()) for cloud in clouds)
    return source, target, rigid(np.loadtxt(folder / "T_target_source.txt"))


def offsets():
    """Identity and three poses off by up to 0.5 m an axis and 10° about any axis, as in their registration_test.cpp."""
    rng = np.random.default_rng(0)
    yield RigidTransform()
    for _ in range(3):
        axis = rng.uniform(-1, 1, 3)
        turn = np.deg2rad(10) * rng.uniform(-1, 1) * axis / np.linalg.norm(axis)
        K = np.cross(np.eye(3), turn)
        yield RigidTransform(RotationMatrix.ProjectToRotationMatrix(np.eye(3) - K), rng.uniform(-0.5, 0.5, 3))


@pytest.mark.parametrize("inverse", [False, True])
def test_small_gicps_own_tests_pass_with_ours(outdoors, inverse):
    """koide3/small_gicp, src/test/registration_test.cpp: 0.2 m and 2.5° from guesses that are off, both ways."""
    source, target, X_TS = outdoors
    if inverse:
        source, target, X_TS = target, source, X_TS.inverse()
    for X_guess in offsets():
        result = register(source, target, X_guess)
        distance, angle = error(result.X_TS, X_TS)
        assert result.valid, result.reason
        assert distance < 0.2
        assert angle < 2.5
        assert distance < 0.04  # what the peers reach from identity: 0.007 to 0.06 m, 0.15 to 0.33°
        assert angle < 0.35


def test_small_gicps_own_test_with_a_source_in_another_frame(outdoors):
    source, target, X_TS = outdoors
    rng = np.random.default_rng(1)
    X_SA = pose(*rng.uniform(-2, 2, 3), *rng.uniform(-0.5, 0.5, 2), 2.5)
    shifted = make_cloud(X_SA.inverse().multiply(source.point.positions.numpy().astype(float).T).T)
    for X_offset in offsets():
        result = register(shifted, target, X_SA @ X_offset)
        distance, angle = error(result.X_TS, X_TS @ X_SA)
        assert distance < 0.2
        assert angle < 2.5


def ouster(folder, name, organised):
    with np.load(folder / f"{name}.npz") as data:
        cloud = make_cloud(data["xyz"])
        if organised:
            for attribute, key, kind in (("ring", "ring", np.uint8), ("column", "col_destaggered", np.uint16)):
                cloud.point[attribute] = o3d.core.Tensor(np.ascontiguousarray(data[key].astype(kind)[:, None]))
    return cloud


@pytest.mark.parametrize("organised", [True, False])
def test_a_street_seen_by_128_rings(shared_data, organised):
    """Poses of the Ouster SDK's own SLAM; peers from 0.007 to 0.037 m of them."""
    folder = shared_data / "ouster_sdk"
    poses = np.loadtxt(folder / "OS-1-128_v2.3.0_1024x10_lb_n3_poses_kitti.txt").reshape(-1, 3, 4)
    scans = [ouster(folder, f"lb_n3_{i}", organised) for i in range(3)]
    for source, target in ((1, 0), (2, 0)):
        result = register(scans[source], scans[target], RigidTransform())
        assert result.valid, result.reason
        assert result.fitness > 0.85
        distance, angle = error(result.X_TS, rigid(poses[target]).inverse() @ rigid(poses[source]))
        assert distance < 0.03
        assert angle < 0.15


def test_two_heads_on_one_car(shared_data):
    folder = shared_data / "ouster_sdk"
    X_true = rigid(np.loadtxt(folder / "pose_delta_2_T_s0_s1.txt").reshape(4, 4))
    source, target = (ouster(folder, f"pose_delta_2_s{i}", True) for i in (1, 0))
    result = register(source, target, RigidTransform())
    assert result.valid, result.reason
    distance, angle = error(result.X_TS, X_true)
    assert distance < 0.05
    assert angle < 0.2


def test_a_park_without_planes_from_another_attitude(shared_data):
    """libpointmatcher's car_cloud, 14.5° apart; its own test asks for 0.1 m and 0.1 rad, peers reach 0.03 to 0.05 m."""
    folder = shared_data / "libpointmatcher"
    target = np.loadtxt(folder / "car_cloud400.csv", delimiter=",", skiprows=1)[:, :3]
    source = np.loadtxt(folder / "car_cloud401.csv")[:, :3]
    truth = np.loadtxt(folder / "carCloudList.csv", delimiter=",", skiprows=2, usecols=range(1, 17)).reshape(4, 4)
    result = register(make_cloud(source), make_cloud(target), RigidTransform())
    assert result.valid, result.reason
    distance, angle = error(result.X_TS, rigid(truth))
    assert distance < 0.05
    assert angle < 0.3


def test_rooms_41_degrees_and_2_metres_apart(shared_data):
    """PCL's room_scan from identity, where GICP is lost; the reference is a GICP result that others agree with."""
    folder = shared_data / "pcl_data"
    clouds = [o3d.t.io.read_point_cloud(str(folder / f"room_scan{i}.pcd")) for i in (2, 1)]
    source, target = (PointCloud(cloud.point.positions) for cloud in clouds)
    X_true = rigid(np.loadtxt(folder / "T_scan1_scan2_ourref.txt").reshape(4, 4))
    result = register(source, target, RigidTransform(), RegistrationConfig(max_correction=3.0))
    assert result.valid, result.reason
    distance, angle = error(result.X_TS, X_true)
    assert distance < 0.03
    assert angle < 0.2
