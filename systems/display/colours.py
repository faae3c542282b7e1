"""Colours of numbers and objects: the scales of a map's attributes, what their legends say, how Meshcat takes them."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat, Rgba

from ..errors import ConfigError

# Red, green and blue on the screen at equal steps from the low end to the high end.
_TABLES = {
    "grey": ((20, 20, 20), (250, 250, 250)),
    # Nine samples each of matplotlib's maps of these names.
    "viridis": (
        *((68, 1, 84), (71, 45, 123), (59, 82, 139), (44, 114, 142), (33, 145, 140)),
        *((40, 174, 128), (94, 201, 98), (173, 220, 48), (253, 231, 37)),
    ),
    "inferno": (
        *((0, 0, 4), (33, 12, 74), (87, 16, 110), (138, 34, 106), (188, 55, 84)),
        *((228, 90, 49), (249, 142, 9), (249, 203, 53), (252, 255, 164)),
    ),
}
# Colour of what is not known.
UNKNOWN = (150, 150, 150)


def _from_table(table: tuple[tuple[int, int, int], ...]) -> Callable[[np.ndarray], np.ndarray]:
    rgb, at = np.array(table).T / 255.0, np.linspace(0.0, 1.0, len(table))
    return lambda t: np.stack([np.interp(t, at, channel) for channel in rgb])


def _height(t: np.ndarray) -> np.ndarray:
    return np.stack([np.clip(2 * t - 0.6, 0.1, 1), 0.35 + 0.5 * np.sin(np.pi * t), np.clip(1 - 1.6 * t, 0.1, 1)])


# From t in [0, 1], (N,), to red, green and blue in [0, 1], (3, N).
PALETTES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "height": _height,
    **{name: _from_table(table) for name, table in _TABLES.items()},
}


@dataclass(frozen=True, kw_only=True)
class ColourScale:
    """Colours between two values of a quantity; values outside have the colour of the nearer end.

    Attributes:
        title: the quantity, as people read it.
        unit: its unit, "" for a pure number.
        low, high: values at the ends; above 0 when `log`.
        palette: one of `PALETTES`.
        log: equal ratios, not equal differences, are equally far apart.

    Raises:
        ConfigError: the ends are not finite and in order, or the palette does not exist.
    """

    title: str
    unit: str = ""
    low: float
    high: float
    palette: str
    log: bool = False

    def __post_init__(self) -> None:
        if self.palette not in PALETTES:
            raise ConfigError("unknown palette", key="palette", value=self.palette, valid=list(PALETTES))
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            valid = "low < high, both finite"
            raise ConfigError("not a range", where=self.title, value=(self.low, self.high), valid=valid)
        if self.log and self.low <= 0:
            raise ConfigError(
                "a logarithm needs positive ends", where=self.title, key="low", value=self.low, valid="> 0"
            )

    def fraction(self, values: np.ndarray) -> np.ndarray:
        """Where values lie between the ends, in [0, 1], as float64 of the same shape; NaN stays NaN."""
        values = np.asarray(values, float)
        if not self.log:
            return np.clip((values - self.low) / (self.high - self.low), 0.0, 1.0)
        return np.log(np.clip(values, self.low, self.high) / self.low) / math.log(self.high / self.low)

    def colours(self, values: np.ndarray) -> np.ndarray:
        """Colours of values, (3, N) uint8, `UNKNOWN` for NaN. values: (N,) or (N, 1)."""
        t = self.fraction(values).reshape(-1)
        unknown = np.isnan(t)
        rgb = _bytes(PALETTES[self.palette](np.where(unknown, 0.0, t)))
        rgb[:, unknown] = np.array(UNKNOWN, np.uint8)[:, None]
        return rgb

    def stops(self, count: int = 13) -> list[str]:
        """Colours at equal steps from the low end to the high end, as "#rrggbb"."""
        rgb = _bytes(PALETTES[self.palette](np.linspace(0.0, 1.0, count)))
        return ["#{:02x}{:02x}{:02x}".format(*colour) for colour in rgb.T]

    def ticks(self, most: int = 6) -> list[tuple[float, str]]:
        """Round values for a colour bar: their places in [0, 1] and their texts, in order, at most `most` (from 3)."""
        values = _log_ticks(self.low, self.high, most) if self.log else _even_ticks(self.low, self.high, most)
        return [(float(self.fraction(np.array(value))), f"{value:g}") for value in values]


HEIGHT = ColourScale(title="height over the floor", unit="m", low=0.0, high=2.0, palette="height")
INTENSITY = ColourScale(title="LiDAR intensity", low=0.0, high=1.0, palette="viridis")
NIR = ColourScale(title="reflectance at 1450 nm", low=0.0, high=1.0, palette="grey")
TEMPERATURE = ColourScale(title="temperature", unit="°C", low=10.0, high=90.0, palette="inferno")
DOSE_RATE = ColourScale(title="dose rate", unit="µSv/h", low=0.1, high=100.0, palette="viridis", log=True)


def height_colours(z: np.ndarray) -> np.ndarray:
    """Colours from blue at the floor over green to red at 2 m. z: (N,) [m]; returns (3, N) uint8."""
    return HEIGHT.colours(z)


def for_meshcat(colours: np.ndarray) -> np.ndarray:
    """Colours of points to give to Meshcat, so that they appear on the screen as `colours`, (3, N) uint8 both.

    Meshcat takes the colours of a cloud for amounts of light and brightens them when it draws; undone here, or they
    would not be those of the legend. What else it does, tone mapping, makes them a little paler; the panel of a
    recording switches that off for points.
    """
    return _bytes(_amounts_of_light(np.asarray(colours) / 255.0))


def set_colour(meshcat: Meshcat, path: str, colour: Rgba, time: float) -> None:
    """Gives an object a colour now, and in a recording from a time on [s]; there its opacity stays.

    Meshcat takes a colour that is changed for amounts of light, unlike the one that an object is made with. What is
    shown now changes by the property `color`, which a recording does not know: that needs the one of the material.
    """
    rgb = _amounts_of_light(np.array([colour.r(), colour.g(), colour.b()])).tolist()
    meshcat.SetProperty(path, "color", [*rgb, colour.a()])
    recording = meshcat.get_mutable_recording()
    recording.SetProperty(recording.frame(time), f"{path}/<object>", "material.color", rgb)


def _amounts_of_light(s: np.ndarray) -> np.ndarray:
    """Of colours in [0, 1] as a screen is given them (sRGB, IEC 61966-2-1)."""
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


def _bytes(rgb: np.ndarray) -> np.ndarray:
    return np.rint(255.0 * rgb).astype(np.uint8)


def _even_ticks(low: float, high: float, most: int) -> list[float]:
    rough = (high - low) / (most - 1)
    decade = 10.0 ** math.floor(math.log10(rough))
    # The finest steps that are few enough: a step as long as the range may have no multiple in it.
    for step in (0.5 * decade, decade, 2 * decade, 5 * decade, 10 * decade):
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if last - first < most:
            break
    return [round(i * step, 12) for i in range(first, last + 1)]


def _log_ticks(low: float, high: float, most: int) -> list[float]:
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    every = max(1, math.ceil((last - first + 1) / most))
    decades = [10.0**i for i in range(first, last + 1, every)]
    return decades if len(decades) > 1 else _even_ticks(low, high, most)
