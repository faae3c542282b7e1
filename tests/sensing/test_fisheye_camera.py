"""Fisheye images against closed forms."""

import numpy as np
import pytest
from naraha.systems.errors import CameraError, ConfigError, PortError
from naraha.systems.sensing.fisheye_camera import (
    EquidistantModel,
    FisheyeCamera,
    FisheyeCameraConfig,
    geometry_colours,
    render_fisheye,
)
from pydrake.geometry import Box, GeometryInstance, PerceptionProperties, Rgba, Role, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from tests.sensing.camera_rig import FORWARD, Station

LENS = EquidistantModel(width=161, height=161, fov=np.deg2rad(190.0))
STILL = FisheyeCameraConfig(width=161, height=161, fov_deg=190.0, noise=0.0, dome_radius=0.0)


def look(scene, colours, X_WC=FORWARD, config=STILL, X_WF=None):
    return render_fisheye(config.lens(), X_WC, scene, colours, np.random.default_rng(0), config=config, X_WF=X_WF)


# --- the lens -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degrees", [0.0, 10.0, 45.0, 90.0, 94.0])
@pytest.mark.parametrize("turn", [0.0, 1.0, -2.5])
def test_the_distance_from_the_centre_is_proportional_to_the_angle_from_the_axis(degrees, turn):
    theta = np.deg2rad(degrees)
    point = 3.0 * np.array([[np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)]])
    uv, inside = LENS.project(point)
    radius = 161 / 2 * degrees / 95.0
    np.testing.assert_allclose(uv[0], [80 + radius * np.cos(turn), 80 + radius * np.sin(turn)], atol=1e-9)
    assert inside[0]


def test_beyond_the_field_of_view_nothing_is_seen():
    theta = np.deg2rad([94.9, 95.1, 180.0])
    _, inside = LENS.project(np.column_stack([np.sin(theta), 0 * theta, np.cos(theta)]))
    np.testing.assert_array_equal(inside, [True, False, False])


def test_rays_of_pixels_project_back_to_them():
    uv, inside = LENS.project(LENS.d_C)
    assert inside.all()
    v, u = np.divmod(np.flatnonzero(LENS.lit), 161)
    np.testing.assert_allclose(uv, np.column_stack([u, v]), atol=2e-4)
    np.testing.assert_allclose(np.linalg.norm(LENS.d_C, axis=1), 1.0, atol=1e-6)


def test_the_disc_touches_the_shorter_sides():
    lens = EquidistantModel(width=300, height=100, fov=np.pi)
    lit = lens.lit.reshape(100, 300)
    rows, columns = np.nonzero(lit)
    assert (rows.min(), rows.max()) == (0, 99)
    assert (columns.min(), columns.max()) == (100, 199)
    assert lit.sum() == pytest.approx(np.pi * 50**2, rel=0.01)


@pytest.mark.parametrize("options", [{"width": 0}, {"fov": 0.0}, {"fov": 7.0}])
def test_a_lens_that_cannot_be_is_refused(options):
    with pytest.raises(CameraError, match="fov"):
        EquidistantModel(**{"width": 10, "height": 10, "fov": 3.0, **options})


# --- the image ------------------------------------------------------------------------------------------------------


def test_a_ball_appears_where_the_lens_projects_it_also_beside_the_camera(make_world):
    """Directions of 0, 60 and 88 degrees from the axis, to the left and upwards."""
    for degrees, direction in ((0.0, (0, 0)), (60.0, (1, 0)), (88.0, (0, 1))):
        theta = np.deg2rad(degrees)
        centre = 2.0 * np.array([np.cos(theta), np.sin(theta) * direction[0], np.sin(theta) * direction[1]])
        scene = make_world().add(Sphere(0.3), centre, "ball").rays()
        image = look(scene, np.array([[1.0, 1.0, 1.0], [0, 0, 0]]))
        v, u = np.nonzero(image[:, :, 0])
        uv, _ = LENS.project((FORWARD.rotation().matrix().T @ centre)[None])
        np.testing.assert_allclose([u.mean(), v.mean()], uv[0], atol=1.0)


@pytest.mark.parametrize("incidence", [0.0, 40.0, 70.0])
def test_brightness_is_even_light_and_a_lamp_at_the_lens(make_world, incidence):
    angle = np.deg2rad(incidence)
    wall = RigidTransform(RotationMatrix.MakeZRotation(angle), [2.0, 0, 0]) @ RigidTransform([0.5, 0, 0])
    scene = make_world().add(Box(1, 50, 50), wall, "wall").rays()
    image = look(scene, np.array([[0.9, 0.6, 0.3], [0, 0, 0]]))
    light = 0.35 + 0.65 * np.cos(angle) / (1 + 2.0**2)
    want = 255 * (light * np.array([0.9, 0.6, 0.3])) ** (1 / 2.2)
    np.testing.assert_allclose(image[80, 80, :3], want, atol=0.6)


