"""The simulated LiDAR against closed forms, with real Drake."""

import dataclasses

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.sensing import (
    Lidar,
    LidarConfig,
    RayScene,
    ScanPattern,
    Surface,
    SurfaceTable,
    deskew,
    vlp16,
    welded_frames,
)
from naraha.systems.sensing.lidar import Returns, configured_pattern, make_cloud, simulate_returns, sweep_rays
from naraha.systems.sensing.mirror import mirror_share
from pydrake.common.value import AbstractValue
from pydrake.geometry import Box, FramePoseVector, HalfSpace, SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from scipy.linalg import expm
from scipy.special import ndtr

EXACT = LidarConfig(range_noise=0.0, dropout=0.0, intensity_noise=0.0, detection_range=1e6)


def still(p=(0, 0, 0)):
    pose = np.eye(4)
    pose[:3, 3] = p
    return pose


def fire(scene, config, pose=None, *, seed=0, **options):
    """Returns of one revolution of a sensor that stands still."""
    pattern = configured_pattern(config)
    pose = still() if pose is None else pose
    rng = np.random.default_rng(seed)
    return pattern, simulate_returns(
        *sweep_rays(pattern, pose, pose), scene, rng, config=config, pattern=pattern, **options
    )


def one_way(count, direction):
    """`count` parallel rays from the origin."""
    return np.zeros(3), np.tile(np.asarray(direction, np.float32), (count, 1))


def beam(count, incidence, distance, surface, make_world, config, seed=0):
    """Returns of `count` equal shots at a wall of `surface` that is hit at an angle [rad] and a distance [m]."""
    turn = RollPitchYaw(0, incidence, 0)
    wall = RigidTransform(turn, [distance, 0, 0]) @ RigidTransform([0.5, 0, 0])
    scene = make_world().add(Box(1, 5000, 5000), wall).rays(SurfaceTable(default=surface))
    return simulate_returns(
        *one_way(count, [1, 0, 0]),
        scene,
        np.random.default_rng(seed),
        config=config,
        pattern=configured_pattern(config),
    )


# --- the sweep ------------------------------------------------------------------------------------------------------


def test_rays_of_a_sensor_at_rest_are_its_pattern_at_its_pose():
    pattern = vlp16()
    X_WS = RigidTransform(RollPitchYaw(0.1, -0.2, 2.0), [3, -4, 0.5])
    p_WR, d_W = sweep_rays(pattern, X_WS.GetAsMatrix4(), X_WS.GetAsMatrix4())
    np.testing.assert_allclose(d_W, pattern.d_S @ X_WS.rotation().matrix().T, atol=2e-7)
    np.testing.assert_allclose(p_WR, pattern.p_SR @ X_WS.rotation().matrix().T + X_WS.translation(), atol=1e-6)
    assert p_WR.dtype == d_W.dtype == np.float32


def test_rays_of_a_sensor_in_a_curve_start_on_its_circle():
    """1 m/s ahead at 1 rad/s is a circle of 1 m about (0, 1), on which column j is at angle times[j]."""
    pattern = vlp16()
    X_WS1 = RigidTransform(RollPitchYaw(0, 0, 0.1), [np.sin(0.1), 1 - np.cos(0.1), 0]).GetAsMatrix4()
    p_WR, d_W = sweep_rays(pattern, np.eye(4), X_WS1)
    angle = np.tile(pattern.times, 16)
    np.testing.assert_allclose(p_WR[:, :2], np.stack([np.sin(angle), 1 - np.cos(angle)], -1), atol=1e-7)
    azimuth = np.tile(pattern.azimuths, 16) + angle
    level = np.cos(np.repeat(pattern.elevations, 1800))
    np.testing.assert_allclose(d_W[:, 0], level * np.cos(azimuth), atol=2e-7)
    np.testing.assert_allclose(d_W[:, 1], level * np.sin(azimuth), atol=2e-7)


# --- what comes back ------------------------------------------------------------------------------------------------


def test_every_range_in_a_room_is_that_to_its_planes(make_world):
    world = make_world()
    for axis in range(3):
        for sign in (-1, 1):
            size = [30, 30, 30]
            size[axis] = 1
            world.add(Box(*size), (0.5 + [5, 4, 2][axis]) * sign * np.eye(3)[axis], f"wall{axis}{sign}")
    pattern, returns = fire(world.rays(), EXACT, still([1, -2, 0.5]))
    assert len(returns.ray) == 28800
    starts, d = pattern.p_SR.astype(float) + np.array([1, -2, 0.5]), pattern.d_S.astype(float)
    with np.errstate(divide="ignore"):
        expected = ((np.sign(d) * [5, 4, 2] - starts) / d).min(axis=1)
    np.testing.assert_allclose(returns.distance, expected, rtol=2e-5)


