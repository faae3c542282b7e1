"""The voxel map: occupancy as OctoMap keeps it, classes and channels where it is occupied."""

import copy

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.voxel_map import FREE, NO_LABEL, OCCUPIED, UNKNOWN, VoxelMap, VoxelMapConfig
from open3d.t.geometry import PointCloud

HIT, MISS = np.log(0.7 / 0.3), np.log(0.4 / 0.6)
LOWEST, HIGHEST = np.log(0.1192 / 0.8808), np.log(0.971 / 0.029)
ORIGIN = np.full(3, 0.05)
WALL = np.array([[1.05, 0.05, 0.05]])
BEFORE = np.array([[0.55, 0.05, 0.05]])
BEHIND = np.array([[2.05, 0.05, 0.05]])


def content(voxels):
    """Everything that a map says, in an order that does not depend on how it was made."""
    cloud = voxels.to_cloud()
    indices, log_odds = voxels.known()
    order = np.lexsort(indices.T)
    return [indices[order], log_odds[order], *(cloud.point[name].numpy() for name, _ in sorted(cloud.point.items()))]


def assert_same(a, b):
    for x, y in zip(content(a), content(b), strict=True):
        np.testing.assert_array_equal(x, y)


def random_scan(seed, count=400):
    rng = np.random.default_rng(seed)
    origin = rng.uniform(-1, 1, 3)
    direction = rng.normal(size=(count, 3))
    return origin + direction / np.linalg.norm(direction, axis=1, keepdims=True) * rng.uniform(1, 4, (count, 1)), origin


def test_one_ray_makes_its_end_occupied_and_its_way_free():
    voxels = VoxelMap()
    voxels.insert(WALL, ORIGIN)
    asked = np.vstack([WALL, BEFORE, WALL + np.array([0.1, 0, 0]), [[np.nan, 0, 0]], [[1e12, 0, 0]]])
    np.testing.assert_allclose(voxels.log_odds(asked)[:2], [HIT, MISS], rtol=1e-6)
    assert voxels.state(asked).tolist() == [OCCUPIED, FREE, UNKNOWN, UNKNOWN, UNKNOWN]
    np.testing.assert_allclose(voxels.occupancy(asked), [0.7, 0.4, 0.5, 0.5, 0.5], rtol=1e-6)
    np.testing.assert_allclose(voxels.occupied(), WALL, atol=1e-12)
    np.testing.assert_allclose(voxels.bounds(), [[0, 0, 0], [1.1, 0.1, 0.1]], atol=1e-12)


def test_a_voxel_counts_once_a_scan_however_many_rays_meet_it():
    voxels = VoxelMap()
    voxels.insert(np.repeat(WALL, 50, axis=0), ORIGIN)
    np.testing.assert_allclose(voxels.log_odds(np.vstack([WALL, BEFORE])), [HIT, MISS], rtol=1e-6)


def test_log_odds_are_clamped_and_recover():
    voxels = VoxelMap()
    for _ in range(20):
        voxels.insert(WALL, ORIGIN)
    np.testing.assert_allclose(voxels.log_odds(np.vstack([WALL, BEFORE])), [HIGHEST, LOWEST], rtol=1e-6)
    voxels.insert(BEHIND, ORIGIN)
    np.testing.assert_allclose(voxels.log_odds(WALL), [HIGHEST + MISS], rtol=1e-6)


def test_the_probabilities_are_parameters_that_are_checked():
    voxels = VoxelMap(VoxelMapConfig(hit_probability=0.9, miss_probability=0.3))
    voxels.insert(WALL, ORIGIN)
    np.testing.assert_allclose(voxels.occupancy(np.vstack([WALL, BEFORE])), [0.9, 0.3], rtol=1e-5)
    with pytest.raises(ConfigError, match="hit_probability"):
        VoxelMap(VoxelMapConfig(hit_probability=0.3))
    with pytest.raises(ConfigError, match="voxel_size"):
        VoxelMap(VoxelMapConfig(voxel_size=0.0))


def test_points_beyond_the_range_only_carve():
    voxels = VoxelMap(VoxelMapConfig(max_range=0.7))
    voxels.insert(WALL, ORIGIN)
    assert voxels.state(np.vstack([WALL, BEFORE])).tolist() == [UNKNOWN, FREE]
    assert len(voxels.occupied()) == 0


