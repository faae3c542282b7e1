"""Exposure and delivery of images, for every kind of camera."""

import copy
import gc
import weakref

import numpy as np
import pytest
from naraha.systems.errors import CameraError, ConfigError, PortError
from naraha.systems.sensing.camera import CameraConfig, Exposure, ExposureQueue
from naraha.systems.sensing.depth_camera import DepthCamera, DepthCameraConfig
from naraha.systems.sensing.nir_camera import NirCamera, NirCameraConfig
from naraha.systems.sensing.thermal_camera import ThermalCamera, ThermalCameraConfig
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from tests.sensing.camera_rig import FORWARD, Station

SMALL = {"width": 16, "height": 12}


def depth(config=None, **changes):
    config = DepthCameraConfig(**{**SMALL, "period": 0.1, **changes}) if config is None else config
    return lambda **options: DepthCamera(config, X_PC=FORWARD, **options)


def nir(**changes):
    config = NirCameraConfig(**{**SMALL, "period": 0.1, **changes})
    return lambda **options: NirCamera(config, X_PN=RigidTransform(), p_PL=np.zeros(3), **options)


def thermal(**changes):
    config = ThermalCameraConfig(**{**SMALL, "period": 0.1, **changes})
    return lambda **options: ThermalCamera(config, X_PC=FORWARD, **options)


CAMERAS = {"depth_image": depth, "nir_image": nir, "temperature_image": thermal}
every_camera = pytest.mark.parametrize(("image", "camera"), CAMERAS.items(), ids=CAMERAS)


# --- the queue ------------------------------------------------------------------------------------------------------


def exposure(time, index=0):
    return Exposure(time, index, RigidTransform(), {})


def test_queue_delivers_what_is_due_and_keeps_the_rest():
    queue = ExposureQueue()
    for i in range(4):
        queue = queue.exposed(exposure(float(i), i))
    assert (queue.count, len(queue.pending), queue.shown) == (4, 4, None)
    after = queue.delivered(1.5)
    assert after.shown.index == 1
    assert [e.index for e in after.pending] == [2, 3]
    assert after.delivered(1.9).shown.index == 1
    assert queue.shown is None
    assert len(queue.pending) == 4


def test_queue_forgets_what_was_exposed_after_a_jump_back():
    queue = ExposureQueue().exposed(exposure(1.0, 0)).exposed(exposure(8.0, 1)).exposed(exposure(2.0, 2))
    assert [e.index for e in queue.pending] == [0, 2]


def test_queue_is_shared_when_a_context_is_copied():
    queue = ExposureQueue().exposed(exposure(0.0))
    assert copy.deepcopy(queue) is queue


# --- exposure and delivery ------------------------------------------------------------------------------------------


@every_camera
@pytest.mark.parametrize("latency", [0.0, 0.03, 0.1, 0.25, 0.3])
def test_images_come_once_a_period_and_latency_later(make_world, image, camera, latency):
    """Also when several images are on their way at a time."""
    station = Station(make_world, camera(latency=latency))
    if latency > 0:
        assert np.isnan(station.read("image_time", latency - 0.005))
    for k in range(6):
        for time in (0.1 * k + latency + 0.001, 0.1 * k + latency + 0.095):
            assert station.read("image_time", time) == pytest.approx(0.1 * k, abs=1e-9)


@every_camera
def test_before_the_first_delivery_there_is_an_empty_image_of_full_size(make_world, image, camera):
    dropout = {"dropout": 0.0} if image == "depth_image" else {}
    station = Station(make_world, camera(latency=0.2, **dropout))
    value = station.read(image, 0.15)
    assert value.shape == (12, 16)
    assert np.isnan(value).all() if image == "temperature_image" else not value.any()
    assert np.isnan(station.read("image_time"))
    if image == "nir_image":
        assert np.isnan(station.read("exposure"))
    later = station.read(image, 0.21)
    assert later.shape == (12, 16)
    assert np.all(later > 0)


@pytest.mark.parametrize("latency", [0.0, 0.25])
def test_image_shows_the_world_at_its_exposure(make_world, latency):
    """The camera drives towards the wall at 1 m/s, so its depth tells when it was exposed."""
    station = Station(make_world, depth(latency=latency, subpixel=0.0, dropout=0.0), velocity=(1.0, 0, 0))
    for time in (latency + 0.05, latency + 0.15, latency + 0.32):
        value = station.read("depth_image", time)
        exposed = np.floor((time - latency) / 0.1) * 0.1
        np.testing.assert_allclose(value, 5 - exposed, rtol=1e-5)
        assert station.read("image_time") == pytest.approx(exposed, abs=1e-9)


def test_image_that_is_read_later_is_the_same_as_one_that_is_read_at_once(make_world):
    """Images are made when they are read; that must not show."""
    early, late = (Station(make_world, depth(latency=0.02), velocity=(1.0, 0, 0)) for _ in range(2))
    for time in (0.03, 0.13, 0.23):
        first = early.read("depth_image", time)
    np.testing.assert_array_equal(late.read("depth_image", 0.29), first)


@every_camera
def test_one_seed_gives_one_image_and_another_seed_another(make_world, image, camera):
    images = [Station(make_world, camera(), seed=seed).read(image, 0.25) for seed in (3, 3, 4)]
    np.testing.assert_array_equal(images[0], images[1])
    assert np.any(images[0] != images[2])


@every_camera
def test_successive_images_of_a_still_scene_have_noise_of_their_own(make_world, image, camera):
    station = Station(make_world, camera())
    first, second = station.read(image, 0.25), station.read(image, 0.35)
    assert np.any(first != second)


