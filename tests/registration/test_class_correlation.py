"""Correlation of classes along motions that the geometry leaves open: patterns with known shifts in closed form."""

import numpy as np
import pytest
from naraha.systems.errors import InputError
from naraha.systems.registration.class_correlation import correlate_classes, moved_along
from naraha.systems.registration.class_lanes import cells_of, lane_grid, meetings
from pydrake.math import RigidTransform, RotationMatrix

ALONG_X = np.array([[0, 0, 0, 1.0, 0, 0]])
ALONG_XY = np.array([[0, 0, 0, 1.0, 0, 0], [0, 0, 0, 0, 1.0, 0]])
ABOUT_Z = np.array([[0, 0, 1.0, 0, 0, 0]])


def _labels(inside, rng=None, wrong=0.0):
    """Class probabilities of hard labels, (N, 2), of which the share `wrong` is the other one."""
    inside = np.asarray(inside, bool).copy()
    if wrong:
        inside ^= rng.random(len(inside)) < wrong
    return np.eye(2)[inside.astype(int)]


def _strip(rng, count, marks, *, low=-6.0, high=6.0, wrong=0.0):
    """Points of a strip 2 m wide along x, marked where x lies in one of `marks` (low, high)."""
    points = np.column_stack([rng.uniform(low, high, count), rng.uniform(-1, 1, count), rng.normal(0, 0.01, count)])
    marked = np.any([(points[:, 0] > a) & (points[:, 0] < b) for a, b in marks], axis=0)
    return points, _labels(marked, rng, wrong)


def _spots(seed, count=40, half=8.0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-half, half, (count, 2)), rng.uniform(0.2, 0.6, count)])


def _in_spots(u, v, spots):
    return ((u[:, None] - spots[:, 0]) ** 2 + (v[:, None] - spots[:, 1]) ** 2 < spots[:, 2] ** 2).any(axis=1)


def _plane(rng, count, spots, *, half=5.0, centre=(0.0, 0.0), wrong=0.0):
    xy = rng.uniform(-half, half, (count, 2)) + centre
    return np.column_stack([xy, rng.normal(0, 0.01, count)]), _labels(_in_spots(*xy.T, spots), rng, wrong)


def _fix(source, target, motions=ALONG_X, span=1.5, **options):
    shares = 0.5 * (source[1].mean(axis=0) + target[1].mean(axis=0))
    return correlate_classes(source[0], source[1], target[0], target[1], shares, motions, span, **options)


MARKS = [(-4.3, -3.6), (-1.9, -1.6), (-0.2, 0.7), (2.4, 2.8), (4.4, 5.3)]


@pytest.mark.parametrize("shift", [-0.9, -0.25, 0.0, 0.04, 0.6, 1.2])
def test_marks_on_a_strip_give_their_shift(shift):
    target = _strip(np.random.default_rng(0), 12000, MARKS)
    source = _strip(np.random.default_rng(1), 12000, MARKS)
    fix = _fix((source[0] - [shift, 0, 0], source[1]), target)
    assert fix.distinct, fix.reason
    assert fix.offsets[0] == pytest.approx(shift, abs=0.01)
    assert fix.covariance[0, 0] ** 0.5 < 0.03
    assert fix.evidence > 20
    assert fix.contrast > 2


@pytest.mark.parametrize("period", [0.5, 0.8])
def test_a_periodic_pattern_is_not_distinct(period):
    marks = [(x, x + 0.5 * period) for x in np.arange(-9, 9, period)]
    target = _strip(np.random.default_rng(0), 12000, marks)
    source = _strip(np.random.default_rng(1), 12000, marks)
    fix = _fix((source[0] - [0.1, 0, 0], source[1]), target)
    assert not fix.distinct
    assert np.isnan(fix.offsets).all()
    assert np.isinf(np.diag(fix.covariance)).all()
    assert fix.reason