@pytest.mark.parametrize("centre", [[0, 0, 0], [-5e3, 4e3, -2e3], [7e5, -7e5, 3e5]])
def test_it_grows_to_negative_and_far_places(centre):
    points, origin = random_scan(0)
    shift = np.array(centre, float)
    near, far = VoxelMap(), VoxelMap()
    for scan in range(3):
        near.insert(points + 0.3 * scan, origin)
        far.insert(points + 0.3 * scan + shift, origin + shift)
    (i, log_odds), (j, far_log_odds) = near.known(), far.known()
    differ = set(map(tuple, (i + np.round(shift / 0.1).astype(int)).tolist())) ^ set(map(tuple, j.tolist()))
    assert len(differ) <= 1e-3 * len(i)  # 7e5 m and 0.05 m share a float64 to 1e-10 m: rays through corners differ
    assert far_log_odds.sum() == pytest.approx(log_odds.sum(), rel=1e-3)


def test_what_is_known_already_is_not_moved_when_the_map_grows():
    voxels = VoxelMap()
    voxels.insert(*random_scan(0))
    chunks = list(voxels._store.chunks)
    for k in range(1, 30):
        points, origin = random_scan(k)
        shift = np.array([20.0 * k, 0, 0])
        voxels.insert(points + shift, origin + shift)
    assert len(voxels._store.chunks) > 10 * len(chunks)
    assert all(a is b for a, b in zip(chunks, voxels._store.chunks, strict=False))


def test_points_that_are_not_finite_change_nothing():
    points, origin = random_scan(1)
    clean, dirty = VoxelMap(), VoxelMap()
    clean.insert(points, origin, channels={"nir": np.ones(len(points))})
    bad = np.vstack([points, [[np.nan, 1, 1], [1, np.inf, 1]]])
    dirty.insert(bad, origin, channels={"nir": np.append(np.ones(len(points)), [5.0, 5.0])})
    assert_same(clean, dirty)
    dirty.insert(np.zeros((0, 3)), origin)
    dirty.insert(np.full((4, 3), np.nan), origin)
    assert_same(clean, dirty)


def test_two_runs_are_equal_to_the_last_bit():
    maps = [VoxelMap(classes=3) for _ in range(2)]
    for voxels in maps:
        for k in range(4):
            points, origin = random_scan(k)
            p = np.random.default_rng(k).dirichlet(np.ones(3), len(points))
            voxels.insert(points, origin, class_probabilities=p, channels={"nir": p[:, 0]})
    assert_same(*maps)
    assert repr(maps[0]) == repr(maps[1])


def test_class_counts_make_the_posterior():
    voxels = VoxelMap()
    p = np.array([[0.75, 0.25, 0.0], [0.5, 0.5, 0.0], [np.nan, np.nan, np.nan]])
    voxels.insert(np.repeat(WALL, 3, axis=0), ORIGIN, class_probabilities=p, numbers=np.array([2, 1, 7]))
    expected = (np.array([2.0, 1.0, 0.0]) + 1 / 3) / 4
    asked = np.vstack([WALL, BEFORE])
    np.testing.assert_allclose(voxels.class_posterior(asked), [expected, np.full(3, 1 / 3)], rtol=1e-6)
    np.testing.assert_allclose(
        voxels.class_entropy(asked), [-(expected * np.log(expected)).sum(), np.log(3)], rtol=1e-6
    )
    assert voxels.classes == 3


def test_class_counts_saturate_by_halving_and_keep_their_ratio():
    voxels = VoxelMap(classes=2)
    for _ in range(100):
        voxels.insert(WALL, ORIGIN, class_probabilities=np.array([[0.8, 0.2]]), numbers=np.array([100]))
    np.testing.assert_allclose(voxels.class_posterior(WALL), [[0.8, 0.2]], atol=2e-3)
    for _ in range(40):
        voxels.insert(WALL, ORIGIN, class_probabilities=np.array([[0.0, 1.0]]), numbers=np.array([100]))
    assert voxels.class_posterior(WALL)[0, 1] > 0.9  # the past has faded


def test_a_fifth_of_wrong_labels_is_outvoted():
    rng = np.random.default_rng(2)
    voxels = VoxelMap(classes=4)
    for _ in range(30):
        label = 2 if rng.random() > 0.2 else rng.integers(0, 4)
        voxels.insert(WALL, ORIGIN, class_probabilities=np.eye(4)[[label]])
    assert voxels.class_posterior(WALL)[0].argmax() == 2
    assert voxels.class_posterior(WALL)[0, 2] > 0.7


