"""Images of a near-infrared camera with a lamp, on SceneGraph geometry."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import FrameId
from pydrake.math import RigidTransform

from ..config import quantity
from .camera import CameraConfig, cast_pixels
from .camera_model import CameraModel
from .ray_scene import RayScene

# What hides a point from the lamp must be nearer than the point by this [m] and this share of the distance.
_SHADOW_MARGIN, _SHADOW_SHARE = 1e-3, 1e-3


@dataclass(kw_only=True)
class NirCameraConfig(CameraConfig):
    """An InGaAs camera (0.9 to 1.7 µm) with a lens of 8° × 8° and a lamp. Values are assumed where nothing is said."""

    width: int = quantity(128, unit="px", low=1)
    height: int = quantity(128, unit="px", low=1)
    fov_x_deg: float = quantity(8.0, unit="deg", above=0.0, high=170.0)
    fov_y_deg: float = quantity(8.0, unit="deg", above=0.0, high=170.0)
    # Lens distortion: almost a pixel in the corners.
    distortion: list[float] = quantity([-1.0, 0.0, 5e-4, -3e-4, 0.0])
    latency: float = quantity(0.05, unit="s", low=0.0)
    # Brightness of a pixel, as a share of the full scale, per unit of radiance; null lets the camera choose.
    exposure: float | None = quantity(None, above=0.0)
    # The camera chooses an exposure that brings this percentile of the pixels to this share of the full scale.
    auto_percentile: float = quantity(98.0, low=0.0, high=100.0)
    auto_level: float = quantity(0.8, above=0.0, high=1.0)
    # Lowest and highest exposure that it chooses.
    min_exposure: float = quantity(0.02, above=0.0)
    max_exposure: float = quantity(500.0, above=0.0)
    # Electrons of a pixel at full scale; their number scatters by its square root.
    full_well: float = quantity(1e5, unit="electrons", above=0.0)
    # Standard deviation of a reading.
    read_noise: float = quantity(150.0, unit="electrons", low=0.0)
    # Light that falls on every surface from all around, against that of the lamp at 1 m.
    ambient: float = quantity(0.001, low=0.0)
    # Angle from the lamp's axis up to which it shines evenly, and over how much more it fades to nothing.
    lamp_half_angle_deg: float = quantity(50.0, unit="deg", above=0.0, high=90.0)
    lamp_fade_deg: float = quantity(5.0, unit="deg", above=0.0)


def nir_radiance(
    model: CameraModel,
    X_WC: RigidTransform,
    scene: RayScene,
    *,
    config: NirCameraConfig,
    p_WL: np.ndarray,
    axis_W: np.ndarray,
    X_WF: Mapping[FrameId, RigidTransform] | None = None,
) -> np.ndarray:
    """Radiance of what every pixel sees, (H, W) float32.

    With the scattered share ρ of the light, i.e. reflectance less its mirrored part, distance r to the lamp, angle θ
    between the normal and the way to the lamp, and angle α of this way to the lamp's axis, it is
    L = ρ (a + c(α) cos θ / r²): Lambert's law and the inverse square. White paper square on at 1 m has 1. The beam c is
    1 up to `lamp_half_angle_deg` and fades evenly to 0 over `lamp_fade_deg`; where something is between lamp and
    surface, or the lamp shines on the other side, c is 0. What is left then is the light a of the surroundings. What a
    mirror shows, also of the lamp, is not modelled.

    Args:
        model, X_WC: the camera and its pose.
        p_WL, axis_W: position of the lamp (3) [m] and unit vector of the axis of its beam (3).
        X_WF: poses of the moving frames, see `RayScene.cast`.
    """
    d_W, hits = cast_pixels(model, X_WC, scene, X_WF)
    diffuse = hits.lookup("nir_reflectance") * (1 - hits.lookup("specular"))
    light = np.full(len(d_W), config.ambient, np.float32)

    seen = np.flatnonzero(hits.geometry >= 0)
    d, n = d_W.take(seen, axis=0), hits.normal_W.take(seen, axis=0)
    to_point = d * hits.distance[seen, None] + (X_WC.translation() - p_WL).astype(np.float32)
    r = np.sqrt(np.einsum("ij,ij->i", to_point, to_point))
    with np.errstate(divide="ignore", invalid="ignore"):
        from_lamp = to_point / r[:, None]
        alpha = np.arccos(np.clip(from_lamp @ np.asarray(axis_W, np.float32), -1, 1))
        # The normal may point to either side: camera and lamp must be on the same one.
        cosine = np.einsum("ij,ij->i", from_lamp, n) * np.sign(np.einsum("ij,ij->i", d, n))
        half, fade = np.deg2rad([config.lamp_half_angle_deg, config.lamp_fade_deg]).astype(np.float32)
        beam = np.clip((half + fade - alpha) / fade, 0, 1)
        lit = np.flatnonzero((cosine > 0) & (beam > 0))
    between = scene.cast(p_WL, from_lamp[lit], X_WF).distance
    lit = lit[between >= r[lit] * (1 - _SHADOW_SHARE) - _SHADOW_MARGIN]
    light[seen[lit]] += beam[lit] * cosine[lit] / np.square(r[lit])
    return (diffuse * light).reshape(model.shape)


def auto_exposure(radiance: np.ndarray, config: NirCameraConfig) -> float:
    """The exposure that `config` fixes, or that which suits an image of `radiance`.

    The camera is taken to have adapted to the scene before the image; real ones need some images for it.
    """
    if config.exposure is not None:
        return config.exposure
    bright = float(np.percentile(radiance, config.auto_percentile))
    wanted = config.auto_level / bright if bright > 0 else np.inf
    return float(np.clip(wanted, config.min_exposure, config.max_exposure))


def grey_values(radiance: np.ndarray, exposure: float, rng: np.random.Generator, config: NirCameraConfig) -> np.ndarray:
    """Image of `radiance` as uint8 of the same shape: exposure × radiance × 255, noisy, rounded and cut to 0 … 255.

    A pixel with the share f of the full scale holds f N electrons, N = `full_well`. Its noise has the variance
    f/N + (read noise / N)².

    Args:
        rng: one number is drawn for every pixel.
    """
    share = np.float32(exposure) * np.asarray(radiance, np.float32)
    variance = share / np.float32(config.full_well) + np.float32((config.read_noise / config.full_well) ** 2)
    share += np.sqrt(variance) * rng.standard_normal(share.shape, np.float32)
    return np.rint(np.clip(share, 0, 1) * 255).astype(np.uint8)


def render_nir(
    model: CameraModel,
    X_WC: RigidTransform,
    scene: RayScene,
    rng: np.random.Generator,
    *,
    config: NirCameraConfig,
    p_WL: np.ndarray,
    axis_W: np.ndarray,
    X_WF: Mapping[FrameId, RigidTransform] | None = None,
) -> tuple[np.ndarray, float]:
    """Image (H, W) uint8 and its exposure; value / 255 / exposure is the radiance. Arguments as for `nir_radiance`."""
    radiance = nir_radiance(model, X_WC, scene, config=config, p_WL=p_WL, axis_W=axis_W, X_WF=X_WF)
    exposure = auto_exposure(radiance, config)
    return grey_values(radiance, exposure, rng, config), exposure