def test_cloud_is_the_range_along_each_beam_with_its_attributes(make_world):
    pattern, returns = fire(make_world().add(HalfSpace(), [0, 0, -1]).rays(), EXACT)
    cloud = make_cloud(pattern, returns)
    assert 0 < len(returns.ray) < 28800
    positions = cloud.point.positions.numpy()
    expected = pattern.p_SR[returns.ray] + returns.distance[:, None] * pattern.d_S[returns.ray]
    np.testing.assert_allclose(positions, expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(positions[:, 2], -1, atol=2e-5)
    for name, dtype in (("intensity", "f4"), ("time", "f4"), ("ring", "u1"), ("column", "u2")):
        assert cloud.point[name].numpy().shape == (len(returns.ray), 1)
        assert cloud.point[name].numpy().dtype == dtype
    np.testing.assert_array_equal(cloud.point["ring"].numpy()[:, 0], returns.ray // 1800)
    np.testing.assert_array_equal(cloud.point["column"].numpy()[:, 0], returns.ray % 1800)
    np.testing.assert_allclose(cloud.point["time"].numpy()[:, 0], returns.ray % 1800 * 0.1 / 1800, rtol=1e-6)


def test_empty_space_returns_nothing(make_world):
    _, returns = fire(make_world().add(Box(1, 1, 1), [0, 0, 50]).rays(), LidarConfig())
    assert returns.ray.shape == returns.distance.shape == returns.intensity.shape == (0,)
    assert make_cloud(vlp16(), returns).point.positions.shape == (0, 3)


@pytest.mark.parametrize("incidence", np.radians([0, 40, 80]))
@pytest.mark.parametrize("distance", [5.0, 60.0, 95.0])
def test_detection_follows_the_power_that_comes_back(make_world, incidence, distance):
    config = LidarConfig(dropout=0.1, detection_range=50.0, detection_steepness=3.0)
    count = 40000
    returns = beam(count, incidence, distance, Surface(lidar_reflectivity=0.6), make_world, config)
    power = 0.6 * np.cos(incidence) * (50 / distance) ** 2
    probability = 0.9 * power**3 / (1 + power**3)
    sigma = np.sqrt(probability * (1 - probability) / count)
    assert len(returns.ray) / count == pytest.approx(probability, abs=4 * sigma + 1e-3)


def test_detection_falls_with_incidence_distance_and_darkness(make_world):
    config = LidarConfig(detection_range=50.0)

    def share(incidence, distance, reflectivity):
        surface = Surface(lidar_reflectivity=reflectivity)
        return len(beam(5000, np.radians(incidence), distance, surface, make_world, config).ray)

    for shares in (
        [share(angle, 30, 0.6) for angle in (0, 60, 75, 85)],
        [share(0, distance, 0.6) for distance in (20, 35, 45, 70)],
        [share(0, 30, reflectivity) for reflectivity in (0.9, 0.4, 0.2, 0.05)],
    ):
        assert np.all(np.diff(shares) < -100), shares


def test_white_wall_square_on_at_the_detection_range_returns_half(make_world):
    config = LidarConfig(dropout=0.0, detection_range=80.0)
    returns = beam(20000, 0, 80, Surface(lidar_reflectivity=1.0), make_world, config)
    assert len(returns.ray) == pytest.approx(10000, abs=4 * np.sqrt(5000))


def test_water_vanishes_at_grazing_angles_and_concrete_stays(make_world):
    water = Surface(label="water", lidar_reflectivity=0.02, specular=0.98)
    for surface, low, high in ((water, 0.0, 0.2), (Surface(lidar_reflectivity=0.4), 0.98, 1.0)):
        scene = make_world().add(HalfSpace(), [0, 0, -0.5]).rays(SurfaceTable(default=surface))
        pattern, returns = fire(scene, LidarConfig())
        near = (pattern.ring < 5) & np.isfinite(pattern.time)  # rings at 1.9 m to 4.1 m, incidence 75° to 83°
        share = np.count_nonzero(near[returns.ray]) / np.count_nonzero(near)
        assert low <= share <= high


def test_mirroring_surface_returns_only_near_normal_incidence(make_world):
    steel = Surface(lidar_reflectivity=0.5, specular=1.0)
    shares = [len(beam(2000, np.radians(a), 10, steel, make_world, LidarConfig(dropout=0)).ray) for a in (0, 3, 20, 60)]
    assert shares[:2] == [2000, 2000]
    assert shares[2:] == [0, 0]


WATER = Surface(label="water", lidar_reflectivity=0.02, specular=0.98)
WALL = Surface(label="wall", lidar_reflectivity=0.5)


def pond(make_world, *, water=WATER, wall=WALL):
    """Still water 1 m below the sensor, and a wall 8 m ahead that rises from it."""
    world = make_world().add(HalfSpace(), [0, 0, -1], "water").add(Box(1, 100, 50), [8.5, 0, 24], "wall")
    return world.rays(SurfaceTable(by_pattern={"water": water, "wall": wall}))


def fresnel(incidence, n=1.33):
    """Fresnel's equations for unpolarised light, as sines and tangents of the angles inside and outside [rad]."""
    inside = np.arcsin(np.sin(incidence) / n)
    low, high = incidence - inside, incidence + inside
    return ((np.sin(low) / np.sin(high)) ** 2 + (np.tan(low) / np.tan(high)) ** 2) / 2


def test_water_reflects_as_fresnel_says():
    angle = np.radians(np.arange(1, 90))
    np.testing.assert_allclose(mirror_share(0.02, 0.98, np.cos(angle)), 0.98 * fresnel(angle), atol=2e-3)


@pytest.mark.parametrize("reflectivity", [0.0, 0.02, 0.45, 1.0])
def test_mirror_share_goes_from_the_reflectivity_to_the_mirrored_share(reflectivity):
    across = mirror_share(reflectivity, 0.3, np.linspace(0, 1, 1001))
    assert across[0] == pytest.approx(0.3)
    assert across[-1] == pytest.approx(0.3 * reflectivity, abs=1e-3)
    assert np.all((across >= 0) & (across <= 0.3 + 1e-12))
    assert not mirror_share(reflectivity, 0.0, np.linspace(0, 1, 11)).any()


def test_wall_across_water_is_seen_at_its_mirror_image_below_it(make_world):
    """The image of the plane x = 8 is that plane below the water, with the way of light as the distance."""
    config = LidarConfig(range_noise=0.0, dropout=0.0, intensity_noise=0.0, detection_range=1e6)
    mirroring = Surface(lidar_reflectivity=0.02, specular=1.0)  # scatters nothing at all
    pattern, returns = fire(pond(make_world, water=mirroring), config)
    p = pattern.p_SR[returns.ray] + returns.distance[:, None] * pattern.d_S[returns.ray].astype(float)
    np.testing.assert_allclose(p[:, 0], 8, atol=2e-4)
    ghosts = p[:, 2] < -1
    with np.errstate(divide="ignore"):
        height = pattern.p_SR[:, 2] + 8 * pattern.d_S[:, 2] / pattern.d_S[:, 0]
    ahead = pattern.d_S[:, 0] > 0.2
    assert set(returns.ray[ghosts]) >= set(np.flatnonzero(ahead & (height < -1 - 1e-4)))
    assert set(returns.ray[~ghosts]) >= set(np.flatnonzero(ahead & (height > -1 + 1e-4)))
    assert np.count_nonzero(ghosts) > 1000

    # Intensity: mirrored twice, and what the wall scatters at its own incidence.
    d = pattern.d_S[returns.ray[ghosts]].astype(float)
    share = fresnel(np.arccos(-d[:, 2]))
    np.testing.assert_allclose(returns.intensity[ghosts], share**2 * 0.5 * d[:, 0], rtol=0.01, atol=1e-4)


def test_mirror_image_is_detected_by_its_whole_way_and_both_mirrorings(make_world):
    config = LidarConfig(dropout=0.1, detection_range=40.0)
    count, angle = 40000, np.radians(80)
    scene, pattern = pond(make_world), configured_pattern(config)
    d = np.tile(np.float32([np.sin(angle), 0, -np.cos(angle)]), (count, 1))
    returns = simulate_returns(np.zeros(3), d, scene, np.random.default_rng(0), config=config, pattern=pattern)
    distance = 8 / np.sin(angle)
    back = (0.98 * fresnel(angle)) ** 2 * 0.5 * np.sin(angle)
    power = back * (40 / distance) ** 2
    probability = 0.9 * power**3 / (1 + power**3)
    assert 0.2 < probability < 0.8
    assert len(returns.ray) / count == pytest.approx(probability, abs=4 * np.sqrt(0.25 / count) + 1e-3)
    assert returns.distance.mean() == pytest.approx(distance, abs=1e-3)
    assert returns.distance.std() == pytest.approx(0.008, rel=0.05)


def test_surface_that_is_detected_itself_shows_no_mirror_image(make_world):
    steel = Surface(label="metal", lidar_reflectivity=0.45, specular=0.3)
    pattern, returns = fire(pond(make_world, water=steel), LidarConfig(dropout=0.0, range_noise=0.0))
    z = pattern.p_SR[returns.ray, 2] + returns.distance * pattern.d_S[returns.ray, 2]
    near = returns.ray < 4 * 1800  # rings that meet the floor within 7 m
    assert np.count_nonzero(near) == 7200
    np.testing.assert_allclose(z[near], -1, atol=1e-4)


def test_without_mirrors_nothing_is_below_the_water(make_world):
    pattern, returns = fire(pond(make_world), LidarConfig(mirror=False))
    assert np.all(returns.distance * pattern.d_S[returns.ray, 2] > -1.1)
    _, with_mirror = fire(pond(make_world), LidarConfig())
    assert len(with_mirror.ray) > len(returns.ray) + 1000
    # What is seen directly does not change.
    common = np.intersect1d(returns.ray, with_mirror.ray, return_indices=True)
    assert len(common[0]) == len(returns.ray)
    np.testing.assert_array_equal(returns.distance[common[1]], with_mirror.distance[common[2]])
    np.testing.assert_array_equal(returns.intensity[common[1]], with_mirror.intensity[common[2]])


def test_mirrors_change_nothing_where_there_are_none(make_world):
    scene = pond(make_world, water=Surface(lidar_reflectivity=0.1))
    _, off = fire(scene, LidarConfig(mirror=False), seed=4)
    _, on = fire(scene, LidarConfig(mirror=True), seed=4)
    for name in ("ray", "distance", "intensity"):
        np.testing.assert_array_equal(getattr(off, name), getattr(on, name))


def test_the_robot_hides_mirror_images(make_world):
    """A wide board of the robot in front of the wall, above the water: rays that meet it in the mirror are lost."""
    world = make_world().add(HalfSpace(), [0, 0, -1], "water").add(Box(1, 100, 50), [8.5, 0, 24], "wall")
    arm = world.frame("arm")
    surfaces = SurfaceTable(by_pattern={"water": WATER}, default=WALL)
    scene = world.add(Box(0.1, 100, 0.4), name="board", frame=arm).rays(surfaces)
    X_WF = {arm: RigidTransform([7.0, 0, -0.5])}
    pattern, seen = fire(scene, LidarConfig(), X_WF=X_WF)
    _, own = fire(scene, LidarConfig(), X_WF=X_WF, own_geometry=scene.geometries_of([arm]))

    def ghosts(returns):
        p = returns.distance[:, None] * pattern.d_S[returns.ray]
        return np.count_nonzero((p[:, 2] < -1.1) & (np.abs(p[:, 0] - 7) < 0.1)), np.count_nonzero(p[:, 2] < -1.1)

    on_board, everything = ghosts(seen)
    assert on_board > 100
    assert ghosts(own) == (0, everything - on_board)
    # What hides a ray from the water hides the mirror image, too.
    _, covered = fire(scene, LidarConfig(), own_distance=np.full(pattern.rays, 0.5, np.float32))
    assert len(covered.ray) == 0


def test_range_noise_is_normal_with_its_standard_deviation(make_world):
    config = LidarConfig(range_noise=0.03, dropout=0.0, detection_range=1e6)
    error = beam(50000, 0, 10, Surface(), make_world, config).distance.astype(float) - 10
    assert error.mean() == pytest.approx(0, abs=4 * 0.03 / np.sqrt(50000))
    assert error.std() == pytest.approx(0.03, rel=0.02)
    assert np.mean(error < -0.03) == pytest.approx(ndtr(-1), abs=0.01)


@pytest.mark.parametrize("specular", [0.0, 0.3])
@pytest.mark.parametrize("incidence", [0.0, 0.08, 1.0])
def test_intensity_is_the_light_that_comes_back_whatever_the_distance(make_world, incidence, specular):
    lobe = 10 * np.exp((np.cos(incidence) - 1) / 0.05**2)
    expected = 0.2 * ((1 - specular) * np.cos(incidence) + specular * lobe)
    for distance in (2, 20):
        surface = Surface(lidar_reflectivity=0.2, specular=specular)
        intensity = beam(3, incidence, distance, surface, make_world, EXACT).intensity
        np.testing.assert_allclose(intensity, expected, rtol=1e-3)


def test_intensity_noise_stays_within_zero_and_one(make_world):
    config = LidarConfig(intensity_noise=0.2, dropout=0.0)
    for reflectivity in (0.05, 0.5, 1.0):
        intensity = beam(20000, 0, 5, Surface(lidar_reflectivity=reflectivity), make_world, config).intensity
        assert intensity.min() >= 0
        assert intensity.max() <= 1
        if reflectivity == 0.5:
            assert intensity.std() == pytest.approx(0.2, rel=0.05)


def test_only_distances_within_the_range_are_reported(make_world):
    config = LidarConfig(min_range=2.0, max_range=8.0, range_noise=0.05, detection_range=1e6, dropout=0.0)
    for distance, share in ((1.5, 0), (2.0, 0.5), (5, 1), (8.0, 0.5), (9, 0)):
        returns = beam(20000, 0, distance, Surface(), make_world, config)
        assert len(returns.ray) / 20000 == pytest.approx(share, abs=0.02)
        assert np.all((returns.distance >= 2) & (returns.distance <= 8))


def test_dust_sends_its_share_back_from_anywhere_on_the_way(make_world):
    config = LidarConfig(stray=0.1, dropout=0.0, range_noise=0.0, detection_range=1e6, min_range=1.0)
    returns = beam(20000, 0, 5, Surface(), make_world, config)
    assert len(returns.ray) == 20000
    dust = returns.distance < 4.99
    assert np.mean(dust) == pytest.approx(0.1, abs=0.01)
    assert returns.distance[dust].min() >= 1.0
    assert np.quantile(returns.distance[dust], [0.25, 0.75]) == pytest.approx([2.0, 4.0], abs=0.2)
    far = make_world().add(Box(1, 1, 1), [40, 0, 0]).rays()
    _, sky = fire(far, LidarConfig(stray=0.1, max_range=20.0))
    assert sky.distance.max() <= 10.0
    clean = dataclasses.replace(config, stray=0.0)
    same = np.isin(returns.ray, beam(20000, 0, 5, Surface(), make_world, clean).ray)
    assert same.all()


def test_randomness_of_a_ray_does_not_depend_on_what_others_hit(make_world):
    """A changed object must not reshuffle the noise of the rest of the scan."""
    world = make_world().add(HalfSpace(), [0, 0, -1], "floor")
    _, before = fire(world.rays(), LidarConfig(), seed=3)
    _, after = fire(world.add(Box(1, 1, 1), [4, 0, 0]).rays(), LidarConfig(), seed=3)
    common = np.intersect1d(before.ray, after.ray, return_indices=True)
    same = before.distance[common[1]] == after.distance[common[2]]
    assert np.mean(same) > 0.95


def test_own_geometry_hides_what_is_behind_and_gives_no_points(make_world):
    world = make_world().add(HalfSpace(), [0, 0, -1], "floor")
    flipper = world.frame("flipper")
    scene = world.add(Box(0.2, 2, 0.4), name="flipper", frame=flipper).rays()
    pattern, free = fire(scene, EXACT)
    _, returns = fire(
        scene, EXACT, X_WF={flipper: RigidTransform([1, 0, -0.2])}, own_geometry=scene.geometries_of([flipper])
    )
    lost = np.setdiff1d(free.ray, returns.ray)
    d = pattern.d_S[lost]
    # The front face is at x = 0.9 with |y| < 1 and -0.4 < z < 0; the box is opaque, so all of that is lost.
    np.testing.assert_array_less(np.abs(d[:, 1] / d[:, 0]), 1 / 0.9 + 1e-3)
    assert len(lost) > 500
    _, others = fire(scene, EXACT, X_WF={flipper: RigidTransform([1, 0, -0.2])})
    shown = np.setdiff1d(others.ray, returns.ray)
    assert set(shown) == set(np.setdiff1d(lost, np.setdiff1d(free.ray, others.ray)))
    nearest = others.distance[np.searchsorted(others.ray, shown)]
    assert nearest.max() < 1.5


# --- the system -----------------------------------------------------------------------------------------------------


class MovingFrame(LeafSystem):
    """Moves a frame at constant twist (angular, linear; in the moving frame) from its pose at time 0."""

    def __init__(self, frame, twist, start):
        super().__init__()
        self.frame, self.start = frame, start
        self.matrix = np.zeros((4, 4))
        x, y, z = twist[:3]
        self.matrix[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        self.matrix[:3, 3] = twist[3:]
        frame_poses = AbstractValue.Make(FramePoseVector())
        self.DeclareAbstractOutputPort("poses", lambda: frame_poses.Clone(), self.CalcPoses, {self.time_ticket()})

    def pose(self, time):
        return RigidTransform(self.start @ expm(time * self.matrix))

    def CalcPoses(self, context, output):
        poses = FramePoseVector()
        poses.set_value(self.frame, self.pose(context.get_time()))
        output.set_value(poses)


X_PS = RigidTransform([0.1, 0, 0.3])


def station(make_world, *, config=EXACT, twist=(0, 0, 0, 0, 0, 0), start=None, seed=0, walls=True, **options):
    """A LiDAR on a moving box in a room of 10 × 8 m; the box is in its own frame, which carries the sensor."""
    builder = DiagramBuilder()
    world = make_world(builder.AddSystem(SceneGraph()))
    if walls:
        for x, y, size in ((5.5, 0, (1, 12, 9)), (-5.5, 0, (1, 12, 9)), (0, 4.5, (12, 1, 9)), (0, -4.5, (12, 1, 9))):
            world.add(Box(*size), [x, y, 0], f"wall{x}{y}")
    else:
        world.add(Box(1, 1, 1), [0, 0, 500], "far away")
    base = world.frame("base")
    world.add(Box(0.6, 0.4, 0.2), name="base", frame=base)
    motion = builder.AddSystem(MovingFrame(base, np.array(twist, float), np.eye(4) if start is None else start))
    scene = world.rays()
    lidar = builder.AddSystem(Lidar(config, scene=scene, parent_frame=base, X_PS=X_PS, seed=seed, **options))
    builder.Connect(motion.GetOutputPort("poses"), world.scene_graph.get_source_pose_port(world.source))
    builder.Connect(world.scene_graph.GetOutputPort("query"), lidar.GetInputPort("geometry_query"))
    builder.ExportOutput(lidar.GetOutputPort("scan_S"), "scan_S")
    diagram = builder.Build()
    return diagram, motion


def scan_at(simulator, time):
    simulator.AdvanceTo(time)
    return simulator.get_system().GetOutputPort("scan_S").Eval(simulator.get_context())


def test_scans_come_once_a_period_and_the_first_at_its_end(make_world):
    simulator = Simulator(station(make_world)[0])
    empty = scan_at(simulator, 0.05)
    assert (empty.index, len(empty.p_SP)) == (-1, 0)
    assert set(empty.cloud_S.point) >= {"intensity", "time", "ring", "column"}
    for time, index in ((0.11, 0), (0.19, 0), (0.21, 1), (1.05, 9)):
        scan = scan_at(simulator, time)
        assert scan.index == index
        assert scan.start_time == pytest.approx(0.1 * index)
        assert scan.end_time == pytest.approx(0.1 * (index + 1))
        assert len(scan.p_SP) == 28800
        assert scan.attribute("time").min() == 0
        assert scan.attribute("time").max() == pytest.approx(0.1 * 1799 / 1800)


def test_deskewed_scan_of_a_moving_sensor_lies_on_the_walls_within_a_millimetre(make_world):
    twist = [0, 0, 1.0, 1.0, 0.2, 0]
    diagram, motion = station(make_world, twist=twist)
    scan = scan_at(Simulator(diagram), 0.31)
    X_WS0, X_WS1 = (motion.pose(t) @ X_PS for t in (0.2, 0.3))
    fraction = scan.attribute("time") / (scan.end_time - scan.start_time)

    def distance_to_walls(p_SP):
        p_WP = np.abs(p_SP.astype(float) @ X_WS1.rotation().matrix().T + X_WS1.translation())
        return np.minimum(np.abs(p_WP[:, 0] - 5), np.abs(p_WP[:, 1] - 4))

    assert distance_to_walls(scan.p_SP).max() > 0.1
    p_S1P = deskew(scan.p_SP, fraction, (X_WS0.inverse() @ X_WS1).GetAsMatrix4())
    assert distance_to_walls(p_S1P).max() < 1e-4


def test_every_point_is_where_the_sensor_saw_it_at_its_own_instant(make_world):
    diagram, motion = station(make_world, twist=[0.1, -0.2, 1.0, 1.0, 0, 0.1])
    scan = scan_at(Simulator(diagram), 0.11)
    for i in np.random.default_rng(0).integers(0, len(scan.p_SP), 50):
        X_WS = motion.pose(scan.start_time + float(scan.attribute("time")[i])) @ X_PS
        p_WP = np.abs(X_WS @ scan.p_SP[i].astype(float))
        assert min(abs(p_WP[0] - 5), abs(p_WP[1] - 4)) < 1e-4


def test_the_part_that_carries_the_sensor_is_never_seen(make_world):
    """The base is 0.3 m below; without walls all that the rays could meet is the robot itself."""
    start = RigidTransform(RollPitchYaw(0.4, 0.3, 1.0), [1, 2, 3]).GetAsMatrix4()
    scan = scan_at(Simulator(station(make_world, walls=False, config=LidarConfig(min_range=0.0), start=start)[0]), 0.11)
    assert scan.index == 0
    assert len(scan.p_SP) == 0


def test_one_seed_gives_one_scan_and_another_seed_another(make_world):
    config = LidarConfig(dropout=0.1)
    scans = [scan_at(Simulator(station(make_world, config=config, seed=s)[0]), 0.25) for s in (7, 7, 8)]
    for name in ("positions", "intensity", "ring", "column", "time"):
        np.testing.assert_array_equal(scans[0].cloud_S.point[name].numpy(), scans[1].cloud_S.point[name].numpy())
    assert len(scans[0].p_SP) != len(scans[2].p_SP) or np.any(scans[0].p_SP != scans[2].p_SP)


def test_successive_scans_of_a_still_scene_differ_by_their_noise(make_world):
    simulator = Simulator(station(make_world, config=LidarConfig(dropout=0.0, detection_range=1e6))[0])
    first, second = scan_at(simulator, 0.15), scan_at(simulator, 0.25)
    difference = np.linalg.norm(first.p_SP, axis=1) - np.linalg.norm(second.p_SP, axis=1)
    assert difference.std() == pytest.approx(0.008 * np.sqrt(2), rel=0.05)


def test_cloned_context_continues_like_the_original(make_world):
    diagram, _ = station(make_world, config=LidarConfig())
    simulator = Simulator(diagram)
    scan_at(simulator, 0.15)
    clone = Simulator(diagram, simulator.get_context().Clone())
    original = scan_at(simulator, 0.25)
    np.testing.assert_array_equal(scan_at(clone, 0.25).p_SP, original.p_SP)


def test_jump_in_time_starts_a_new_revolution(make_world):
    simulator = Simulator(station(make_world)[0])
    assert scan_at(simulator, 0.15).index == 0
    simulator.get_mutable_context().SetTime(5.0)
    simulator.Initialize()
    assert scan_at(simulator, 5.05).index == 0
    scan = scan_at(simulator, 5.15)
    assert (scan.index, scan.start_time) == (1, pytest.approx(5.0))


def test_utm30lx_scans_in_front_and_a_period_can_be_set(make_world):
    config = LidarConfig(pattern="utm30lx", range_noise=0.0, dropout=0.0, detection_range=1e6, period=0.05)
    scan = scan_at(Simulator(station(make_world, config=config)[0]), 0.06)
    assert len(scan.p_SP) == 1081
    assert scan.end_time == pytest.approx(0.05)
    assert np.degrees(np.abs(np.arctan2(scan.p_SP[:, 1], scan.p_SP[:, 0])).max()) == pytest.approx(135, abs=1e-3)
    assert scan.attribute("time").max() == pytest.approx(0.75 * 0.05)


ROBOT = """
<robot name="robot">
  <link name="base">
    <inertial><mass value="5"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual name="base"><geometry><box size="0.6 0.4 0.2"/></geometry></visual>
  </link>
  <link name="mast">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual name="mast"><origin xyz="-0.3 0 0.25"/><geometry><box size="0.02 0.02 0.5"/></geometry></visual>
  </link>
  <link name="flipper">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual name="flipper"><origin xyz="0.25 0 0"/><geometry><box size="0.5 0.1 0.1"/></geometry></visual>
  </link>
  <joint name="mast" type="fixed"><parent link="base"/><child link="mast"/></joint>
  <joint name="hinge" type="revolute">
    <parent link="base"/><child link="flipper"/><origin xyz="0.6 0 0"/>
    <axis xyz="0 -1 0"/><limit lower="-2" upper="2"/>
  </joint>
</robot>
"""


@pytest.mark.parametrize(("angle", "blocks"), [(0.0, False), (1.4, True)])
def test_robot_of_several_bodies_sees_its_world_and_not_itself(angle, blocks):
    """A mast welded to the base hides part of what is behind, and so does a flipper when it is raised."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    Parser(plant).AddModelsFromString(ROBOT, "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"), RigidTransform([0, 0, 0.5]))
    for x in (-4.0, 4.0):
        wall = RigidTransform([x + np.sign(x) * 0.5, 0, 0])
        plant.RegisterVisualGeometry(plant.world_body(), wall, Box(1, 20, 20), f"wall{x}", np.ones(4))
    plant.GetJointByName("hinge").set_default_angle(angle)
    plant.gravity_field().set_gravity_vector([0, 0, 0])
    plant.Finalize()
    base = plant.GetBodyByName("base")
    frame = plant.GetBodyFrameIdOrThrow(base.index())
    flipper = plant.GetBodyFrameIdOrThrow(plant.GetBodyByName("flipper").index())
    scene = RayScene(scene_graph.model_inspector())
    lidar = Lidar(
        EXACT,
        scene=scene,
        parent_frame=frame,
        X_PS=RigidTransform([0, 0, 0.3]),
        rigid_frames=welded_frames(plant, base),
        own_frames=[flipper],
    )
    builder.AddSystem(lidar)
    builder.Connect(scene_graph.GetOutputPort("query"), lidar.GetInputPort("geometry_query"))
    builder.ExportOutput(lidar.GetOutputPort("scan_S"), "scan_S")
    points = scan_at(Simulator(builder.Build()), 0.11).p_SP
    np.testing.assert_allclose(np.abs(points[:, 0]), 4, atol=1e-4)

    def shadow(sign, tangent):
        """Number of points on one wall whose azimuth is within ± arctan(tangent) of straight ahead or back."""
        return np.count_nonzero((points[:, 0] * sign > 0) & (np.abs(points[:, 1]) < 4 * tangent))

    # Seen from the sensor the mast covers |y/x| < 0.01/0.29, from 0.8 m below to 0.2 m above the sensor at x = -0.3.
    assert shadow(-1, 0.01 / 0.29 - 0.002) == 0
    assert shadow(-1, 0.06) > 0
    # The raised flipper is 0.1 m wide about 0.65 m away; it reaches 0.2 m above the sensor.
    ahead = shadow(1, 0.05)
    assert ahead < 300 if blocks else ahead > 400


def test_other_bodies_are_seen_where_they_are_at_the_end_of_the_scan(make_world):
    """A wall that flies towards a sensor that stands still."""
    builder = DiagramBuilder()
    world = make_world(builder.AddSystem(SceneGraph()))
    wall = world.frame("wall")
    world.add(Box(1, 50, 50), [5.5, 0, 0], "wall", wall)
    motion = builder.AddSystem(MovingFrame(wall, np.array([0, 0, 0, -2.0, 0, 0]), np.eye(4)))
    lidar = Lidar(
        EXACT,
        scene=world.rays(),
        parent_frame=world.scene_graph.world_frame_id(),
        X_PS=RigidTransform(),
    )
    builder.AddSystem(lidar)
    builder.Connect(motion.GetOutputPort("poses"), world.scene_graph.get_source_pose_port(world.source))
    builder.Connect(world.scene_graph.GetOutputPort("query"), lidar.GetInputPort("geometry_query"))
    builder.ExportOutput(lidar.GetOutputPort("scan_S"), "scan_S")
    scan = scan_at(Simulator(builder.Build()), 0.51)
    np.testing.assert_allclose(scan.p_SP[:, 0], 4, atol=1e-4)
    assert len(scan.p_SP) > 10000


# --- what a user can get wrong --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (LidarConfig(pattern="hdl64"), "lidar: pattern: unknown value, got 'hdl64' .*vlp16, utm30lx"),
        (LidarConfig(range_noise=-0.1), "lidar: range_noise"),
        (LidarConfig(dropout=1.5), "lidar: dropout"),
        (LidarConfig(period=0.0), "lidar: period"),
        (LidarConfig(min_range=200.0), "0 <= min_range < max_range"),
    ],
)
def test_configuration_out_of_range_is_refused(make_world, config, message):
    with pytest.raises(ConfigError, match=message):
        station(make_world, config=config)


def test_missing_connection_is_named(make_world):
    world = make_world()
    frame = world.frame("base")
    lidar = Lidar(EXACT, scene=world.add(Box(1, 1, 1)).rays(), parent_frame=frame, X_PS=RigidTransform())
    with pytest.raises(PortError, match=r"Lidar\.geometry_query"):
        Simulator(lidar).AdvanceTo(0.1)


def test_overrides_replace_the_values_of_the_pattern():
    pattern = configured_pattern(
        LidarConfig(period=0.05, min_range=1.0, max_range=20.0, range_noise=0.02, detection_range=33.0)
    )
    assert (pattern.period, pattern.min_range, pattern.max_range) == (0.05, 1.0, 20.0)
    assert (pattern.range_noise, pattern.detection_range) == (0.02, 33.0)
    assert pattern.times[-1] == pytest.approx(0.05 * 1799 / 1800)
    default = configured_pattern(LidarConfig())
    assert (default.period, default.range_noise) == (0.1, 0.008)


def test_any_pattern_of_ones_own_can_be_cast(make_world):
    pattern = ScanPattern(
        elevations=np.radians([-30.0]),
        azimuths=np.zeros(1),
        times=np.zeros(1),
        period=1.0,
        min_range=0.0,
        max_range=10.0,
        range_noise=0.0,
        detection_range=1e6,
    )
    scene = make_world().add(HalfSpace(), [0, 0, -1]).rays()
    rng = np.random.default_rng(0)
    rays = sweep_rays(pattern, still(), still())
    returns = simulate_returns(*rays, scene, rng, config=LidarConfig(dropout=0.0), pattern=pattern)
    assert isinstance(returns, Returns)
    np.testing.assert_allclose(returns.distance, [2.0], rtol=1e-6)
