"""Candidates for loops, and what a registration and the classes say of them."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.pose_graph import LoopDetectionConfig, Place, PlaceRecognition, check_loop, find_candidates
from naraha.systems.pose_graph.loop_detection import agreement
from pydrake.math import RigidTransform

from tests.rooms import make_cloud, pose, room_scan

NOTHING = make_cloud(np.zeros((0, 3)))


def places_at(xs, descriptors=None):
    ways = np.concatenate([[0], np.cumsum(np.abs(np.diff(xs)))])
    descriptors = descriptors or [None] * len(xs)
    return [
        Place(NOTHING, pose(x), float(way), None if d is None else np.array([float(d)]))
        for x, way, d in zip(xs, ways, descriptors, strict=True)
    ]


def test_candidates_are_near_and_not_just_left():
    out_and_back = [*np.arange(0.0, 20.0), *np.arange(19.0, -0.5, -1.0)]
    places = places_at(out_and_back)
    config = LoopDetectionConfig(min_way=5.0, near=3.0, spacing=2, max_candidates=3)
    assert find_candidates(places, np.zeros(len(places)), config) == [0, 2]
    # At the turning point all that is near was just left.
    assert find_candidates(places[:21], np.zeros(21), config) == []
    assert find_candidates(places[:1], np.zeros(1), config) == []


def test_uncertain_poses_are_looked_for_farther_away_but_not_beyond_the_limit():
    places = places_at([0.0, 30.0, 6.0])
    config = LoopDetectionConfig(near=2.0, deviations=3.0, far=8.0)
    assert find_candidates(places, np.array([1.0, 1.0, 0.0]), config) == []
    assert find_candidates(places, np.array([2.5, 2.5, 0.0]), config) == [0]
    assert find_candidates(places, np.array([50.0, 50.0, 0.0]), config) == [0]


def test_what_looks_alike_comes_first_within_what_the_poses_allow():
    places = places_at([0.0, 40.0, 41.0, 0.5], descriptors=[0.0, 5.0, 9.0, 5.1])
    recognition = PlaceRecognition(lambda cloud: np.zeros(1), lambda a, b: np.abs(b - a).ravel(), lambda s, t: None)
    config = LoopDetectionConfig(spacing=1)
    unsure = np.full(4, 15.0)
    assert find_candidates(places, unsure, config, recognition) == [1, 0]
    # Without a way to align it, what is far cannot be registered; and where the poses are sure, looks do not count.
    assert find_candidates(places, unsure, config, PlaceRecognition(recognition.describe, recognition.distance)) == [0]
    assert find_candidates(places, np.zeros(4), config, recognition) == [0]


def with_classes(cloud, classes, share=0.9):
    """Class probabilities (N, 2) that give `share` to class 0 or 1."""
    p = np.full((len(classes), 2), 1 - share, np.float32)
    p[np.arange(len(classes)), classes] = share
    cloud.point["class_probabilities"] = o3d.core.Tensor(p)
    return cloud


def test_agreement_of_classes_is_their_log_likelihood_ratio():
    points = np.random.default_rng(0).uniform(0, 100, (400, 3))
    half = np.arange(400) % 2
    source = with_classes(make_cloud(points), half)
    overlap, same = agreement(source, with_classes(make_cloud(points), half), RigidTransform(), 0.2)
    assert overlap == 1.0
    # Shares are one half: (0.9² + 0.1²) / 0.5, and for the other class 2 · 0.9 · 0.1 / 0.5.
    assert same == pytest.approx(np.log(1.64))
    assert agreement(source, with_classes(make_cloud(points), 1 - half), RigidTransform(), 0.2)[1] == pytest.approx(
        np.log(0.36)
    )
    assert agreement(source, make_cloud(points), RigidTransform(), 0.2) == (1.0, 0.0)
    assert agreement(source, make_cloud(points[:200]), RigidTransform(), 0.2)[0] == pytest.approx(0.5)
    assert agreement(source, NOTHING, RigidTransform(), 0.2) == (0.0, 0.0)


def rooms(rng, X_found, classes=(0, 0)):
    """A room seen from three places, and again from `X_found` after a long way; classes of the floor then and now."""

    def seen(X, floor):
        points = room_scan(rng, X)
        return with_classes(make_cloud(points), np.where(X.multiply(points.T)[2] < 0.05, floor, 0))

    X_true = pose(0.4, 0.2, yaw=0.3)
    steps = [pose(0.3 * k) for k in range(3)]
    return [
        *(Place(seen(X, classes[0]), X, 0.3 * k) for k, X in enumerate(steps)),
        Place(seen(X_true, classes[1]), X_found, 50.0),
    ], steps[1].inverse() @ X_true


def test_a_place_is_found_again_from_a_pose_that_is_half_a_metre_off():
    places, X_TS = rooms(np.random.default_rng(0), pose(0.8, -0.1, yaw=0.38), classes=(1, 1))
    check = check_loop(places, 1, LoopDetectionConfig())
    assert check.reason == ""
    assert np.linalg.norm(check.X_TS.translation() - X_TS.translation()) < 0.03
    assert check.overlap > 0.9
    assert check.class_evidence > 0.1
    assert (np.sqrt(np.diag(check.covariance)) < 0.05).all()


def test_a_room_with_another_floor_is_another_room():
    places, _ = rooms(np.random.default_rng(0), pose(0.4, 0.2, yaw=0.3), classes=(0, 1))
    assert check_loop(places, 1, LoopDetectionConfig()).reason.startswith("classes disagree")


def test_what_does_not_fit_says_why():
    places, _ = rooms(np.random.default_rng(0), pose(0.4, 0.2, yaw=0.3))
    elsewhere = Place(make_cloud(np.random.default_rng(1).uniform(-4, 4, (3000, 3))), places[-1].X_MB, 50.0)
    assert check_loop([*places[:-1], elsewhere], 1, LoopDetectionConfig()).reason != ""
    empty = Place(NOTHING, places[-1].X_MB, 50.0)
    assert "source has 0 usable points" in check_loop([*places[:-1], empty], 1, LoopDetectionConfig()).reason
    strict = LoopDetectionConfig(min_overlap=1.0, overlap_distance=0.01)
    assert "overlap" in check_loop(places, 1, strict).reason


def test_where_the_guess_fails_the_alignment_of_the_places_is_tried():
    places, X_TS = rooms(np.random.default_rng(0), pose(20.0, 20.0, yaw=2.0))
    assert check_loop(places, 1, LoopDetectionConfig()).reason != ""
    near = X_TS @ pose(0.2, -0.1, 0.0, yaw=0.05)
    recognition = PlaceRecognition(
        lambda cloud: np.zeros(1), lambda a, b: np.zeros(len(b)), lambda source, target: near
    )
    check = check_loop(places, 1, LoopDetectionConfig(), recognition)
    assert check.reason == ""
    assert np.linalg.norm(check.X_TS.translation() - X_TS.translation()) < 0.03
    assert check_loop(places, 1, LoopDetectionConfig(), recognition, reach=5.0).reason.endswith("may be 5.0 m")
