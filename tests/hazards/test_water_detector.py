"""The water detector: what it counts of a drive, when it evaluates the map, and how good it is with every filter."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.hazards.shot_grid import HIT, MIRROR, MISSING, ShotConfig
from naraha.systems.hazards.water import FILTERS, WaterConfig, cloud_attribute, cloud_points, water_probability
from naraha.systems.hazards.water_detector import WaterDetector
from naraha.systems.ports import weak_method
from naraha.systems.sensing import Scan
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from tests.hazards.pool_hall import (
    MAT,
    PATTERN,
    POOL,
    RADIUS,
    hall_map,
    hall_scene,
    iou,
    scan_between,
    sensor_pose,
)
from tests.sensing.conftest import ShapeWorld

X_BS = RigidTransform([0.0, 0.0, 0.22])
SPEED, START = 0.5, -0.8


class Robot(LeafSystem):
    """Plays a drive: scans and poses as a LiDAR and a scan matcher give them, and a map whose evaluations it counts."""

    def __init__(self, scans, poses, map_M):
        super().__init__()
        self.maps = 0
        self._scans, self._poses, self._map = scans, poses, map_M
        for name, calc, value in (
            ("scan_S", self._calc_scan, object()),
            ("X_MB", self._calc_pose, RigidTransform()),
            ("map_M", self._calc_map, object()),
        ):
            self.DeclareAbstractOutputPort(name, lambda value=value: AbstractValue.Make(value), weak_method(calc))

    def _calc_scan(self, context, output):
        output.set_value(self._scans[min(round(context.get_time() / 0.1), len(self._scans) - 1)])

    def _calc_pose(self, context, output):
        output.set_value(self._poses(context.get_time()))

    def _calc_map(self, context, output):
        self.maps += 1
        output.set_value(self._map)


def no_scan():
    return Scan(PointCloud(o3d.core.Tensor(np.zeros((0, 3), np.float32))), 0.0, 0.0, -1)


def base_pose(time):
    return sensor_pose(START + SPEED * time) @ X_BS.inverse()


def drive(scans, poses=base_pose, map_M=None, seconds=6.0, config=None):
    builder = DiagramBuilder()
    robot = builder.AddSystem(Robot(scans, poses, PointCloud() if map_M is None else map_M))
    detector = builder.AddSystem(WaterDetector(config, X_BS=X_BS, pattern=PATTERN))
    for name in ("map_M", "scan_S", "X_MB"):
        builder.Connect(robot.GetOutputPort(name), detector.GetInputPort(name))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(seconds)
    context = detector.GetMyContextFromRoot(simulator.get_context())
    return robot, lambda name: detector.GetOutputPort(name).Eval(context)


@pytest.fixture(scope="module")
def scans():
    """One scan every 0.1 s for 6 s; the one of t = 0 is empty."""
    scene = hall_scene(ShapeWorld())
    found = [no_scan()]
    for i in range(60):
        time = 0.1 * i
        ends = (base_pose(t) @ X_BS for t in (time, time + 0.1))
        found.append(scan_between(scene, *ends, i, start_time=time))
    return found


def test_the_drive_past_the_pool_leaves_evidence_and_does_not_evaluate_the_map(scans):
    robot, output = drive(scans)
    shots = output("shots")
    assert robot.maps == 0
    around = np.stack(np.meshgrid([-0.1, 0, 0.1], [-0.1, 0, 0.1]), -1).reshape(-1, 2)
    assert shots.log_likelihood_ratio(POOL + around).min() > 2
    assert shots.log_likelihood_ratio(MAT + around).max() < -2
    assert (shots.counts(POOL + around)[:, [MISSING, MIRROR]].sum(axis=1) > 20).all()


def test_each_filter_contributes_and_all_together_find_the_pool_and_no_trap(scans):
    map_M, truth = hall_map()
    robot, output = drive(scans, map_M=map_M)
    found = output("water_probability")
    assert robot.maps == 1
    columns = {name: cloud_attribute(map_M, name) for name in ("nir", "nir_range", "tilt")}
    reached = []
    for count in range(1, 5):
        filters = FILTERS[:count]
        probability = water_probability(cloud_points(map_M), **columns, shots=output("shots"), filters=filters)
        reached.append(iou(probability > 0.5, truth))
    assert reached[0] < reached[1] < reached[2] < reached[3]
    assert reached[2] < 0.5
    assert reached[3] > 0.85
    assert iou(found > 0.5, truth) > 0.85
    (puddle,) = output("puddles")
    np.testing.assert_allclose(puddle.p_MC, [*POOL, 0], atol=0.03)
    assert puddle.area == pytest.approx(np.pi * RADIUS**2, rel=0.15)
    assert robot.maps == 1


def test_a_robot_that_stands_still_counts_one_scan(scans):
    still = [Scan(scans[1].cloud_S, 0.1 * i, 0.1 * i + 0.1, i) for i in range(30)]
    _, output = drive([no_scan(), *still], lambda time: base_pose(0.0), seconds=3.0)
    _, once = drive([no_scan(), *still[:1]], lambda time: base_pose(0.0), seconds=3.0)
    assert output("shots").counts([[1.0, 0.5]])[0, HIT] == once("shots").counts([[1.0, 0.5]])[0, HIT] > 0


@pytest.mark.parametrize("place", [RigidTransform([0, 0, 0.3]), RigidTransform(RollPitchYaw(0, -0.3, 0), [0, 0, 0])])
def test_a_robot_on_a_step_or_a_ramp_says_nothing_of_the_floor(scans, place):
    def poses(time):
        return base_pose(time) @ (RigidTransform() if time < 1.05 else place)

    _, output = drive(scans[:41], poses, seconds=4.0)
    _, before = drive(scans[:11], seconds=4.0)
    assert output("shots").tiles.keys() == before("shots").tiles.keys()
    assert all((output("shots").tiles[key] == tile).all() for key, tile in before("shots").tiles.items())


@pytest.mark.parametrize("fault", ["nan pose", "jump", "stale scan", "no rings", "no scan"])
def test_scans_that_cannot_be_placed_are_left_out(scans, fault):
    poses, played = base_pose, scans[:11]
    if fault == "nan pose":
        poses = lambda time: RigidTransform([np.nan, 0, 0])  # noqa: E731
    elif fault == "jump":
        poses = lambda time: RigidTransform([10 * time, 0, 0.08])  # noqa: E731
    elif fault == "stale scan":
        played = [Scan(scan.cloud_S, -5.0, -4.9, scan.index) for scan in played]
    elif fault == "no rings":
        played = [Scan(PointCloud(scan.cloud_S.point.positions), 0.0, 0.1, scan.index) for scan in played]
    else:
        played = [no_scan()]
    _, output = drive(played, poses, seconds=1.0)
    assert output("shots").tiles == {}
    assert output("water_probability").shape == (0,)
    assert output("puddles") == ()


def test_one_pose_that_is_not_finite_costs_little(scans):
    def poses(time):
        return RigidTransform([np.nan, 0, 0]) if abs(time - 2.0) < 0.01 else base_pose(time)

    _, output = drive(scans, poses)
    assert output("shots").log_likelihood_ratio([POOL])[0] > 2


def test_maps_with_nothing_known_are_unknown(scans):
    cloud = PointCloud(o3d.core.Tensor(np.float32([[*POOL, 0.0], [-50, 0, 0]])))
    _, output = drive(scans, map_M=cloud)
    probability = output("water_probability")
    assert probability[0] > 0.5  # the LiDAR is sure
    assert np.isnan(probability[1])


def test_wrong_inputs_are_refused(scans):
    with pytest.raises(ConfigError, match=r"shots\.cell"):
        WaterDetector(WaterConfig(shots=ShotConfig(cell=0.0)), X_BS=X_BS, pattern=PATTERN)
    detector = WaterDetector(X_BS=X_BS, pattern=PATTERN)
    with pytest.raises(PortError, match="map_M"):
        detector.GetOutputPort("puddles").Eval(detector.CreateDefaultContext())
    with pytest.raises(PortError, match="scan_S"):
        drive([{"not": "a scan"}], seconds=0.2)
