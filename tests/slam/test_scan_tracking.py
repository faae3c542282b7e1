"""Tracking from scan to scan, without Drake: poses, keyframes, and what happens to scans that cannot be used."""

import copy
from dataclasses import replace
from itertools import pairwise

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.registration import RegistrationConfig
from naraha.systems.sensing import Scan
from naraha.systems.slam import KeyframePoses, ScanMatcherConfig, Track, track_scan
from naraha.systems.slam.motion import distance_and_angle, scale_motion
from naraha.systems.slam.scan_tracking import choose_keyframes, correct_track, prepare_cloud
from pydrake.math import RigidTransform

from tests.rooms import make_cloud, pose, room_points, room_scan

X_BS = pose(0.2, 0.0, 0.5, 0.0, 0.1, 0.3)
PERIOD = 0.1


def path(count, step=0.2, turn=0.03):
    """Poses of the base along a bend, starting in the middle of the room."""
    X = [pose(-1.5, -1.0, 0.3, yaw=0.4)]
    for _ in range(count - 1):
        X.append(X[-1] @ pose(step, 0.0, 0.0, yaw=turn))
    return X


def scan_at(X_WB, index, points=4000, seed=None):
    rng = np.random.default_rng(index if seed is None else seed)
    cloud = make_cloud(room_scan(rng, X_WB @ X_BS, points))
    return Scan(cloud, PERIOD * index, PERIOD * index, index)


def follow(X_WB, config, odometry=None, scans=None):
    """Tracks along true poses X_WB; returns the track after each scan. odometry: X_OB at each scan."""
    track, tracks = Track(X_WB[0], X_OB=odometry[0] if odometry else None), []
    for i in range(len(X_WB)):
        scan = scans[i] if scans else scan_at(X_WB[i], i)
        span = (odometry[i], odometry[i]) if odometry else None
        track = track_scan(track, scan, X_BS, config, span)
        tracks.append(track)
    return tracks


def errors(tracks, X_WB):
    return [distance_and_angle(X.inverse() @ track.X_MB)[0] for track, X in zip(tracks, X_WB, strict=True)]


def slipping(X_WB, slip=0.1):
    """Odometry that sees every step too long, in a frame of its own."""
    X_OB = [pose(7.0, 7.0, 0.0, yaw=-1.0)]
    for before, after in pairwise(X_WB):
        step = before.inverse() @ after
        X_OB.append(X_OB[-1] @ RigidTransform(step.rotation(), (1 + slip) * step.translation()))
    return X_OB


@pytest.mark.parametrize("reference", ["local_map", "previous_keyframe"])
def test_without_odometry_every_scan_is_registered_and_found(reference):
    X_WB = path(12)
    tracks = follow(X_WB, ScanMatcherConfig(reference=reference))
    assert max(errors(tracks, X_WB)) < (0.02 if reference == "local_map" else 0.1)
    assert [track.keyframe.index for track in tracks] == list(range(12))
    assert [track.health.scans_used for track in tracks] == list(range(1, 13))
    assert tracks[-1].health.valid
    assert tracks[-1].keyframe.X_OB is None


def test_with_odometry_only_scans_that_moved_are_registered_and_correct_its_slip():
    X_WB = path(16)
    X_OB = slipping(X_WB)
    tracks = follow(X_WB, ScanMatcherConfig(), X_OB)
    # 0.22 m a step by odometry: the third step is the first beyond 0.5 m.
    assert sorted({track.keyframe.index for track in tracks}) == [0, 3, 6, 9, 12, 15]
    drift = np.linalg.norm((X_WB[0] @ X_OB[0].inverse() @ X_OB[-1]).translation() - X_WB[-1].translation())
    assert drift > 0.25
    assert errors(tracks, X_WB)[-1] < 0.02
    for track in tracks:
        k = track.keyframe
        assert (track.X_MO @ k.X_OB).IsNearlyEqualTo(k.X_MB, 1e-9)
        assert k.time == pytest.approx(PERIOD * k.index)
    assert tracks[-1].health.scans_used == 16
    assert tracks[-1].health.scans_skipped == 0


