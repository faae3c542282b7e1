import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.localization import (
    CorrelativeSearchConfig,
    GraphMapper,
    GraphMappingConfig,
    OccupancyGrid,
    PlanarOdometryAccuracy,
    correlative_search,
    make_field,
    make_search_image,
    read_carmen_log,
)
from naraha.systems.localization.planar import between, difference

from .rooms import drive, noisy_odometry, rasterised, rectangle, room, scan_in

SEARCH = CorrelativeSearchConfig(distance=0.6, angle_deg=8.0, window=5)


def image_of(walls):
    occupied, origin = rasterised(walls)
    return make_search_image(make_field(OccupancyGrid.from_plan(occupied, 0.05, origin)), SEARCH)


def score_at(image, points, X):
    c, s = np.cos(X[2]), np.sin(X[2])
    ends = points @ np.array([[c, s], [-s, c]])
    # Shifts are whole cells from where the beams end at the expected pose.
    ij = np.floor((ends + X[:2] - image.origin) / image.resolution).astype(int)
    inside = ((ij >= 0) & (ij < image.fine.shape)).all(axis=1)
    return image.fine[tuple(ij[inside].T)].sum() / len(points)


@pytest.mark.parametrize("seed", range(2))
def test_the_search_finds_the_best_of_the_whole_lattice(seed):
    """Against trying every pose of it, without bounds."""
    rng = np.random.default_rng(seed)
    image = image_of(room())
    truth = np.array([rng.uniform(2, 4), rng.uniform(2, 4), rng.uniform(-3, 3)])
    points = scan_in(room(), truth, rng).p_SP[::6]
    expected = truth + rng.uniform(-0.45, 0.45, 3) * [1, 1, 0.25]
    found, score, rival = correlative_search(image, points, expected, SEARCH)
    shifts = 0.05 * np.arange(-12, 13)
    best = max(
        score_at(image, points, np.add(expected, [x, y, np.radians(turn)]))
        for turn in range(-8, 9)
        for x in shifts
        for y in shifts
    )
    assert score == pytest.approx(best, abs=1e-6)
    assert score == pytest.approx(score_at(image, points, found), abs=0.02)
    assert not rival.any()
    assert np.abs(difference(truth, found))[:2].max() < 0.07
    assert abs(difference(truth, found)[2]) < np.radians(1.1)


def test_loops_need_a_localizer_that_makes_a_likelihood_field():
    config = GraphMappingConfig()
    config.localizer.method = "paper"
    with pytest.raises(ConfigError, match=r"graph_mapping\.localizer\.method"):
        GraphMapper(config)


def test_a_place_that_looks_alike_has_a_rival():
    """In a bare corridor the scan fits anywhere along it."""
    image = image_of(rectangle(-8, -1, 8, 1))
    points = scan_in(rectangle(-8, -1, 8, 1), np.zeros(3), range_max=3.0).p_SP
    _, score, rival = correlative_search(image, points, np.array([0.1, 0.05, 0.02]), SEARCH)
    assert score > 0.9
    assert abs(rival[0]) > 0.5
    assert abs(rival[1]) < 0.2


def test_the_bounds_hold_at_the_edges_of_the_map_too():
    image = image_of(rectangle(0, 0, 3, 3))
    w = SEARCH.window
    rng = np.random.default_rng(0)
    for i, j in rng.integers(0, np.array(image.fine.shape) - w, (500, 2)):
        assert image.coarse[i, j] == image.fine[i : i + w, j : j + w].max()


# A ring of corridors, 2 m wide, around a block, with niches that tell where one is.
FRONT = np.radians(np.arange(-90, 91))
NICHES = ((3, 0), (9, 0), (15, 3), (15, 7.5), (11, 10.5), (5, 10.5), (0.5, 6))
RING = np.concatenate(
    [
        rectangle(0.5, 0, 15.5, 10.9),
        rectangle(2.6, 2, 13.4, 8.9),
        *(rectangle(x, y, x + 0.5, y + 0.4) for x, y in NICHES),
    ]
)


