"""The local cloud: where points end up, which stay, and what is forgotten."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.clouds import LocalCloud, LocalCloudConfig, heading_frame
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.sensing import Scan
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from scipy.spatial import cKDTree

PERIOD = 0.1
X_BS = RigidTransform(RollPitchYaw(0.0, 0.4, 0.0), [0.15, 0.0, 0.4])
BASE_HEIGHT = 0.1


def make_scan(p_S, index=0, start=0.0, end=0.0, time=None):
    cloud = PointCloud(o3d.core.Tensor(np.ascontiguousarray(p_S, np.float32).reshape(-1, 3)))
    if time is not None:
        cloud.point["time"] = o3d.core.Tensor(np.asarray(time, np.float32)[:, None])
    return Scan(cloud, start, end, index)


class Rig:
    """A local cloud whose inputs are fixed, and which then looks at them."""

    def __init__(self, **config):
        self.system = LocalCloud(LocalCloudConfig(period=PERIOD, base_height=BASE_HEIGHT, **config))
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.set(make_scan([], index=-1), RigidTransform([0, 0, BASE_HEIGHT]), X_BS)

    def set(self, scan=None, X_OB=None, X_BS=None):
        for name, value in (("scan_S", scan), ("X_OB", X_OB), ("X_BS", X_BS)):
            if value is not None:
                self.system.GetInputPort(name).FixValue(self.context, AbstractValue.Make(value))

    def update(self, time):
        """Runs to the event that belongs to a whole period at `time`; returns the cloud in H."""
        self.simulator.AdvanceTo(time + 0.0015)
        return self.cloud()

    def cloud(self):
        return self.system.GetOutputPort("cloud_H").Eval(self.context).point.positions.numpy()

    def take(self, p_O, index, time, X_OB=None, X_BS=X_BS):
        """Takes in a scan of points of O, at rest."""
        X_OB = X_OB or RigidTransform([0, 0, BASE_HEIGHT])
        p_S = ((X_OB @ X_BS).inverse() @ np.asarray(p_O, float).reshape(-1, 3).T).T
        self.set(make_scan(p_S, index, time, time), X_OB, X_BS)
        return self.update(time)


def test_a_point_is_in_the_heading_frame_whichever_way_the_robot_leans_and_heads():
    tilted = RollPitchYaw(0.1, -0.2, 2.0).ToRotationMatrix()
    heading = np.arctan2(tilted.matrix()[1, 0], tilted.matrix()[0, 0])
    rig = Rig()
    place = np.array([3.0, -2.0, 0.5])
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    cloud = rig.take(place + ahead, 0, 0.0, RigidTransform(tilted, place))
    depth = BASE_HEIGHT / tilted.matrix()[2, 2]
    np.testing.assert_allclose(cloud, [[1.0, 0.0, depth]], atol=1e-6)


def test_on_a_slope_the_heading_frame_is_on_the_ground():
    """The base stands 0.1 m square above a plane that rises at 20 degrees."""
    slope = np.deg2rad(20)
    normal = np.array([-np.sin(slope), 0, np.cos(slope)])
    foot = np.array([1.0, 0.0, np.tan(slope)])
    X_OB = RigidTransform(RollPitchYaw(0, -slope, 0), foot + 0.1 * normal)
    p_OH = heading_frame(X_OB.GetAsMatrix4(), 0.1)[:3, 3]
    assert p_OH[2] == pytest.approx(np.tan(slope) * p_OH[0], abs=1e-12)
    np.testing.assert_array_equal(p_OH[:2], X_OB.translation()[:2])


def test_points_stay_where_they_are_while_the_robot_drives_and_turns():
    rig = Rig()
    rng = np.random.default_rng(1)
    ground = np.column_stack([rng.uniform(-2, 2, (300, 2)), np.zeros(300)])
    rig.take(ground, 0, 0.0)
    X_OB = RigidTransform(RollPitchYaw(0, 0, 1.0), [0.5, 0.3, BASE_HEIGHT])
    rig.set(X_OB=X_OB)
    cloud = rig.cloud()  # before any update: the cloud is in H of now
    X_OH = heading_frame(X_OB.GetAsMatrix4(), BASE_HEIGHT)
    back = cloud @ X_OH[:3, :3].T + X_OH[:3, 3]
    distance, _ = cKDTree(ground).query(back)
    assert len(cloud) > 250
    assert distance.max() < 1e-5


def test_of_a_voxel_the_newest_point_stays():
    rig = Rig(clear_after=0)
    rig.take([[1.001, 0.001, 0.001], [1.5, 0.0, 0.0]], 0, 0.0)
    cloud = rig.take([[1.003, 0.002, 0.03], [1.02, 0.01, 0.035]], 1, 0.1)
    np.testing.assert_allclose(cloud, [[1.02, 0.01, 0.035], [1.5, 0.0, 0.0]], atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_there_is_one_point_a_voxel_and_it_is_one_of_the_scans(seed):
    rng = np.random.default_rng(seed)
    rig = Rig(clear_after=0)
    newest = {}
    for index in range(4):
        p_O = rng.uniform([-0.4, -0.4, 0.0], [0.4, 0.4, 0.2], (800, 3)).round(3) + 0.0005
        cloud = rig.take(p_O, index, 0.1 * index)
        for point in p_O:
            newest[tuple(np.floor(point / 0.04).astype(int))] = point
    found = {tuple(np.floor(point / 0.04).astype(int)): point for point in cloud}
    assert len(found) == len(cloud)
    assert found.keys() == newest.keys()
    for key, point in found.items():
        assert np.abs(point - newest[key]).max() < 1e-5


def test_a_scan_is_taken_in_once_and_not_before_the_first_revolution():
    rig = Rig()
    rig.set(make_scan([[1.0, 0, -0.3]], index=-1))
    assert len(rig.update(0.0)) == 0
    rig.take([[1.0, 0, 0]], 0, 0.1)
    # The same scan is still there when the robot has moved on: it must not be put down a second time.
    rig.set(X_OB=RigidTransform([0.5, 0, BASE_HEIGHT]))
    np.testing.assert_allclose(rig.update(0.2), [[0.5, 0, 0]], atol=1e-6)


@pytest.mark.parametrize(("height_time", "largest"), [(0.5, 0.012), (None, 0.05)])
def test_a_height_that_drifts_makes_no_steps(height_time, largest):
    rng = np.random.default_rng(5)
    rig = Rig(height_time=height_time, voxel=0.04)
    floor = np.column_stack([rng.uniform(0, 3, 4000), rng.uniform(-1.5, 1.5, 4000), np.zeros(4000)])
    rig.take(floor, 0, 0.0)
    for index in range(1, 60):
        # The odometry says that the robot rises by 1 mm a scan: in O, so does the ground that it sees.
        drift = 0.001 * index
        X_OB = RigidTransform([0, 0, BASE_HEIGHT + drift])
        near = floor[np.hypot(*floor[:, :2].T) < 1.5]
        cloud = rig.take(near[rng.permutation(len(near))[:700]] + [0, 0, drift], index, 0.1 * index, X_OB)
    heights = cloud[:, 2]
    spread = np.quantile(heights, 0.98) - np.quantile(heights, 0.02)
    assert (spread <= largest) == (height_time is not None)
    assert np.abs(np.median(heights[np.hypot(*cloud[:, :2].T) < 1.0])) < 0.02


def test_points_outside_the_window_are_left_out_and_forgotten_when_it_moves_on():
    rig = Rig(radius=2.0, min_height=-0.5, max_height=0.8)
    inside, outside = [[1.9, 0, 0], [0, 1, 0.79], [0, 1, -0.49]], [[2.1, 0, 0], [0, 1, 0.81], [0, 1, -0.51]]
    assert len(rig.take(inside + outside, 0, 0.0)) == 3
    moved = rig.take([], 1, 0.1, RigidTransform([2.0, 0, BASE_HEIGHT]))
    np.testing.assert_allclose(moved, [[-0.1, 0, 0]], atol=1e-6)


def test_points_are_forgotten_with_time():
    rig = Rig(memory=1.0)
    rig.take([[1, 0, 0]], 0, 0.0)
    assert len(rig.take([[0, 1, 0]], 1, 0.9)) == 2
    np.testing.assert_allclose(rig.take([], 2, 1.5), [[0, 1, 0]], atol=1e-6)


def test_points_are_forgotten_with_the_way_and_turns_count():
    rig = Rig(memory_way=1.0)
    rig.take([[1, 0, 0]], 0, 0.0)
    assert len(rig.take([], 1, 0.1, RigidTransform([0.9, 0, BASE_HEIGHT]))) == 1
    turned = RigidTransform(RollPitchYaw(0, 0, 0.5), [0.9, 0, BASE_HEIGHT])
    assert len(rig.take([], 2, 0.2, turned)) == 0


def test_the_noise_of_a_pose_at_rest_is_no_way():
    rig, rng = Rig(memory_way=0.5), np.random.default_rng(0)
    rig.take([[1, 0, 0]], 0, 0.0)
    for index in range(1, 300):
        X_OB = RigidTransform(RollPitchYaw(rng.normal(0, 2e-3, 3)), rng.normal([0, 0, BASE_HEIGHT], 2e-3))
        cloud = rig.take([], index, 0.1 * index, X_OB)
    assert len(cloud) == 1


def wall(x, step=0.01):
    y, z = np.meshgrid(np.arange(-0.6, 0.6, step), np.arange(0.0, 0.6, step))
    return np.column_stack([np.full(y.size, x), y.ravel(), z.ravel()])


def test_what_has_moved_away_is_gone_after_scans_have_seen_through_it():
    rig = Rig(clear_after=3)
    box = np.random.default_rng(0).uniform([1.0, -0.1, 0.35], [1.2, 0.1, 0.5], (60, 3))
    behind = wall(2.0)
    rig.take(np.vstack([box, behind]), 0, 0.0)
    counts = [int((rig.take(behind, index, 0.1 * index)[:, 0] < 1.5).sum()) for index in range(1, 5)]
    assert counts[1] > 30
    assert counts[2] == 0


def test_what_nothing_looks_at_and_what_is_seen_again_stays():
    rig = Rig(clear_after=2)
    near, low = [[0.0, 0.5, 0.0], [-0.5, 0.0, 0.0]], [[1.0, 0.0, 0.2]]
    for index in range(6):
        # Every other scan sees the wall past the point, the others see the point.
        cloud = rig.take(np.vstack([near, low, wall(2.0)]) if index % 2 == 0 else wall(2.0), index, 0.1 * index)
    for point in (*near, *low):
        assert np.linalg.norm(cloud - point, axis=1).min() < 1e-5


def test_flat_ground_seen_at_a_low_angle_does_not_see_through_itself():
    rig, rng = Rig(clear_after=1), np.random.default_rng(0)
    counts = []
    for index in range(5):
        azimuth, distance = rng.uniform(-np.pi, np.pi, 20_000), rng.uniform(0.5, 3.9, 20_000)
        ground = np.column_stack([distance * np.cos(azimuth), distance * np.sin(azimuth), rng.normal(0, 0.003, 20_000)])
        counts.append(len(rig.take(ground, index, 0.1 * index)))
    assert counts[-1] >= counts[0]


class Turning(LeafSystem):
    """A robot that turns and drives while its sensor tilts, with scans of landmarks, each seen at its own instant."""

    def __init__(self, landmarks):
        super().__init__()
        self._landmarks, self._index = landmarks, -1
        self.DeclareAbstractOutputPort("scan_S", lambda: AbstractValue.Make(make_scan([], -1)), self._CalcScan)
        for name, pose in (("X_OB", self.X_OB), ("X_BS", self.X_BS)):
            self.DeclareAbstractOutputPort(
                name,
                lambda: AbstractValue.Make(RigidTransform()),
                lambda context, output, pose=pose: output.set_value(pose(context.get_time())),
            )

    def X_OB(self, t):
        return RigidTransform(RollPitchYaw(0, 0, 0.8 * t), [0.4 * t, 0, BASE_HEIGHT])

    def X_BS(self, t):
        return RigidTransform(RollPitchYaw(0, 0.3 + 0.8 * t, 0), [0.1, 0, 0.4])

    def _CalcScan(self, context, output):
        index = int(context.get_time() / PERIOD + 1e-6) - 1
        if index < 0:
            return output.set_value(make_scan([], -1))
        start = PERIOD * index
        times = np.linspace(0, PERIOD, len(self._landmarks))
        p_S = [
            (self.X_OB(start + t) @ self.X_BS(start + t)).inverse() @ p
            for t, p in zip(times, self._landmarks, strict=True)
        ]
        return output.set_value(make_scan(p_S, index, start, start + PERIOD, times))


def test_scans_of_a_turning_robot_with_a_tilting_sensor_fall_on_the_same_places():
    rng = np.random.default_rng(0)
    landmarks = rng.uniform([0.5, -1.5, 0.0], [2.0, 1.5, 0.6], (200, 3))
    builder = DiagramBuilder()
    robot = builder.AddSystem(Turning(landmarks))
    local_cloud = builder.AddSystem(LocalCloud(LocalCloudConfig(base_height=BASE_HEIGHT, clear_after=0)))
    for name in ("scan_S", "X_OB", "X_BS"):
        builder.Connect(robot.GetOutputPort(name), local_cloud.GetInputPort(name))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.05)
    context = local_cloud.GetMyContextFromRoot(simulator.get_context())
    cloud = local_cloud.GetOutputPort("cloud_H").Eval(context).point.positions.numpy()
    X_OH = heading_frame(robot.X_OB(1.05).GetAsMatrix4(), BASE_HEIGHT)
    distance, _ = cKDTree(landmarks).query(cloud @ X_OH[:3, :3].T + X_OH[:3, 3])
    assert len(cloud) >= 195
    # 1 ms between the poses and the notes of them, and what the steps of de-skewing leave.
    assert distance.max() < 0.006


def test_points_that_are_not_finite_and_empty_scans_add_nothing():
    rig = Rig()
    rig.set(make_scan([[np.nan, 0, 0], [np.inf, 0, 0], [0, -np.inf, 1], [1e30, 0, 0], [0, 0, 0]], 0, 0.0, 0.0))
    assert len(rig.update(0.0)) == 0
    rig.set(make_scan([], 1, 0.0, 0.1, time=[]))
    cloud = rig.update(0.1)
    assert cloud.shape == (0, 3)
    assert cloud.dtype == np.float32


def test_bad_values_and_wrong_inputs_are_named():
    with pytest.raises(ConfigError, match=r"voxel: out of range.*> 0 m"):
        LocalCloud(LocalCloudConfig(voxel=0.0))
    with pytest.raises(ConfigError, match="min_height: no window"):
        LocalCloud(LocalCloudConfig(min_height=1.0, max_height=0.5))
    system = LocalCloud()
    context = system.CreateDefaultContext()
    with pytest.raises(PortError, match=r"LocalCloud\.X_OB: input port is not connected"):
        system.GetOutputPort("cloud_H").Eval(context)
