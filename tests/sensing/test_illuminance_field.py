import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.sensing import Lamp, fit_field, illuminance, make_emitters
from naraha.systems.sensing.illuminance_field import IlluminanceField

RNG = np.random.default_rng(0)


def drawn(length, n=70, amplitude=30.0, seed=0):
    """Values of a field with that length at random points of 10 x 10 m."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 10, (n, 2))
    empty = IlluminanceField(points, np.zeros(n), 0.0, amplitude, length, 0.1)
    return points, 200.0 + np.linalg.cholesky(empty._covariance()) @ rng.standard_normal(n)


def test_it_goes_through_what_was_measured_and_is_sure_there():
    points, values = drawn(3.0, n=25)
    mean, deviation = fit_field(points, values, noise=1e-4).at(points)
    np.testing.assert_allclose(mean, values, atol=0.5)
    assert deviation.max() < 1.0


def test_far_from_all_points_it_is_the_mean_and_as_unsure_as_the_field_varies():
    field = fit_field(*drawn(1.0, n=40))
    mean, deviation = field.at(np.array([[500.0, 500.0]]))
    assert mean[0] == pytest.approx(field.mean)
    assert deviation[0] == pytest.approx(field.amplitude)


@pytest.mark.parametrize("length", [1.0, 3.0])
def test_length_and_amplitude_are_found(length):
    found = [fit_field(*drawn(length, seed=seed)) for seed in range(4)]
    assert np.mean([field.length for field in found]) == pytest.approx(length, rel=0.35)
    assert np.mean([field.amplitude for field in found]) == pytest.approx(30.0, rel=0.35)


def test_errors_are_as_large_as_it_says():
    ratios = []
    for seed in range(6):
        points, values = drawn(2.5, n=100, seed=seed)
        mean, deviation = fit_field(points[:50], values[:50]).at(points[50:])
        ratios.extend((values[50:] - mean) / deviation)
    assert np.std(ratios) == pytest.approx(1.0, abs=0.25)


def test_under_lamps_it_is_nearer_than_the_nearest_point():
    emitters = make_emitters([Lamp(xyz=[x, y, 5.0]) for x in (3.0, 10.0) for y in (2.0, 6.0)])

    def true(points):
        return illuminance(np.column_stack([points, np.full(len(points), 0.85)]), np.array([0, 0, 1.0]), emitters)

    measured = np.stack(np.meshgrid(np.arange(0, 13.5, 1.5), np.arange(0, 8.5, 1.5)), -1).reshape(-1, 2)
    points = RNG.uniform([0, 0], [13, 8], (300, 2))
    mean, _ = fit_field(measured, true(measured)).at(points)
    nearest = true(measured)[np.linalg.norm(points[:, None] - measured, axis=2).argmin(axis=1)]
    assert np.abs(mean - true(points)).mean() < 0.3 * np.abs(nearest - true(points)).mean()


def same_side(eyes, points):
    """A wall at x = 5."""
    return (eyes[:, None, 0] < 5) == (points[:, 0] < 5)


def test_what_a_wall_hides_says_nothing_about_the_light_here():
    """A dim room beside a bright one; right before the wall the lamps behind it count for nothing."""
    points = np.array([[x, y] for x in (1.0, 3.0, 7.0, 9.0) for y in (1.0, 4.0, 7.0)])
    values = np.where(points[:, 0] < 5, 50.0, 500.0) + points[:, 1]
    before_the_wall, true = np.array([[4.8, 4.0], [5.2, 4.0]]), [54.0, 504.0]
    through, _ = fit_field(points, values).at(before_the_wall)
    field = fit_field(points, values, sight=same_side)
    mean, deviation = field.at(before_the_wall)
    assert np.abs(mean - true).max() < 0.4 * np.abs(through - true).max()
    left = points[:, 0] < 5
    alone = IlluminanceField(points[left], values[left], field.mean, field.amplitude, field.length, field.noise)
    assert alone.at(before_the_wall[:1]) == (pytest.approx(mean[:1]), pytest.approx(deviation[:1]))


def test_where_no_point_is_seen_it_is_the_mean_and_as_unsure_as_the_field_varies():
    points, values = drawn(3.0, n=20)
    field = fit_field(points, values, sight=lambda eyes, others: np.zeros((len(eyes), len(others)), bool))
    mean, deviation = field.at(points)
    assert (mean == field.mean).all()
    assert (deviation == field.amplitude).all()


def test_rooms_that_do_not_see_each_other_are_independent_and_one_room_has_the_joint_density():
    points, values = drawn(2.0, n=30)

    def density(which, sight):
        return IlluminanceField(points[which], values[which], 200.0, 30.0, 2.0, 0.1, sight).log_likelihood()

    left, everything = points[:, 0] < 5, np.ones(30, bool)
    assert 5 < left.sum() < 25
    apart = density(left, None) + density(~left, None)
    assert density(everything, same_side) == pytest.approx(apart, rel=1e-9)
    assert abs(density(everything, None) - apart) > 1.0


@pytest.mark.parametrize("values", [[1.0, 2.0], [1.0, 2.0, float("nan")], [1.0, 2.0, 3.0, 4.0]])
def test_too_little_is_refused(values):
    with pytest.raises(ConfigError, match="no field"):
        fit_field(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])[: max(2, min(len(values), 3))], values)


def test_equal_values_are_no_trouble():
    mean, _ = fit_field(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), [50.0, 50.0, 50.0]).at(np.array([[0.5, 0.5]]))
    assert mean[0] == pytest.approx(50.0, abs=0.1)