def test_a_turn_in_place_makes_keyframes_too():
    X_WB = path(9, step=0.0, turn=np.deg2rad(8))
    tracks = follow(X_WB, ScanMatcherConfig(), X_WB)
    assert sorted({track.keyframe.index for track in tracks}) == [0, 2, 4, 6, 8]


@pytest.mark.parametrize(("turn", "expected"), [(0.1, 2), (0.01, 1)])
def test_a_robot_that_comes_to_rest_after_a_small_motion_makes_one_more_keyframe(turn, expected):
    """It turns for five scans and stands for five more; the whole turn is below `keyframe_angle_deg`."""
    yaws = [0.0, *np.linspace(0, turn, 6), *[turn] * 5]
    X_OB = [pose(-1.5, -1.0, 0.3, yaw=yaw) for yaw in yaws]
    track, made = Track(X_OB[0], X_OB=X_OB[0]), []
    for i in range(1, len(yaws)):
        scan = replace(scan_at(X_OB[i], i), start_time=PERIOD * (i - 1))
        track = track_scan(track, scan, X_BS, ScanMatcherConfig(), (X_OB[i - 1], X_OB[i]))
        made.append(track.keyframe.index)
    assert len(set(made)) == expected
    if expected == 2:
        assert made[-1] == 7  # the first scan during which it stood still
        assert track.keyframe.health > 0.5


def test_tracks_that_slide_unseen_are_followed_when_the_last_pose_is_old():
    """It slides 6 cm a scan to the side, of which odometry sees nothing, and creeps 2 cm ahead."""
    X_WB = [pose(-1.5 + 0.02 * i, -1.5 + 0.06 * i, 0.3) for i in range(16)]
    X_OB = [pose(-1.5 + 0.02 * i, -1.5, 0.3) for i in range(16)]
    patient, prompt = (follow(X_WB, ScanMatcherConfig(max_wait=wait), X_OB) for wait in (None, 0.5))
    assert max(errors(patient, X_WB)) > 0.8
    assert sorted({track.keyframe.index for track in prompt}) == [0, 5, 10, 15]
    assert max(errors(prompt, X_WB)) < 0.3
    still = follow(X_WB[:1] * 16, ScanMatcherConfig(max_wait=0.5), X_OB[:1] * 16)
    assert {track.keyframe.index for track in still} == {0}


def test_while_the_robot_tips_it_waits_for_a_calm_scan():
    """Odometry that is half a scan late is off by 4° in the middle of tipping; a pose found then would stay off."""
    pitches = np.deg2rad([0, 0, 0, -8, -16, -24, -24, -24, -24])
    X_WB = [pose(-1.5 + 0.18 * i, -1.0, 0.3, pitch=pitch) for i, pitch in enumerate(pitches)]
    late = [pitches[0], *(0.5 * (a + b) for a, b in pairwise(pitches))]
    X_OB = [pose(*X.translation(), pitch=pitch) for X, pitch in zip(X_WB, late, strict=True)]

    def follow_tipping(config):
        """Scans that were registered, and how far the odometry frame, which is the world, ever leaned in the map."""
        track, made, lean = Track(X_WB[0], X_OB=X_OB[0]), set(), 0.0
        for i in range(1, len(X_WB)):
            scan = replace(scan_at(X_WB[i], i), start_time=PERIOD * (i - 1))
            track = track_scan(track, scan, X_BS, config, (X_OB[i - 1], X_OB[i]))
            made.add(track.keyframe.index)
            lean = max(lean, np.rad2deg(distance_and_angle(track.X_MO)[1]))
        return made, lean

    # By their way alone, the fourth and the seventh scan are registered.
    made, lean = follow_tipping(ScanMatcherConfig(keyframe_angle_deg=90, max_swing_deg=90))
    assert made == {1, 4, 7}
    assert lean > 3
    made, lean = follow_tipping(ScanMatcherConfig(keyframe_angle_deg=90))
    assert made == {1, 7}
    assert lean < 0.5


