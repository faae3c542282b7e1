"""What a scan tells: closed forms in front of walls; and the covariance along a route against a textbook filter."""

import numpy as np
import pytest
from naraha.systems.placement import InformationConfig, scans_along
from naraha.systems.placement.follow_kernels import follow
from naraha.systems.placement.information import full_matrix
from naraha.systems.placement.problem import word_of
from naraha.systems.placement.ray_kernels import cast_ray, is_clear, straighten

from .halls import hall, lines, small_problem

NOWHERE = np.zeros((0, 2))


def information(pose, sites=NOWHERE, plan=None, **settings):
    base, added = scans_along(
        plan or hall(), np.array([pose]), np.asarray(sites, float), 0.5, InformationConfig(**settings)
    )
    return full_matrix(base[0]), full_matrix(added[0])


def test_a_ray_meets_the_first_occupied_cell_at_its_exact_distance():
    occupied = np.zeros((20, 30), bool)
    occupied[:, 25] = True
    distance, row, col = cast_ray(occupied, 3.25, 4.5, np.cos(0.3), np.sin(0.3), 100.0)
    assert distance == pytest.approx((25 - 3.25) / np.cos(0.3))
    assert (row, col) == (int(4.5 + 21.75 * np.tan(0.3)), 25)
    assert cast_ray(occupied, 3.25, 4.5, -1.0, 0.0, 100.0)[0] == np.inf
    assert cast_ray(occupied, 3.25, 4.5, 1.0, 0.0, 20.0)[0] == np.inf
    assert is_clear(occupied, 3.0, 3.0, 24.9, 15.0)
    assert not is_clear(occupied, 3.0, 3.0, 25.1, 15.0)


def test_a_straightened_way_is_the_shortest_that_skips_points():
    blocked = np.zeros((20, 20), bool)
    blocked[:10, 10] = True
    points = np.array([[5.5, 5.5], [6.5, 9.5], [8.5, 11.5], [10.5, 10.6], [12.5, 12.5], [15.5, 5.5]])
    kept = straighten(blocked, points)
    assert kept.tolist() == [0, 3, 5]


def test_one_wall_tells_the_distance_and_the_heading_and_nothing_along_it():
    found, _ = information([18.0, 3.0, 0.0], used_range=6.0)
    values = np.linalg.eigvalsh(found)
    assert values[0] < 1e-6 * values[1]
    assert found[1, 1] > 1000
    assert found[0, 0] == pytest.approx(0, abs=1e-6 * found[1, 1])


def test_the_information_of_a_wall_is_the_sum_over_its_rays():
    config = InformationConfig(used_range=6.0, map_noise=0.1, range_noise=0.02)
    found, _ = information([18.0, 3.0, 0.0], used_range=6.0, map_noise=0.1, range_noise=0.02)
    angles = -0.5 * config.field_of_view + config.cast_spacing * np.arange(
        int(config.field_of_view / config.cast_spacing) + 1
    )
    depth = 3.0 - 0.2
    slant = -np.sin(angles)
    hit = (slant > 0) & (depth / np.maximum(slant, 1e-9) <= 6.0)
    weight = config.share * config.cast_spacing / config.ray_spacing / ((0.02 * slant[hit]) ** 2 + 0.1**2)
    reach = depth / slant[hit] * np.cos(angles[hit])
    assert found[1, 1] == pytest.approx(weight.sum(), rel=0.03)
    assert found[2, 2] == pytest.approx((weight * reach**2).sum(), rel=0.05)
    assert found[1, 2] == pytest.approx((weight * reach).sum(), rel=0.05, abs=0.05 * weight.sum())


def test_a_corner_tells_all_and_an_empty_place_nothing():
    corner, _ = information([3.0, 3.0, np.pi / 4], used_range=6.0)
    assert np.linalg.eigvalsh(corner)[0] > 100
    empty, added = information([18.0, 8.0, 0.0], [[20.0, 9.0], [26.0, 8.0]], used_range=6.0)
    assert (empty == 0).all()
    assert np.linalg.eigvalsh(added[0])[1] > 10
    assert (added[1] == 0).all()  # out of range


def test_a_box_tells_nothing_behind_the_back_or_behind_a_wall():
    plan = hall(lines((20, 6), (20, 10)))
    _, added = information([18.0, 8.0, 0.0], [[15.0, 8.0], [22.0, 8.0], [18.0, 11.0]], plan, used_range=6.0)
    assert (added[0] == 0).all()
    assert (added[1] == 0).all()
    assert (added[2] != 0).any()


def test_a_box_never_takes_information_away():
    problem = small_problem()
    assert np.linalg.eigvalsh(full_matrix(problem.added)).min() > -1e-6 * problem.added.max()


def filtered(problem, order, chosen):
    """Errors along a route by matrices, in the textbook's form."""
    of = problem.config.information
    P = np.diag([of.start_position**2] * 2 + [of.start_heading**2])
    heading, at, errors = problem.plan.start[2], 0, []
    for to in order:
        leg = at * len(problem.points) + to
        at = to
        for p in range(problem.first[leg], problem.first[leg + 1]):
            theta, step = problem.poses[p, 2:]
            turn = abs((theta - heading + np.pi) % (2 * np.pi) - np.pi)
            heading = theta
            P[2, 2] += of.odometry_turn**2 * turn
            F = np.array([[1, 0, -step * np.sin(theta)], [0, 1, step * np.cos(theta)], [0, 0, 1]])
            Q = step * np.diag([of.odometry_position**2] * 2 + [of.odometry_heading**2])
            P = F @ P @ F.T + Q
            P = np.linalg.inv(np.linalg.inv(P) + full_matrix(problem.base[p] + problem.added[p][chosen].sum(axis=0)))
            errors.append(of.sigmas * np.sqrt(np.linalg.eigvalsh(P[:2, :2])[-1]))
    return np.array(errors)


def test_errors_along_a_route_are_those_of_a_kalman_filter():
    problem = small_problem()
    rng = np.random.default_rng(0)
    for _ in range(3):
        order, chosen = rng.permutation(6) + 1, rng.random(len(problem.sites)) < 0.3
        poses, errors = problem.errors_along(order, chosen)
        expected = filtered(problem, order, chosen)
        assert errors == pytest.approx(expected, rel=1e-6)
        assert np.hypot(*(poses[-1, :2] - problem.points[order[-1]])) < 1e-9
        excess, share, count = follow(order, word_of(chosen), problem.tables(), np.zeros(0))
        steps = np.hypot(*np.diff(np.vstack([problem.plan.start[None, :2], poses[:, :2]]), axis=0).T)
        assert count == len(expected)
        assert excess == pytest.approx((np.maximum(expected / 0.18 - 1, 0) * steps).sum())
        assert share == pytest.approx((expected / 0.18 * steps).sum() / steps.sum())


def test_more_landmarks_never_make_the_error_larger():
    problem = small_problem()
    rng = np.random.default_rng(1)
    for _ in range(20):
        order, chosen = rng.permutation(6) + 1, rng.random(len(problem.sites)) < 0.4
        more = chosen | (rng.random(len(chosen)) < 0.3)
        assert (problem.errors_along(order, more)[1] <= problem.errors_along(order, chosen)[1] + 1e-9).all()