def test_channel_means_count_each_measurement_and_skip_what_is_not_known():
    voxels = VoxelMap()
    points = np.repeat(WALL, 4, axis=0)
    voxels.insert(points, ORIGIN, channels={"nir": np.array([1.0, 2.0, np.nan, 6.0]), "colour": np.ones(4)})
    voxels.insert(WALL, ORIGIN, channels={"nir": np.array([10.0])}, numbers=np.array([5]))
    cloud = voxels.to_cloud()
    np.testing.assert_allclose(cloud.point["nir"].numpy(), [[(1 + 2 + 6 + 50) / 8]], rtol=1e-6)
    assert sorted(name for name, _ in cloud.point.items()) == ["nir", "occupancy", "positions"]


def test_a_voxel_that_becomes_free_forgets_what_it_was():
    voxels = VoxelMap(classes=2)
    voxels.insert(WALL, ORIGIN, class_probabilities=np.array([[1.0, 0.0]]), channels={"nir": np.array([0.9])})
    for _ in range(3):
        voxels.insert(BEHIND, ORIGIN)
    assert voxels.state(WALL).tolist() == [FREE]
    np.testing.assert_allclose(voxels.class_posterior(WALL), [[0.5, 0.5]])
    voxels.insert(WALL, ORIGIN, class_probabilities=np.array([[0.0, 1.0]]), channels={"nir": np.array([0.1])})
    voxels.insert(WALL, ORIGIN, class_probabilities=np.array([[0.0, 1.0]]), channels={"nir": np.array([0.1])})
    assert voxels.class_posterior(WALL)[0, 1] > 0.7
    at = np.argmin(np.linalg.norm(voxels.to_cloud().point.positions.numpy() - WALL, axis=1))
    np.testing.assert_allclose(voxels.to_cloud().point["nir"].numpy()[at], [0.1], rtol=1e-6)


def test_a_cloud_brings_its_attributes_and_other_sensors_points_carve_nothing():
    cloud = PointCloud(o3d.core.Tensor(np.array([[1, 0, 0], [0, 1, 0]], np.float32)))
    for name, column in {"intensity": [0.4, np.nan], "nir": [0.1, 0.2], "count": [3, 1]}.items():
        cloud.point[name] = o3d.core.Tensor(np.array(column, np.float32)[:, None])
    cloud.point["class_probabilities"] = o3d.core.Tensor(np.array([[0.9, 0.1], [0.2, 0.8]], np.float32))
    X = np.eye(4)
    X[:3, 3] = [5.05, 0.05, 0.05]
    voxels = VoxelMap()
    voxels.insert_cloud(cloud, X, np.zeros(3))
    asked = X[:3, 3] + np.array([[1, 0, 0], [0, 1, 0], [0.5, 0, 0], [0, 0.5, 0]])
    assert voxels.state(asked).tolist() == [OCCUPIED, OCCUPIED, FREE, UNKNOWN]
    np.testing.assert_allclose(voxels.class_posterior(asked)[0], [(2.7 + 0.5) / 4, (0.3 + 0.5) / 4], atol=3e-3)
    made = voxels.to_cloud()
    assert made.point["label"].numpy().ravel().tolist() == [1, 0]  # sorted by index: x = 5.05 first
    np.testing.assert_allclose(made.point["nir"].numpy().ravel(), [0.2, 0.1], rtol=1e-6)
    np.testing.assert_allclose(made.point["intensity"].numpy().ravel(), [np.nan, 0.4], rtol=1e-6)
    np.testing.assert_allclose(made.point["occupancy"].numpy().ravel(), [0.7, 0.7], rtol=1e-6)
    voxels.insert_cloud(PointCloud(), X, np.zeros(3))
    assert len(voxels.to_cloud().point.positions) == 2


def test_an_empty_map_answers_everything():
    voxels = VoxelMap()
    assert voxels.bounds() is None
    assert len(voxels.occupied()) == 0
    assert len(voxels.to_cloud().point.positions) == 0
    assert voxels.state(np.zeros((2, 3))).tolist() == [UNKNOWN, UNKNOWN]
    assert voxels.class_posterior(np.zeros((2, 3))).shape == (2, 0)
    assert (voxels.to_dense([0, 0, 0], [1, 1, 1]).state == UNKNOWN).all()