def test_the_first_scan_is_placed_where_odometry_says():
    X_WB = path(3)
    track = Track(X_WB[0], X_OB=pose(5.0, 0.0, 0.0))
    X_OB = pose(5.0, 0.0, 0.0) @ X_WB[0].inverse() @ X_WB[2]
    track = track_scan(track, scan_at(X_WB[2], 2), X_BS, ScanMatcherConfig(), (X_OB, X_OB))
    assert track.X_MB.IsNearlyEqualTo(X_WB[2], 1e-12)
    assert track.keyframe.index == 2


def test_a_keyframe_has_the_scan_in_the_base_frame_with_its_attributes():
    X_WB = pose(0.5, 0.0, 0.3)
    scan = scan_at(X_WB, 0)
    scan.cloud_S.point["intensity"] = o3d.core.Tensor(np.full((len(scan.p_SP), 1), 0.25, np.float32))
    scan.cloud_S.point["ring"] = o3d.core.Tensor(np.zeros((len(scan.p_SP), 1), np.uint8))
    keyframe = track_scan(Track(X_WB), scan, X_BS, ScanMatcherConfig()).keyframe
    names = {name for name, _ in keyframe.cloud_B.point.items()}
    assert names == {"positions", "intensity", "count"}
    np.testing.assert_allclose(keyframe.cloud_B.point["intensity"].numpy(), 0.25)
    # The walls, the floor and the ceiling of the room are where they are when the base is where it is.
    p_WP = keyframe.X_MB.multiply(keyframe.p_BP.T.astype(float)).T
    np.testing.assert_allclose(p_WP.min(axis=0), [-5, -4, 0], atol=0.03)
    np.testing.assert_allclose(p_WP.max(axis=0), [5, 4, 3], atol=0.03)


@pytest.mark.parametrize("with_odometry", [True, False])
def test_a_moving_sensor_does_not_bend_the_keyframe(with_odometry):
    """Each point is measured at its own instant of a sweep of 0.1 s at 2 m/s and 1.5 rad/s."""
    motion = pose(0.2, 0.0, 0.0, yaw=0.15)
    X_WB0 = pose(-1.0, -1.0, 0.3)
    ends = [X_WB0, X_WB0 @ motion, X_WB0 @ motion @ motion]

    def sweep(X_start, index):
        rng = np.random.default_rng(index)
        p_WP = room_points(rng, 3000)
        fraction = rng.random(len(p_WP))
        X_WS = [X_start @ scale_motion(motion, s) @ X_BS for s in fraction]
        cloud = make_cloud([X.inverse().multiply(p) for X, p in zip(X_WS, p_WP, strict=True)])
        cloud.point["time"] = o3d.core.Tensor((PERIOD * fraction[:, None]).astype(np.float32))
        return Scan(cloud, PERIOD * index, PERIOD * (index + 1), index)

    config = ScanMatcherConfig(keyframe_distance=0.1)
    track = Track(ends[0], X_OB=ends[0] if with_odometry else None)
    for i in range(2):
        if not with_odometry:  # the velocity is known from the step before
            track = replace(track, step=motion, step_time=PERIOD)
        span = (ends[i], ends[i + 1]) if with_odometry else None
        track = track_scan(track, sweep(ends[i], i), X_BS, config, span)
    assert distance_and_angle(ends[2].inverse() @ track.X_MB)[0] < 0.02
    p_WP = ends[2].multiply(track.keyframe.p_BP.T.astype(float)).T
    np.testing.assert_allclose([p_WP.min(axis=0), p_WP.max(axis=0)], [[-5, -4, 0], [5, 4, 3]], atol=0.02)
    raw = ends[2].multiply(X_BS.multiply(sweep(ends[1], 1).p_SP.T.astype(float))).T
    assert np.abs(np.abs([raw.min(axis=0), raw.max(axis=0)]) - [[5, 4, 0], [5, 4, 3]]).max() > 0.1