def test_image_shows_other_bodies_where_they_were_at_its_exposure(make_world):
    """An arm of 0.1 m crosses the view at 1 m/s, 0.5 m ahead; it belongs to the robot and so has depth 0."""
    crossing = (RigidTransform([0.5, -0.3, 0]), (0, 1.0, 0))
    options = {"width": 200, "height": 4, "fov_x_deg": 90.0, "fov_y_deg": 2.0, "dropout": 0.0, "latency": 0.25}
    station = Station(make_world, depth(**options), arm=crossing)
    for time, exposed in ((0.3, 0.0), (0.53, 0.2)):
        columns = np.flatnonzero(station.read("depth_image", time)[2] == 0)
        left = -station.camera.model.xy[columns, 0] * 0.45  # y of its front
        assert (left.min() + left.max()) / 2 == pytest.approx(exposed - 0.3, abs=0.05)


@every_camera
def test_cloned_context_continues_like_the_original(make_world, image, camera):
    station = Station(make_world, camera(latency=0.15), velocity=(1.0, 0, 0))
    before = station.read(image, 0.2)
    clone = Simulator(station.diagram, station.simulator.get_context().Clone())
    np.testing.assert_array_equal(station.read(image, simulator=clone), before)
    original = station.read(image, 0.4)
    np.testing.assert_array_equal(station.read(image, simulator=clone), before)
    np.testing.assert_array_equal(station.read(image, 0.4, simulator=clone), original)


def test_jump_back_in_time_shows_nothing_of_the_future(make_world):
    station = Station(make_world, depth(latency=0.25))
    assert station.read("image_time", 5.01) == pytest.approx(4.7)
    station.simulator.get_mutable_context().SetTime(0.0)
    station.simulator.Initialize()
    for k in range(3):
        assert station.read("image_time", 0.1 * k + 0.251) == pytest.approx(0.1 * k, abs=1e-9)


def test_the_robot_hides_what_is_behind_it_and_gives_no_measurement(make_world):
    """An arm 0.1 m wide, 0.5 m ahead: it covers |y/z| < 0.05/0.45 of the view, and is nearer than the wall."""
    ahead = (RigidTransform([0.5, 0, 0]), (0, 0, 0))
    options = {"width": 160, "height": 6, "fov_x_deg": 60.0, "fov_y_deg": 3.0}
    for camera, image in ((depth, "depth_image"), (thermal, "temperature_image")):
        station = Station(make_world, camera(**options), arm=ahead)
        value = station.read(image, 0.15)
        hidden = (value == 0) if image == "depth_image" else np.isnan(value)
        across = np.abs(station.camera.model.xy[:160, 0])
        assert hidden[:, across < 0.11].all()
        assert np.mean(hidden[:, across > 0.112]) < 0.05


def test_what_rides_with_the_camera_hides_too(make_world):
    """Turned round, the camera looks at its own box, 0.1 m away, which covers |y/z| < 1.5 and |x/z| < 1."""
    back = RigidTransform(np.diag([-1.0, -1, 1, 1])) @ FORWARD
    config = {"width": 16, "height": 12, "fov_x_deg": 80.0, "fov_y_deg": 60.0}

    def turned_depth(**options):
        return DepthCamera(DepthCameraConfig(**config, min_range=0.01), X_PC=back, **options)

    def turned_thermal(**options):
        return ThermalCamera(ThermalCameraConfig(**config), X_PC=back, **options)

    assert not Station(make_world, turned_depth).read("depth_image", 0.15).any()
    assert np.isnan(Station(make_world, turned_thermal).read("temperature_image", 0.15)).all()


@every_camera
def test_camera_is_freed_when_nothing_uses_it(make_world, image, camera):
    world = make_world().add(Box(1, 1, 1))
    system = camera()(scene=world.rays(), parent_frame=world.scene_graph.world_frame_id())
    system.CreateDefaultContext()
    gone = weakref.ref(system)
    del system
    gc.collect()
    assert gone() is None


# --- what a user can get wrong --------------------------------------------------------------------------------------


@every_camera
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"period": 0.0}, "period"),
        ({"latency": -0.1}, "latency"),
        ({"width": 0}, "width"),
        ({"fov_x_deg": 180.0}, "fov_x_deg"),
        ({"distortion": [0.0, np.nan, 0, 0, 0]}, "distortion"),
    ],
)
def test_configuration_out_of_range_is_refused(make_world, image, camera, change, message):
    with pytest.raises(ConfigError, match=message):
        Station(make_world, camera(**change))


@every_camera
def test_lens_that_folds_the_image_is_refused_at_construction(make_world, image, camera):
    with pytest.raises(CameraError, match="folds the image"):
        Station(make_world, camera(distortion=[-9.0, 0, 0, 0, 0], fov_x_deg=60.0, fov_y_deg=45.0))


def test_config_gives_the_model_of_its_numbers():
    model = CameraConfig(width=100, height=50, fov_x_deg=90.0, fov_y_deg=60.0, distortion=[0.01, 0, 0, 0, 0]).model()
    assert (model.fx, model.fy) == (pytest.approx(50), pytest.approx(25 / np.tan(np.pi / 6)))
    assert model.distortion == (0.01, 0, 0, 0, 0)
    with pytest.raises(CameraError, match="wrong length"):
        CameraConfig(distortion=[0.1]).model()


@every_camera
def test_missing_connection_is_named(make_world, image, camera):
    world = make_world().add(Box(1, 1, 1))
    system = camera()(scene=world.rays(), parent_frame=world.scene_graph.world_frame_id())
    with pytest.raises(PortError, match=rf"{type(system).__name__}\.geometry_query"):
        Simulator(system).AdvanceTo(0.1)
