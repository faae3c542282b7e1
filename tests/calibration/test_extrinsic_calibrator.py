import numpy as np
import pytest
from naraha.systems.calibration.edge_calibration import EdgeCalibrationConfig
from naraha.systems.calibration.extrinsic_calibrator import ExtrinsicCalibrator, ExtrinsicCalibratorConfig
from naraha.systems.calibration.pose_fit import change_between, changed
from naraha.systems.errors import CameraError, ConfigError, PortError
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageDepth32F, ImageGrey8U

from tests.calibration.calibration_world import DEPTH, NIR, THERMAL, X_DN, Room, small_change, thermal_views

FLAT = np.full(THERMAL.shape, 20.0, np.float32)
PERIOD = 0.2


class Bench:
    """A calibrator with fixed inputs that looks once whenever it is told to."""

    def __init__(self, config=None, *, camera=THERMAL, grey=False, with_pan_tilt=False, guess=None):
        self.system = ExtrinsicCalibrator(
            config,
            depth_camera=DEPTH,
            camera=camera,
            X_HC_guess=guess or RigidTransform(),
            X_DN=X_DN if with_pan_tilt else None,
            grey=grey,
            with_pan_tilt=with_pan_tilt,
        )
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.grey = grey
        self.now = 0.0

    def fix(self, name, value):
        self.system.GetInputPort(name).FixValue(self.context, value)

    def look(self, depth, image, *, depth_age=0.0, image_age=0.0, angles=None):
        held = ImageDepth32F(depth.shape[1], depth.shape[0])
        held.mutable_data[:, :, 0] = depth
        self.fix("depth_image", held)
        self.fix("depth_time", [self.now - depth_age])
        if self.grey:
            grey = ImageGrey8U(image.shape[1], image.shape[0])
            grey.mutable_data[:, :, 0] = image
            image = grey
        self.fix("image", image)
        self.fix("image_time", [self.now - image_age])
        if angles is not None:
            self.fix("pan_tilt_angles", angles)
        self.simulator.AdvanceTo(self.now + PERIOD / 2)
        self.now += PERIOD
        return self.views

    @property
    def views(self):
        return int(self.system.GetOutputPort("views").Eval(self.context)[0])

    @property
    def calibration(self):
        return self.system.GetOutputPort("calibration").Eval(self.context)


@pytest.fixture(scope="module")
def room():
    return Room.furnished(1)


def test_a_place_gives_one_view_once_the_robot_rests(room):
    bench = Bench()
    assert bench.look(room.depth(), FLAT) == 0  # nothing to compare with yet
    assert bench.look(room.depth(), FLAT) == 1
    assert bench.look(room.depth(), FLAT) == 1


def test_a_moving_robot_gives_no_views_and_the_next_place_gives_another(room):
    bench = Bench()
    for step in range(4):
        assert bench.look(room.depth() + 0.05 * step, FLAT) == 0
    assert "the robot moves" in bench.calibration.reason
    assert bench.look(room.depth() + 0.15, FLAT) == 1
    assert bench.look(room.depth() + 0.5, FLAT) == 1
    assert bench.look(room.depth() + 0.5, FLAT) == 2


def test_views_are_taken_only_when_the_pan_tilt_rests_and_the_image_is_from_then(room):
    bench = Bench(camera=NIR, grey=True, with_pan_tilt=True)
    image, depth = np.full(NIR.shape, 90, np.uint8), room.depth()
    bench.look(depth, image, angles=[0.0, 0.0])
    assert bench.look(depth, image, angles=[0.1, 0.0], image_age=0.1) == 0  # taken on the way
    assert bench.look(depth, image, angles=[0.1002, 0.0]) == 1  # noise of the encoder
    assert bench.look(depth, image, angles=[0.2, 0.0], image_age=0.1) == 1
    assert bench.look(depth, image, angles=[0.2, 0.0], image_age=0.3) == 1
    assert bench.look(depth, image, angles=[0.2, 0.0]) == 2
    assert bench.look(depth, image, angles=[0.1, 0.0]) == 2  # seen before
    assert bench.look(depth, image, angles=[0.1, 0.0]) == 2