def test_distant_and_near_points_are_left_out():
    scan = Scan(make_cloud([[0.1, 0, 0], [1, 0, 0], [0, 5, 0], [0, 0, 11], [np.nan, 1, 1]]), 0.0, 0.0, 0)
    config = ScanMatcherConfig(min_range=0.5, max_range=10.0)
    cloud = prepare_cloud(scan, RigidTransform(), RigidTransform(), config)
    assert sorted(map(tuple, cloud.point.positions.numpy().tolist())) == [(0, 5, 0), (1, 0, 0)]


def empty_scan(index):
    return Scan(make_cloud(np.zeros((0, 3))), PERIOD * index, PERIOD * index, index)


def nan_scan(index):
    return Scan(make_cloud(np.full((500, 3), np.nan)), PERIOD * index, PERIOD * index, index)


def foreign_scan(index):
    points = np.random.default_rng(index).uniform(-40, 40, (4000, 3))
    return Scan(make_cloud(points), PERIOD * index, PERIOD * index, index)


@pytest.mark.parametrize("bad", [empty_scan, nan_scan, foreign_scan])
@pytest.mark.parametrize("with_odometry", [True, False])
def test_a_bad_scan_is_skipped_counted_and_named_and_the_run_goes_on(bad, with_odometry):
    X_WB = path(8, step=0.6)
    scans = [scan_at(X, i) for i, X in enumerate(X_WB)]
    scans[3] = bad(3)
    tracks = follow(X_WB, ScanMatcherConfig(), X_WB if with_odometry else None, scans)
    assert [track.health.scans_skipped for track in tracks] == [0, 0, 0, 1, 1, 1, 1, 1]
    assert [track.health.valid for track in tracks] == [True] * 3 + [False] + [True] * 4
    assert tracks[3].health.health == 0
    assert tracks[3].health.reason.startswith("scan 3")
    assert tracks[3].health.time == tracks[2].health.time
    assert tracks[3].keyframe.index == 2
    assert tracks[4].health.reason == ""
    assert errors(tracks[4:], X_WB[4:])[-1] < 0.03


def test_scans_before_the_first_revolution_and_repeated_ones_do_not_count():
    X = pose()
    track = track_scan(Track(X), empty_scan(-1), X_BS, ScanMatcherConfig())
    assert track.health.scans_skipped == track.health.scans_used == 0
    assert track.health.reason == "no scan yet"
    assert not track.health.valid
    first = track_scan(track, scan_at(X, 0), X_BS, ScanMatcherConfig())
    assert track_scan(first, scan_at(X, 0), X_BS, ScanMatcherConfig()) is first


def test_after_many_failures_a_new_map_starts_where_odometry_says():
    X_WB = path(14, step=0.6, turn=0.3)
    config = ScanMatcherConfig(max_failures=3)
    scans = [scan_at(X, i) for i, X in enumerate(X_WB)]
    # From scan 4 on the robot is in another room, which fits nothing that was mapped.
    other = pose(3.0, 1.0, 0.2, 0.1, 0.1, 0.7)
    for i in range(4, 14):
        rng = np.random.default_rng(i)
        p_WP = other.multiply((room_points(rng, 4000) * [0.6, 0.5, 1.4] + [6.0, 9.0, 3.0]).T).T
        scans[i] = Scan(make_cloud((X_WB[i] @ X_BS).inverse().multiply(p_WP.T).T), PERIOD * i, PERIOD * i, i)
    tracks = follow(X_WB, config, X_WB, scans)
    assert [track.health.scans_skipped for track in tracks[3:8]] == [0, 1, 2, 3, 3]
    placed = tracks[6]
    assert not placed.health.valid
    assert "new local map by dead reckoning after 3 failures" in placed.health.reason
    assert placed.keyframe.index == 6
    assert placed.keyframe.health == 0
    assert placed.X_MB.IsNearlyEqualTo(tracks[3].X_MO @ X_WB[6], 1e-9)
    assert tracks[-1].health.valid
    assert tracks[-1].health.scans_used == 11
    assert errors(tracks, X_WB)[-1] < 0.1


