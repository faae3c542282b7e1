import dataclasses

import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.localization import (
    LaserScan,
    LocalizerConfig,
    OccupancyGrid,
    PlanarOdometryAccuracy,
    localize,
    start_localization,
)
from naraha.systems.localization.planar import compose, difference
from naraha.systems.localization.uncertainty import fuse, information_of, predict, surprise, the_lower

from .rooms import corridor, drive, noisy_odometry, rasterised, room, scan_in

IN_CIRCLE = [[0.1, 0.0, 0.072]] * 90
ALONG = [[0.2, 0.0, 0.0]] * 150


def plan_of(walls):
    occupied, origin = rasterised(walls)
    return OccupancyGrid.from_plan(occupied, 0.05, origin)


ROOM, CORRIDOR = plan_of(room()), plan_of(corridor())


def run(walls, grid, start, steps, config, seed, *, odometry=None, blind=()):
    """Errors (n, 3) and the Localizations of a drive; the pose at the start is as wrong as the configuration says."""
    rng = np.random.default_rng(seed)
    truth = drive(start, steps)
    if odometry is None:
        odometry = noisy_odometry(steps, rng, config.odometry)
    deviation = np.array([config.start_deviation, config.start_deviation, np.radians(config.start_deviation_deg)])
    known = start_localization(config, grid, truth[0] + (deviation * rng.standard_normal(3) if grid else 0))
    all_known = []
    for k, (X, X_OB) in enumerate(zip(truth, odometry, strict=True)):
        scan = scan_in(walls, X, rng, time=0.1 * k, index=k)
        if k in blind:
            scan = LaserScan(np.full(len(scan.ranges), np.inf), scan.angles, 30.0, scan.time, index=k)
        known = localize(known, scan, X_OB, config, seed=seed)
        all_known.append(known)
    return np.array([difference(X, one.pose) for X, one in zip(truth, all_known, strict=True)]), all_known


def nees(errors, all_known):
    """Normalised error squared of every scan, 3 on average where the covariance is right, (n,)."""
    return np.array([e @ np.linalg.solve(one.covariance, e) for e, one in zip(errors, all_known, strict=True)])


def test_in_a_room_the_pose_is_known_to_centimetres_and_the_covariance_is_honest():
    config, values, errors = LocalizerConfig(), [], []
    for seed in range(3):
        error, all_known = run(room(), ROOM, [4, 1.2, 0], IN_CIRCLE, config, seed)
        values.append(nees(error, all_known))
        errors.append(error[5:])
        assert not any(one.lost for one in all_known)
        assert min(one.health for one in all_known) > 0.9
    assert np.sqrt(np.square(errors).mean(axis=(0, 1)))[:2].max() < 0.01
    assert np.abs(errors)[..., :2].max() < 0.04
    assert 0.2 < np.mean(values) / 3 < 1.5


def test_along_a_bare_corridor_the_covariance_grows_and_covers_the_error():
    config, values = LocalizerConfig(), []
    for seed in range(4):
        errors, all_known = run(corridor(), CORRIDOR, [0, 0.2, 0], ALONG, config, seed)
        values.append(nees(errors, all_known)[::10])
        along = np.array([np.sqrt(one.covariance[0, 0]) for one in all_known])
        assert (np.diff(along[2:]) > 0).all()
        # As the odometry alone: 30 m of a random walk of 5 cm/√m.
        assert along[-1] == pytest.approx(np.sqrt(0.05**2 + 0.05**2 * 30), rel=0.1)
        assert np.sqrt(all_known[-1].covariance[1, 1]) < 0.02
        assert np.abs(errors[5:, 1]).max() < 0.03
    assert 0.2 < np.mean(values) / 3 < 2.0


def test_fitness_stays_high_while_the_pose_is_wrong_and_only_our_covariance_says_so():
    """The weak point of the paper: in a bare corridor with wheels that slip, its fitness sees nothing."""
    truth = drive([0, 0.2, 0], ALONG)
    odometry = truth * [0.95, 1, 1]  # 5 % of the way is lost: 1.5 m
    accuracy = PlanarOdometryAccuracy(along=0.3)
    results = {}
    for method in ("paper", "naraha"):
        config = LocalizerConfig(method=method, odometry=accuracy)
        config.evolution.paper_generations = 300
        errors, all_known = run(corridor(), CORRIDOR, [0, 0.2, 0], ALONG, config, 0, odometry=odometry)
        error, health = np.abs(errors[:, 0]), np.array([one.health for one in all_known])
        k = int(error.argmax())
        deviation = np.sqrt(all_known[k].covariance[0, 0])
        falls = np.median(health[error < 0.2]) - np.median(health[error > 0.7])
        results[method] = error[k], deviation, falls, all_known[k].lost
    error, deviation, falls, lost = results["paper"]
    assert error > 1.0
    assert falls < 0.05
    assert error > 5 * deviation  # what an evolution strategy knows of its uncertainty
    assert not lost
    error, deviation, falls, lost = results["naraha"]
    assert error > 1.0  # nobody can know
    assert falls < 0.05
    assert error < 2 * deviation
    assert lost


