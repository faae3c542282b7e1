"""Any camera onto the newest keyframe, as its images arrive."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State
from pydrake.systems.sensors import ImageGrey8U

from ..config import check_config, quantity
from ..errors import CameraError, ConfigError, PortError
from ..ports import eval_typed, weak_method
from ..sensing.camera_model import CameraModel
from ..sensing.pan_tilt import pan_tilt_pose
from ..slam.keyframe import NO_KEYFRAME, Keyframe
from ..slam.motion import distance_and_angle
from ..slam.scan_matcher import History, odometry_at
from .camera_view import Angles, CameraView, LampConfig, angles_at, image_values, plain_values, radiance
from .layers import with_layers
from .painting import Paint, PaintConfig, paint
from .projection import check_extrinsics, check_pan_tilt

# [s] Odometry and pan-tilt angles are remembered this long, for images that arrive late.
_HISTORY = 3.0

KINDS = ("brightness", "plain")


@dataclass(kw_only=True)
class CameraFusionConfig:
    """Which attribute a camera gives, and which of its images are used."""

    # Name of the attribute that points get.
    attribute: str = "nir"
    # "brightness": grey images become the reflectance of the surface, by exposure and lamp. "plain": points get what
    # the pixels say, such as temperatures.
    kind: str = quantity("brightness", choices=KINDS)
    # Name of the attribute that says from how far it was seen; none when empty.
    range_attribute: str = "nir_range"
    # [s] Interval at which images and keyframes are looked for; that of the camera or shorter, or images are missed.
    period: float = quantity(0.1, unit="s", above=0)
    # [s], [views] How long and how many images are remembered, to paint the next keyframe with.
    memory: float = quantity(8.0, unit="s", low=0)
    max_views: int = quantity(60, unit="views", low=1)
    # [deg] Images taken before or after a larger turn of the robot do not paint a keyframe: in a turn, tracks tell
    # little of where the robot goes.
    max_turn_deg: float = quantity(10.0, unit="deg", low=0, high=180)
    # [rad/s] Images taken while pan or tilt turned faster are blurred, and skipped.
    max_pan_tilt_rate: float = quantity(0.1, unit="rad/s", above=0)
    # Pixels of a "plain" image that differ by more than this from a neighbour are left out: at the edge of something
    # hot a coarse pixel shows a mean of two surfaces. Null keeps all.
    max_step: float | None = quantity(None, above=0)
    # [rad] Range of pan and of tilt; an encoder that says anything else is broken.
    pan_tilt_low: list[float] = quantity([-3.15, -1.6], unit="rad")
    pan_tilt_high: list[float] = quantity([3.15, 1.6], unit="rad")
    # Weights and visibility.
    paint: PaintConfig = field(default_factory=PaintConfig)


@dataclass(frozen=True)
class FusionHealth:
    """What became of the images.

    Attributes:
        views_used: images that painted points of a keyframe.
        views_skipped: images that were not used at all: blurred, or without any pixel that says something.
        reason: why the last image painted nothing, "" when it did.
        painted: part of the keyframe's points that were seen, [0, 1].
    """

    views_used: int = 0
    views_skipped: int = 0
    reason: str = "no keyframe yet"
    painted: float = 0.0

    def __deepcopy__(self, memo: dict) -> "FusionHealth":
        return self


@dataclass(frozen=True, eq=False)
class _Fusion:
    """Abstract state; read-only, so that Drake may share it instead of copying it at every update."""

    received: Keyframe = NO_KEYFRAME
    painted: Keyframe = NO_KEYFRAME
    paint: Paint = field(default_factory=lambda: Paint.none(0))
    views: tuple[CameraView, ...] = ()
    used_until: float = -1.0
    image_time: float = -1.0
    odometry: History = ()
    angles: Angles = ()
    health: FusionHealth = FusionHealth()

    def __deepcopy__(self, memo: dict) -> "_Fusion":
        return self


class CameraFusion(LeafSystem):
    """
    .. pydrake_system::

        name: CameraFusion
        input_ports:
        - keyframe
        - image
        - image_time
        - exposure
        - pan_tilt_angles
        - X_OB
        output_ports:
        - keyframe
        - health

    Paints the points of keyframes with what a camera sees of them (S0-a, S0-b, Eq. 1): see `paint`.

    Every `period` it notes the odometry and the pan-tilt angles and takes in a new image, once for each `image_time`.
    The camera's pose at the exposure is interpolated between the notes, so an image may arrive late. It is added to the
    paint of the held keyframe, and remembered: a new keyframe is first painted with all remembered images, each moved
    by the odometry between exposure and keyframe.

    - `keyframe` (`Keyframe`), in: with `normals` (N, 3) where known. The same index again, with the same points and
      perhaps more attributes from a system before this one, keeps its paint.
    - `image`: an `ImageGrey8U` for kind "brightness", a float array (H, W) for "plain", NaN where it says nothing.
    - `image_time` (1) [s]: when the image was exposed; negative or NaN before the first.
    - `exposure` (1), optional, only there for "brightness": gain of the grey image, see `radiance`.
    - `pan_tilt_angles` (2) [rad], optional, only there with `X_BN`: encoders, pan to the left and tilt downwards.
    - `X_OB` (`RigidTransform`): odometry, pose of the base B in O.
    - `keyframe` (`Keyframe`), out: the newest one, with the attribute (N, 1) float32 in `cloud_B` and the weighted mean
      distance at which it was seen, NaN where a point was never seen. It is given out anew, with the same index, as
      more images arrive.
    - `health` (`FusionHealth`).

    Images taken while the pan-tilt moved, and those where no pixel says anything, are skipped and counted.

    Args:
        camera: intrinsics.
        X_BC: pose of the camera in the base, when it is fixed to it.
        X_BN, X_HC: pose of the pan-tilt's mount in the base and of the camera in its head, instead of X_BC.
        lamp: the light, for "brightness".

    Raises:
        ConfigError: a value of the configuration is out of range.
        CameraError: extrinsics are no rigid motion, or (while running) an image has another size than the camera, the
            exposure is no positive number, or pan or tilt is not finite or out of its range.
        PortError: an input is not connected or of another type.
    """

    def __init__(
        self,
        config: CameraFusionConfig | None = None,
        *,
        camera: CameraModel,
        X_BC: RigidTransform | None = None,
        X_BN: RigidTransform | None = None,
        X_HC: RigidTransform | None = None,
        lamp: LampConfig | None = None,
    ):
        super().__init__()
        config = config or CameraFusionConfig()
        check_config(config, where="CameraFusion")
        if not config.attribute:
            raise ConfigError("must not be empty", where="CameraFusion", key="attribute")
        bright = config.kind == "brightness"
        if bright != (lamp is not None):
            problem = "needs a lamp" if bright else "has no use for a lamp"
            raise ConfigError(problem, where="CameraFusion", key="lamp", value=config.kind)
        if (X_BC is None) == (X_BN is None) or (X_BN is None) != (X_HC is None):
            raise CameraError("where is the camera?", where="CameraFusion", valid="X_BC, or X_BN and X_HC")
        if lamp is not None:
            check_config(lamp, where="CameraFusion", key="lamp")
        self._config, self._camera, self._lamp = config, camera, lamp
        self._mount = check_extrinsics(_matrix(X_BC or X_BN), "CameraFusion.X_BC" if X_BC else "CameraFusion.X_BN")
        self._X_HC = None if X_HC is None else check_extrinsics(_matrix(X_HC), "CameraFusion.X_HC")

        self.DeclareAbstractInputPort("keyframe", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("image", AbstractValue.Make(ImageGrey8U(1, 1) if bright else object()))
        self.DeclareVectorInputPort("image_time", 1)
        if bright:
            self.DeclareVectorInputPort("exposure", 1)
        if self._X_HC is not None:
            self.DeclareVectorInputPort("pan_tilt_angles", 2)
        self.DeclareAbstractInputPort("X_OB", AbstractValue.Make(RigidTransform()))
        ticket = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(_Fusion())))
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Fuse)
        self.DeclareAbstractOutputPort(
            "keyframe", lambda: AbstractValue.Make(NO_KEYFRAME), weak_method(self._CalcKeyframe), {ticket}
        )
        self.DeclareAbstractOutputPort(
            "health", lambda: AbstractValue.Make(FusionHealth()), weak_method(self._CalcHealth), {ticket}
        )

    def _Fuse(self, context: Context, state: State) -> EventStatus:
        known = self._fusion(context)
        now = context.get_time()
        # A copy: what the port gives is a reference to its cache, which will hold the next pose.
        X_OB = RigidTransform(eval_typed(self, context, "X_OB", RigidTransform))
        fusion = replace(known, odometry=_noted(known.odometry, now, X_OB))
        if self._X_HC is not None:
            fusion = replace(fusion, angles=_noted(fusion.angles, now, self._eval_angles(context)))
        fusion, view = self._take_image(context, fusion)
        keyframe = eval_typed(self, context, "keyframe", Keyframe)
        received = fusion.received
        fresh: tuple[CameraView, ...] = () if view is None else (view,)
        if keyframe.index >= 0 and keyframe is not received:
            fusion = replace(fusion, received=keyframe)
            if keyframe.index != received.index or not np.array_equal(keyframe.p_BP, received.p_BP):
                fusion = replace(fusion, paint=Paint.none(len(keyframe.p_BP)))
                fresh = fusion.views
        for added in fresh if fusion.received.index >= 0 else ():
            fusion = self._add(fusion, added)
        if fusion.received is not received or fusion.paint is not known.paint:
            fusion = replace(fusion, painted=self._give_out(fusion))
        state.get_mutable_abstract_state(0).set_value(fusion)
        return EventStatus.Succeeded()

    def _eval_vector(self, context: Context, name: str) -> np.ndarray:
        port = self.GetInputPort(name)
        if not port.HasValue(context):
            raise PortError("input port is not connected", where=f"CameraFusion.{name}", valid="a vector")
        value: Any = port.Eval(context)
        return np.array(value)

    def _eval_angles(self, context: Context) -> tuple[float, float]:
        angles, low, high = (
            self._eval_vector(context, "pan_tilt_angles"),
            self._config.pan_tilt_low,
            self._config.pan_tilt_high,
        )
        pan, tilt = check_pan_tilt(angles, np.array(low), np.array(high), "CameraFusion.pan_tilt_angles")
        return float(pan), float(tilt)

    def _take_image(self, context: Context, fusion: _Fusion) -> tuple[_Fusion, CameraView | None]:
        """The state with a new image among its views, and its view; None when there is none that can be used."""
        time = float(self._eval_vector(context, "image_time")[0])
        if not time >= 0 or time == fusion.image_time:  # NaN, too
            return fusion, None
        fusion = replace(fusion, image_time=time)
        X_BC = self._mount
        if self._X_HC is not None:
            angles, rate = angles_at(fusion.angles, time)
            if rate > self._config.max_pan_tilt_rate:
                return _skipped(fusion, f"the pan-tilt turned at {rate:.2f} rad/s"), None
            X_BC = X_BC @ pan_tilt_pose(angles, self._X_HC)
        bright = self._config.kind == "brightness"
        image: Any = eval_typed(self, context, "image", ImageGrey8U if bright else np.ndarray)
        pixels = image_values(image, self._camera, "CameraFusion.image")
        if bright:
            exposure = float(self._eval_vector(context, "exposure")[0])
            values = radiance(pixels, exposure, "CameraFusion.exposure")
        else:
            values = plain_values(pixels, self._config.max_step)
        view = CameraView(time, X_BC, odometry_at(fusion.odometry, time), values)
        if not view.known:
            return _skipped(fusion, "no pixel of the image says anything"), None
        oldest = time - self._config.memory
        kept = tuple(v for v in fusion.views if v.time >= oldest)
        return replace(fusion, views=(*kept, view)[-self._config.max_views :]), view

    def _add(self, fusion: _Fusion, view: CameraView) -> _Fusion:
        """The state with a view added to the paint of the keyframe."""
        keyframe, health = fusion.received, fusion.health
        X_OB = keyframe.X_OB or odometry_at(fusion.odometry, keyframe.time)
        turn = np.rad2deg(distance_and_angle(X_OB.inverse() @ view.X_OB)[1])
        if turn > self._config.max_turn_deg:
            return replace(fusion, health=replace(health, reason=f"the robot turned by {turn:.0f} deg in between"))
        normals = keyframe.cloud_B.point.normals.numpy() if "normals" in keyframe.cloud_B.point else None
        added = paint(
            keyframe.p_BP, normals, X_OB, view, self._camera, self._config.paint, lamp=self._lamp, before=fusion.paint
        )
        used = health.views_used + (added.newly > 0 and view.time > fusion.used_until)
        until = view.time if added.newly else fusion.used_until
        health = replace(health, views_used=used, reason=added.reason, painted=added.painted)
        return replace(fusion, paint=added, used_until=max(until, fusion.used_until), health=health)

    def _give_out(self, fusion: _Fusion) -> Keyframe:
        """The received keyframe with what was seen of its points."""
        layers = {self._config.attribute: fusion.paint.value}
        if self._config.range_attribute:
            layers[self._config.range_attribute] = fusion.paint.range
        cloud = with_layers(fusion.received.cloud_B, layers)
        return replace(fusion.received, cloud_B=cloud)

    @staticmethod
    def _fusion(context: Context) -> _Fusion:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _CalcKeyframe(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._fusion(context).painted)

    def _CalcHealth(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._fusion(context).health)


def _noted[T](notes: tuple[tuple[float, T], ...], time: float, value: T) -> tuple[tuple[float, T], ...]:
    kept = tuple(note for note in notes if time - _HISTORY <= note[0] < time)
    return (*kept, (time, value))


def _skipped(fusion: _Fusion, reason: str) -> _Fusion:
    health = replace(fusion.health, views_skipped=fusion.health.views_skipped + 1, reason=reason)
    return replace(fusion, health=health)


def _matrix(X: RigidTransform | np.ndarray | None) -> np.ndarray:
    return X.GetAsMatrix4() if isinstance(X, RigidTransform) else np.asarray(X, float)
