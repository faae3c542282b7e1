"""The scan matcher and the survey map in running diagrams."""

import gc
import weakref
from itertools import pairwise

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.registration import IcpConfig, RegistrationConfig
from naraha.systems.sensing import Scan
from naraha.systems.slam import Keyframe, Odometry6Dof, ScanMatcher, ScanMatcherConfig, SurveyMap, SurveyMapConfig
from naraha.systems.slam.motion import distance_and_angle, scale_motion
from naraha.systems.slam.scan_matcher import odometry_at
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from tests.rooms import make_cloud, pose, room_points

PERIOD = 0.1
X_WB0 = pose(-1.5, -1.0, 0.3, yaw=0.3)
STEP = pose(0.1, 0.0, 0.0, yaw=0.03)  # in one period: 1 m/s
X_BS = pose(0.2, 0.0, 0.5, yaw=0.4)
SLIP = 1.08


def true_pose(time):
    return X_WB0 @ scale_motion(STEP, time / PERIOD)


def odometry(time):
    slipping = RigidTransform(STEP.rotation(), SLIP * STEP.translation())
    return pose(4.0, -3.0, 1.0, yaw=2.0) @ scale_motion(slipping, time / PERIOD)


class RoomLidar(LeafSystem):
    """Publishes, at the end of each revolution, the points of the room as they are seen in the course of it.

    Its X_OB port holds one C++ pose that is written again and again, as that of a real odometry does.
    """

    def __init__(self, bad=()):
        super().__init__()
        self._bad = bad
        nothing = Scan(make_cloud(np.zeros((0, 3))), 0.0, 0.0, -1)
        self._state = self.DeclareAbstractState(AbstractValue.Make(nothing))
        self.DeclareAbstractOutputPort(
            "scan_S",
            lambda: AbstractValue.Make(nothing),
            lambda context, output: output.set_value(context.get_abstract_state(0).get_value()),
            {self.abstract_state_ticket(self._state)},
        )
        self.DeclareAbstractOutputPort(
            "X_OB",
            lambda: AbstractValue.Make(RigidTransform()),
            lambda context, output: output.set_value(odometry(context.get_time())),
            {self.time_ticket()},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Publish)

    def _Publish(self, context, state):
        end = context.get_time()
        index = round(end / PERIOD) - 1
        if index < 0:
            return
        rng = np.random.default_rng(index)
        p_WP = room_points(rng, 2500)
        bins = np.repeat(np.arange(25), 1 + len(p_WP) // 25)[: len(p_WP)]
        rng.shuffle(p_WP)
        for k in range(25):
            X_WS = true_pose(end - PERIOD + PERIOD * (k + 0.5) / 25) @ X_BS
            p_WP[bins == k] = X_WS.inverse().multiply(p_WP[bins == k].T).T
        cloud = make_cloud(p_WP if index not in self._bad else p_WP[:0])
        times = (PERIOD * (bins + 0.5) / 25).astype(np.float32)[: len(cloud.point.positions), None]
        cloud.point["time"] = o3d.core.Tensor(times)
        cloud.point["intensity"] = o3d.core.Tensor(np.full_like(times, 0.5))
        state.get_mutable_abstract_state(0).set_value(Scan(cloud, end - PERIOD, end, index))


def make_diagram(with_odometry=True, bad=(), **config):
    builder = DiagramBuilder()
    lidar = builder.AddNamedSystem("lidar", RoomLidar(bad))
    matcher = builder.AddNamedSystem(
        "matcher", ScanMatcher(ScanMatcherConfig(**config), X_BS=X_BS, X_MB0=X_WB0, with_odometry=with_odometry)
    )
    survey_map = builder.AddNamedSystem("survey_map", SurveyMap(SurveyMapConfig()))
    builder.Connect(lidar.GetOutputPort("scan_S"), matcher.GetInputPort("scan_S"))
    if with_odometry:
        builder.Connect(lidar.GetOutputPort("X_OB"), matcher.GetInputPort("X_OB"))
    builder.Connect(matcher.GetOutputPort("keyframe"), survey_map.GetInputPort("keyframe"))
    return builder.Build()


def read(simulator, name, port):
    system = simulator.get_system().GetSubsystemByName(name)
    return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(simulator.get_context()))


