"""A route: a path with what an operator wants to know before choosing it (S0-i)."""

from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError
from ..tracking import Path


@dataclass(frozen=True, eq=False, kw_only=True)
class Route(Path):
    """A path in M to be chosen and driven; read-only. Without points it is no route.

    Attributes:
        xy: (K, 2) [m]. z: (K,) height of the ground [m], NaN where it is not known.
        time_s: to turn to it and drive along it [s].
        clearance_m: least distance to a cell that cannot be entered, beyond what the grid keeps already [m].
        dose: on the way, dose rate times time; µSv for a map in µSv/h.
        steepest_rad: largest slope of the ground along the route [rad]. tilt_rad: largest slope across it [rad].
        confidence: share of the ground around that was seen, times the probability that no motion in a narrow place
            goes wrong, [0, 1].
        cost: length weighted by the cost of the cells [m].
        signature: of `Islands`: how often each island's ray is crossed.
        sides: in words, the islands of hazards that are passed, such as "left of water"; numbered when there are more.
    """

    z: np.ndarray = field(default_factory=lambda: np.zeros(0))
    time_s: float = 0.0
    clearance_m: float = 0.0
    dose: float = 0.0
    steepest_rad: float = 0.0
    tilt_rad: float = 0.0
    confidence: float = 0.0
    cost: float = 0.0
    signature: tuple[int, ...] = ()
    sides: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        z = np.array(self.z, float)
        if z.shape != (len(self.xy),):
            raise InputError(
                "not one height a point", where="Route", key="z", value=z.shape, valid=f"({len(self.xy)},)"
            )
        z.flags.writeable = False
        object.__setattr__(self, "z", z)

    @property
    def label(self) -> str:
        """A line for the operator, such as "6.2 m · 25 s · 0.4 µSv · sure 97 % · left of water"."""
        parts = [f"{self.length_m:.1f} m", f"{self.time_s:.0f} s"]
        if self.dose > 0:
            parts.append(f"{self.dose:.2g} µSv")
        if self.steepest_rad > np.deg2rad(5):
            parts.append(f"{np.rad2deg(self.steepest_rad):.0f}° steep")
        parts.append(f"sure {100 * self.confidence:.0f} %")
        return " · ".join([*parts, *self.sides])
