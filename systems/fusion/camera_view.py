"""One image of a camera with what is needed to paint points from it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.sensors import ImageGrey8U
from scipy.ndimage import maximum_filter, minimum_filter

from ..config import quantity
from ..errors import CameraError, PortError
from ..sensing.camera_model import CameraModel

# Notes of pan and tilt [rad] with their times [s], oldest first.
Angles = tuple[tuple[float, tuple[float, float]], ...]

# Brightness at which a pixel says no more than that there was too much light.
SATURATED = 255


@dataclass(kw_only=True)
class LampConfig:
    """The near-infrared lamp: a point that lights a cone, fixed to the robot."""

    # [m] Where it is in the base B.
    p_BL: list[float] = quantity([0.2, 0.0, 0.36], unit="m")
    # [-] Axis of its cone in B, of any length; [rad] angle between the axis and the edge of the cone.
    axis_B: list[float] = quantity([1.0, 0.0, 0.0])
    half_angle: float = quantity(0.87, unit="rad", above=0, high=float(np.pi))
    # [-] Radiance E0 of a white surface, square on, at 1 m: 1 by definition of the camera's exposure.
    intensity: float = quantity(1.0, above=0)
    # [-] Radiance of a white surface in the light that is there without the lamp; a floor at 5 m gets 0.003 from it.
    ambient: float = quantity(0.001, low=0)


@dataclass(frozen=True, eq=False)
class CameraView:
    """One image and where it was taken. Read-only: it is shared, not copied.

    Attributes:
        time: of the exposure [s].
        X_BC: pose of the camera C in the base B at `time`, with the pan-tilt where it was.
        X_OB: pose of the base in the odometry frame O at `time`.
        values: (H, W) float32, NaN where a pixel says nothing.
        known: whether any pixel says something.
    """

    time: float
    X_BC: RigidTransform
    X_OB: RigidTransform
    values: np.ndarray
    known: bool = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "known", bool(np.isfinite(self.values).any()))

    def __deepcopy__(self, memo: dict) -> "CameraView":
        return self


def image_values(image: ImageGrey8U | np.ndarray, camera: CameraModel, where: str) -> np.ndarray:
    """The pixels of an image port's value, (H, W); grey images as uint8, arrays as they are.

    Raises:
        PortError: it is neither an `ImageGrey8U` nor an array of numbers.
        CameraError: its height and width are not those of the camera.
    """
    if not isinstance(image, (ImageGrey8U, np.ndarray)) or (isinstance(image, np.ndarray) and image.dtype.kind == "O"):
        raise PortError("wrong type", where=where, value=type(image).__name__, valid="ImageGrey8U or an array (H, W)")
    data: Any = image if isinstance(image, np.ndarray) else image.data
    pixels: np.ndarray = data if isinstance(image, np.ndarray) else data[:, :, 0]
    if pixels.ndim != 2:
        raise CameraError("not an image of one channel", where=where, value=pixels.shape, valid=camera.shape)
    camera.check_image(pixels, where)
    return pixels


def radiance(pixels: np.ndarray, exposure: float, where: str = "exposure") -> np.ndarray:
    """Radiance that a camera saw, L = pixel / 255 / exposure, float32; NaN where a pixel is saturated.

    Args:
        pixels: (H, W) uint8.
        exposure: gain that the camera chose: its pixels are exposure · L · 255, rounded and cut at 255.

    Raises:
        CameraError: the exposure is not a positive number.
    """
    if not (np.isfinite(exposure) and exposure > 0):
        raise CameraError("no exposure", where=where, value=float(exposure), valid="a finite number > 0")
    scale = np.float32(1 / (255 * exposure))
    return np.where(pixels >= SATURATED, np.float32(np.nan), pixels * scale)


def plain_values(pixels: np.ndarray, max_step: float | None = None) -> np.ndarray:
    """An image whose pixels are what points get, float32; NaN where they are not finite.

    Args:
        max_step: pixels that differ by more than this from one of their eight neighbours, in the unit of the image, are
            NaN, too: they may show two surfaces, and so neither.
    """
    values = np.array(pixels, np.float32)
    values[~np.isfinite(values)] = np.nan
    if max_step is not None:
        highest = maximum_filter(np.nan_to_num(values, nan=-np.inf), 3, mode="nearest")
        lowest = minimum_filter(np.nan_to_num(values, nan=np.inf), 3, mode="nearest")
        values[np.maximum(highest - values, values - lowest) > max_step] = np.nan
    return values


def angles_at(notes: Angles, time: float) -> tuple[np.ndarray, float]:
    """Pan and tilt [rad] at `time` [s] between notes, and how fast they turned then [rad/s].

    The faster of the two intervals that meet at a note counts. Before the first and after the last note they are held.
    """
    times = np.array([noted for noted, _ in notes])
    angles = np.array([pair for _, pair in notes])
    now = np.array([np.interp(time, times, angles[:, axis]) for axis in range(2)])
    if len(notes) < 2:
        return now, 0.0
    rates = np.abs(np.diff(angles, axis=0)).max(axis=1) / np.diff(times)
    first = min(max(int(np.searchsorted(times, time - 1e-6)) - 1, 0), len(rates) - 1)
    last = min(max(int(np.searchsorted(times, time + 1e-6, side="right")) - 1, 0), len(rates) - 1)
    return now, float(rates[first : last + 1].max())
