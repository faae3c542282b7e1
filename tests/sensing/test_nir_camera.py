"""Near-infrared images against closed forms."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.sensing import Surface, SurfaceTable
from naraha.systems.sensing.nir_camera import NirCamera, NirCameraConfig, render_nir
from naraha.systems.sensing.nir_rendering import auto_exposure, grey_values, nir_radiance
from naraha.systems.sensing.pan_tilt import pan_tilt_pose
from pydrake.geometry import Box, Cylinder
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from tests.sensing.camera_rig import FORWARD, Station

AHEAD = np.array([1.0, 0, 0])
GREY = SurfaceTable(
    default=Surface(nir_reflectance=0.4),
    by_pattern={"*black*": Surface(nir_reflectance=0.05), "*water*": Surface(nir_reflectance=0.02, specular=0.98)},
)


def look(world, *, lamp=(0, 0, 0), axis=AHEAD, X_WC=FORWARD, X_WF=None, surfaces=GREY, **changes):
    """Camera model and radiance image."""
    options = {"width": 32, "height": 24, "fov_x_deg": 40.0, "fov_y_deg": 30.0, "distortion": [0.0] * 5, "ambient": 0.0}
    config = NirCameraConfig(**{**options, **changes})
    model = config.model()
    scene = world.rays(surfaces)
    return model, nir_radiance(
        model, X_WC, scene, config=config, p_WL=np.array(lamp, float), axis_W=np.asarray(axis, float), X_WF=X_WF
    )


def wall(make_world, distance=3.0, turn=(0, 0, 0), name="wall"):
    pose = RigidTransform(RollPitchYaw(*turn), [distance, 0, 0]) @ RigidTransform([0.5, 0, 0])
    return make_world().add(Box(1, 100, 100), pose, name)


def points_on_wall(model, distance=3.0):
    """Where the pixels of a camera in FORWARD meet the plane x = distance, (N, 3)."""
    xy = model.xy
    return distance * np.column_stack([np.ones(len(xy)), -xy[:, 0], -xy[:, 1]])


# --- the lamp -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lamp", [(0, 0, 0), (0.3, -0.5, 0.4), (-1, 0, 2)])
def test_radiance_is_lamberts_law_and_the_inverse_square_of_the_lamp(make_world, lamp):
    model, radiance = look(wall(make_world), lamp=lamp, lamp_half_angle_deg=90.0)
    way = points_on_wall(model) - lamp
    r = np.linalg.norm(way, axis=1)
    assert radiance.dtype == np.float32
    np.testing.assert_allclose(radiance.ravel(), 0.4 * (way[:, 0] / r) / r**2, rtol=1e-4)


def test_white_paper_square_on_at_one_metre_has_radiance_one(make_world):
    surfaces = SurfaceTable(default=Surface(nir_reflectance=1.0))
    options = {"width": 1, "height": 1, "fov_x_deg": 0.1, "fov_y_deg": 0.1}
    _, radiance = look(wall(make_world, 1.0), surfaces=surfaces, **options)
    np.testing.assert_allclose(radiance, 1, rtol=1e-5)


@pytest.mark.parametrize("incidence", [20.0, 60.0, 85.0])
def test_radiance_falls_with_the_cosine_of_the_lamps_incidence_not_the_cameras(make_world, incidence):
    """The lamp is square on to a wall that the camera sees at an angle, and the other way round."""
    angle = np.deg2rad(incidence)
    world = wall(make_world, turn=(0, 0, angle))
    normal = np.array([np.cos(angle), np.sin(angle), 0])
    options = {"width": 1, "height": 1, "fov_x_deg": 0.01, "fov_y_deg": 0.01, "lamp_half_angle_deg": 90.0}
    _, by_camera = look(world, lamp=AHEAD * 3 - 2 * normal, axis=normal, **options)
    np.testing.assert_allclose(by_camera, 0.4 / 4, rtol=1e-3)
    _, by_lamp = look(world, **options)
    np.testing.assert_allclose(by_lamp, 0.4 * np.cos(angle) / 9, rtol=1e-3)


def test_beam_is_even_up_to_its_half_angle_and_fades_to_nothing(make_world):
    options = {"lamp_half_angle_deg": 10.0, "lamp_fade_deg": 4.0, "width": 200}
    model, lit = look(wall(make_world), **options)
    _, even = look(wall(make_world), width=200, lamp_half_angle_deg=90.0)
    xy = model.xy
    alpha = np.rad2deg(np.arctan(np.hypot(xy[:, 0], xy[:, 1])))
    share = lit.ravel() / even.ravel()
    np.testing.assert_allclose(share, np.clip((14 - alpha) / 4, 0, 1), atol=1e-3)
    assert np.any(share == 0)


def test_beam_points_where_its_axis_does(make_world):
    options = {"lamp_half_angle_deg": 5.0, "lamp_fade_deg": 0.1, "width": 101, "height": 75}
    turned = RollPitchYaw(0, np.deg2rad(5), np.deg2rad(12)).ToRotationMatrix().matrix() @ AHEAD
    model, radiance = look(wall(make_world), axis=turned, **options)
    v, u = np.nonzero(radiance)
    aim, _ = model.project((FORWARD.rotation().matrix().T @ turned)[None])
    np.testing.assert_allclose([(u.min() + u.max()) / 2, (v.min() + v.max()) / 2], aim[0], atol=1.0)


@pytest.mark.parametrize("ambient", [0.0, 0.01])
def test_pillar_throws_its_shadow_where_the_lamp_does_not_reach(make_world, ambient):
    """Lamp 0.5 m left of the camera, pillar of radius 0.1 m at x = 1.5: its shadow on the wall at x = 3 is at
    y = −0.5 ± 0.2, to the right of the pillar, and only what has ambient light is left in it."""
    world = wall(make_world).add(Cylinder(0.1, 10), [1.5, 0, 0], "pillar")
    model, radiance = look(world, lamp=(0, 0.5, 0), width=320, height=6, fov_y_deg=1.0, ambient=ambient)
    row, y = radiance[3], points_on_wall(model)[:320, 1]
    # Tangents from the lamp at (0, 0.5) to the circle about (1.5, 0): where they meet x = 3.
    centre, half = np.arctan2(-0.5, 1.5), np.arcsin(0.1 / np.hypot(1.5, 0.5))
    low, high = 0.5 + 3 * np.tan([centre - half, centre + half])
    visible = np.abs(np.arctan(y / 3)) > np.arcsin(0.1 / 1.5) + 0.003
    shadow = (y > low + 0.01) & (y < high - 0.01)
    assert np.count_nonzero(shadow & visible) > 20
    np.testing.assert_allclose(row[shadow & visible], 0.4 * ambient, atol=1e-9)
    beside = visible & ((y < low - 0.01) | (y > high + 0.01))
    way = np.column_stack([0 * y + 3, y - 0.5])
    r = np.linalg.norm(way, axis=1)
    np.testing.assert_allclose(row[beside], 0.4 * (ambient + 3 / r[beside] ** 3), rtol=2e-4)


def test_moving_things_throw_shadows_where_they_are(make_world):
    world = wall(make_world)
    frame = world.frame("moving")
    world.add(Box(0.1, 0.2, 0.2), name="board", frame=frame)
    options = {"lamp": (0, 1.0, 0), "lamp_half_angle_deg": 90.0}
    _, bright = look(world, **options)
    for y in (0.5, 0.7):
        # Half way between the lamp and the point (3, 2 y − 1) of the wall.
        model, radiance = look(world, X_WF={frame: RigidTransform([1.5, y, 0])}, **options)
        dark = np.flatnonzero((radiance == 0).ravel())
        assert len(dark) > 3
        centre = points_on_wall(model)[dark].mean(axis=0)
        np.testing.assert_allclose(centre[1:], [2 * y - 1, 0], atol=0.1)
    assert np.all(bright > 0)


def test_lamp_behind_a_surface_does_not_light_its_front(make_world):
    """A board so thin that its two sides are nearer than any tolerance."""
    world = make_world().add(Box(1e-6, 10, 10), [2, 0, 0])
    _, radiance = look(world, lamp=(3, 0, 0), axis=-AHEAD, lamp_half_angle_deg=90.0, ambient=0.02)
    np.testing.assert_allclose(radiance, 0.4 * 0.02, rtol=1e-5)


def test_water_is_dark_and_what_is_not_there_is_black(make_world):
    ratio = look(wall(make_world, name="water"))[1] / look(wall(make_world))[1]
    np.testing.assert_allclose(ratio, 0.02 * 0.02 / 0.4, rtol=1e-4)
    assert not look(make_world().add(Box(1, 1, 1), [-9, 0, 0]), ambient=0.5)[1].any()


# --- exposure -------------------------------------------------------------------------------------------------------


def test_automatic_exposure_brings_the_percentile_to_its_level():
    radiance = np.linspace(0, 0.02, 1001)
    config = NirCameraConfig(auto_percentile=90.0, auto_level=0.5)
    assert auto_exposure(radiance, config) == pytest.approx(0.5 / 0.018)


def test_exposure_stays_within_its_limits_or_is_fixed():
    config = NirCameraConfig(min_exposure=0.5, max_exposure=40.0)
    assert auto_exposure(np.full(9, 1e-6), config) == 40.0
    assert auto_exposure(np.zeros(9), config) == 40.0
    assert auto_exposure(np.full(9, 100.0), config) == 0.5
    assert auto_exposure(np.full(9, 100.0), NirCameraConfig(exposure=7.0)) == 7.0


def test_grey_values_are_rounded_and_cut():
    config = NirCameraConfig(full_well=1e12, read_noise=0.0)
    radiance = np.array([0.0, 0.1, 0.2, 0.5, 0.9, 10.0])
    values = grey_values(radiance, 2.0, np.random.default_rng(0), config)
    assert values.dtype == np.uint8
    np.testing.assert_array_equal(values, [0, 51, 102, 255, 255, 255])


def test_noise_is_that_of_electrons_and_of_reading():
    config = NirCameraConfig(full_well=400.0, read_noise=10.0)
    for share in (0.25, 0.64):
        values = grey_values(np.full(40000, share / 3), 3.0, np.random.default_rng(0), config) / 255
        assert values.std() == pytest.approx(np.sqrt(share / 400 + (10 / 400) ** 2), rel=0.03)
        assert values.mean() == pytest.approx(share, abs=0.002)


def test_radiance_can_be_had_back_from_image_and_exposure(make_world):
    config = NirCameraConfig(distortion=[0.0] * 5)
    scene = wall(make_world).add(Box(0.1, 0.2, 10), [2, 0.1, 0], "black").rays(GREY)
    options = {"config": config, "p_WL": np.array([0, 0.1, 0.2]), "axis_W": AHEAD}
    image, exposure = render_nir(config.model(), FORWARD, scene, np.random.default_rng(0), **options)
    radiance = nir_radiance(config.model(), FORWARD, scene, **options)
    assert image.shape == (128, 128)
    assert image.max() < 255
    np.testing.assert_allclose(image / 255 / exposure, radiance, atol=0.02 * radiance.max())
    assert np.percentile(image, 98) == pytest.approx(0.8 * 255, abs=3)


# --- the system -----------------------------------------------------------------------------------------------------

CONFIG = {"width": 31, "height": 31, "period": 0.1, "latency": 0.0}


def camera(config=CONFIG, **options):
    defaults = {"X_PN": RigidTransform(), "p_PL": np.zeros(3), **options}
    return lambda **more: NirCamera(NirCameraConfig(**config), **defaults, **more)


def test_camera_on_a_pan_tilt_unit_looks_where_it_points(make_world):
    """What it sees at the wall at x = 5 fixes its distance, and so its brightness at a fixed exposure."""
    config = {**CONFIG, "width": 1, "height": 1, "fov_x_deg": 0.01, "fov_y_deg": 0.01, "exposure": 12.0}
    X_PN, p_PL = RigidTransform(RollPitchYaw(0, 0.1, 0), [0.2, 0, 0.1]), np.array([0.3, 0.05, 0])
    X_HC = RigidTransform([0.02, 0, 0.03]) @ FORWARD
    for angles in ([0.0, 0.0], [0.5, 0.2], [-0.4, -0.3]):
        source = {"pan_tilt_angles": ConstantVectorSource(np.array(angles))}
        make = camera(config, X_PN=X_PN, X_HC=X_HC, p_PL=p_PL, axis_P=AHEAD, on_pan_tilt=True)
        value = Station(make_world, make, inputs=source).read("nir_image", 0.01)[0, 0]
        X_WC = X_PN @ pan_tilt_pose(angles, X_HC)
        p, d = X_WC.translation(), X_WC.rotation().matrix()[:, 2]
        way = p + d * (5 - p[0]) / d[0] - p_PL
        r = np.linalg.norm(way)
        assert value == pytest.approx(255 * 12 * 0.4 * (way[0] / r / r**2 + 0.001), abs=2.5)


def test_angles_are_those_at_the_exposure_and_not_at_the_delivery(make_world):
    """The unit turns at 1 rad/s: a black stripe at 0.3 rad is in the middle of the image that was exposed at 0.3 s."""
    turning = {"pan_tilt_angles": TrajectorySource(PiecewisePolynomial.FirstOrderHold([0, 9], [[0, 9], [0, 0]]))}
    surfaces = SurfaceTable(default=Surface(nir_reflectance=0.4), by_pattern={"arm": Surface(nir_reflectance=0.0)})
    stripe = (RigidTransform(RollPitchYaw(0, 0, 0.3), [3 * np.cos(0.3), 3 * np.sin(0.3), 0]), (0, 0, 0))
    make = camera({**CONFIG, "latency": 0.05}, on_pan_tilt=True)
    station = Station(make_world, make, inputs=turning, arm=stripe, surfaces=surfaces)
    assert not np.any(station.read("nir_image", 0.27) < 20)
    columns = np.flatnonzero(station.read("nir_image", 0.37)[15] < 20)
    assert (columns.min() + columns.max()) / 2 == pytest.approx(15, abs=1)


def test_fixed_camera_has_no_input_for_angles(make_world):
    assert not Station(make_world, camera()).camera.HasInputPort("pan_tilt_angles")


def test_image_and_exposure_belong_together(make_world):
    """The robot drives to the wall; the exposure follows, and value / 255 / exposure is the radiance."""
    station = Station(make_world, camera({**CONFIG, "read_noise": 0.0}), velocity=(2.0, 0, 0))
    exposures = []
    for time in (0.05, 0.55, 1.05):
        image, exposure = station.read("nir_image", time), station.read("exposure")[0]
        distance = 5 - 2 * station.read("image_time")[0]
        assert image[15, 15] / 255 / exposure == pytest.approx(0.4 * (1 / distance**2 + 0.001), rel=0.02)
        exposures.append(exposure)
    assert exposures[0] > 1.3 * exposures[1] > 1.69 * exposures[2]


def test_the_robot_shows_as_it_looks_and_throws_shadows(make_world):
    """An arm that is black: in front of the camera it is dark; between lamp and wall its shadow is."""
    surfaces = SurfaceTable(default=Surface(nir_reflectance=0.4), by_pattern={"arm": Surface(nir_reflectance=0.0)})
    config = {**CONFIG, "fov_x_deg": 20.0}
    for lamp in (np.zeros(3), np.array([0, 0.5, 0])):
        arm = (RigidTransform([1.0, 0.25 if lamp.any() else 0.0, 0]), (0, 0, 0))
        make = camera(config, p_PL=lamp)
        free = Station(make_world, make, surfaces=surfaces).read("nir_image", 0.05)
        assert free.min() > 150
        dark = Station(make_world, make, surfaces=surfaces, arm=arm).read("nir_image", 0.05) < 20
        columns = np.flatnonzero(dark[15])
        assert 3 < len(columns) < 20


def test_what_rides_with_the_camera_shows_too(make_world):
    """Turned round, the camera looks at the box that carries it, 0.1 m away; behind that there is nothing."""
    back = RigidTransform(RollPitchYaw(0, 0, np.pi), [0, 0, 0])
    image = Station(make_world, camera({**CONFIG, "exposure": 0.01}, X_PN=back)).read("nir_image", 0.05)
    assert image[15, 15] == pytest.approx(255 * 0.01 * 0.4 / 0.1**2, abs=3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"exposure": 0.0}, "NirCamera: exposure"),
        ({"auto_percentile": 101.0}, "NirCamera: auto_percentile"),
        ({"lamp_half_angle_deg": 95.0}, "NirCamera: lamp_half_angle_deg"),
        ({"min_exposure": 3.0, "max_exposure": 2.0}, "min_exposure <= max_exposure"),
        ({"ambient": -1.0}, "NirCamera: ambient"),
    ],
)
def test_configuration_out_of_range_is_refused(make_world, change, message):
    with pytest.raises(ConfigError, match=message):
        Station(make_world, camera({**CONFIG, **change}))


@pytest.mark.parametrize("lamp", [{"axis_P": np.zeros(3)}, {"axis_P": [np.nan, 0, 1]}, {"p_PL": [0, np.inf, 0]}])
def test_lamp_needs_a_place_and_a_direction(make_world, lamp):
    with pytest.raises(ConfigError, match="not a lamp's place and direction"):
        Station(make_world, camera(**lamp))


def test_missing_angles_are_named(make_world):
    station = Station(make_world, camera(on_pan_tilt=True))
    with pytest.raises(PortError, match=r"NirCamera\.pan_tilt_angles"):
        Simulator(station.diagram).AdvanceTo(0.1)
