"""Simulated fisheye camera for operators, on SceneGraph geometry."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import FrameId, Rgba, Role, SceneGraphInspector
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context
from pydrake.systems.sensors import ImageRgba8U

from ..config import check_config, quantity
from ..errors import CameraError
from ..noise import generator_at
from ..ports import weak_method
from .camera import CameraConfig, _Camera
from .ray_scene import RayScene

_GREY = (0.7, 0.7, 0.7)
_NOTHING = (0.06, 0.09, 0.16)
"""Colours of what has none, and of what is not there."""


@dataclass(frozen=True, eq=False, kw_only=True)
class EquidistantModel:
    """A fisheye lens: a direction at the angle θ from the optical axis is drawn at the distance f θ from the centre.

    The equidistant projection (Kannala and Brandt 2006, Eq. 3), which is OpenCV's fisheye model without its polynomial.
    Camera frame C and pixels are those of `CameraModel`. The image is a disc that touches the shorter sides.

    Attributes:
        width, height: [px]. fov: angle across the disc [rad].

    Raises:
        CameraError: a size is below one pixel or the angle not within 0 and 2 π.
    """

    width: int
    height: int
    fov: float

    def __post_init__(self) -> None:
        if min(self.width, self.height) < 1 or not 0 < self.fov <= 2 * np.pi:
            value = (self.width, self.height, self.fov)
            raise CameraError("no fisheye has such a lens", where="camera", value=value, valid="0 < fov <= 2 pi")

    @property
    def focal_length(self) -> float:
        """f [px/rad]."""
        return min(self.width, self.height) / self.fov

    @property
    def centre(self) -> tuple[float, float]:
        """Where the optical axis meets the image [px]."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    def project(self, p_CP: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixel coordinates uv (N, 2) of points (N, 3) [m], and which of them are within the disc (N,)."""
        p_CP = np.asarray(p_CP, float)
        across = np.hypot(p_CP[:, 0], p_CP[:, 1])
        theta = np.arctan2(across, p_CP[:, 2])
        scale = self.focal_length * np.divide(theta, across, out=np.zeros_like(theta), where=across > 0)
        return p_CP[:, :2] * scale[:, None] + self.centre, theta <= self.fov / 2

    @cached_property
    def lit(self) -> np.ndarray:
        """Which pixels are within the disc (H·W,), row by row."""
        return self._polar[0] <= self.fov / 2

    @cached_property
    def d_C(self) -> np.ndarray:
        """Unit directions (K, 3) float32 of the pixels that are `lit`, in order."""
        theta, u, v = (values[self.lit] for values in self._polar)
        radius = np.maximum(np.hypot(u, v), 1e-12)
        across = np.sin(theta) / radius
        return np.column_stack([across * u, across * v, np.cos(theta)]).astype(np.float32)

    @cached_property
    def _polar(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angle from the axis [rad] and offsets from the centre [px] of every pixel (H·W,)."""
        u, v = np.meshgrid(np.arange(self.width) - self.centre[0], np.arange(self.height) - self.centre[1])
        return np.hypot(u, v).ravel() / self.focal_length, u.ravel(), v.ravel()


@dataclass(kw_only=True)
class FisheyeCameraConfig:
    """Image, light and timing. All values are assumed; those of the snake of S1 are not published."""

    width: int = quantity(160, unit="px", low=1)
    height: int = quantity(160, unit="px", low=1)
    # Angle across the image's disc.
    fov_deg: float = quantity(185.0, unit="deg", above=0.0, high=360.0)
    # Time between exposures, and from one to the delivery of its image.
    period: float = quantity(0.5, unit="s", above=0.0)
    latency: float = quantity(0.1, unit="s", low=0.0)
    # Rays begin on the dome of the lens, so that its mount does not show.
    dome_radius: float = quantity(0.014, unit="m", low=0.0)
    # Share of even light in the light; the rest is that of a lamp at the lens.
    ambient: float = quantity(0.35, low=0.0, high=1.0)
    # Distance at which a surface has half of the lamp's light.
    lamp_range: float = quantity(1.0, unit="m", above=0.0)
    # Standard deviation of a grey value of 0 to 255.
    noise: float = quantity(2.0, low=0.0)

    def lens(self) -> EquidistantModel:
        return EquidistantModel(width=self.width, height=self.height, fov=float(np.deg2rad(self.fov_deg)))


def geometry_colours(scene: RayScene, inspector: SceneGraphInspector) -> np.ndarray:
    """Colours (G + 1, 3) of the geometries of a scene, 0 to 1; the last, dark blue, is for rays that meet nothing."""
    found: dict[str, tuple[float, float, float]] = {}
    for geometry in inspector.GetAllGeometryIds(Role.kPerception) + inspector.GetAllGeometryIds(Role.kIllustration):
        for properties in (inspector.GetPerceptionProperties(geometry), inspector.GetIllustrationProperties(geometry)):
            if properties is not None and properties.HasProperty("phong", "diffuse"):
                rgba: Any = properties.GetProperty("phong", "diffuse")
                rgba = rgba if isinstance(rgba, Rgba) else Rgba(*rgba)
                found.setdefault(inspector.GetName(geometry), (rgba.r(), rgba.g(), rgba.b()))
    return np.array([*(found.get(name, _GREY) for name in scene.names), _NOTHING], np.float32)


def render_fisheye(
    lens: EquidistantModel,
    X_WC: RigidTransform,
    scene: RayScene,
    colours: np.ndarray,
    rng: np.random.Generator,
    *,
    config: FisheyeCameraConfig,
    X_WF: Mapping[FrameId, RigidTransform] | None = None,
) -> np.ndarray:
    """What an operator sees, (H, W, 4) uint8 RGBA; black outside the disc.

    A surface has the brightness a + (1 - a) cos β / (1 + (r / r₀)²) times its colour, with the share a of even light,
    the angle of incidence β, the distance r and `lamp_range` r₀: a headlamp without shadows, since lamp and lens are at
    one place. Shown with a gamma of 2.2. For people to look at, not to measure with.

    Args:
        colours: as from `geometry_colours`. rng: three numbers are drawn for every pixel of the disc.
        X_WF: poses of the moving frames, see `RayScene.cast`.
    """
    d_W = lens.d_C @ X_WC.rotation().matrix().T.astype(np.float32)
    hits = scene.cast(X_WC.translation() + config.dome_radius * d_W, d_W, X_WF)
    near = np.where(np.isfinite(hits.distance), hits.distance, 0.0) / config.lamp_range
    light = config.ambient + (1 - config.ambient) * hits.incidence_cos / (1 + near * near)
    seen = (light[:, None] * colours.take(hits.geometry, axis=0, mode="wrap")) ** (1 / 2.2)
    image = np.zeros((lens.height * lens.width, 4), np.uint8)
    image[:, 3] = 255
    noisy = 255 * seen + config.noise * rng.standard_normal(seen.shape, np.float32)
    image[lens.lit, :3] = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return image.reshape(lens.height, lens.width, 4)


class FisheyeCamera(_Camera):
    """
    .. pydrake_system::

        name: FisheyeCamera
        input_ports:
        - geometry_query
        output_ports:
        - fisheye_image
        - image_time

    Simulated fisheye camera for operators, with the equidistant projection. It exposes at t = 0, period, 2 period, ...,
    and each image is delivered `latency` later and held until the next. An image that nobody reads is not made. How
    bright things are: see `render_fisheye`.

    - `geometry_query` (QueryObject): the SceneGraph's `query` port, for the poses of the frames.
    - `fisheye_image` (ImageRgba8U): all 0 before the first delivery.
    - `image_time` (1) [s]: when the image was exposed; NaN before the first delivery.

    Args:
        config: image, light and timing.
        scene: geometry that is seen.
        colours: of its geometries, as from `geometry_colours`.
        parent_frame: SceneGraph frame P that the camera is fixed to.
        X_PC: pose of the camera in P, its frame as in `CameraModel`.
        rigid_frames, own_frames: as for `DepthCamera`; here they are seen like anything else.
        seed: of noise; two runs with one seed are equal.

    Raises:
        ConfigError: a value of `config` is out of its range.
        CameraError: `colours` are not those of the scene.
        PortError: `geometry_query` is not connected.
    """

    def __init__(
        self,
        config: FisheyeCameraConfig,
        *,
        scene: RayScene,
        colours: np.ndarray,
        parent_frame: FrameId,
        X_PC: RigidTransform,
        rigid_frames: Mapping[FrameId, RigidTransform] | None = None,
        own_frames: Collection[FrameId] = (),
        seed: int = 0,
    ):
        check_config(config, where=type(self).__name__)
        shared = CameraConfig(width=config.width, height=config.height, period=config.period, latency=config.latency)
        super().__init__(
            shared,
            scene=scene,
            parent_frame=parent_frame,
            rigid_frames=rigid_frames,
            own_frames=own_frames,
            seed=seed,
        )
        if np.shape(colours) != (len(scene.names) + 1, 3):
            valid = (len(scene.names) + 1, 3)
            raise CameraError("not a colour a geometry", where="FisheyeCamera", value=np.shape(colours), valid=valid)
        self.config, self.lens = config, config.lens()
        self._colours, self._X_PC = np.asarray(colours, np.float32), X_PC
        self.DeclareAbstractOutputPort(
            "fisheye_image",
            lambda: AbstractValue.Make(ImageRgba8U(config.width, config.height)),
            weak_method(self._CalcFisheyeImage),
            {self.state_ticket},
        )
        self.declare_image_time()

    def _CalcFisheyeImage(self, context: Context, output: AbstractValue) -> None:
        image: Any = ImageRgba8U(self.lens.width, self.lens.height)
        exposure = self.shown(context)
        if exposure is None:
            image.mutable_data[:] = 0
        else:
            image.mutable_data[:] = render_fisheye(
                self.lens,
                exposure.X_WP @ self._X_PC,
                self._scene,
                self._colours,
                generator_at(self._seed, exposure.index),
                config=self.config,
                X_WF={**exposure.X_WF, **self._body.rigid_poses(exposure.X_WP)},
            )
        output.set_value(image)
