"""Two scans laid on each other without a guess, or with a bad one."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.registration.coarse import (
    NearSearchConfig,
    PoseSearchConfig,
    View,
    align_near,
    find_pose,
    judge_pose,
)
from pydrake.math import RigidTransform, RollPitchYaw

from tests.benchmarks.registration_scenes import Flat, flat_pairs
from tests.rooms import make_cloud
from tests.viewpoints.viewpoints import box_room, errors


@pytest.fixture(scope="module")
def flat():
    return Flat(7)


def tilted_pose(x, y, yaw, roll_deg=0.0, pitch_deg=0.0):
    return RigidTransform(RollPitchYaw(np.deg2rad(roll_deg), np.deg2rad(pitch_deg), yaw), [x, y, 0.6])


def points_of(cloud):
    return cloud.point.positions.numpy().astype(float)


@pytest.fixture(scope="module")
def apart(flat):
    """Two single scans 5.6 m apart that lean by up to 5°: clouds of target and source, and X_TS."""
    rng = np.random.default_rng(0)
    X_WT, X_WS = tilted_pose(2, -1.5, 0.4, 3.0, -2.0), tilted_pose(5, -5, -2.5, -4.0, 3.0)
    return flat.scan(X_WT, rng), flat.scan(X_WS, rng), X_WT.inverse() @ X_WS


def test_leaning_scans_metres_apart_are_found_from_nothing(apart):
    target, source, X_TS = apart
    best, *others = find_pose(source, target)
    distance, angle = errors(best.X_TS, X_TS)
    assert distance < 0.05
    assert angle < 0.5
    assert best.denied < 0.01
    assert not best.ambiguous
    assert all(best.score > other.score + 0.2 for other in others)


def test_two_runs_agree_to_the_last_bit(apart):
    target, source, _ = apart
    first, second = find_pose(source, target), find_pose(source, target)
    assert [c.score for c in first] == [c.score for c in second]
    assert (first[0].X_TS.GetAsMatrix4() == second[0].X_TS.GetAsMatrix4()).all()


@pytest.mark.parametrize("turn", [(0.6, 10.0), (1.2, -25.0)])
def test_a_bad_guess_is_corrected(apart, turn):
    target, source, X_TS = apart
    shift, yaw_deg = turn
    guess = X_TS @ RigidTransform(RollPitchYaw(0, 0, np.deg2rad(yaw_deg)), [shift, 0, 0])
    best = align_near(source, target, guess)[0]
    distance, angle = errors(best.X_TS, X_TS)
    assert distance < 0.05
    assert angle < 0.5


def test_only_poses_near_the_guess_are_returned(apart):
    target, source, X_TS = apart
    guess = X_TS @ RigidTransform([6.0, 0.0, 0.0])
    config = NearSearchConfig(span=1.0, span_yaw_deg=20.0)
    assert all(errors(c.X_TS, guess)[0] < 2.5 for c in align_near(source, target, guess, config))
    assert align_near(source, target, RigidTransform([np.nan, 0, 0]), config) == ()


@pytest.mark.parametrize("lean_deg", [(4.0, -3.0), (-30.0, 20.0)])
def test_the_floor_says_which_way_is_up(flat, lean_deg):
    X_WS = tilted_pose(-8, -4, 1.0, *lean_deg)
    # A hand-held scanner looks down far enough to see the floor; 16 rings within 15° lose it behind a lean of 30°.
    rng = np.random.default_rng(1)
    whole = np.vstack(
        [points_of(flat.scan(tilted_pose(-8, -4, 1.0, 5 * k, 0), rng)) @ R(5 * k).T for k in range(-6, 7)]
    )
    turn = X_WS.rotation().inverse() @ RigidTransform(RollPitchYaw(0, 0, 1.0), np.zeros(3)).rotation()
    view = View(make_cloud(whole @ turn.matrix().T))
    up_S = X_WS.rotation().inverse().matrix()[:, 2]
    assert view.has_floor
    assert np.rad2deg(np.arccos(min(view.X_LS.rotation().matrix()[2] @ up_S, 1.0))) < 0.3
    assert view.p_LV[2] == pytest.approx(0.6, abs=0.03)


def R(roll_deg):
    return RollPitchYaw(np.deg2rad(roll_deg), 0, 0).ToRotationMatrix().matrix()


def test_a_given_up_levels_a_scan_that_sees_no_floor(flat):
    X_WS = tilted_pose(-8, -4, 1.0, 6.0, 5.0)
    points = points_of(flat.scan(X_WS, np.random.default_rng(2)))
    cloud = make_cloud(points[points[:, 2] > 0.05 * np.linalg.norm(points, axis=1)])  # the rings that look up
    up_S = X_WS.rotation().inverse().matrix()[:, 2]

    def error_deg(view):
        return np.rad2deg(np.arccos(min(view.X_LS.rotation().matrix()[2] @ up_S, 1.0)))

    assert error_deg(View(cloud, up=up_S)) < 1.0
    assert error_deg(View(cloud)) > 2.0


def test_an_empty_rectangle_fits_in_two_ways_and_a_crate_decides():
    rng = np.random.default_rng(0)
    for crate in (False, True):
        a, X_WA = box_room(rng, p=(-2.0, 0.5), yaw=0.3, crate=crate)
        b, X_WB = box_room(rng, p=(1.5, -1.0), yaw=2.0, crate=crate)
        found = find_pose(make_cloud(b), make_cloud(a))
        assert found[0].ambiguous is not crate
        if crate:
            assert errors(found[0].X_TS, X_WA.inverse() @ X_WB)[0] < 0.03


def test_classes_decide_where_the_walls_do_not():
    """A puddle in one corner of the empty rectangle; a tenth of the labels is wrong."""
    rng = np.random.default_rng(3)
    clouds = []
    for p, yaw in (((-2.0, 0.5), 0.3), ((1.5, -1.0), 2.0)):
        points, X_WS = box_room(rng, p=p, yaw=yaw)
        p_W = X_WS.multiply(points.T).T
        wet = (p_W[:, 2] < 0.05) & (np.hypot(p_W[:, 0] - 3.5, p_W[:, 1] - 1.5) < 1.0)
        label = np.where(rng.random(len(wet)) < 0.1, rng.integers(0, 2, len(wet)), wet).astype(int)
        cloud = make_cloud(points)
        layer = np.where(np.eye(2)[label] > 0, 0.95, 0.05).astype(np.float32)
        cloud.point["class_probabilities"] = o3d.core.Tensor(layer)
        clouds.append((cloud, X_WS))
    (a, X_WA), (b, X_WB) = clouds
    best, second, *_ = find_pose(b, a)
    assert errors(best.X_TS, X_WA.inverse() @ X_WB)[0] < 0.1
    assert best.class_evidence > second.class_evidence
    assert not best.ambiguous


def test_opposite_faces_of_a_wall_do_not_agree():
    points, _ = box_room(np.random.default_rng(1))
    view = View(make_cloud(points))
    assert judge_pose(view, view, RigidTransform()).agreed > 0.99
    # The room next door shares the wall at y = 3 m, seen from its other side.
    assert judge_pose(view, view, RigidTransform([0.0, 6.0, 0.0])).agreed < 0.05


def test_a_merged_cloud_seen_from_everywhere_can_be_the_target(flat):
    rng = np.random.default_rng(4)
    poses = [tilted_pose(x, y, 0.0) for x, y in ((-8, -4), (-6, -4), (-4, -4), (-3, -4))]
    merged = make_cloud(np.vstack([X.multiply(points_of(flat.scan(X, rng)).T).T for X in poses]))
    X_WS = tilted_pose(-5, -5, 2.0, 2.0, 1.0)
    best = find_pose(View(flat.scan(X_WS, rng)), View(merged, seen_from=None))[0]
    distance, angle = errors(best.X_TS, X_WS)
    assert distance < 0.1
    assert angle < 1.0


@pytest.mark.parametrize(
    ("points", "problem"),
    [
        (np.zeros((0, 3)), "0 columns"),
        (np.full((5000, 3), np.nan), "0 columns"),
        (np.random.default_rng(0).uniform(-3, 3, (5000, 3)) * [1, 1, 0], "0 columns"),
        (np.ones((10, 3)), "columns of walls and objects, needs 60"),
    ],
)
def test_a_scan_that_cannot_be_searched_says_why(points, problem):
    room, _ = box_room(np.random.default_rng(1))
    view = View(make_cloud(points))
    assert problem in view.problem
    assert find_pose(view, make_cloud(room)) == ()
    assert find_pose(make_cloud(room), view) == ()
    assert align_near(make_cloud(room), view, RigidTransform()) == ()


def test_configurations_out_of_range_are_refused():
    room, _ = box_room(np.random.default_rng(1))
    with pytest.raises(ConfigError, match="pixel"):
        find_pose(make_cloud(room), make_cloud(room), PoseSearchConfig(pixel=0.0))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 11, 12, 13])
def test_scans_two_to_five_metres_apart_are_found(seed):
    pairs = flat_pairs(seed)
    right = near = 0
    for pair, guessed in zip(pairs.apart, pairs.partial, strict=True):
        source, target = View(pair.source), View(pair.target)
        found = find_pose(source, target)
        distance, angle = errors(found[0].X_TS, pair.X_TS) if found else (np.inf, np.inf)
        right += distance < 0.3 and angle < 5
        assert not found or found[0].ambiguous or distance < 0.3, "a wrong pose, and no doubt about it"
        found = align_near(source, target, guessed.X_TS_guess)
        distance, angle = errors(found[0].X_TS, pair.X_TS) if found else (np.inf, np.inf)
        near += distance < 0.1 and angle < 1
    print(f"\nlayout {seed}: without a guess {right} of {len(pairs.apart)}, near a guess {near}")
    assert right >= 18
    assert near >= 18
