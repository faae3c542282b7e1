"""The pose graph of a running survey: as functions, at its ports, and in a simulation."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.ports import weak_method
from naraha.systems.pose_graph import (
    KeyframeGraph,
    LoopDetectionConfig,
    PlaceRecognition,
    PoseGraphConfig,
    PoseGraphSlam,
    RobustLoopsConfig,
    add_keyframe,
    finish,
)
from naraha.systems.pose_graph.keyframe_graph import registration_covariance
from naraha.systems.slam import Keyframe, KeyframePoses, OdometryAccuracy, odometry_covariance
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from tests.pose_graph.ring import drive
from tests.rooms import make_cloud, pose, room_scan


@pytest.fixture(scope="module")
def ring():
    return drive()


def run(keyframes, config=None, recognition=None):
    known = KeyframeGraph()
    for keyframe in keyframes:
        known = add_keyframe(known, keyframe, config or PoseGraphConfig(), recognition)
    return known


def errors(poses, truth):
    return np.array([np.linalg.norm(X.translation() - T.translation()) for X, T in zip(poses, truth, strict=True)])


def test_a_loop_in_a_square_corridor_takes_the_drift_out(ring):
    keyframes, truth = ring
    known = run(keyframes)
    drifted = errors([keyframe.X_MB for keyframe in keyframes], truth)
    assert drifted[-1] > 0.8
    accepted = [loop for loop in known.loops if loop.accepted]
    assert accepted
    for loop in accepted:
        true = truth[loop.first].inverse() @ truth[loop.second]
        assert np.linalg.norm(loop.X_ij.translation() - true.translation()) < 0.05
    poses = [known.published.of(keyframe) for keyframe in keyframes]
    assert errors(poses, truth)[-1] < 0.1
    assert errors(poses, truth).max() < 0.6 * drifted.max()
    assert known.published.version >= 1
    done = finish(known, PoseGraphConfig()).published
    assert errors([done.of(keyframe) for keyframe in keyframes], truth)[-1] < 0.1


def test_without_candidates_poses_are_the_chain_of_steps(ring):
    keyframes, _ = ring
    config = PoseGraphConfig(loops=LoopDetectionConfig(max_candidates=0))
    known = run(keyframes, config)
    assert known.published.version == 0
    assert known.published.of(keyframes[-1]).IsNearlyEqualTo(keyframes[-1].X_MB, 1e-6)
    assert known.loops == known.refused == ()


def two_rooms(seed=0):
    """A room, a way of 12 m that is known well, and a second room which is the same from where the robot stands."""
    rng = np.random.default_rng(seed)
    here = [pose(0.3 * k) for k in range(4)]
    covariance = np.diag(np.square([0.002, 0.002, 0.005, 0.03, 0.03, 0.01]))
    keyframes = []
    for room in range(2):
        for k, X in enumerate(here):
            X_MB = RigidTransform([12.0 * room, 0, 0]) @ X
            X_PB = keyframes[-1].X_MB.inverse() @ X_MB if keyframes else None
            cloud = make_cloud(room_scan(rng, X))
            keyframes.append(Keyframe(len(keyframes), 0.1 * len(keyframes), X_MB, None, cloud, 1.0, X_PB, covariance))
            del k
    return keyframes


ALIKE = PlaceRecognition(
    describe=lambda cloud: np.zeros(1),
    distance=lambda a, b: np.zeros(len(b)),
    align=lambda source, target: RigidTransform(),
)


def test_a_second_room_that_looks_the_same_is_not_the_first_one():
    keyframes = two_rooms()
    # 12 m away is near enough to be looked at, whatever the poses say.
    known = run(keyframes, PoseGraphConfig(loops=LoopDetectionConfig(min_way=5.0, near=20.0)), ALIKE)
    # The geometry fits, so that they get as far as the test of consistency, and all of them agree with each other.
    assert len(known.loops) >= 3
    assert not any(loop.accepted for loop in known.loops)
    assert all("off by chi2" in loop.reason for loop in known.loops)
    assert known.published.of(keyframes[-1]).IsNearlyEqualTo(keyframes[-1].X_MB, 0.02)


def test_edges_are_as_sure_as_their_sources():
    config = PoseGraphConfig(registration_deviation=0.03, registration_deviation_deg=1.0)
    covariance = np.diag([0, 0, 0, 0.04, 0.0, 0.0])  # along M's x axis
    turned = pose(yaw=np.pi / 2)
    keyframe = Keyframe(1, 0.0, turned, None, make_cloud([[0, 0, 0]]), 1.0, None, covariance)
    floor = np.repeat([np.deg2rad(1.0) ** 2, 0.03**2], 3)
    np.testing.assert_allclose(
        np.diag(registration_covariance(keyframe, config)), floor + np.array([0, 0, 0, 0, 0.04, 0]), atol=1e-12
    )
    lost = replace(keyframe, health=0.0)
    assert registration_covariance(lost, config)[3, 3] == pytest.approx(config.blind_deviation**2)
    no_covariance = replace(keyframe, covariance=None)
    np.testing.assert_allclose(np.diag(registration_covariance(no_covariance, config)), floor)
    assert odometry_covariance(pose(2.0, z=0.0), OdometryAccuracy(slip=0.2, least_deviation=0.03))[
        3, 3
    ] == pytest.approx(0.4**2 + 0.03**2)


def test_odometry_bridges_what_registration_does_not_know():
    """A step that was dead reckoned wrongly, by a keyframe of health 0, is drawn to the odometry."""
    cloud = make_cloud(np.zeros((0, 3)))
    first = Keyframe(0, 0.0, RigidTransform(), pose(0, z=0), cloud, 1.0)
    second = Keyframe(1, 0.1, pose(1.5, z=0), pose(1.0, z=0), cloud, 0.0, pose(1.5, z=0))
    config = PoseGraphConfig(odometry=OdometryAccuracy(slip=0.1), optimize_every=1)
    known = run([first, second], config)
    x = known.published.of(second).translation()[0]
    weights = np.array([0.5, np.hypot(0.1, config.registration_deviation)]) ** -2.0
    assert x == pytest.approx(weights @ [1.5, 1.0] / weights.sum(), abs=1e-4)


def test_gravity_of_the_odometry_levels_a_map_that_tilts():
    cloud = make_cloud(np.zeros((0, 3)))
    tilt = RigidTransform(RollPitchYaw(0, 0.02, 0), [0, 0, 0])
    keyframes, X_MB = [], RigidTransform()
    for k in range(10):
        X_PB = RigidTransform([1.0, 0, 0]) @ tilt if k else None
        X_MB = X_MB @ X_PB if X_PB else X_MB
        keyframes.append(Keyframe(k, 0.1 * k, X_MB, pose(k, z=0), cloud, 1.0, X_PB))
    blurred = PoseGraphConfig(registration_deviation_deg=1.0, use_odometry=False)
    pitch = RollPitchYaw(finish(run(keyframes, blurred), blurred).places[-1].X_MB.rotation()).pitch_angle()
    assert pitch > 0.1
    config = replace(blurred, attitude_deviation_deg=0.3)
    pitch = RollPitchYaw(finish(run(keyframes, config), config).places[-1].X_MB.rotation()).pitch_angle()
    assert abs(pitch) < 0.03


def test_versions_of_a_keyframe():
    cloud, other = make_cloud([[0, 0, 0]]), make_cloud([[1, 0, 0]])
    first = Keyframe(3, 0.0, RigidTransform(), None, cloud, 1.0)
    known = run([first, replace(first, cloud_B=other)])
    assert len(known.keyframes) == 1
    assert known.places[0].cloud_B is other
    second = Keyframe(5, 0.1, pose(1.0), None, cloud, 1.0)
    known = run([first, second])
    assert add_keyframe(known, first, PoseGraphConfig()) is known
    assert add_keyframe(known, replace(first, index=-1), PoseGraphConfig()) is known
    assert set(known.published.poses) == {3, 5}


# At the ports


class Sender(LeafSystem):
    """Hands out one keyframe a period."""

    def __init__(self, keyframes):
        super().__init__()
        self._keyframes = keyframes
        self.DeclareAbstractOutputPort(
            "keyframe", lambda: AbstractValue.Make(keyframes[0]), weak_method(self._Calc), {self.time_ticket()}
        )

    def _Calc(self, context, output):
        index = min(int(context.get_time() / 0.1 + 1e-6), len(self._keyframes) - 1)
        output.set_value(self._keyframes[index])


def read(system, context, port):
    return system.GetOutputPort(port).Eval(context)


def test_a_keyframe_at_the_port_is_taken_in_once():
    system = PoseGraphSlam()
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    assert read(system, context, "keyframe_poses").poses == {}
    assert read(system, context, "health").reason == "no keyframe yet"
    keyframe = Keyframe(7, 0.0, pose(1.0), None, make_cloud([[0, 0, 0]]), 1.0)
    system.GetInputPort("keyframe").FixValue(context, AbstractValue.Make(keyframe))
    simulator.AdvanceTo(0.35)
    poses = read(system, context, "keyframe_poses")
    assert isinstance(poses, KeyframePoses)
    assert list(poses.poses) == [7]
    assert poses.poses[7].IsExactlyEqualTo(keyframe.X_MB)
    assert read(system, context, "loops") == ()
    assert (read(system, context, "health").keyframes, read(system, context, "health").valid) == (1, False)
    assert list(read(system, context, "batch_poses").poses) == [7]


def test_a_survey_of_the_ring_in_a_simulation(ring):
    keyframes, truth = ring
    traces = []
    for _ in range(2):
        builder = DiagramBuilder()
        sender = builder.AddNamedSystem("sender", Sender(keyframes))
        system = builder.AddNamedSystem("graph", PoseGraphSlam())
        builder.Connect(sender.GetOutputPort("keyframe"), system.GetInputPort("keyframe"))
        for port in ("keyframe_poses", "health", "batch_poses"):
            builder.ExportOutput(system.GetOutputPort(port), port)
        simulator = Simulator(diagram := builder.Build())
        context = simulator.get_context()
        simulator.AdvanceTo(2.95)
        halfway = read(diagram, context, "keyframe_poses")
        assert len(halfway.poses) == 30
        assert read(diagram, context, "health").loops_accepted == 0
        simulator.AdvanceTo(0.1 * len(keyframes) + 0.05)
        poses, health = read(diagram, context, "keyframe_poses"), read(diagram, context, "health")
        assert poses.version > halfway.version
        assert health.valid
        assert health.loops_accepted >= 1
        assert errors([poses.of(keyframe) for keyframe in keyframes], truth)[-1] < 0.1
        assert len(halfway.poses) == 30  # what was given out does not change
        traces.append([X.GetAsMatrix4().tobytes() for X in read(diagram, context, "batch_poses").poses.values()])
    assert traces[0] == traces[1]


def test_the_system_is_freed():
    system = PoseGraphSlam()
    reference = weakref.ref(system)
    Simulator(system)
    del system
    gc.collect()
    assert reference() is None


def test_wrong_inputs_and_values_are_named():
    simulator = Simulator(system := PoseGraphSlam())
    with pytest.raises(PortError, match=r"PoseGraphSlam.keyframe: input port is not connected"):
        simulator.AdvanceTo(0.1)
    simulator = Simulator(system)
    system.GetInputPort("keyframe").FixValue(simulator.get_mutable_context(), AbstractValue.Make(("no", "keyframe")))
    with pytest.raises(PortError, match=r"PoseGraphSlam.keyframe: wrong type, got 'tuple' .valid: Keyframe"):
        simulator.AdvanceTo(0.1)
    with pytest.raises(ConfigError, match="slip: out of range"):
        PoseGraphSlam(PoseGraphConfig(odometry=OdometryAccuracy(slip=0.0)))
    with pytest.raises(ConfigError, match=r"robust.confidence: out of range"):
        PoseGraphSlam(PoseGraphConfig(robust=RobustLoopsConfig(confidence=0.1)))
