"""Temperature images against closed forms."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.sensing import Surface, SurfaceTable
from naraha.systems.sensing.thermal_camera import (
    ThermalCamera,
    ThermalCameraConfig,
    apparent_temperature,
    render_temperature,
)
from pydrake.geometry import Box, Cylinder
from pydrake.math import RigidTransform
from scipy.special import ndtr

from tests.sensing.camera_rig import FORWARD, Station

HOT = SurfaceTable(by_pattern={"hot*": Surface(temperature=80.0, emissivity=1.0)})
EXACT = {"netd": 0.0, "blur": 0.0}


def look(world, X_WC=FORWARD, *, surfaces=HOT, seed=0, offset=0.0, X_WF=None, own_geometry=None, **changes):
    config = ThermalCameraConfig(**changes)
    model = config.model()
    rng = np.random.default_rng(seed)
    image = render_temperature(
        model,
        X_WC,
        world.rays(surfaces),
        rng,
        config=config,
        offset=offset,
        X_WF=X_WF,
        own_geometry=own_geometry,
    )
    return model, image


def wall(make_world, name="hot wall"):
    return make_world().add(Box(1, 50, 50), [3.5, 0, 0], name)


def test_apparent_temperature_is_that_of_equal_radiance():
    """80 °C at ε = 0.5 before 20 °C: ((353.15⁴ + 293.15⁴)/2)^¼ = 327.25 K."""
    assert apparent_temperature(np.array(80.0), np.array(0.5), 20.0) == pytest.approx(327.2548 - 273.15, abs=1e-4)
    hot = np.array([80.0, 80.0, 20.0, -10.0])
    np.testing.assert_allclose(apparent_temperature(hot, np.array([1, 0, 0.3, 1]), 20.0), [80, 20, 20, -10], atol=1e-9)


@pytest.mark.parametrize("emissivity", [0.1, 0.5, 0.95, 1.0])
def test_every_pixel_of_a_wall_has_its_apparent_temperature(make_world, emissivity):
    surfaces = SurfaceTable(default=Surface(temperature=120.0, emissivity=emissivity))
    _, image = look(wall(make_world), surfaces=surfaces, background=5.0, **EXACT)
    assert image.shape == (60, 80)
    assert image.dtype == np.float32
    expected = (emissivity * 393.15**4 + (1 - emissivity) * 278.15**4) ** 0.25 - 273.15
    np.testing.assert_allclose(image, expected, atol=1e-4)


def test_where_there_is_nothing_the_background_is_seen(make_world):
    _, image = look(make_world().add(Box(1, 1, 1), [-9, 0, 0]), background=12.0, **EXACT)
    np.testing.assert_allclose(image, 12, atol=1e-5)


def test_hot_cylinder_is_at_its_pixels(make_world):
    """A hot pipe along y of radius 0.12 m, 4 m ahead and 0.5 m up: its edges are tangents from the camera."""
    pipe = RigidTransform(np.array([[1.0, 0, 0, 4], [0, 0, 1, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]]))
    model, image = look(make_world().add(Cylinder(0.12, 100), pipe, "hot pipe"), **EXACT)
    centre, half = np.arctan2(0.5, 4), np.arcsin(0.12 / np.hypot(0.5, 4))
    for u in (0, 40, 79):
        rows = np.flatnonzero(image[:, u] > 50)
        # In every column it is the plane through the pipe that counts: y_C/z_C of its upper and lower edge.
        edges = model.cy - model.fy * np.tan([centre + half, centre - half])
        assert rows[0] == pytest.approx(edges[0], abs=0.6)
        assert rows[-1] == pytest.approx(edges[1], abs=0.6)
        np.testing.assert_allclose(image[rows, u], 80, atol=1e-4)
    np.testing.assert_allclose(image[image < 50], 20, atol=1e-5)


def test_blur_spreads_an_edge_as_a_gaussian_of_radiance(make_world):
    world = make_world().add(Box(1, 50, 50), [3.5, 25, 0], "hot half")
    model, image = look(world, blur=1.5, netd=0.0)
    radiance = (image[30].astype(float) + 273.15) ** 4
    share = (radiance - 293.15**4) / (353.15**4 - 293.15**4)
    edge = model.cx  # y > 0 is left of the axis: the last hot pixel is 39, the first cold one 40
    np.testing.assert_allclose(share, ndtr((edge - np.arange(80)) / 1.5), atol=0.012)
    _, sharp = look(world, **EXACT)
    assert set(np.unique(np.rint(sharp))) == {20, 80}


def test_noise_has_the_netd_and_the_offset_moves_all_pixels(make_world):
    _, image = look(wall(make_world), offset=1.5, netd=0.2)
    assert image.mean() == pytest.approx(81.5, abs=4 * 0.2 / 69)
    assert image.std() == pytest.approx(0.2, rel=0.05)


@pytest.mark.parametrize(("temperature", "reported"), [(400.0, 150.0), (-50.0, -10.0)])
def test_temperatures_are_cut_to_what_the_camera_reports(make_world, temperature, reported):
    surfaces = SurfaceTable(default=Surface(temperature=temperature, emissivity=1.0))
    _, image = look(wall(make_world), surfaces=surfaces)
    np.testing.assert_array_equal(image, reported)


def test_the_robot_gives_no_temperature(make_world):
    world = wall(make_world)
    arm = world.frame("arm")
    world.add(Box(0.2, 0.2, 4), name="arm", frame=arm)
    pose = {arm: RigidTransform([1.1, 0, 0])}
    model, image = look(world, X_WF=pose, own_geometry=world.rays().geometries_of([arm]), **EXACT)
    own = np.abs(model.xy[:80, 0]) < 0.1
    assert np.isnan(image[:, own]).all()
    np.testing.assert_allclose(image[:, ~own], 80, atol=1e-4)


# --- the system -----------------------------------------------------------------------------------------------------


def camera(**changes):
    return lambda **options: ThermalCamera(ThermalCameraConfig(**changes), X_PC=FORWARD, **options)


def test_offset_is_drawn_once_a_run(make_world):
    station = Station(make_world, camera(offset=2.0, netd=0.0, latency=0.0), seed=1)
    first, second = station.read("temperature_image", 0.05), station.read("temperature_image", 0.5)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_allclose(first, 20 + station.camera.offset, atol=1e-5)
    assert abs(station.camera.offset) > 0.01


def test_offsets_of_runs_have_their_standard_deviation(make_world):
    world = wall(make_world)
    scene, frame = world.rays(), world.scene_graph.world_frame_id()
    config = ThermalCameraConfig(offset=0.5, width=2, height=2)
    offsets = [ThermalCamera(config, scene=scene, parent_frame=frame, X_PC=FORWARD, seed=s).offset for s in range(400)]
    assert np.std(offsets) == pytest.approx(0.5, rel=0.15)
    assert np.mean(offsets) == pytest.approx(0, abs=0.1)


def test_image_cannot_be_written_to(make_world):
    image = Station(make_world, camera()).read("temperature_image", 0.3)
    assert image.dtype == np.float32
    with pytest.raises(ValueError, match="read-only"):
        image[0, 0] = 1


def test_range_of_temperatures_must_not_be_empty(make_world):
    with pytest.raises(ConfigError, match="min_temperature < max_temperature"):
        Station(make_world, camera(min_temperature=50.0, max_temperature=40.0))