def test_the_guess_tells_the_periods_apart_when_it_is_good_enough():
    marks = [(x, x + 0.4) for x in np.arange(-9, 9, 0.8)]
    target = _strip(np.random.default_rng(0), 12000, marks)
    source = _strip(np.random.default_rng(1), 12000, marks)
    moved = source[0] - [0.1, 0, 0], source[1]
    fix = _fix(moved, target, deviations=np.array([0.08]))
    assert fix.distinct, fix.reason
    assert fix.offsets[0] == pytest.approx(0.1, abs=0.02)
    one_on = _fix(moved, target, deviations=np.array([0.08]), expected=np.array([0.85]))
    assert one_on.offsets[0] == pytest.approx(0.9, abs=0.03)


def test_without_classes_it_makes_nothing_up():
    points, _ = _strip(np.random.default_rng(0), 5000, MARKS)
    plain = np.tile([0.9, 0.1], (5000, 1))
    for prob in (plain, _labels(np.zeros(5000))):
        fix = _fix((points, prob), (points + 0.001, prob))
        assert not fix.distinct
        assert np.isnan(fix.offsets).all()
        assert fix.reason
    empty = np.zeros((0, 3)), np.zeros((0, 2))
    assert not correlate_classes(*empty, points, plain, [0.9, 0.1], ALONG_X).distinct


@pytest.mark.parametrize("seed", range(6))
def test_labels_that_have_nothing_to_do_with_the_place_are_not_distinct(seed):
    rng = np.random.default_rng(seed)
    spots = [_spots(10 * seed + k) for k in range(2)]
    source, target = (_plane(rng, 12000, s) for s in spots)
    assert not _fix(source, target).distinct


@pytest.mark.parametrize("shift", [-0.7, 0.3])
def test_every_fifth_label_wrong_costs_precision_only(shift):
    errors = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        source, target = (_plane(rng, 15000, _spots(seed), wrong=0.2) for _ in range(2))
        fix = _fix((source[0] - [shift, 0, 0], source[1]), target)
        assert fix.distinct, fix.reason
        errors.append(fix.offsets[0] - shift)
        assert abs(errors[-1]) < 4 * fix.covariance[0, 0] ** 0.5
    assert np.abs(errors).max() < 0.08
    assert np.median(np.abs(errors)) < 0.02


def test_a_shift_beyond_the_interval_is_not_reported_at_its_end():
    target = _strip(np.random.default_rng(0), 12000, MARKS)
    source = _strip(np.random.default_rng(1), 12000, MARKS)
    fix = _fix((source[0] - [1.0, 0, 0], source[1]), target, span=0.7)
    assert not fix.distinct


def test_two_free_directions_of_a_floor():
    spots, shift = _spots(3), np.array([0.63, -0.41])
    rng = np.random.default_rng(0)
    target, source = _plane(rng, 15000, spots, wrong=0.1), _plane(rng, 15000, spots, centre=(0.3, 0.2), wrong=0.1)
    fix = _fix((source[0] - [*shift, 0], source[1]), target, ALONG_XY)
    assert fix.distinct, fix.reason
    np.testing.assert_allclose(fix.offsets, shift, atol=0.04)
    assert np.linalg.eigvalsh(fix.covariance).min() > 0
    assert np.sqrt(np.diag(fix.covariance)).max() < 0.05


def test_stripes_across_one_of_two_free_directions_are_not_distinct():
    target = _strip(np.random.default_rng(0), 12000, MARKS)
    source = _strip(np.random.default_rng(1), 12000, MARKS)
    fix = _fix((source[0] - [0.3, 0.1, 0], source[1]), target, ALONG_XY)
    assert not fix.distinct


def _tank(rng, count, spots, radius=4.0):
    """Inside of a round tank with spots in (arc, height)."""
    angle, height = rng.uniform(-np.pi, np.pi, count), rng.uniform(-3, 3, count)
    r = radius + rng.normal(0, 0.01, count)
    around = radius * angle[:, None] - radius * np.pi / 8 * spots[:, 0]
    around = (around + radius * np.pi) % (2 * radius * np.pi) - radius * np.pi
    marked = (around**2 + (height[:, None] - spots[:, 1] * 3 / 8) ** 2 < spots[:, 2] ** 2).any(axis=1)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), height]), _labels(marked, rng, 0.1)


