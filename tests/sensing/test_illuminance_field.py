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


@pytest.mark.parametrize("values", [[1.0, 2.0], [1.0, 2.0, float("nan")], [1.0, 2.0, 3.0, 4.0]])
def test_too_little_is_refused(values):
    with pytest.raises(ConfigError, match="no field"):
        fit_field(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])[: max(2, min(len(values), 3))], values)


def test_equal_values_are_no_trouble():
    mean, _ = fit_field(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), [50.0, 50.0, 50.0]).at(np.array([[0.5, 0.5]]))
    assert mean[0] == pytest.approx(50.0, abs=0.1)
