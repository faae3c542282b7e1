"""The LeafSystem: keyframes once and in their last version, corrections, and contexts that go their own way."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.slam import Keyframe
from naraha.systems.slam.keyframe import NO_KEYFRAME, KeyframePoses
from naraha.systems.voxel_map import FREE, OCCUPIED, UNKNOWN, OccupancyMap, OccupancyMapConfig, VoxelMapConfig
from open3d.t.geometry import PointCloud
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

LIDAR = np.array([0.05, 0.05, 0.05])


def keyframe(index, points, x=0.0, nir=None):
    cloud = PointCloud(o3d.core.Tensor(np.array(points, np.float32)))
    if nir is not None:
        cloud.point["nir"] = o3d.core.Tensor(np.full((len(points), 1), nir, np.float32))
    return Keyframe(index, 0.1 * index, RigidTransform([x, 0, 0]), None, cloud, 1.0)


WALL = [[1.05, 0.05, 0.05]]


class Mapping:
    """The system in a simulator that takes one input a period."""

    def __init__(self, config=None, p_BS=LIDAR, with_corrections=False):
        self.system = OccupancyMap(config, p_BS=p_BS, with_corrections=with_corrections)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.ticks = 0

    def take(self, one=None, poses=None):
        for name, value in (("keyframe", one), ("keyframe_poses", poses)):
            if value is not None:
                self.system.GetInputPort(name).FixValue(self.context, Value(value))
        self.simulator.AdvanceTo(0.1 * self.ticks + 0.05)
        self.ticks += 1
        return self

    def output(self, name="voxel_map", context=None):
        return self.system.GetOutputPort(name).Eval(context or self.context)

    def state(self, *points):
        return self.output().state(np.array(points)).tolist()


def test_a_keyframe_makes_its_points_occupied_and_its_rays_free():
    mapping = Mapping().take(keyframe(0, WALL, x=2.0))
    assert mapping.state([3.05, 0.05, 0.05], [2.55, 0.05, 0.05], [3.25, 0.05, 0.05]) == [OCCUPIED, FREE, UNKNOWN]
    cloud = mapping.output("occupied_M")
    np.testing.assert_allclose(cloud.point.positions.numpy(), [[3.05, 0.05, 0.05]], atol=1e-6)
    np.testing.assert_allclose(cloud.point["occupancy"].numpy(), [[0.7]], rtol=1e-6)


def test_rays_start_at_the_lidar_and_not_at_the_base():
    mapping = Mapping(p_BS=np.array([0.05, 1.05, 0.05])).take(keyframe(0, WALL))
    assert mapping.state([0.05, 1.05, 0.05], [0.05, 0.05, 0.05]) == [FREE, UNKNOWN]


def test_before_the_first_keyframe_the_map_is_empty():
    mapping = Mapping().take(NO_KEYFRAME)
    assert len(mapping.output().known()[1]) == 0
    assert len(mapping.output("occupied_M").point.positions) == 0


def test_the_last_version_of_a_keyframe_is_what_counts_and_only_once():
    mapping = Mapping()
    for nir in (None, 0.2, 0.6):
        mapping.take(keyframe(0, WALL, nir=nir))
    cloud = mapping.output("occupied_M")
    np.testing.assert_allclose(cloud.point["nir"].numpy(), [[0.6]], rtol=1e-6)
    np.testing.assert_allclose(cloud.point["occupancy"].numpy(), [[0.7]], rtol=1e-6)
    mapping.take(keyframe(1, WALL, nir=0.8))
    np.testing.assert_allclose(mapping.output("occupied_M").point["nir"].numpy(), [[0.7]], rtol=1e-6)
    mapping.take(keyframe(0, [[5.05, 0.05, 0.05]]))
    assert len(mapping.output("occupied_M").point.positions) == 1


def test_corrected_poses_move_what_was_mapped_before():
    mapping = Mapping(OccupancyMapConfig(scans=1), with_corrections=True).take(keyframe(0, WALL), KeyframePoses())
    mapping.take(keyframe(1, WALL, x=3.0)).take(keyframe(2, WALL, x=6.0))
    poses = {k: RigidTransform([3.0 * k, 0.1 * k, 0]) for k in range(3)}
    mapping.take(poses=KeyframePoses(1, poses))
    places = [[1.05, 0.05, 0.05], [4.05, 0.15, 0.05], [7.05, 0.25, 0.05]]
    np.testing.assert_allclose(mapping.output("occupied_M").point.positions.numpy(), places, atol=1e-6)
    before = repr(mapping.output())
    mapping.take(poses=KeyframePoses(2, dict(poses)))
    assert repr(mapping.output()) == before


def test_a_keyframe_without_a_corrected_pose_stays_until_it_has_one():
    mapping = Mapping(OccupancyMapConfig(scans=1), with_corrections=True).take(keyframe(0, WALL), KeyframePoses())
    mapping.take(keyframe(1, WALL, x=3.0))
    assert mapping.state([4.05, 0.05, 0.05]) == [OCCUPIED]
    late = {0: RigidTransform(), 1: RigidTransform([3.0, 2.0, 0])}
    mapping.take(poses=KeyframePoses(0, late))  # new poses come without a new version
    assert mapping.state([1.05, 0.05, 0.05], [4.05, 2.05, 0.05], [4.05, 0.05, 0.05]) == [OCCUPIED, OCCUPIED, UNKNOWN]


def test_a_cloned_context_goes_its_own_way():
    mapping = Mapping().take(keyframe(0, WALL)).take(keyframe(1, WALL, x=0.1))
    before = repr(mapping.output())
    clone = mapping.context.Clone()
    assert repr(mapping.output(context=clone)) == before
    other = Simulator(mapping.system, clone)
    for k in range(2, 5):
        mapping.system.GetInputPort("keyframe").FixValue(clone, Value(keyframe(k, WALL, x=0.5 * k)))
        other.AdvanceTo(0.1 * k + 0.05)
    after = repr(mapping.output(context=clone))
    assert repr(mapping.output()) == before != after
    mapping.take(keyframe(2, [[0.05, 2.05, 0.05]]))
    assert repr(mapping.output(context=clone)) == after
    assert repr(mapping.output()) not in (before, after)


def test_the_map_that_goes_out_cannot_be_written_to():
    mapping = Mapping().take(keyframe(0, WALL))
    with pytest.raises(ValueError, match="frozen"):
        mapping.output().insert(np.array(WALL), LIDAR)


def test_unusable_inputs_and_configurations_are_refused():
    with pytest.raises(PortError, match="keyframe"):
        Mapping().take()
    with pytest.raises(PortError, match="keyframe_poses"):
        Mapping(with_corrections=True).take(keyframe(0, WALL), poses=keyframe(0, WALL))
    with pytest.raises(PortError, match="keyframe_poses"):
        Mapping(with_corrections=True).take(keyframe(0, WALL))
    config = OccupancyMapConfig(voxels=VoxelMapConfig(voxel_size=-1.0))
    with pytest.raises(ConfigError, match=r"voxels\.voxel_size"):
        OccupancyMap(config)