def test_a_gap_in_the_scans_is_bridged_at_the_last_velocity():
    X_WB = path(12, step=0.25)
    seen = [0, 1, 2, 3, 4, 7, 8, 9, 10, 11]
    track = Track(X_WB[0])
    for i in seen:
        track = track_scan(track, scan_at(X_WB[i], i), X_BS, ScanMatcherConfig(registration=RegistrationConfig()))
        assert distance_and_angle(X_WB[i].inverse() @ track.X_MB)[0] < 0.03
    assert track.health.scans_skipped == 0


def test_where_the_robot_was_before_old_keyframes_join_the_local_map():
    X_WB = [pose(0.5 * i) for i in range(20)] + [pose(1.0, 0.3)]
    keyframes = tuple(replace(Track(X).keyframe, index=i, X_MB=X) for i, X in enumerate(X_WB))
    config = ScanMatcherConfig(local_map_keyframes=3, revisited_keyframes=4, revisit_distance=4.0)
    chosen = [keyframe.index for keyframe in choose_keyframes(keyframes, config)]
    # By quarters of the distance: 1 to 3 are nearer than 1 m, 0 and 4 nearer than 2 m, and 0 is older.
    assert chosen == [0, 1, 2, 3, 18, 19, 20]
    fewer = replace(config, revisited_keyframes=2)
    assert [keyframe.index for keyframe in choose_keyframes(keyframes, fewer)] == [1, 2, 18, 19, 20]
    # On the way out these are the ones before the last: 16 at 1.5 m, 14 and 15 nearer than 3 m.
    assert [keyframe.index for keyframe in choose_keyframes(keyframes[:20], fewer)] == [14, 16, 17, 18, 19]
    alone = replace(config, revisited_keyframes=0)
    assert [keyframe.index for keyframe in choose_keyframes(keyframes, alone)] == [18, 19, 20]
    assert [keyframe.index for keyframe in choose_keyframes(keyframes[:1], config)] == [0]


def test_a_copy_of_the_track_is_the_track():
    """Drake copies every abstract state of a diagram at every update; this one says that it cannot change."""
    track = track_scan(Track(pose()), scan_at(pose(), 0), X_BS, ScanMatcherConfig())
    assert copy.deepcopy(track) is track
    assert copy.deepcopy(track.keyframe) is track.keyframe
    assert copy.deepcopy(track.health) is track.health


def test_a_correction_moves_the_robot_and_its_local_map_and_tracking_goes_on_there():
    X_WB, config = path(16), ScanMatcherConfig()
    X_OB = slipping(X_WB)
    track = follow(X_WB[:10], config, X_OB[:10])[-1]
    assert track.keyframe.X_PB is not None
    X_MM = pose(0.3, -0.2, 0.1, yaw=0.2)  # the whole map turns out to lie elsewhere
    poses = KeyframePoses(1, {k.index: X_MM @ k.X_MB for k in track.mapped})
    corrected = correct_track(track, poses, config)
    assert correct_track(corrected, poses, config) is corrected
    moved, _ = distance_and_angle((X_MM @ track.X_MB).inverse() @ corrected.X_MB)
    assert moved < 1e-9
    for i in range(10, 16):
        corrected = track_scan(corrected, scan_at(X_WB[i], i), X_BS, config, (X_OB[i], X_OB[i]))
    assert corrected.health.scans_skipped == 0
    off, _ = distance_and_angle((X_MM @ X_WB[15]).inverse() @ corrected.X_MB)
    assert off < 0.02


def test_a_keyframe_knows_its_motion_since_the_one_before_whatever_the_map_does_in_between():
    X_WB, config = path(16), ScanMatcherConfig()
    X_OB = slipping(X_WB)
    track = follow(X_WB[:10], config, X_OB[:10])[-1]
    before = track.keyframe
    track = correct_track(track, KeyframePoses(1, {k.index: pose(y=5.0) @ k.X_MB for k in track.mapped}), config)
    for i in range(10, 13):
        track = track_scan(track, scan_at(X_WB[i], i), X_BS, config, (X_OB[i], X_OB[i]))
    assert track.keyframe.index == 12 != before.index
    off, _ = distance_and_angle(X_WB[before.index].inverse() @ X_WB[12] @ track.keyframe.X_PB.inverse())
    assert off < 0.02