@pytest.fixture(scope="module")
def driven():
    """Two seconds at 1 m/s with odometry; scan 7 has no points."""
    simulator = Simulator(make_diagram(bad=(7,)))
    trace = []
    for i in range(1, 21):
        simulator.AdvanceTo(PERIOD * i + 0.05)
        pose_now, health = read(simulator, "matcher", "X_MB"), read(simulator, "matcher", "health")
        trace.append((simulator.get_context().get_time(), RigidTransform(pose_now), health))
    return simulator, trace


def test_the_pose_is_that_of_now_and_not_that_of_the_last_scan(driven):
    """The robot moves 0.1 m a period; the slip of the odometry, 8 mm a period, is all that may be wrong."""
    _, trace = driven
    for time, X_MB, _ in trace:
        since = 0.5 + 2 * PERIOD  # a keyframe is made every 0.5 m, and two periods pass before it is used
        assert distance_and_angle(true_pose(time).inverse() @ X_MB)[0] < 0.08 * since + 0.02
    drift = (X_WB0 @ odometry(0).inverse() @ odometry(trace[-1][0])).translation() - trace[-1][1].translation()
    assert np.linalg.norm(drift) > 0.1


def test_keyframes_have_the_pose_at_the_end_of_their_scan(driven):
    simulator, _ = driven
    keyframes = read(simulator, "survey_map", "keyframes")
    assert [keyframe.index for keyframe in keyframes] == [0, 5, 10, 15]
    for keyframe in keyframes:
        assert keyframe.time == pytest.approx(PERIOD * (keyframe.index + 1))
        # The odometry at the first update is what is aligned; it slips until the first keyframe.
        assert distance_and_angle(true_pose(keyframe.time).inverse() @ keyframe.X_MB)[0] < 0.03
        assert keyframe.X_OB.IsNearlyEqualTo(odometry(keyframe.time), 1e-6)
    offsets = [
        distance_and_angle((a.X_MB.inverse() @ b.X_MB).inverse() @ true_pose(a.time).inverse() @ true_pose(b.time))[0]
        for a, b in pairwise(keyframes)
    ]
    assert max(offsets) < 0.02


def test_health_counts_the_scan_that_had_no_points(driven):
    _, trace = driven
    skipped = [health.scans_skipped for _, _, health in trace]
    # Scan 7 ends at 0.8 s and is seen at 0.9 s.
    assert skipped == [0] * 8 + [1] * 12
    assert "scan 7 has 0 usable points" in trace[8][2].reason
    assert not trace[8][2].valid
    assert trace[-1][2].valid
    assert trace[-1][2].scans_used == 18
    assert trace[-1][2].time == pytest.approx(1.6)


def test_the_map_is_every_keyframe_at_its_pose(driven):
    simulator, _ = driven
    cloud = read(simulator, "survey_map", "map_M")
    keyframes = read(simulator, "survey_map", "keyframes")
    assert cloud.point["count"].numpy().sum() == sum(k.cloud_B.point["count"].numpy().sum() for k in keyframes)
    np.testing.assert_allclose(cloud.point["intensity"].numpy(), 0.5, atol=1e-6)
    points = cloud.point.positions.numpy()
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [[-5, -4, 0], [5, 4, 3]], atol=0.08)


