"""What sensors need to know about a surface, found by the name of its geometry."""

import dataclasses
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from ..config import check_config, quantity
from ..errors import ConfigError


def name_matches(name: str, pattern: str) -> bool:
    """Whether a geometry's name, or its last part after "::", matches a pattern of `fnmatch` (`*`, `?`, `[abc]`).

    Names are scoped by model, for example `basement::puddle_1`. Case matters.
    """
    return fnmatchcase(name, pattern) or fnmatchcase(name.rpartition("::")[2], pattern)


@dataclass(kw_only=True)
class Surface:
    """Optical, thermal and radiological properties of one surface.

    The defaults are those of dull grey concrete at room temperature. Rough values of others, at 903 nm and 1450 nm:
    white wall 0.8 and 0.7, wood 0.5 and 0.5, black rubber 0.05 and 0.05, still water 0.02 and 0.02 with 0.98 specular.
    """

    # Class of the surface, such as floor, wall, water, heat, metal.
    label: str = "other"
    # Share of the light of a LiDAR (903 nm) that comes back, mirrored or scattered.
    lidar_reflectivity: float = quantity(0.4, low=0.0, high=1.0)
    # Share of near-infrared light (1450 nm, where water absorbs) that comes back.
    nir_reflectance: float = quantity(0.4, low=0.0, high=1.0)
    # Share of the light that comes back which is mirrored: it returns to the LiDAR only near normal incidence.
    specular: float = quantity(0.0, low=0.0, high=1.0)
    # What a thermal camera sees.
    temperature: float = quantity(20.0, unit="°C", low=-273.15)
    # Emissivity in the long-wave infrared; most non-metals are above 0.9.
    emissivity: float = quantity(0.95, low=0.0, high=1.0)
    # Activity of a radioactive source behind this surface, of all of it together.
    activity: float = quantity(0.0, unit="MBq", low=0.0)
    # Linear attenuation of gamma rays (662 keV) in the solid; concrete 17.8, steel 57, water 8.6, wood 5 per metre.
    attenuation: float = quantity(17.8, unit="1/m", low=0.0)


@dataclass(kw_only=True)
class SurfaceTable:
    """Surfaces by the name of the geometry. Treat it as immutable: whoever was built from it does not follow changes.

    The first pattern that matches a geometry's name wins (see `name_matches`), so put the specific ones first. A
    geometry that matches none has the `default` surface.

    Raises:
        ConfigError: a pattern is empty, an entry is not a `Surface`, or a property is out of its range.
    """

    # Surface of every geometry whose name matches the pattern; the first match counts.
    by_pattern: dict[str, Surface] = dataclasses.field(default_factory=dict)
    # Surface of everything else.
    default: Surface = dataclasses.field(default_factory=Surface)

    def __post_init__(self) -> None:
        entries = {f"by_pattern.{pattern}": surface for pattern, surface in self.by_pattern.items()}
        for key, surface in (entries | {"default": self.default}).items():
            if key == "by_pattern.":
                raise ConfigError("empty pattern", where="surfaces", key=key, valid="a pattern such as *floor*")
            if not isinstance(surface, Surface):
                raise ConfigError("not a Surface", where="surfaces", key=key, value=surface, valid="Surface")
        check_config(self, where="surfaces")

    def lookup(self, name: str) -> Surface:
        """Surface of the geometry called `name`."""
        for pattern, surface in self.by_pattern.items():
            if name_matches(name, pattern):
                return surface
        return self.default


@dataclass(frozen=True, eq=False)
class SurfaceArrays:
    """Properties of G geometries as arrays of G + 1 entries, to be indexed by an array of geometry indices.

    The entry after the last is for index -1, a ray that hits nothing: all are 0 there but temperature, which is NaN,
    and `label_id`, which is -1.

    Attributes:
        lidar_reflectivity, nir_reflectance, specular, temperature, emissivity, activity, attenuation: float32, as in
            `Surface`.
        label_id: int32, index into `labels`.
        labels: the different labels, sorted.
    """

    lidar_reflectivity: np.ndarray
    nir_reflectance: np.ndarray
    specular: np.ndarray
    temperature: np.ndarray
    emissivity: np.ndarray
    activity: np.ndarray
    attenuation: np.ndarray
    label_id: np.ndarray
    labels: tuple[str, ...]


def surface_arrays(surfaces: list[Surface]) -> SurfaceArrays:
    """Properties of `surfaces`, one a geometry, as arrays."""

    def column(name: str, nothing: float = 0.0) -> np.ndarray:
        return np.array([getattr(surface, name) for surface in surfaces] + [nothing], np.float32)

    labels = tuple(sorted({surface.label for surface in surfaces}))
    return SurfaceArrays(
        lidar_reflectivity=column("lidar_reflectivity"),
        nir_reflectance=column("nir_reflectance"),
        specular=column("specular"),
        temperature=column("temperature", np.nan),
        emissivity=column("emissivity"),
        activity=column("activity"),
        attenuation=column("attenuation"),
        label_id=np.array([labels.index(surface.label) for surface in surfaces] + [-1], np.int32),
        labels=labels,
    )