def test_outside_the_disc_and_where_there_is_nothing_it_is_black(make_world):
    scene = make_world().add(Box(100, 100, 1), [0, 0, -1], "floor").rays()
    image = look(scene, np.array([[1.0, 1.0, 1.0], [0, 0, 0]]))
    lit = LENS.lit.reshape(161, 161)
    assert not image[~lit][:, :3].any()
    assert not image[:80][:, :, :3].any()
    assert (image[82:][lit[82:]][:, 0] > 0).mean() > 0.9
    assert (image[:, :, 3] == 255).all()


def test_moving_things_are_seen_where_they_are(make_world):
    world = make_world()
    frame = world.frame("moving")
    scene = world.add(Sphere(0.2), name="ball", frame=frame).rays()
    places = []
    for y in (-1.0, 1.0):
        image = look(scene, np.array([[1.0, 1, 1], [0, 0, 0]]), X_WF={frame: RigidTransform([1.0, y, 0.0])})
        places.append(np.nonzero(image[:, :, 0])[1].mean())
    assert places[0] > 80 > places[1]
    np.testing.assert_allclose(np.add(*places), 160, atol=1.0)


def test_the_mount_around_the_lens_does_not_show(make_world):
    world = make_world().add(Box(0.2, 0.2, 0.2), [-0.1, 0, 0], "mount")
    world.add(Sphere(0.012), name="glass")
    scene, colours = world.rays(), np.array([[1.0, 1, 1], [1, 1, 1], [0, 0, 0]])
    narrow = FisheyeCameraConfig(width=161, height=161, fov_deg=170.0, noise=0.0)
    assert not look(scene, colours, config=narrow)[:, :, :3].any()


def test_noise_has_the_given_strength(make_world):
    scene = make_world().add(Box(1, 50, 50), [2.5, 0, 0], "wall").rays()
    colours = np.array([[0.5, 0.5, 0.5], [0, 0, 0]])
    noisy = FisheyeCameraConfig(width=161, height=161, fov_deg=190.0, noise=5.0, dome_radius=0.0)
    middle = np.s_[60:100, 60:100, :3]
    apart = look(scene, colours, config=noisy)[middle].astype(float) - look(scene, colours)[middle]
    assert apart.std() == pytest.approx(5.0, rel=0.05)


def test_colours_are_those_that_the_geometries_have(make_world):
    world = make_world().add(Sphere(0.1), name="plain")
    painted = GeometryInstance(RigidTransform(), Sphere(0.1), "painted")
    properties = PerceptionProperties()
    properties.AddProperty("phong", "diffuse", Rgba(0.2, 0.4, 0.6, 1.0))
    painted.set_perception_properties(properties)
    world.scene_graph.RegisterAnchoredGeometry(world.source, painted)
    scene = world.rays(role=Role.kPerception)
    colours = dict(zip(scene.names, geometry_colours(scene, world.scene_graph.model_inspector()), strict=False))
    np.testing.assert_allclose(colours["painted"], [0.2, 0.4, 0.6], atol=1e-6)
    np.testing.assert_allclose(colours["plain"], 0.7, atol=1e-6)


# --- the system -----------------------------------------------------------------------------------------------------


def station(make_world, colours=None, **changes):
    options = {"width": 41, "height": 41, "period": 0.1, "latency": 0.0, "noise": 0.0, **changes}

    def make(scene, **more):
        given = np.vstack([np.full((len(scene.names), 3), 0.8), np.zeros(3)]) if colours is None else colours
        return FisheyeCamera(FisheyeCameraConfig(**options), scene=scene, colours=given, X_PC=FORWARD, **more)

    return Station(make_world, make, velocity=(1.0, 0, 0))


def test_an_image_is_that_of_its_exposure_and_comes_after_the_latency(make_world):
    rig = station(make_world, latency=0.04)
    assert not rig.read("fisheye_image").any()
    assert np.isnan(rig.read("image_time")[0])
    early = rig.read("fisheye_image", 0.05)[20, 20]
    assert rig.read("image_time")[0] == 0.0
    late = rig.read("fisheye_image", 1.05)[20, 20]
    assert rig.read("image_time")[0] == pytest.approx(1.0)
    for value, distance in ((early, 5.0 - 0.014), (late, 4.0 - 0.014)):
        light = 0.35 + 0.65 / (1 + distance**2)
        assert value == pytest.approx(255 * (0.8 * light) ** (1 / 2.2), abs=1.0)


def test_values_out_of_range_and_wrong_colours_are_named(make_world):
    with pytest.raises(ConfigError, match="fov_deg"):
        station(make_world, fov_deg=400.0)
    with pytest.raises(CameraError, match="not a colour a geometry"):
        station(make_world, colours=np.zeros((2, 3)))


def test_a_missing_query_port_is_named(make_world):
    world = make_world()
    frame = world.frame("base")
    scene = world.add(Sphere(0.1), name="ball", frame=frame).rays()
    camera = FisheyeCamera(
        FisheyeCameraConfig(), scene=scene, colours=np.zeros((2, 3)), parent_frame=frame, X_PC=FORWARD
    )
    context = camera.CreateDefaultContext()
    with pytest.raises(PortError, match="geometry_query"):
        camera._Expose(context, context.get_mutable_state())
