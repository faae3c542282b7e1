"""The scenes of the registration benchmark are what their tables say."""

import numpy as np
import pytest

from tests.benchmarks.registration_scenes import COLUMNS, PAIRS, PLACES, RANGE_NOISE, RINGS, Flat, flat_pairs, yaw_pose


@pytest.fixture(scope="module")
def sets():
    return flat_pairs(0)


def distance(X):
    return np.linalg.norm(X.translation())


def angle_deg(X):
    return np.rad2deg(abs(X.rotation().ToAngleAxis().angle()))


def test_near_pairs_are_half_a_metre_and_ten_degrees_apart(sets):
    assert len(sets.near) == PAIRS
    for pair in sets.near:
        assert distance(pair.X_TS) == pytest.approx(0.5)
        assert angle_deg(pair.X_TS) == pytest.approx(10, abs=1)
        assert distance(pair.X_TS_guess) == angle_deg(pair.X_TS_guess) == 0


def test_partial_pairs_are_metres_apart_and_their_guess_is_off(sets):
    for pair in sets.partial:
        assert 3.1 < distance(pair.X_TS) < 5.7
        assert angle_deg(pair.X_TS) == pytest.approx(40, abs=1e-6)
        off = pair.X_TS.inverse() @ pair.X_TS_guess
        assert distance(off) == pytest.approx(0.5)
        assert angle_deg(off) == pytest.approx(10, abs=1e-6)


def test_only_scans_from_against_a_box_are_ill_posed(sets):
    assert [i for i, pair in enumerate(sets.partial) if pair.ill_posed] == [5, 11, 17, 23]
    assert not any(pair.ill_posed for pair in sets.near)
    assert all(len(pair.source.point.positions) < 0.9 * RINGS * COLUMNS for pair in sets.partial if pair.ill_posed)


def test_pairs_without_a_guess_show_the_partial_views_and_one_place_from_any_side(sets):
    for pair, partial in zip(sets.apart, sets.partial, strict=True):
        assert pair.source is partial.source
        assert distance(pair.X_TS_guess) == 0
    angles = [angle_deg(pair.X_TS) for pair in sets.same_place]
    assert min(angles) < 45
    assert max(angles) > 135
    assert [distance(pair.X_TS) for pair in sets.same_place] == pytest.approx([0.5] * PAIRS)


def test_clouds_are_range_images_in_the_sensor_frame(sets):
    cloud = sets.near[0].source
    points, ring, column = (cloud.point[name].numpy() for name in ("positions", "ring", "column"))
    assert len(points) > 0.99 * RINGS * COLUMNS
    assert (ring.dtype, column.dtype) == (np.uint8, np.uint16)
    elevation = np.rad2deg(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    np.testing.assert_allclose(elevation, -15 + 2.0 * ring[:, 0], atol=1e-3)
    azimuth = np.rad2deg(np.arctan2(points[:, 1], points[:, 0]))
    past = (azimuth - (column[:, 0] * (360 / COLUMNS) - 180)) % 360
    assert past.max() <= 360 / COLUMNS + 1e-3
    assert np.ptp(past) < 1e-3
    assert 0 <= cloud.point["intensity"].numpy().min() < cloud.point["intensity"].numpy().max() <= 1


def test_true_poses_lay_the_floors_on_each_other(sets):
    for pair in (*sets.near[:4], *sets.partial[:4]):
        height = []
        for cloud, X in ((pair.target, None), (pair.source, pair.X_TS)):
            points = cloud.point.positions.numpy()[cloud.point["ring"].numpy()[:, 0] == 0].astype(float)
            points = points if X is None else X.multiply(points.T).T
            height.append(np.median(points[np.abs(points[:, 2] + 0.6) < 4 * RANGE_NOISE, 2]))
        assert height[0] == pytest.approx(height[1], abs=0.003)


def test_the_same_seed_gives_the_same_scan_and_another_one_another_flat():
    X_WS = yaw_pose(*PLACES[0], 0.6, 0.3)
    first, again, other = (
        Flat(seed).scan(X_WS, np.random.default_rng(4)).point.positions.numpy() for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first, again)
    assert other.shape != first.shape or not np.allclose(first, other)