@pytest.mark.parametrize("turn", [-0.15, 0.2])
def test_a_turn_in_a_round_tank(turn):
    rng = np.random.default_rng(2)
    target, source = (_tank(rng, 15000, _spots(5)) for _ in range(2))
    X = moved_along(RigidTransform(), ABOUT_Z, [turn], np.zeros(3)).inverse()
    source = X.multiply(source[0].T).T, source[1]
    fix = _fix(source, target, ABOUT_Z, centre=np.zeros(3))
    assert fix.distinct, fix.reason
    assert fix.offsets[0] == pytest.approx(turn, abs=0.006)
    # The unit of a motion is that of its offset: twice the motion, half the offset.
    half = _fix(source, target, 2 * ABOUT_Z, centre=np.zeros(3))
    assert half.offsets[0] == pytest.approx(fix.offsets[0] / 2)
    assert half.covariance[0, 0] == pytest.approx(fix.covariance[0, 0] / 4)


def test_turn_and_height_in_a_round_tank():
    rng = np.random.default_rng(3)
    target, source = (_tank(rng, 15000, _spots(6)) for _ in range(2))
    motions = np.vstack([ABOUT_Z, [0, 0, 0, 0, 0, 1.0]])
    X = moved_along(RigidTransform(), motions, [0.2, -0.3], np.zeros(3)).inverse()
    fix = _fix((X.multiply(source[0].T).T, source[1]), target, motions, centre=np.zeros(3))
    assert fix.distinct, fix.reason
    assert fix.offsets[0] == pytest.approx(0.2, abs=0.01)
    assert fix.offsets[1] == pytest.approx(-0.3, abs=0.04)


def test_rings_at_the_same_places_in_both_scans_do_not_pull_to_zero():
    """Points only on lines that ride with the sensor, as rings do; nearest partners would say no motion."""
    shift, errors, normal = 0.35, [], []
    for seed in range(10):
        spots, clouds = _spots(100 + seed), []
        for x in (0.0, shift):
            rng = np.random.default_rng([seed, int(1000 * x)])
            angle, ring = rng.uniform(-np.pi, np.pi, 12000), rng.choice(1.2 * 1.1 ** np.arange(16), 12000)
            xy = np.column_stack([ring * np.cos(angle), ring * np.sin(angle)])
            marked = _in_spots(xy[:, 0] + x, xy[:, 1], spots)
            clouds.append((np.column_stack([xy, np.zeros(12000)]), _labels(marked, rng, 0.02)))
        fix = _fix(clouds[1], clouds[0])
        if fix.distinct:
            errors.append(fix.offsets[0] - shift)
            normal.append(errors[-1] / fix.covariance[0, 0] ** 0.5)
    assert len(errors) >= 7
    assert abs(np.mean(errors)) < 0.025
    assert np.abs(errors).max() < 0.08
    assert np.mean(np.square(normal)) < 1.6


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [0.02, 0.2])
def test_errors_are_as_large_as_the_covariance_says(wrong):
    errors = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        source, target = (_plane(rng, 8000, _spots(seed), wrong=wrong) for _ in range(2))
        fix = _fix((source[0] - [0.2, 0, 0], source[1]), target)
        if fix.distinct:
            errors.append((fix.offsets[0] - 0.2) / np.sqrt(fix.covariance[0, 0]))
    assert len(errors) > 50
    assert 0.15 < np.mean(np.square(errors)) < 2.0
    assert np.abs(errors).max() < 4


