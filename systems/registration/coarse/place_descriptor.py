"""A short vector that is nearly the same wherever in a place, and whichever way round, a scan was taken."""

from dataclasses import dataclass, field

import numpy as np
import scipy.fft
from open3d.t.geometry import PointCloud
from scipy.ndimage import map_coordinates

from ...config import check_config, quantity
from .view import View, ViewConfig


@dataclass(kw_only=True)
class PlaceDescriptorConfig:
    """What of a view goes into its descriptor. Descriptors made with different values do not compare."""

    view: ViewConfig = field(default_factory=ViewConfig)
    # [m] Pixel and edge of the image from above.
    pixel: float = quantity(0.25, unit="m", above=0)
    size: float = quantity(32.0, unit="m", above=1)
    # [1/m] Lowest and highest frequency of the walls' pattern: from the width of a hall to that of a door.
    frequencies: list[float] = quantity([0.05, 1.8], unit="1/m", above=0)
    # Frequencies, and orders of their change with direction, that are kept.
    rings: int = quantity(24, unit="rings", low=1)
    orders: int = quantity(8, unit="orders", low=1)


def describe_place(cloud: PointCloud | View, config: PlaceDescriptorConfig | None = None) -> np.ndarray:
    """Descriptor (D,) float32 of the place where a scan was taken, D = 2 · rings · orders; zero when it has no walls.

    The walls and objects from above make an image, and the way they face a second one with two parts. The amplitude of
    an image's spectrum is the same wherever the image lies (a shift turns only the phases), and turns with the image;
    over one ring of frequencies it is a periodic function of direction, and of that the amplitudes of its Fourier
    series are the same for all yaws. (The transform of Fourier and Mellin; Reddy and Chatterji 1996, without its
    scale.) Descriptors around the sensor itself, as scan context and ring key (Kim and Kim, IROS 2018), change with
    every metre that the robot is elsewhere; this one only by what is newly seen or hidden.
    """
    config = config or PlaceDescriptorConfig()
    check_config(config)
    view = cloud if isinstance(cloud, View) else View(cloud, config.view)
    columns = view.columns
    near = np.linalg.norm(columns.centres, axis=1) < config.size / 2
    width = int(config.size / config.pixel)
    if not near.any():
        return np.zeros(2 * config.rings * config.orders, np.float32)
    x, y = np.floor(columns.centres[near] / config.pixel).astype(int).T % width
    images = np.zeros((3, width, width), np.float32)
    images[0, x, y] = 1.0
    images[1:, x, y] = (columns.normals * columns.flatness[:, None])[near].T
    power = np.square(np.abs(scipy.fft.fft2(images)))
    parts = [_invariant(spectrum, config) for spectrum in (power[0], power[1] + power[2])]
    return np.concatenate(parts).astype(np.float32)


def place_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Euclidean distance of descriptors (..., D); of one against many it is (M,).

    In four simulated buildings the median is 0.9 to 1.0 within 2 m of a place and 1.3 to 1.4 to other places, and the
    two overlap: it ranks candidates, and no threshold on it says that two places are one.
    """
    return np.asarray(np.linalg.norm(np.asarray(a, float) - np.asarray(b, float), axis=-1))


def _invariant(power: np.ndarray, config: PlaceDescriptorConfig) -> np.ndarray:
    """Amplitudes of a power spectrum (n, n) around each ring of frequencies, (rings · orders,)."""
    width = len(power)
    # Without the mean square, a full and a sparse scan of one place would differ by scale. The logarithm keeps
    # the peak of one long wall from outweighing all that stands in the room.
    amplitude = np.log1p(np.sqrt(power / max(float(power.mean()), 1e-12)))
    radius = np.linspace(config.frequencies[0], config.frequencies[1], config.rings) * width * config.pixel
    angle = np.arange(120) * np.pi / 120
    at = [radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)]
    polar = map_coordinates(amplitude, at, order=1, mode="grid-wrap")
    series = np.abs(np.fft.rfft(polar, axis=1))[:, : config.orders] / 120
    series[:, 1:] *= 2
    return np.asarray(series.ravel())