def test_without_odometry_the_pose_is_that_of_the_last_scan():
    simulator = Simulator(make_diagram(with_odometry=False))
    simulator.AdvanceTo(1.05)
    matcher = simulator.get_system().GetSubsystemByName("matcher")
    assert matcher.num_input_ports() == 1
    X_MB, keyframe = read(simulator, "matcher", "X_MB"), read(simulator, "matcher", "keyframe")
    assert keyframe.index == 8
    assert keyframe.X_OB is None
    assert X_MB.IsExactlyEqualTo(keyframe.X_MB)
    # The first scan is taken to be where the robot started, and as its velocity is not known yet, it stays bent.
    assert distance_and_angle((X_WB0 @ true_pose(0.1).inverse() @ true_pose(0.9)).inverse() @ X_MB)[0] < 0.06


def test_before_the_first_scan_the_pose_is_the_initial_one_and_nothing_is_valid():
    simulator = Simulator(make_diagram())
    simulator.Initialize()
    assert read(simulator, "matcher", "X_MB").IsExactlyEqualTo(X_WB0)
    keyframe = read(simulator, "matcher", "keyframe")
    assert isinstance(keyframe, Keyframe)
    assert keyframe.index == -1
    assert keyframe.p_BP.shape == (0, 3)
    health = read(simulator, "matcher", "health")
    assert (health.valid, health.reason) == (False, "no scan yet")
    assert len(read(simulator, "survey_map", "map_M").point.positions) == 0
    assert read(simulator, "survey_map", "keyframes") == ()
    simulator.AdvanceTo(0.05)
    assert read(simulator, "survey_map", "keyframes") == ()
    expected = X_WB0 @ odometry(0).inverse() @ odometry(0.05)
    assert read(simulator, "matcher", "X_MB").IsNearlyEqualTo(expected, 1e-9)


def test_odometry_between_its_notes_is_interpolated_and_held_outside():
    notes = tuple((t, odometry(t)) for t in (1.0, 1.1, 1.2))
    assert odometry_at(notes, 1.14).IsNearlyEqualTo(odometry(1.14), 1e-9)
    assert odometry_at(notes, 1.1).IsNearlyEqualTo(odometry(1.1), 1e-9)
    assert odometry_at(notes, 0.5) is notes[0][1]
    assert odometry_at(notes, 1.5) is notes[-1][1]


def test_two_runs_are_equal_to_the_last_bit():
    maps = []
    for _ in range(2):
        simulator = Simulator(make_diagram())
        simulator.AdvanceTo(1.25)
        maps.append(read(simulator, "survey_map", "map_M").point.positions.numpy().tobytes())
    assert maps[0] == maps[1]


def test_systems_are_freed():
    simulator = Simulator(make_diagram())
    simulator.AdvanceTo(0.25)
    systems = [simulator.get_system().GetSubsystemByName(name) for name in ("matcher", "survey_map")]
    systems.append(Odometry6Dof())
    references = [weakref.ref(system) for system in systems]
    del simulator, systems
    gc.collect()
    assert [reference() for reference in references] == [None] * 3


def test_wrong_inputs_and_values_are_named():
    matcher = ScanMatcher()
    simulator = Simulator(matcher)
    with pytest.raises(PortError, match=r"ScanMatcher.scan_S: input port is not connected"):
        simulator.AdvanceTo(0.1)
    simulator = Simulator(survey_map := SurveyMap())
    survey_map.GetInputPort("keyframe").FixValue(
        simulator.get_mutable_context(), AbstractValue.Make(("no", "keyframe"))
    )
    with pytest.raises(PortError, match=r"SurveyMap.keyframe: wrong type, got 'tuple' .valid: Keyframe"):
        simulator.AdvanceTo(0.1)
    with pytest.raises(ConfigError, match=r"registration.method: unknown value, got 'magic' .valid: surfaces"):
        ScanMatcher(ScanMatcherConfig(registration=RegistrationConfig(method="magic")))
    with pytest.raises(ConfigError, match=r"registration.icp.max_distances: must not be empty"):
        ScanMatcher(ScanMatcherConfig(registration=RegistrationConfig(icp=IcpConfig(max_distances=[]))))
    with pytest.raises(ConfigError, match="voxel_size: out of range"):
        SurveyMap(SurveyMapConfig(voxel_size=0.0))
