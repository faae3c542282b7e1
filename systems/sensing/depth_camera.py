"""Simulated stereo depth camera on SceneGraph geometry."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import FrameId
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context
from pydrake.systems.sensors import ImageDepth32F

from ..config import quantity
from ..errors import ConfigError
from ..noise import generator_at
from ..ports import weak_method
from .camera import CameraConfig, _Camera, cast_pixels
from .camera_model import CameraModel
from .ray_scene import RayScene

TOO_NEAR, TOO_FAR = np.float32(0), np.float32(np.inf)


@dataclass(kw_only=True)
class DepthCameraConfig(CameraConfig):
    """An Intel RealSense D415. Its field of view and baseline are those of the data sheet."""

    fov_x_deg: float = quantity(69.4, unit="deg", above=0.0, high=170.0)
    fov_y_deg: float = quantity(42.5, unit="deg", above=0.0, high=170.0)
    # Time between exposures: the real one gives up to 30 images a second, of which every second is used.
    period: float = quantity(1 / 15, unit="s", above=0.0)
    # Nearest and farthest depth that is measured.
    min_range: float = quantity(0.45, unit="m", low=0.0)
    max_range: float = quantity(10.0, unit="m", above=0.0)
    # Standard deviation of a disparity, and the distance between the two lenses.
    subpixel: float = quantity(0.08, unit="px", low=0.0)
    baseline: float = quantity(0.055, unit="m", above=0.0)
    # Width of the images that are matched; a smaller depth image is as exact, only thinned.
    stereo_width: int = quantity(640, unit="px", low=1)
    # Share of pixels without depth for no reason that is modelled. Assumed.
    dropout: float = quantity(0.01, low=0.0, high=1.0)
    # Share of pixels without depth on a surface that mirrors all light: both lenses see another place in it. Assumed.
    specular_dropout: float = quantity(0.3, low=0.0, high=1.0)
    # Angle of incidence at which surfaces begin to be lost; from here the share grows evenly to all at 90°. Assumed.
    grazing_angle_deg: float = quantity(85.0, unit="deg", low=0.0, high=89.9)

    def noise_factor(self) -> float:
        """c [1/m] of the standard deviation c z² of a depth z.

        Depth is z = f b / d, with disparity d, baseline b, and the focal length f of the images that are matched. An
        error of d gives dz = z² dd / (f b).
        """
        f = self.stereo_width / 2 / np.tan(np.deg2rad(self.fov_x_deg) / 2)
        return float(self.subpixel / (f * self.baseline))


def render_depth(
    model: CameraModel,
    X_WC: RigidTransform,
    scene: RayScene,
    rng: np.random.Generator,
    *,
    config: DepthCameraConfig,
    X_WF: Mapping[FrameId, RigidTransform] | None = None,
    own_geometry: np.ndarray | None = None,
    own_distance: np.ndarray | None = None,
) -> np.ndarray:
    """Depth along z_C of what every pixel sees, (H, W) float32 [m].

    With noise of standard deviation c z² (`DepthCameraConfig.noise_factor`). 0 where there is no measurement: nearer
    than `min_range`, a dropout, or the robot itself; infinite beyond `max_range` and where there is nothing. A pixel
    drops out with probability 1 − (1 − a)(1 − b s)(1 − g), where a is `dropout`, b `specular_dropout`, s the mirrored
    share of the surface, and g grows from 0 at `grazing_angle_deg` of incidence to 1 at 90°. A pixel is one ray: at an
    edge it has the depth of one side or of the other. What a mirror shows is not modelled.

    Args:
        model, X_WC: the camera and its pose.
        rng: two numbers are drawn for every pixel, whatever it sees.
        X_WF: poses of the moving frames, see `RayScene.cast`.
        own_geometry: geometries of the robot itself, as from `RayScene.geometries_of`.
        own_distance: distance along every ray to the parts of the robot that ride with the camera, (H·W,).
    """
    _, hits = cast_pixels(model, X_WC, scene, X_WF)
    depth = hits.distance * model.d_C[:, 2]
    with np.errstate(invalid="ignore"):  # inf − inf of a ray that met nothing
        depth += np.float32(config.noise_factor()) * depth * depth * rng.standard_normal(len(depth), np.float32)
    uniform = rng.random(len(depth), np.float32)
    kept = 1 - np.float32(config.specular_dropout) * hits.lookup("specular")
    kept *= np.float32(1 - config.dropout)
    grazing = np.deg2rad(90 - config.grazing_angle_deg)
    flat = np.flatnonzero(hits.incidence_cos < np.float32(np.sin(grazing)))
    kept[flat] *= np.arcsin(hits.incidence_cos[flat]) / np.float32(grazing)
    depth[~(depth <= config.max_range)] = TOO_FAR
    depth[hits.geometry < 0] = TOO_FAR
    lost = (depth < config.min_range) | ((uniform >= kept) & (hits.geometry >= 0))
    if own_geometry is not None:
        lost |= own_geometry[hits.geometry]
    if own_distance is not None:
        lost |= own_distance < hits.distance
    depth[lost] = TOO_NEAR
    return depth.reshape(model.shape)


class DepthCamera(_Camera):
    """
    .. pydrake_system::

        name: DepthCamera
        input_ports:
        - geometry_query
        output_ports:
        - depth_image
        - image_time

    Simulated stereo depth camera. It exposes at t = 0, period, 2 period, ..., and each image is delivered `latency`
    later and held until the next. Noise and dropout: see `render_depth`.

    - `geometry_query` (QueryObject): the SceneGraph's `query` port, for the poses of the frames.
    - `depth_image` (ImageDepth32F) [m]: depth along z_C, not range. As in Drake, 0 is nearer than can be measured and
      infinite is farther; 0 also stands for no measurement at all. All 0 before the first delivery.
    - `image_time` (1) [s]: when the image was exposed; NaN before the first delivery.

    Geometry of the robot itself hides what is behind it and gives no depth. What rides with the camera is found once,
    at construction.

    Args:
        config: image, lens, timing and noise.
        scene: geometry with surface properties; build it once, sensors can share it.
        parent_frame: SceneGraph frame P that the camera is fixed to.
        X_PC: pose of the camera in P, its frame as in `CameraModel`.
        rigid_frames: poses X_PF of the robot's frames that are welded to P, from `welded_frames(plant, body)`; P alone
            when not given.
        own_frames: further frames of the robot, which move against P, such as flippers.
        seed: of noise and dropout; two runs with one seed are equal.

    Raises:
        ConfigError: a value of `config` is out of its range.
        CameraError: the distortion folds the image.
        PortError: `geometry_query` is not connected.
    """

    def __init__(
        self,
        config: DepthCameraConfig,
        *,
        scene: RayScene,
        parent_frame: FrameId,
        X_PC: RigidTransform,
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
        if config.min_range >= config.max_range:
            value = (config.min_range, config.max_range)
            raise ConfigError("range", where="DepthCamera", value=value, valid="min_range < max_range")
        self.config = config
        self._X_PC = X_PC
        d_P = self.model.d_C @ X_PC.rotation().matrix().T.astype(np.float32)
        self._own_distance = self._body.distance(X_PC.translation(), d_P)
        self.DeclareAbstractOutputPort(
            "depth_image",
            lambda: AbstractValue.Make(ImageDepth32F(config.width, config.height)),
            weak_method(self._CalcDepthImage),
            {self.state_ticket},
        )
        self.declare_image_time()

    def _CalcDepthImage(self, context: Context, output: AbstractValue) -> None:
        image: Any = ImageDepth32F(self.model.width, self.model.height)
        exposure = self.shown(context)
        if exposure is None:
            image.mutable_data[:] = TOO_NEAR
        else:
            image.mutable_data[:, :, 0] = render_depth(
                self.model,
                exposure.X_WP @ self._X_PC,
                self._scene,
                generator_at(self._seed, exposure.index),
                config=self.config,
                X_WF=exposure.X_WF,
                own_geometry=self._body.moving,
                own_distance=self._own_distance,
            )
        output.set_value(image)
