"""Calibration of a camera while the robot works: views are collected at rest, the pose is found when asked for."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State
from pydrake.systems.sensors import ImageDepth32F, ImageGrey8U

from ..config import check_config, quantity
from ..errors import CameraError, PortError
from ..ports import eval_typed, weak_method
from ..sensing.camera_model import CameraModel
from .edge_calibration import CalibrationView, EdgeCalibrationConfig, calibrate_from_views
from .pose_fit import Calibration, unfitted


@dataclass(kw_only=True)
class ExtrinsicCalibratorConfig:
    """When views are taken, and how the calibration is made from them."""

    # [s] Interval at which the inputs are looked at.
    period: float = quantity(0.2, unit="s", above=0)
    # [views] No more are collected than the one, no calibration is made from fewer than the other.
    max_views: int = quantity(80, unit="views", low=1)
    min_views: int = quantity(1, unit="views", low=1)
    # [s] Depth image and image of a view are at most this far apart in time; both are as old as the rest, or younger.
    max_time_difference: float = quantity(0.5, unit="s", above=0)
    # [rad] The pan-tilt rests while neither angle leaves this range about where it came to rest; three times the noise
    # of the encoders. A view is new when an angle differs from those of all others by more than `new_angle_deg`.
    rest_angle: float = quantity(0.001, unit="rad", above=0)
    new_angle_deg: float = quantity(1.0, unit="deg", above=0)
    # [1/m] The robot rests while the median change of depth between two looks is below this times z²; twice what a
    # D415 shows by its noise alone.
    rest_depth: float = quantity(0.006, unit="1/m", above=0)
    # [-] A depth image needs depth in this share of its pixels.
    min_depth_share: float = quantity(0.05, unit="-", above=0, high=1)
    edges: EdgeCalibrationConfig = field(default_factory=EdgeCalibrationConfig)


@dataclass(frozen=True, eq=False)
class _Collected:
    """Abstract state; read-only, so that Drake may share it instead of copying it at every update.

    Attributes:
        views: so far, with `scenes`, the number of the place where the robot stood at each.
        depth, depth_time: depth image of the last look, None before there is one.
        scene, scene_time, scene_depth: number of the place, since when the robot rests there, the depth image that
            all views of the place share.
        angles, angles_time: where the pan-tilt came to rest, and when.
        note: why the last look gave no view.
    """

    views: tuple[CalibrationView, ...] = ()
    scenes: tuple[int, ...] = ()
    depth: np.ndarray | None = None
    depth_time: float = -np.inf
    scene: int = 0
    scene_time: float = np.inf
    scene_depth: np.ndarray | None = None
    angles: tuple[float, float] = (np.inf, np.inf)
    angles_time: float = np.inf
    note: str = "nothing seen yet"

    def __deepcopy__(self, memo: dict) -> "_Collected":
        return self


class ExtrinsicCalibrator(LeafSystem):
    """
    .. pydrake_system::

        name: ExtrinsicCalibrator
        input_ports:
        - depth_image
        - depth_time
        - image
        - image_time
        - pan_tilt_angles
        output_ports:
        - calibration
        - views

    Calibrates where a camera C sits from what it and the depth camera D see of the same things, without targets.

    Every `period` it looks at its inputs. While robot and pan-tilt rest, and both images were taken since then, a new
    place or a new direction of the pan-tilt becomes a view, up to `max_views`. Views of one place share one
    depth image. The robot counts as resting while the depth image stays the same but for its noise, so that odometry
    is not needed; turning before a bare wall is not noticed.

    - `depth_image` (`ImageDepth32F`) [m] and `depth_time` (1) [s]: of D, and when it was taken, NaN before the first.
    - `image` (`ImageGrey8U`, or an array (H, W) of float32 when `grey` is False) and `image_time` (1) [s]: of C.
    - `pan_tilt_angles` (2) [rad]: pan, left +, and tilt, down +, as the encoders say; this optional port is there with
      `with_pan_tilt`.
    - `calibration` (`Calibration`): see `calibrate_from_views`. It is made when it is asked for, which takes a
      second for ten views or so, and kept until there is another view. With fewer than `min_views` it is the guess, not
      valid, and `reason` says what is missing.
    - `views` (1): number of views collected.

    Raises:
        CameraError: an image does not have the size that its camera has.
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(
        self,
        config: ExtrinsicCalibratorConfig | None = None,
        *,
        depth_camera: CameraModel,
        camera: CameraModel,
        X_HC_guess: RigidTransform,
        X_DN: RigidTransform | None = None,
        grey: bool = True,
        with_pan_tilt: bool = True,
    ):
        """
        Args:
            X_HC_guess: pose of the camera in the head of the pan-tilt, or in D when it is fixed, by ruler.
            X_DN: pose of the pan-tilt's mount in D; identity when not given.
        """
        super().__init__()
        self._config = config or ExtrinsicCalibratorConfig()
        check_config(self._config)
        self._depth_camera, self._camera = depth_camera, camera
        self._X_HC_guess, self._X_DN = X_HC_guess, X_DN or RigidTransform()
        self._grey, self._with_pan_tilt = grey, with_pan_tilt
        self.DeclareAbstractInputPort("depth_image", AbstractValue.Make(ImageDepth32F(1, 1)))
        self.DeclareVectorInputPort("depth_time", 1)
        self.DeclareAbstractInputPort("image", AbstractValue.Make(ImageGrey8U(1, 1) if grey else object()))
        self.DeclareVectorInputPort("image_time", 1)
        if with_pan_tilt:
            self.DeclareVectorInputPort("pan_tilt_angles", 2)
        ticket = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(_Collected())))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._Look)
        nothing = unfitted(X_HC_guess, self._X_DN, 6, self._config.edges.hold, "")
        self.DeclareAbstractOutputPort(
            "calibration", lambda: AbstractValue.Make(nothing), weak_method(self._CalcCalibration), {ticket}
        )
        self.DeclareVectorOutputPort("views", 1, self._CalcViews, {ticket})

    def _Look(self, context: Context, state: State) -> EventStatus:
        collected = self._collected(context)
        if len(collected.views) >= self._config.max_views:
            return EventStatus.DidNothing()
        depth_time, image_time = self._vector(context, "depth_time")[0], self._vector(context, "image_time")[0]
        angles = self._vector(context, "pan_tilt_angles") if self._with_pan_tilt else np.zeros(2)
        depth = self._depth(context)
        image = self._image(context)
        if np.isfinite(angles).all() and np.isfinite([depth_time, image_time]).all():
            now = context.get_time()
            looked = _look(collected, now, depth, depth_time, image, image_time, angles, self._config)
            state.get_mutable_abstract_state(0).set_value(looked)
        return EventStatus.Succeeded()

    def _depth(self, context: Context) -> np.ndarray:
        held: Any = eval_typed(self, context, "depth_image", ImageDepth32F)
        depth: np.ndarray = held.data[:, :, 0]
        self._depth_camera.check_image(depth, "ExtrinsicCalibrator.depth_image")
        return depth.copy()

    def _image(self, context: Context) -> np.ndarray:
        held: Any = eval_typed(self, context, "image", ImageGrey8U if self._grey else np.ndarray)
        image: np.ndarray = held.data[:, :, 0] if self._grey else held
        self._camera.check_image(image, "ExtrinsicCalibrator.image")
        if image.ndim != 2:
            where = "ExtrinsicCalibrator.image"
            raise CameraError("one value a pixel is needed", where=where, value=image.shape, valid=self._camera.shape)
        return image.copy()

    def _vector(self, context: Context, name: str) -> np.ndarray:
        port = self.GetInputPort(name)
        if not port.HasValue(context):
            raise PortError("input port is not connected", where=f"ExtrinsicCalibrator.{name}", valid="a vector")
        value: Any = port.Eval(context)
        return np.asarray(value)

    @staticmethod
    def _collected(context: Context) -> _Collected:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _CalcCalibration(self, context: Context, output: AbstractValue) -> None:
        collected, config = self._collected(context), self._config
        if len(collected.views) < config.min_views:
            reason = f"only {len(collected.views)} views, needs {config.min_views}: {collected.note}"
            output.set_value(unfitted(self._X_HC_guess, self._X_DN, 6, config.edges.hold, reason))
            return
        fit: Calibration = calibrate_from_views(
            collected.views,
            self._depth_camera,
            self._camera,
            self._X_HC_guess,
            X_DN=self._X_DN,
            config=config.edges,
        )
        output.set_value(fit)

    def _CalcViews(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([float(len(self._collected(context).views))]))