def test_a_blinded_laser_is_said_and_the_pose_goes_on_with_odometry():
    config = LocalizerConfig()
    blind = range(30, 60)
    errors, all_known = run(room(), ROOM, [4, 1.2, 0], IN_CIRCLE, config, 0, blind=blind)
    assert all(all_known[k].health == 0 and not all_known[k].tracked for k in blind)
    assert not all_known[30].lost
    assert all(all_known[k].lost for k in range(30 + config.lost_scans - 1, 60))
    deviation = [np.sqrt(np.trace(all_known[k].covariance[:2, :2])) for k in blind]
    assert (np.diff(deviation) > 0).all()
    assert nees(errors, all_known)[59] < 16.3
    assert np.abs(errors[70:, :2]).max() < 0.04  # and it is found again
    assert not all_known[70].lost


def test_odometry_that_fails_is_noticed_and_the_scan_decides():
    config = LocalizerConfig()
    truth = drive([4, 1.2, 0], IN_CIRCLE)
    steps = np.array(IN_CIRCLE)
    steps[40] = [0.4, 0.0, 0.072]  # the wheels spin for 30 cm
    odometry = drive([0, 0, 0], steps)
    errors, all_known = run(room(), ROOM, truth[0], IN_CIRCLE, config, 1, odometry=odometry)
    assert all_known[41].surprise > 16.3
    assert max(one.surprise for one in all_known[5:40]) < 16.3
    assert np.abs(errors[41:, :2]).max() < 0.05


def test_mapping_while_localising_closes_on_itself_in_a_room():
    config = LocalizerConfig(mapping=True)
    errors, all_known = run(room(), None, [4, 1.2, 0], IN_CIRCLE, config, 0)
    assert np.abs(errors[:, :2]).max() < 0.05
    assert np.abs(errors[-1, 2]) < np.radians(1)
    last = all_known[-1]
    assert 10 < len(last.keyframes) < 40
    # The map lies on the walls.
    cells = last.grid.origin + (np.argwhere(last.grid.occupied) + 0.5) * last.grid.resolution
    walls = room()
    distance = np.min([_to_segment(cells, *wall) for wall in walls], axis=0)
    assert np.quantile(distance, 0.95) < 0.06
    assert nees(errors, all_known).mean() / 3 < 4


def test_the_strategy_of_the_paper_maps_on_the_way_though_much_of_a_scan_is_not_in_the_map_yet():
    config = LocalizerConfig(method="paper", mapping=True, max_range=4.0)
    errors, all_known = run(room(), None, [4, 1.2, 0], IN_CIRCLE, config, 0)
    assert np.hypot(*errors[:, :2].T).max() < 0.2
    assert len(all_known[-1].keyframes) > 10
    assert all(known.likelihood is all_known[0].likelihood for known in all_known)  # costs time, and is not used


def test_mapping_a_bare_corridor_does_not_hold_on_to_its_own_noise():
    errors, all_known = run(corridor(), None, [0, 0.2, 0], ALONG, LocalizerConfig(mapping=True), 4)
    deviation = np.sqrt(all_known[-1].covariance[0, 0])
    assert deviation > 0.2
    assert abs(errors[-1, 0]) < 3 * deviation
    assert abs(errors[-1, 0]) < 1.0


def test_a_given_plan_takes_in_what_is_new():
    """A box that is not in the plan is in the map after a drive past it."""
    config = LocalizerConfig(mapping=True)
    bare = plan_of(room()[:5])
    _, all_known = run(room(), bare, [4, 1.2, 0], IN_CIRCLE, config, 0)
    grid = all_known[-1].grid
    i, j = np.floor(grid.cells_of(np.array([[5.52, 1.6]]))[0]).astype(int)
    assert bare.log_odds.shape <= grid.log_odds.shape
    assert grid.occupied[i - 1 : i + 2, j].any()


