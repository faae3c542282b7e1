import numpy as np
import open3d as o3d
import pytest
from naraha.systems.changes.seen_space import SeenSpace, free_voxels, make_seen_space, read_seen, voxel_keys, write_seen
from naraha.systems.changes.sight import Rays, SeenSpaceConfig, keyframe_rays, look_again
from naraha.systems.errors import ScanFileError
from naraha.systems.slam import Keyframe
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform

ORIGIN = np.array([0.0, 0.0, 1.0])


def fan(points, time=0.0, origin=ORIGIN):
    return Rays(np.asarray(origin, float), np.asarray(points, np.float32).reshape(-1, 3), time)


def wall(x=5.0, half=1.0, step=0.05):
    """Returns of a wall across x."""
    y, z = np.meshgrid(np.arange(-half, half, step), np.arange(0, 2, step))
    return np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1)


def one(point, normal=(-1.0, 0, 0), rays=None, **config):
    sight = look_again(np.array([point]), np.array([normal]), rays, SeenSpaceConfig(**config))
    return tuple(int(count[0]) for count in (sight.hit, sight.through, sight.hidden))


def test_a_ray_frees_every_voxel_up_to_just_before_its_hit_and_no_other():
    keys = free_voxels(fan([[2.95, 0.01, 1.01]], origin=[0.05, 0.05, 1.05]), SeenSpaceConfig(stop_short=0.15))
    x = 0.05 + 0.1 * np.arange(28)
    expected = voxel_keys(np.stack([x, 0.05 - 0.04 * (x - 0.05) / 2.9, 1.05 - 0.04 * (x - 0.05) / 2.9], axis=1), 0.1)
    np.testing.assert_array_equal(keys, np.sort(expected))


def test_free_voxels_are_the_same_however_large_the_grid(monkeypatch):
    rng = np.random.default_rng(0)
    rays = fan(rng.normal(0, 3, (500, 3)) - 1e3, origin=[-1e3, -1e3, -1e3])
    sparse = free_voxels(rays)
    monkeypatch.setitem(free_voxels.__globals__, "_MAX_GRID", 0)
    np.testing.assert_array_equal(free_voxels(rays), sparse)
    assert (np.diff(sparse) > 0).all()


def test_space_behind_a_hit_and_beside_the_rays_is_unseen():
    seen = make_seen_space([fan(wall())])
    at = np.array([[4.0, 0, 1], [4.97, 0, 1], [5.5, 0, 1], [3.0, 2.0, 1], [np.nan, 0, 0]])
    np.testing.assert_array_equal(seen.views_at(at), [1, 0, 0, 0, 0])


def test_seen_space_remembers_how_often_and_when_last():
    first = make_seen_space([fan(wall(), 3.0), fan(wall(4.0), 9.0)], survey=0)
    near, far = np.array([[2.0, 0, 1]]), np.array([[4.5, 0, 1]])
    assert first.views_at(near) == 2
    assert first.views_at(far) == 1
    both = first.merge(make_seen_space([fan(wall(4.0), 1.0)], survey=1))
    at = dict(zip(both.keys.tolist(), zip(both.survey.tolist(), both.time.tolist(), strict=True), strict=True))
    assert both.views_at(near) == 3
    assert at[int(voxel_keys(near, 0.1)[0])] == (1, 1.0)
    assert at[int(voxel_keys(far, 0.1)[0])] == (0, 3.0)


def test_no_rays_and_rays_that_are_not_finite_free_nothing():
    assert len(make_seen_space([]).keys) == 0
    assert len(free_voxels(fan([[np.nan, 0, 0], [np.inf, 0, 0], [0, 0, 1.0]]))) == 0
    assert make_seen_space([]).merge(make_seen_space([fan(wall())])).volume > 0
    assert make_seen_space([]).views_at(ORIGIN[None]) == 0


def test_a_point_is_hit_seen_through_hidden_or_out_of_view():
    rays = [fan(wall())]
    assert one([5.05, 0.2, 1.0], rays=rays) == (1, 0, 0)
    assert one([3.0, 0.2, 1.0], rays=rays) == (0, 1, 0)
    assert one([7.0, 0.2, 1.0], rays=rays) == (0, 0, 1)
    assert one([3.0, 2.5, 1.0], rays=rays) == (0, 0, 0)
    assert one([np.nan, 0, 1.0], rays=rays) == (0, 0, 0)
    assert one([3.0, 0.2, 1.0], (0, 0, 0), rays=rays) == (0, 1, 0)  # a surface of which the normal is not known
    assert one([3.0, 0.2, 1.0], rays=rays * 3) == (0, 3, 0)