def ring_drive():
    straight = lambda length: [[0.1, 0.0, 0.0]] * round(length / 0.1)  # noqa: E731
    corner = [[0.05, 0.0, np.pi / 40]] * 20
    lap = [*straight(11.6), *corner, *straight(7.6), *corner, *straight(11.6), *corner, *straight(7.6), *corner]
    return lap + straight(5.0)


@pytest.fixture(scope="module")
def lap():
    """A lap and a bit around the ring, with bad odometry; the robot sees 4 m."""
    config = GraphMappingConfig()
    rng = np.random.default_rng(1)
    steps = ring_drive()
    truth = drive([2.2, 1.0, 0.0], steps)
    odometry = noisy_odometry(steps, rng, PlanarOdometryAccuracy(along=0.08, across=0.03, heading_deg=3, turn_deg=4))
    mapper = GraphMapper(config)
    for k, (X, X_OB) in enumerate(zip(truth, odometry, strict=True)):
        scan = scan_in(
            RING, X, rng, noise=0.02, time=0.1 * k, index=k, range_max=4.0, angles=np.radians(np.arange(-90, 91))
        )
        mapper.add_scan(scan, X_OB)
    return mapper, truth, mapper.finish()


def in_start(truth):
    """Poses in the axes of the first."""
    c, s = np.cos(truth[0, 2]), np.sin(truth[0, 2])
    p = (truth[:, :2] - truth[0, :2]) @ np.array([[c, -s], [s, c]])
    return np.column_stack([p, truth[:, 2] - truth[0, 2]])


def test_a_lap_is_closed_and_the_map_is_sharper_for_it(lap):
    mapper, truth, grid = lap
    assert mapper.accepted.sum() >= 3
    error = np.linalg.norm(mapper.trajectory()[:, :2] - in_start(truth)[:, :2], axis=1)
    open_error = np.linalg.norm(mapper.open_trajectory()[:, :2] - in_start(truth)[:, :2], axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.2
    assert error[-1] < 0.1
    assert open_error[-1] > 2 * error[-1]
    local = np.array([keyframe.local for keyframe in mapper.keyframes])
    assert grid.entropy() < mapper.make_map(local).entropy()


def test_every_scan_has_a_pose_and_the_last_is_the_one_now(lap):
    mapper, truth, _ = lap
    assert mapper.trajectory().shape == (len(truth), 3)
    np.testing.assert_allclose(mapper.pose, mapper.trajectory()[-1])


def test_loops_agree_with_truth(lap):
    mapper, truth, _ = lap
    for (i, j, X_ij, information), accepted in zip(mapper.loops, mapper.accepted, strict=True):
        if accepted:
            scans = mapper.keyframes[i].scan, mapper.keyframes[j].scan
            error = between(X_ij, between(truth[scans[0]], truth[scans[1]]))
            assert error @ information @ error < 16.3


def test_a_wrong_configuration_is_refused():
    with pytest.raises(ConfigError, match=r"graph_mapping.submap_keyframes"):
        GraphMapper(GraphMappingConfig(submap_keyframes=1))


@pytest.mark.slow
def test_a_real_building_is_mapped_without_a_tear(shared_data):
    """FR079: loops are found and believed, and the map is sharper than by odometry or by the localiser alone."""
    log = read_carmen_log(shared_data / "radish" / "fr079.clf.bz2", most=2000)
    mapper = GraphMapper(X_BS=log.X_BS)
    for scan, X_OB in zip(log.scans, log.odometry, strict=True):
        mapper.add_scan(scan, X_OB)
    grid = mapper.finish()
    raw = log.odometry[[keyframe.scan for keyframe in mapper.keyframes]]
    local = np.array([keyframe.local for keyframe in mapper.keyframes])
    assert mapper.accepted.mean() > 0.7
    assert mapper.accepted.sum() > 80
    assert grid.entropy() < mapper.make_map(local).entropy() < mapper.make_map(raw).entropy()