def test_moved_along_is_the_exponential_of_the_twist():
    motion, centre = np.array([[0.1, -0.2, 0.3, 0.5, 0.4, -0.1]]), np.array([1.0, 2.0, 3.0])
    many = RigidTransform()
    for _ in range(2000):
        R = RotationMatrix.ProjectToRotationMatrix(np.eye(3) + np.cross(motion[0, :3] / 2000, np.eye(3)).T)
        step = RigidTransform(R, centre - R.matrix() @ centre + motion[0, 3:] / 2000)
        many = step @ many
    once = moved_along(RigidTransform(), motion, [1.0], centre)
    np.testing.assert_allclose(once.GetAsMatrix4(), many.GetAsMatrix4(), atol=1e-3)
    halves = moved_along(moved_along(RigidTransform(), motion, [0.5], centre), motion, [0.5], centre)
    np.testing.assert_allclose(halves.GetAsMatrix4(), once.GetAsMatrix4(), atol=1e-12)


@pytest.mark.parametrize(
    "motion", [[0, 0, 0, 0.6, 0.8, 0], [0, 0, 1, 0, 0, 0], [0.2, 0, 1, 0, 0.5, 0.3], [0, 0.3, 0.1, 0, 0, 0]]
)
def test_lanes_are_what_a_motion_leaves_alone(motion):
    rng = np.random.default_rng(0)
    points, centre, motion = rng.uniform(-3, 3, (200, 3)), np.array([0.3, 0.2, -0.1]), np.array(motion, float)
    grid = lane_grid(points, motion, centre, 0.2)
    X = moved_along(RigidTransform(), motion[None], [0.1], centre)
    before, after = grid.coordinates(points), grid.coordinates(X.multiply(points.T).T)
    whole = np.abs(after[:, 0] - before[:, 0]) < 1  # not those that pass the end of a turn
    assert whole.mean() > 0.9
    np.testing.assert_allclose(after[whole], before[whole] + [0.1, 0, 0], atol=1e-9)


def test_meetings_count_what_falls_on_what():
    shares = np.array([0.5, 0.5])
    options = {"cell": 0.1, "reach": 0.0, "power": 1.0, "error": 0.0}
    target_place = np.array([0.05, 0.35, 0.85])
    points = np.zeros((3, 3))
    prob = np.array([[0.99, 0.01], [0.01, 0.99], [0.99, 0.01]])
    target = cells_of(np.zeros(3, np.int64), target_place, points, prob, shares, **options)
    source = cells_of(np.zeros(1, np.int64), np.array([0.05]), points[:1], prob[:1], shares, **options)
    table = np.arange(100.0).reshape(10, 10)
    none, ones = np.zeros(10), np.ones(10)
    args = (source.lane, source.place, source.code, np.zeros(1, np.int64), target.lane, target.place, target.code)
    score, sums = meetings(*args, table, none, ones, 0.2, 1.0, 0.01, 0)
    offsets = 0.01 * np.arange(201) - 1
    one, other = (table[source.code[0], target.code[i]] for i in (0, 1))
    expected = np.select(
        [(offsets >= -0.2) & (offsets < 0.15), (offsets >= 0.15) & (offsets < 0.5), (offsets >= 0.6) & (offsets < 1.0)],
        [one, other, one],
    )
    wrong = np.flatnonzero(~np.isclose(score[0], expected))
    bounds = np.array([-0.2, 0.15, 0.5, 0.6, 1.0])
    assert all(np.abs(bounds - offsets[k]).min() < 0.011 for k in wrong)
    assert len(wrong) <= len(bounds)
    np.testing.assert_allclose(sums[2], score[0] != 0)


def test_bad_arrays_are_refused():
    points, prob = np.zeros((5, 3)), np.full((5, 2), 0.5)
    with pytest.raises(InputError, match="numbers of classes differ"):
        correlate_classes(points, prob, points, prob, [1.0], ALONG_X)
    with pytest.raises(InputError, match="do not fit"):
        correlate_classes(points, prob[:3], points, prob, [0.5, 0.5], ALONG_X)
    with pytest.raises(InputError, match="motions"):
        correlate_classes(points, prob, points, prob, [0.5, 0.5], np.zeros((3, 6)))
