"""The chain replay → scan matching → map on real scans, against recorded poses that nothing in the chain sees."""

import numpy as np
import pytest
from naraha.systems.registration import IcpConfig, RegistrationConfig
from naraha.systems.sensing import ScanReplay, list_scans, read_poses
from naraha.systems.slam import ScanMatcher, ScanMatcherConfig, SurveyMap, map_error, rebuild_map, trajectory_error
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

# Frame to frame from where the last scan was, and whatever comes out is taken.
NAIVE = ScanMatcherConfig(
    reference="previous_keyframe",
    guess="none",
    local_map_voxel=0.1,
    registration=RegistrationConfig(
        method="generalized",
        icp=IcpConfig(max_distances=[1.0], max_iterations=50, source_voxel=0.0),
        retry_yaws_deg=[],
        min_fitness=0.0,
        min_constraint=0.0,
        max_correction=1000.0,
        max_correction_deg=180.0,
    ),
)


def track_recorded(folder, count, config):
    """Returns keyframes, true poses and health after mapping the first `count` scans."""
    truth = read_poses(folder / "poses_tum.txt")
    builder = DiagramBuilder()
    scans = list_scans(folder / "scans")[:count]
    replay = builder.AddNamedSystem("replay", ScanReplay(scans, times=truth.times[:count]))
    matcher = builder.AddNamedSystem("matcher", ScanMatcher(config, with_odometry=False))
    survey_map = builder.AddNamedSystem("survey_map", SurveyMap())
    builder.Connect(replay.GetOutputPort("scan_S"), matcher.GetInputPort("scan_S"))
    builder.Connect(matcher.GetOutputPort("keyframe"), survey_map.GetInputPort("keyframe"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(replay.duration + 0.15)

    def read(system, port):
        return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(simulator.get_context()))

    assert read(replay, "scans_skipped")[0] == 0
    return read(survey_map, "keyframes"), truth, read(matcher, "health")


def errors(keyframes, truth):
    """Mean and largest error of the positions, and map error, with the first pose aligned [m]."""
    times = [keyframe.time for keyframe in keyframes]
    X = np.array([keyframe.X_MB.GetAsMatrix4() for keyframe in keyframes])
    X_true = np.linalg.inv(truth.X_WS[0]) @ truth.X_WS[[keyframe.index for keyframe in keyframes]]
    maps = [rebuild_map(keyframes, poses, 0.1).point.positions.numpy() for poses in (X, X_true)]
    return *trajectory_error(times, X, truth.times, truth.X_WS), map_error(*maps)


def test_the_first_seconds_of_a_hand_held_lidar(balm):
    keyframes, truth, health = track_recorded(balm, 20, ScanMatcherConfig())
    assert [keyframe.index for keyframe in keyframes] == list(range(20))
    assert health.valid
    assert health.scans_skipped == 0
    assert "intensity" in keyframes[0].cloud_B.point
    mean, largest, of_map = errors(keyframes, truth)
    assert mean < 0.05
    assert largest < 0.1
    assert of_map < 0.05


@pytest.mark.slow
def test_74_metres_of_a_hand_held_lidar(balm):
    keyframes, truth, health = track_recorded(balm, 177, ScanMatcherConfig())
    mean, largest, of_map = errors(keyframes, truth)
    print(f"local map: mean {mean:.3f} m, largest {largest:.3f} m, map {of_map:.3f} m")
    assert len(keyframes) == 177
    assert health.scans_skipped == 0
    assert mean < 0.15
    assert largest < 0.3
    assert of_map < 0.1


@pytest.mark.slow
def test_naive_registration_from_scan_to_scan_is_lost_there(balm):
    """What the local map, the velocity and the turns of the guess are good for."""
    keyframes, truth, _ = track_recorded(balm, 177, NAIVE)
    mean, largest, of_map = errors(keyframes, truth)
    print(f"naive GICP: mean {mean:.3f} m, largest {largest:.3f} m, map {of_map:.3f} m")
    assert len(keyframes) == 177
    assert mean > 1.0
    assert largest > 5.0