def test_what_motion_does_to_a_scan_is_undone():
    """Beams that are fired one after the other while the robot turns at 1 rad/s and drives 1 m/s, 0.1 s a scan."""
    config = LocalizerConfig()
    rng = np.random.default_rng(0)
    angles = np.radians(np.linspace(-135, 135, 271))
    ages = 0.1 * (1 - np.linspace(0, 1, 271))
    errors = {}
    for undone in (True, False):
        X, odometry = np.array([2.0, 3.0, 0.0]), np.zeros(3)
        known = start_localization(config, ROOM, X)
        worst = 0.0
        for k in range(12):
            ranges = np.empty(len(angles))
            for b, (angle, age) in enumerate(zip(angles, ages, strict=True)):
                at = compose(X, np.array([-age, 0.0, -age]))
                ranges[b] = scan_in(room(), at, angles=np.array([angle])).ranges[0]
            ranges += 0.01 * rng.standard_normal(len(ranges))
            scan = LaserScan(ranges, angles, 30.0, 0.1 * k, ages if undone else (), index=k)
            known = localize(known, scan, odometry, config)
            if k > 0:
                worst = max(worst, np.abs(difference(X, known.pose))[:2].max())
            step = np.array([0.1, 0.0, 0.1])
            X, odometry = compose(X, step), compose(odometry, step)
        errors[undone] = worst
    assert errors[True] < 0.03
    assert errors[False] > 2 * errors[True]


def test_two_runs_with_one_seed_are_equal():
    config = LocalizerConfig(mapping=True)
    first, again = (run(room(), None, [4, 1.2, 0], IN_CIRCLE[:20], config, 3)[1][-1] for _ in range(2))
    np.testing.assert_array_equal(first.pose, again.pose)
    np.testing.assert_array_equal(first.grid.log_odds, again.grid.log_odds)


def test_a_wrong_configuration_is_refused_by_name():
    wrong = dataclasses.replace(LocalizerConfig(), beams=3)
    with pytest.raises(ConfigError, match=r"localizer.beams"):
        start_localization(wrong, ROOM)


def test_prediction_agrees_with_a_cloud_of_samples():
    rng, accuracy = np.random.default_rng(0), PlanarOdometryAccuracy(along=0.1, across=0.05, heading_deg=2, turn_deg=4)
    X, P, step = np.array([1.0, 2.0, 0.7]), np.diag([0.02, 0.05, 0.03]) ** 2, np.array([0.5, 0.1, 0.2])
    after, covariance = predict(X, P, step, accuracy)
    _, Q = predict(np.zeros(3), np.zeros((3, 3)), step, accuracy)
    starts = X + rng.standard_normal((4000, 3)) @ np.linalg.cholesky(P).T
    noise = rng.standard_normal((4000, 3)) @ np.linalg.cholesky(Q).T
    ends = np.array([compose(a, step + n) for a, n in zip(starts, noise, strict=True)])
    np.testing.assert_allclose(ends.mean(axis=0), after, atol=0.005)
    np.testing.assert_allclose(np.cov(ends.T), covariance, atol=0.06 * np.abs(covariance).max())


def test_fusion_is_that_of_two_gaussians_and_ignores_what_the_scan_does_not_tell():
    P, information = np.diag([0.04, 0.01, 0.001]), np.diag([25.0, 0.0, 1000.0])
    change, after = fuse(P, information, np.array([0.2, 0.3, 0.01]))
    np.testing.assert_allclose(change, [0.1, 0.0, 0.005])
    np.testing.assert_allclose(np.diag(after), [0.02, 0.01, 0.0005])
    assert surprise(P, information, np.array([0.2, 5.0, 0.0])) == pytest.approx(0.04 / 0.08)


def test_the_lower_of_two_covariances_is_below_both():
    rng = np.random.default_rng(0)
    for _ in range(20):
        P, Q = (a @ a.T + 0.01 * np.eye(3) for a in rng.standard_normal((2, 3, 3)))
        least = the_lower(P, Q)
        for other in (P, Q):
            assert np.linalg.eigvalsh(other - least).min() > -1e-9
    np.testing.assert_allclose(the_lower(np.diag([1.0, 4, 9]), np.diag([2.0, 3, 9])), np.diag([1.0, 3, 9]))


def test_walls_that_are_not_straight_tell_nothing_along_them():
    n, tilt = 200, np.random.default_rng(0).normal(0, np.radians(3), 200)
    j = np.stack([np.sin(tilt), np.cos(tilt), np.linspace(-5, 5, n)], axis=1)
    t = np.stack([-np.cos(tilt), np.sin(tilt), np.full(n, 1.5)], axis=1)
    A, T = j.T @ j / 0.02**2, t.T @ t / 0.02**2
    left = information_of(A, T, np.radians(5))
    assert A[0, 0] > 1000  # 3 cm, out of nothing
    assert left[0, 0] < 1e-3 * A[0, 0]
    assert left[1, 1] == pytest.approx(A[1, 1], rel=0.02)


def _to_segment(points, a, b):
    t = np.clip(((points - a) @ (b - a)) / np.dot(b - a, b - a), 0, 1)
    return np.linalg.norm(points - a - t[:, None] * (b - a), axis=1)