def _look(
    known: _Collected,
    now: float,
    depth: np.ndarray,
    depth_time: float,
    image: np.ndarray,
    image_time: float,
    angles: np.ndarray,
    config: ExtrinsicCalibratorConfig,
) -> _Collected:
    """What is known after a look at two images and the angles of the pan-tilt."""
    if np.abs(angles - known.angles).max() > config.rest_angle:
        known = replace(known, angles=(float(angles[0]), float(angles[1])), angles_time=now)
    if depth_time > known.depth_time:
        if known.depth is None or _changed(known.depth, depth, config):
            known = replace(known, scene=known.scene + 1, scene_time=depth_time, scene_depth=None)
        known = replace(known, depth=depth, depth_time=depth_time)
    if (depth > 0).mean() < config.min_depth_share:
        return replace(known, note="the depth image is empty")
    if known.depth_time <= known.scene_time:
        return replace(known, note="the robot moves, or has just stopped")
    if image_time < max(known.angles_time, known.scene_time):
        return replace(known, note="no image since robot and pan-tilt came to rest")
    if abs(image_time - depth_time) > config.max_time_difference:
        return replace(known, note="depth image and image are from different times")
    if not np.isfinite(image).all():
        return replace(known, note="the image has pixels that are not finite")
    here = [view.pan_tilt for view, scene in zip(known.views, known.scenes, strict=True) if scene == known.scene]
    near = [np.abs(np.subtract(angles, there)).max() <= np.deg2rad(config.new_angle_deg) for there in here]
    if any(near):
        return replace(known, note="nothing new in view")
    shared = depth if known.scene_depth is None else known.scene_depth
    view = CalibrationView(shared, image, (float(angles[0]), float(angles[1])))
    return replace(known, views=(*known.views, view), scenes=(*known.scenes, known.scene), scene_depth=shared, note="")


def _changed(before: np.ndarray, now: np.ndarray, config: ExtrinsicCalibratorConfig) -> bool:
    """Whether the median pixel shows more than noise; also when there is nothing to compare."""
    both = np.isfinite(before) & np.isfinite(now) & (before > 0) & (now > 0)
    if not both.any():
        return True
    change = np.abs(now[both] - before[both]) / before[both] ** 2
    return bool(np.median(change) > config.rest_depth)