def test_images_from_different_times_are_not_paired(room):
    bench = Bench(ExtrinsicCalibratorConfig(max_time_difference=0.05))
    for _ in range(4):
        assert bench.look(room.depth(), FLAT, image_age=0.1) == 0
    assert "different times" in bench.calibration.reason


def test_no_more_views_than_allowed_are_collected(room):
    bench = Bench(ExtrinsicCalibratorConfig(max_views=2), camera=NIR, grey=True, with_pan_tilt=True)
    image, depth = np.full(NIR.shape, 90, np.uint8), room.depth()
    for step in range(8):
        bench.look(depth, image, angles=[0.1 * (step // 2), 0.0])
    assert bench.views == 2


def test_the_calibration_is_made_from_what_was_collected():
    views, X_DC = thermal_views(1, 2)
    guess = changed(X_DC, small_change(np.random.default_rng(1)))
    bench = Bench(ExtrinsicCalibratorConfig(min_views=2), guess=guess)
    for view in views:
        bench.look(view.depth, view.image)
        assert not bench.calibration.valid
        bench.look(view.depth, view.image)
    result = bench.calibration
    assert result.valid
    change = change_between(X_DC, result.X_HC)
    assert np.linalg.norm(change[3:]) < 0.008
    assert np.rad2deg(np.linalg.norm(change[:3])) < 0.2
    # Kept by Drake until there is another view.
    assert bench.calibration.X_HC is result.X_HC


def test_too_few_views_are_no_calibration(room):
    guess = RigidTransform([0.1, 0.0, 0.0])
    bench = Bench(ExtrinsicCalibratorConfig(min_views=3), guess=guess)
    for _ in range(3):
        bench.look(room.depth(), FLAT)
    result = bench.calibration
    assert not result.valid
    assert result.reason == "only 1 views, needs 3: nothing new in view"
    np.testing.assert_array_equal(result.X_HC.GetAsMatrix4(), guess.GetAsMatrix4())


@pytest.mark.parametrize("empty", [np.nan, 0.0])
def test_a_depth_image_without_depth_gives_no_view(empty):
    bench = Bench()
    for _ in range(3):
        assert bench.look(np.full(DEPTH.shape, empty, np.float32), FLAT) == 0
    assert not bench.calibration.valid
    assert "the depth image is empty" in bench.calibration.reason


def test_a_camera_that_has_not_delivered_yet_is_waited_for(room):
    bench = Bench()
    for _ in range(3):
        assert bench.look(room.depth(), FLAT, image_age=np.nan) == 0


def test_an_image_of_the_wrong_size_is_named_with_the_right_one(room):
    with pytest.raises(CameraError, match=r"ExtrinsicCalibrator\.image.*60, 80"):
        Bench().look(room.depth(), FLAT[:, :-1])
    with pytest.raises(CameraError, match=r"ExtrinsicCalibrator\.depth_image.*480, 640"):
        Bench().look(room.depth()[:-1], FLAT)
    with pytest.raises(CameraError, match="one value a pixel"):
        Bench().look(room.depth(), np.zeros((60, 80, 3), np.float32))


def test_what_is_not_connected_or_of_another_type_is_named(room):
    bench = Bench()
    with pytest.raises(PortError, match="depth_time"):
        bench.simulator.AdvanceTo(0.1)
    bench = Bench()
    with pytest.raises(PortError, match="image"):
        bench.look(room.depth(), [1, 2, 3])


def test_a_configuration_out_of_range_is_refused():
    config = ExtrinsicCalibratorConfig(edges=EdgeCalibrationConfig(starts=0))
    with pytest.raises(ConfigError, match=r"edges\.starts"):
        Bench(config)