def test_dense_boxes_say_what_the_map_says():
    voxels = VoxelMap(classes=3)
    for k in range(3):
        points, origin = random_scan(k)
        p = np.random.default_rng(k).dirichlet(np.ones(3), len(points))
        voxels.insert(points[:200], origin, class_probabilities=p[:200])
        voxels.insert(points[200:], origin)
    dense = voxels.to_dense([-2.3, -1.0, -0.7], [1.7, 2.0, 3.3])
    assert dense.state.shape == (40, 30, 40)
    np.testing.assert_allclose(dense.origin, [-2.3, -1.0, -0.7], atol=1e-12)
    every = np.argwhere(np.ones(dense.state.shape, bool))
    centres = dense.centres(every)
    np.testing.assert_array_equal(dense.indices(centres), every)
    np.testing.assert_array_equal(dense.log_odds.ravel(), voxels.log_odds(centres))
    np.testing.assert_array_equal(dense.state.ravel(), voxels.state(centres))
    posterior = voxels.class_posterior(centres)
    seen = posterior.max(axis=1) > posterior.min(axis=1)
    np.testing.assert_array_equal(dense.label.ravel()[seen], posterior[seen].argmax(axis=1))
    assert seen.any()
    assert (dense.label.ravel()[~seen] == NO_LABEL).all()


@pytest.mark.parametrize("high", [[0, 1, 1], [1, np.inf, 1], [1e4, 1e4, 1e4]])
def test_boxes_that_make_no_sense_are_refused(high):
    with pytest.raises(ValueError, match="box"):
        VoxelMap().to_dense([0, 0, 0], high)


def test_a_copy_and_its_original_do_not_write_into_each_other():
    original = VoxelMap(classes=2)
    points, origin = random_scan(0)
    p = np.full((len(points), 2), 0.5)
    original.insert(points, origin, class_probabilities=p)
    before = content(original)
    branch, twin = original.copy(), copy.deepcopy(original)
    assert branch._store.chunks[0] is original._store.chunks[0]
    branch.insert(*random_scan(1), class_probabilities=p)
    for x, y in zip(before, content(original), strict=True):
        np.testing.assert_array_equal(x, y)
    original.insert(*random_scan(2), class_probabilities=p)
    for x, y in zip(before, content(twin), strict=True):
        np.testing.assert_array_equal(x, y)
    again = VoxelMap(classes=2)
    for k in (0, 1):
        again.insert(*random_scan(k), class_probabilities=p)
    assert_same(branch, again)


def test_a_frozen_map_cannot_be_written_to():
    frozen = VoxelMap().freeze()
    assert copy.deepcopy(frozen) is frozen
    with pytest.raises(ValueError, match="frozen"):
        frozen.insert(WALL, ORIGIN)
    with pytest.raises(ValueError, match="frozen"):
        frozen.merge(VoxelMap())
    thawed = frozen.copy()
    thawed.insert(WALL, ORIGIN)
    assert len(frozen.occupied()) == 0


def test_another_number_of_classes_is_refused():
    voxels = VoxelMap(classes=3)
    with pytest.raises(ValueError, match="2 classes in a map of 3"):
        voxels.insert(WALL, ORIGIN, class_probabilities=np.ones((1, 2)))
    with pytest.raises(ValueError, match="not \\(1, K\\)"):
        voxels.insert(WALL, ORIGIN, class_probabilities=np.ones((2, 3)))
    assert len(voxels.known()[1]) == 0


def test_the_bytes_of_a_known_voxel_stay_below_sixty():
    voxels = VoxelMap(classes=6)
    for k in range(4):
        points, origin = random_scan(k, 4000)
        p = np.random.default_rng(k).dirichlet(np.ones(6), len(points))
        voxels.insert(points, origin, class_probabilities=p, channels=dict.fromkeys(voxels.channels, p[:, 0]))
    assert voxels.nbytes / len(voxels.known()[1]) < 60


def test_occupancy_is_that_of_octomap():
    octomap = pytest.importorskip("octomap")
    tree, voxels = octomap.OcTree(0.1), VoxelMap(VoxelMapConfig(max_range=3.0))
    for k in range(6):
        points, origin = (a.astype(np.float32).astype(float) for a in random_scan(k, 1500))
        tree.insertPointCloud(points, origin, 3.0)
        voxels.insert(points, origin)
    indices, log_odds = voxels.known()
    theirs = []
    for centre in (indices + 0.5) * 0.1:
        node = tree.search(centre)
        try:
            theirs.append(node.getLogOdds())
        except octomap.NullPointerException:
            theirs.append(np.nan)
    theirs = np.array(theirs)
    differs = ~np.isclose(theirs, log_odds, atol=1e-6)
    assert differs.mean() < 1e-3  # rays through corners: OctoMap follows its rays in float32
    assert len(indices) > 10_000
