"""Simulated near-infrared camera with a lamp, fixed or on a pan-tilt unit."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import FrameId
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, ValueProducer
from pydrake.systems.sensors import ImageGrey8U

from ..errors import ConfigError, PortError
from ..noise import generator_at
from ..ports import weak_method
from .camera import Exposure, _Camera
from .camera_model import R_OPTICAL
from .nir_rendering import NirCameraConfig, render_nir
from .pan_tilt import pan_tilt_pose
from .ray_scene import RayScene

__all__ = ["NirCamera", "NirCameraConfig", "render_nir"]


class NirCamera(_Camera):
    """
    .. pydrake_system::

        name: NirCamera
        input_ports:
        - geometry_query
        - pan_tilt_angles
        output_ports:
        - nir_image
        - exposure
        - image_time

    Simulated near-infrared camera, fixed or on a pan-tilt unit, with a lamp that is fixed to the robot. It exposes at
    t = 0, period, 2 period, ..., and each image is delivered `latency` later and held until the next. What the lamp
    lights and how bright: see `nir_radiance` and `grey_values`.

    - `geometry_query` (QueryObject): the SceneGraph's `query` port, for the poses of the frames.
    - `pan_tilt_angles` (2) [rad], optional, only there with `on_pan_tilt`: true angles, `cheat.pan_tilt_angles` of
      `PanTilt`, read at the exposure.
    - `nir_image` (ImageGrey8U): brightness. All 0 before the first delivery.
    - `exposure` (1): brightness, as a share of 255, per unit of radiance; radiance = value / 255 / exposure. NaN before
      the first delivery.
    - `image_time` (1) [s]: when the image was exposed; NaN before the first delivery.

    The robot itself hides what is behind it, throws shadows, and shows in the image as it looks: eight bits have no
    value for "not measured". Leave the housings of camera and lamp out of the `scene`.

    Args:
        config: image, lens, timing, exposure, noise and lamp.
        scene: geometry with surface properties; build it once, sensors can share it.
        parent_frame: SceneGraph frame P that lamp and camera, or the mount of its pan-tilt unit, are fixed to.
        X_PN: pose of the mount N in P, x forward, y left, z up. X_PC = X_PN `pan_tilt_pose`(angles, X_HC).
        p_PL: position of the lamp in P (3) [m].
        axis_P: axis of the lamp's beam in P (3), of any length; the x axis of N when not given.
        X_HC: pose of the camera in the head of the unit; at its origin, looking forward, when not given.
        on_pan_tilt: whether the head turns; if not, both angles are 0.
        rigid_frames: poses X_PF of the robot's frames that are welded to P, from `welded_frames(plant, body)`; P alone
            when not given.
        own_frames: further frames of the robot; here they are like any others.
        seed: of noise; two runs with one seed are equal.

    Raises:
        ConfigError: a value of `config` is out of its range, or the lamp has no direction.
        CameraError: the distortion folds the image.
        PortError: an input is not connected.
    """

    def __init__(
        self,
        config: NirCameraConfig,
        *,
        scene: RayScene,
        parent_frame: FrameId,
        X_PN: RigidTransform,
        p_PL: np.ndarray,
        axis_P: np.ndarray | None = None,
        X_HC: RigidTransform | None = None,
        on_pan_tilt: bool = False,
        rigid_frames: Mapping[FrameId, RigidTransform] | None = None,
        own_frames: Collection[FrameId] = (),
        seed: int = 0,
    ):
        super().__init__(
            config,
            scene=scene,
            parent_frame=parent_frame,
            rigid_frames=rigid_frames,
            own_frames=own_frames,
            seed=seed,
        )
        if config.min_exposure > config.max_exposure:
            value = (config.min_exposure, config.max_exposure)
            raise ConfigError("range", where="NirCamera", value=value, valid="min_exposure <= max_exposure")
        self.config = config
        self._X_PN, self._X_HC = X_PN, RigidTransform(R_OPTICAL) if X_HC is None else X_HC
        self._p_PL = np.asarray(p_PL, float)
        axis = X_PN.rotation().matrix()[:, 0] if axis_P is None else np.asarray(axis_P, float)
        length = float(np.linalg.norm(axis))
        if not (np.isfinite(length) and length > 0 and np.isfinite(self._p_PL).all()):
            value = (self._p_PL.tolist(), axis.tolist())
            raise ConfigError("not a lamp's place and direction", where="NirCamera", value=value)
        self._axis_P = axis / length
        self._on_pan_tilt = on_pan_tilt
        if on_pan_tilt:
            self.DeclareVectorInputPort("pan_tilt_angles", 2)
        nothing = np.zeros(self.model.shape, np.uint8)
        producer = ValueProducer(
            allocate=lambda: AbstractValue.Make((nothing, np.nan)), calc=weak_method(self._CalcRendered)
        )
        rendered = self.DeclareCacheEntry("image and exposure", producer, {self.state_ticket})
        self._rendered = rendered.cache_index()
        ticket = {self.cache_entry_ticket(self._rendered)}
        self.DeclareAbstractOutputPort(
            "nir_image",
            lambda: AbstractValue.Make(ImageGrey8U(config.width, config.height)),
            weak_method(self._CalcNirImage),
            ticket,
        )
        self.DeclareVectorOutputPort("exposure", 1, self._CalcExposure, ticket)
        self.declare_image_time()

    def pan_tilt(self, context: Context) -> tuple[float, float]:
        if not self._on_pan_tilt:
            return 0.0, 0.0
        port = self.GetInputPort("pan_tilt_angles")
        if not port.HasValue(context):
            raise PortError("input port is not connected", where="NirCamera.pan_tilt_angles", valid="pan, tilt [rad]")
        angles: Any = port.Eval(context)
        return float(angles[0]), float(angles[1])

    def _render(self, shown: Exposure) -> tuple[np.ndarray, float]:
        X_WP = shown.X_WP
        return render_nir(
            self.model,
            X_WP @ self._X_PN @ pan_tilt_pose(shown.pan_tilt, self._X_HC),
            self._scene,
            generator_at(self._seed, shown.index),
            config=self.config,
            p_WL=X_WP @ self._p_PL,
            axis_W=X_WP.rotation().matrix() @ self._axis_P,
            X_WF={**shown.X_WF, **self._body.rigid_poses(X_WP)},
        )

    def _CalcRendered(self, context: Context, output: AbstractValue) -> None:
        shown = self.shown(context)
        output.set_value((np.zeros(self.model.shape, np.uint8), np.nan) if shown is None else self._render(shown))

    def _eval_rendered(self, context: Context) -> tuple[np.ndarray, float]:
        rendered: Any = self.get_cache_entry(self._rendered).Eval(context)
        return rendered

    def _CalcNirImage(self, context: Context, output: AbstractValue) -> None:
        image: Any = ImageGrey8U(self.model.width, self.model.height)
        image.mutable_data[:, :, 0] = self._eval_rendered(context)[0]
        output.set_value(image)

    def _CalcExposure(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([self._eval_rendered(context)[1]]))