def test_nothing_is_said_between_two_rings():
    rings = np.deg2rad([-3.0, -1.0, 1.0, 3.0])
    yaw = np.deg2rad(np.arange(-20, 20, 0.2))
    points = np.array([[9 * np.cos(a), 9 * np.sin(a), 1 + 9 * np.tan(e)] for e in rings for a in yaw])
    on_ring, between = [8.0, 0.0, 1 + 8 * np.tan(rings[2])], [8.0, 0.0, 1.0]
    assert one(on_ring, rays=[fan(points)]) == (0, 1, 0)
    assert one(between, rays=[fan(points)]) == (0, 0, 0)  # the rings pass 0.14 m away


def test_a_ray_that_grazes_a_floor_does_not_see_through_it():
    far_floor = [[8.0, y, 0.0] for y in np.arange(-0.5, 0.5, 0.02)]
    rays = [fan(far_floor, origin=[0, 0, 0.3])]
    assert one([6.0, 0.0, 0.0], (0, 0, 1), rays=rays) == (0, 0, 0)  # passed over at 0.075 m
    assert one([6.0, 0.0, 0.075], (-1, 0, 0), rays=rays) == (0, 1, 0)  # something upright would have been met


def test_points_of_another_sensor_are_no_rays():
    cloud = PointCloud(o3d.core.Tensor(np.array([[1, 0, 0], [2, 0, 0], [np.nan, 0, 0]], np.float32)))
    cloud.point["intensity"] = o3d.core.Tensor(np.array([[0.5], [np.nan], [0.5]], np.float32))
    rays = keyframe_rays(Keyframe(0, 2.0, RigidTransform([0, 0, 3.0]), None, cloud, 1.0), np.array([0, 0, 0.2]))
    np.testing.assert_allclose(rays.p_MP, [[1, 0, 3]])
    np.testing.assert_allclose(rays.p_MS, [0, 0, 3.2])


def test_seen_space_survives_its_file(tmp_path):
    seen = make_seen_space([fan(wall(), 3.5), fan(-wall(), 4.0)], survey=2)
    write_seen(tmp_path / "survey_seen.npz", seen)
    again = read_seen(tmp_path / "survey_seen.npz")
    assert again.voxel_size == seen.voxel_size
    for name in ("keys", "views", "survey", "time"):
        np.testing.assert_array_equal(getattr(again, name), getattr(seen, name))
        assert getattr(again, name).dtype == getattr(seen, name).dtype


def test_a_seen_file_that_cannot_be_used_is_named(tmp_path):
    good = make_seen_space([fan(wall())])
    path = tmp_path / "survey_seen.npz"
    with pytest.raises(ScanFileError, match=r"survey_seen.npz: no such file"):
        read_seen(path)
    path.write_bytes(b"not an archive")
    with pytest.raises(ScanFileError, match=r"survey_seen.npz: not a readable"):
        read_seen(path)
    np.savez(path, voxel_size=0.1)
    with pytest.raises(ScanFileError, match="key_steps: not a record of seen space"):
        read_seen(path)
    write_seen(path, SeenSpace(0.1, good.keys[::-1].copy(), good.views, good.survey, good.time))
    with pytest.raises(ScanFileError, match="not rising"):
        read_seen(path)
    write_seen(path, SeenSpace(0.1, good.keys, good.views[:-1], good.survey, good.time))
    with pytest.raises(ScanFileError, match="views: wrong shape"):
        read_seen(path)
    write_seen(path, SeenSpace(-1.0, good.keys, good.views, good.survey, good.time))
    with pytest.raises(ScanFileError, match="voxel_size: out of range"):
        read_seen(path)
    with pytest.raises(ScanFileError, match=r"NPZ.*\.txt"):
        write_seen(tmp_path / "seen.txt", good)
    with pytest.raises(ScanFileError, match="cannot be written"):
        write_seen(tmp_path / "nowhere" / "seen.npz", good)
