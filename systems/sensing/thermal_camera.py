"""Simulated thermal camera on SceneGraph geometry."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import FrameId
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context
from scipy.ndimage import gaussian_filter

from ..config import quantity
from ..errors import ConfigError
from ..noise import generator_at
from ..ports import weak_method
from .camera import CameraConfig, _Camera, cast_pixels
from .camera_model import CameraModel
from .ray_scene import RayScene

_KELVIN = 273.15


@dataclass(kw_only=True)
class ThermalCameraConfig(CameraConfig):
    """A FLIR C3: image, field of view, rate, range and sensitivity are those of its data sheet."""

    width: int = quantity(80, unit="px", low=1)
    height: int = quantity(60, unit="px", low=1)
    fov_x_deg: float = quantity(41.0, unit="deg", above=0.0, high=170.0)
    fov_y_deg: float = quantity(31.0, unit="deg", above=0.0, high=170.0)
    # Time between exposures: 9 images a second.
    period: float = quantity(1 / 9, unit="s", above=0.0)
    # Time from an exposure to the delivery of its image. Assumed.
    latency: float = quantity(0.1, unit="s", low=0.0)
    # Noise of a pixel as a difference of temperature.
    netd: float = quantity(0.1, unit="K", low=0.0)
    # Standard deviation of an error of all pixels that is drawn once for a run. Assumed: after a shutter calibration.
    offset: float = quantity(0.5, unit="K", low=0.0)
    # Standard deviation of the optical blur. Assumed.
    blur: float = quantity(0.6, unit="px", low=0.0)
    # Temperature of the surroundings, which surfaces mirror, and which is seen where there is nothing.
    background: float = quantity(20.0, unit="°C", low=-273.15)
    # Lowest and highest temperature that is reported.
    min_temperature: float = quantity(-10.0, unit="°C", low=-273.15)
    max_temperature: float = quantity(150.0, unit="°C", low=-273.15)


def apparent_temperature(temperature: np.ndarray, emissivity: np.ndarray, background: float) -> np.ndarray:
    """Temperature [°C] of the black body that radiates as much as a surface and what it mirrors.

    Tₐ⁴ = ε T⁴ + (1 − ε) T_b⁴ in kelvin: what a grey surface of emissivity ε does not emit itself, it mirrors of the
    surroundings. The law of Stefan and Boltzmann stands for the band of the camera.

    Args:
        temperature, emissivity: of the surfaces, (N,) [°C], [0, 1].
        background: temperature of the surroundings [°C].
    """
    return _temperature(emissivity * _radiance(temperature) + (1 - emissivity) * _radiance(background))


def _radiance(temperature: np.ndarray | float) -> np.ndarray:
    return (np.asarray(temperature, float) + _KELVIN) ** 4


def _temperature(radiance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.sqrt(radiance)) - _KELVIN


def render_temperature(
    model: CameraModel,
    X_WC: RigidTransform,
    scene: RayScene,
    rng: np.random.Generator,
    *,
    config: ThermalCameraConfig,
    offset: float = 0.0,
    X_WF: Mapping[FrameId, RigidTransform] | None = None,
    own_geometry: np.ndarray | None = None,
    own_distance: np.ndarray | None = None,
) -> np.ndarray:
    """Apparent temperature of what every pixel sees, (H, W) float32 [°C]; NaN where it is the robot itself.

    `apparent_temperature` of the surfaces, the background where there is none; its radiance blurred over neighbouring
    pixels by a Gaussian of standard deviation `blur`; then `offset` and noise are added, and the result is cut to what
    the camera reports. The robot itself counts as background in the blur.

    Args:
        model, X_WC: the camera and its pose.
        rng: one number is drawn for every pixel.
        offset: error of all pixels [K].
        X_WF: poses of the moving frames, see `RayScene.cast`.
        own_geometry: geometries of the robot itself, as from `RayScene.geometries_of`.
        own_distance: distance along every ray to the parts of the robot that ride with the camera, (H·W,).
    """
    _, hits = cast_pixels(model, X_WC, scene, X_WF)
    own = np.zeros(len(hits.distance), bool)
    if own_geometry is not None:
        own |= own_geometry[hits.geometry]
    if own_distance is not None:
        own |= own_distance < hits.distance
    background = own | (hits.geometry < 0)
    temperature = np.where(background, config.background, hits.lookup("temperature"))
    image = apparent_temperature(temperature, hits.lookup("emissivity").astype(float), config.background)
    image = image.reshape(model.shape)
    if config.blur > 0:
        image = _temperature(gaussian_filter(_radiance(image), config.blur, mode="nearest"))
    image = image + offset + config.netd * rng.standard_normal(model.shape)
    image = np.clip(image, config.min_temperature, config.max_temperature).astype(np.float32)
    image[own.reshape(model.shape)] = np.nan
    return image


class ThermalCamera(_Camera):
    """
    .. pydrake_system::

        name: ThermalCamera
        input_ports:
        - geometry_query
        output_ports:
        - temperature_image
        - image_time

    Simulated thermal camera. It exposes at t = 0, period, 2 period, ..., and each image is delivered `latency` later
    and held until the next. What it measures: see `render_temperature`.

    - `geometry_query` (QueryObject): the SceneGraph's `query` port, for the poses of the frames.
    - `temperature_image` (numpy.ndarray, (H, W) float32, read-only) [°C]: apparent temperature, as of black surfaces;
      NaN where the robot itself is in the way. Drake has no image type for it. All NaN before the first delivery.
    - `image_time` (1) [s]: when the image was exposed; NaN before the first delivery.

    The offset of all pixels is drawn once for a run. What rides with the camera is found once, at construction.

    Args:
        config: image, lens, timing and noise.
        scene: geometry with surface properties; build it once, sensors can share it.
        parent_frame: SceneGraph frame P that the camera is fixed to.
        X_PC: pose of the camera in P, its frame as in `CameraModel`.
        rigid_frames: poses X_PF of the robot's frames that are welded to P, from `welded_frames(plant, body)`; P alone
            when not given.
        own_frames: further frames of the robot, which move against P, such as flippers.
        seed: of noise and offset; two runs with one seed are equal.

    Attributes:
        offset: error of all pixels in this run [K].

    Raises:
        ConfigError: a value of `config` is out of its range.
        CameraError: the distortion folds the image.
        PortError: `geometry_query` is not connected.
    """

    def __init__(
        self,
        config: ThermalCameraConfig,
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
        if config.min_temperature >= config.max_temperature:
            value = (config.min_temperature, config.max_temperature)
            valid = "min_temperature < max_temperature"
            raise ConfigError("range", where="ThermalCamera", value=value, valid=valid)
        self.config = config
        self.offset = config.offset * float(generator_at(seed, 0).standard_normal())
        self._X_PC = X_PC
        d_P = self.model.d_C @ X_PC.rotation().matrix().T.astype(np.float32)
        self._own_distance = self._body.distance(X_PC.translation(), d_P)
        nothing = _read_only(np.full(self.model.shape, np.nan, np.float32))
        self.DeclareAbstractOutputPort(
            "temperature_image",
            lambda: AbstractValue.Make(nothing),
            weak_method(self._CalcTemperatureImage),
            {self.state_ticket},
        )
        self.declare_image_time()

    def _CalcTemperatureImage(self, context: Context, output: AbstractValue) -> None:
        exposure = self.shown(context)
        if exposure is None:
            image = np.full(self.model.shape, np.nan, np.float32)
        else:
            image = render_temperature(
                self.model,
                exposure.X_WP @ self._X_PC,
                self._scene,
                generator_at(self._seed, exposure.index + 1),
                config=self.config,
                offset=self.offset,
                X_WF=exposure.X_WF,
                own_geometry=self._body.moving,
                own_distance=self._own_distance,
            )
        output.set_value(_read_only(image))


def _read_only(image: np.ndarray) -> np.ndarray:
    image.flags.writeable = False
    return image
