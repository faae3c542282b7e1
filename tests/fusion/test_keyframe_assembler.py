"""Depth points, normals and tilts in keyframes."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.clouds import VoxelCloud, voxel_filter
from naraha.systems.errors import CameraError, ConfigError, PortError
from naraha.systems.fusion.keyframe_assembler import (
    KeyframeAssembler,
    KeyframeAssemblerConfig,
    depth_points,
    join_clouds,
    surface_layers,
)
from naraha.systems.slam import Keyframe
from naraha.systems.slam.keyframe import NO_KEYFRAME
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageDepth32F

from .box_world import BOX_ROOM, DEPTH, looking

X_BD = looking(0.1, 0.0, 0.48, pitch=0.17)


def depth_image(depth):
    image = ImageDepth32F(depth.shape[1], depth.shape[0])
    image.mutable_data[:, :, 0] = depth
    return image


def lidar_cloud(points):
    cloud = PointCloud(o3d.core.Tensor(np.asarray(points, np.float32)))
    cloud.point["intensity"] = o3d.core.Tensor(np.full((len(points), 1), 0.25, np.float32))
    return voxel_filter(cloud, 0.1)


def room_keyframe(time=1.0, index=0, X_OB=None):
    rng = np.random.default_rng(0)
    d = rng.standard_normal((12000, 3))
    t, box, _ = BOX_ROOM.cast(np.array([0, 0, 0.6]), d)
    points = np.array([0, 0, 0.6]) + t[box >= 0, None] * d[box >= 0]
    return Keyframe(index, time, RigidTransform(), X_OB or RigidTransform(), lidar_cloud(points), 1.0)


class Rig:
    """An assembler whose inputs are set by hand."""

    def __init__(self, **config):
        self.system = KeyframeAssembler(KeyframeAssemblerConfig(**config), camera=DEPTH, X_BD=X_BD)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.set(keyframe=NO_KEYFRAME, depth_image=depth_image(np.zeros(DEPTH.shape)), image_time=[np.nan])
        self.set(rpy=[0, 0, 0], X_OB=RigidTransform())

    def set(self, **values):
        for name, value in values.items():
            self.system.GetInputPort(name).FixValue(self.context, value)

    def until(self, time):
        self.simulator.AdvanceTo(time)
        return self.system.GetOutputPort("keyframe").Eval(self.context)


def test_a_keyframe_gets_the_depth_points_and_keeps_those_of_the_lidar():
    rig = Rig()
    assert rig.until(0.95).index == -1
    keyframe = room_keyframe()
    rig.set(keyframe=keyframe, depth_image=depth_image(BOX_ROOM.depth(DEPTH, X_BD)), image_time=[1.02])
    cloud = rig.until(1.15).cloud_B.point
    lidar = len(keyframe.p_BP)
    points, intensity = cloud.positions.numpy(), cloud.intensity.numpy()[:, 0]
    assert len(points) > lidar + 3000
    np.testing.assert_array_equal(points[:lidar], keyframe.p_BP)
    assert np.isfinite(intensity[:lidar]).all()
    assert np.isnan(intensity[lidar:]).all()
    start = X_BD.translation()
    t, _, _ = BOX_ROOM.cast(start, points[lidar:] - start)
    off = np.abs(t - 1) * np.linalg.norm(points[lidar:] - start, axis=1)
    assert np.quantile(off, 0.95) < 0.05  # mean points of voxels at edges are off the surface


def test_the_result_can_be_put_into_the_survey_map():
    rig = Rig()
    rig.set(keyframe=room_keyframe(), depth_image=depth_image(BOX_ROOM.depth(DEPTH, X_BD)), image_time=[1.0])
    keyframe = rig.until(1.15)
    cloud = VoxelCloud(0.1).insert(keyframe.cloud_B, np.eye(4)).to_cloud()
    assert set(dict(cloud.point.items())) == {"positions", "count", "intensity", "tilt"}
    intensity, tilt = cloud.point["intensity"].numpy(), cloud.point["tilt"].numpy()
    np.testing.assert_allclose(intensity[np.isfinite(intensity)], 0.25, atol=1e-6)
    assert np.isfinite(tilt).mean() > 0.7


def test_normals_face_the_sensor_and_tilts_are_those_of_the_surfaces_whatever_the_robot_leans():
    lean = RollPitchYaw(0.1, -0.15, 0.7)
    X_WB = RigidTransform(lean, np.array([0, 0, 0.1]))
    X_WD = X_WB @ X_BD
    rig = Rig()
    rig.set(rpy=lean.vector(), depth_image=depth_image(BOX_ROOM.depth(DEPTH, X_WD)), image_time=[1.0])
    rig.set(keyframe=Keyframe(0, 1.0, RigidTransform(), RigidTransform(), PointCloud(), 1.0))
    rig.until(0.95)
    cloud = rig.until(1.15).cloud_B.point
    p_BP, normals, tilt = cloud.positions.numpy(), cloud.normals.numpy(), cloud.tilt.numpy()[:, 0]
    known = normals.any(axis=1)
    assert known.mean() > 0.7
    np.testing.assert_array_equal(np.isnan(tilt), ~known)
    assert (np.einsum("ij,ij->i", normals, X_BD.translation() - p_BP)[known] >= 0).all()
    z = X_WB.multiply(p_BP.astype(float).T)[2]
    near = np.linalg.norm(p_BP, axis=1) < 3
    floor, wall = known & near & (z < 0.01), known & (z > 0.7)
    assert floor.sum() > 200
    assert wall.sum() > 100
    assert np.quantile(tilt[floor], 0.95) < np.deg2rad(2)
    assert np.quantile(np.abs(tilt[wall] - np.pi / 2), 0.9) < np.deg2rad(4)


def test_the_tilt_is_that_at_the_keyframe_and_not_at_its_arrival():
    rig = Rig()
    points = np.random.default_rng(0).uniform([0.5, -2, -0.08], [4, 2, -0.08], (3000, 3))
    rig.until(0.95)
    rig.set(rpy=[0.3, 0, 0], keyframe=Keyframe(0, 0.9, RigidTransform(), None, lidar_cloud(points), 1.0))
    tilt = rig.until(1.05).cloud_B.point["tilt"].numpy()
    assert np.nanmax(tilt) < 0.01


def test_what_the_robot_moved_between_image_and_keyframe_is_taken_out():
    def wall_distance(X_OB_at_image):
        rig = Rig()
        rig.set(X_OB=X_OB_at_image)
        rig.until(0.95)
        X_OB = RigidTransform([0.2, 0, 0])
        rig.set(X_OB=X_OB, depth_image=depth_image(BOX_ROOM.depth(DEPTH, X_BD)), image_time=[0.9])
        rig.set(keyframe=Keyframe(0, 1.0, RigidTransform(), X_OB, PointCloud(), 1.0))
        points = rig.until(1.05).p_BP
        return points[points[:, 2] > 1.2, 0].max()

    assert wall_distance(RigidTransform()) == pytest.approx(4.3, abs=0.01)  # 0.2 m nearer than in the image
    assert wall_distance(RigidTransform([0.2, 0, 0])) == pytest.approx(4.5, abs=0.01)


def test_of_the_remembered_images_the_nearest_in_time_is_taken():
    rig = Rig(memory=1.0)
    for time, distance in [(0.5, 1.0), (0.7, 2.0), (0.9, 3.0)]:
        rig.until(time - 0.01)
        rig.set(depth_image=depth_image(np.full(DEPTH.shape, distance)), image_time=[time])
    rig.until(1.0)
    rig.set(keyframe=Keyframe(0, 0.72, RigidTransform(), RigidTransform(), PointCloud(), 1.0))
    cloud = rig.until(1.15).p_BP
    in_D = X_BD.inverse().multiply(cloud.astype(float).T)
    np.testing.assert_allclose(in_D[2], 2.0, atol=1e-3)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, 0.1, 20.0])
def test_a_depth_image_without_any_usable_depth_leaves_the_lidar_points(value):
    rig = Rig()
    keyframe = room_keyframe()
    rig.set(keyframe=keyframe, depth_image=depth_image(np.full(DEPTH.shape, value)), image_time=[1.0])
    result = rig.until(1.15)
    np.testing.assert_array_equal(result.p_BP, keyframe.p_BP)
    assert {"normals", "tilt", "intensity", "count"} <= set(dict(result.cloud_B.point.items()))


@pytest.mark.parametrize("image_time", [np.nan, -1.0, 0.2])
def test_no_image_or_one_that_is_too_old_leaves_the_lidar_points(image_time):
    rig = Rig()
    keyframe = room_keyframe()
    rig.set(keyframe=keyframe, depth_image=depth_image(BOX_ROOM.depth(DEPTH, X_BD)), image_time=[image_time])
    np.testing.assert_array_equal(rig.until(1.15).p_BP, keyframe.p_BP)


def test_an_image_of_another_size_is_refused_with_port_and_size():
    rig = Rig()
    rig.set(keyframe=room_keyframe(), depth_image=depth_image(np.ones((24, 32))), image_time=[1.0])
    with pytest.raises(CameraError, match=r"KeyframeAssembler\.depth_image: .*\(24, 32\).*\(valid: 240, 320\)"):
        rig.until(1.15)
    with pytest.raises(CameraError, match="depth_image"):
        depth_points(np.ones((3, 4)), DEPTH, X_BD, KeyframeAssemblerConfig())


def test_points_of_the_robot_itself_are_dropped():
    config = KeyframeAssemblerConfig(body_low=[0.9, -0.5, -1], body_high=[1.2, 0.5, 2], voxel_size=0.0)
    points = depth_points(np.full(DEPTH.shape, 1.0, np.float32), DEPTH, X_BD, config)
    assert 0 < len(points) < DEPTH.width * DEPTH.height
    assert not ((points >= config.body_low) & (points <= config.body_high)).all(axis=1).any()


def test_attributes_that_one_part_lacks_are_not_known_there():
    cloud = lidar_cloud([[1, 0, 0], [2, 0, 0]])
    cloud.point["label"] = o3d.core.Tensor(np.array([[1], [2]], np.uint8))
    joined = join_clouds(cloud, np.array([[3, 0, 0]], np.float32)).point
    np.testing.assert_array_equal(joined.label.numpy()[:, 0], [1, 2, np.nan])
    np.testing.assert_array_equal(joined["count"].numpy()[:, 0], [1, 1, 1])
    np.testing.assert_array_equal(joined.positions.numpy()[:, 0], [1, 2, 3])


def test_surfaces_of_nothing_are_nothing():
    layers = surface_layers(np.zeros((0, 3), np.float32), np.zeros(3), np.array([0, 0, 1]), 0.5)
    assert layers["normals"].shape == (0, 3)
    assert layers["tilt"].shape == (0,)


def test_bad_configuration_and_inputs_are_named():
    with pytest.raises(ConfigError, match="voxel_size"):
        KeyframeAssembler(KeyframeAssemblerConfig(voxel_size=-1), camera=DEPTH, X_BD=X_BD)
    with pytest.raises(ConfigError, match="body_low"):
        KeyframeAssembler(KeyframeAssemblerConfig(body_low=[0, 0]), camera=DEPTH, X_BD=X_BD)
    rig = Rig()
    rig.set(keyframe="a keyframe")
    with pytest.raises(PortError, match=r"KeyframeAssembler\.keyframe"):
        rig.until(0.2)
