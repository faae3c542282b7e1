"""Fuzzy inference of Mamdani's kind, min-max-centroid, compiled for batches (row S3-b, Eq. 7)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from ..config import quantity
from ..errors import ConfigError
from .mamdani_kernels import infer_all

SIZES = ("SMALL", "MEDIUM", "LARGE")
GRADES = ("POOR", "LOW", "MODERATE", "HIGH")
INPUTS = ("pitch_slope", "roll_slope", "roughness")


@dataclass(kw_only=True)
class SizeTerms:
    """SMALL, MEDIUM and LARGE of one feature: trapezoids a ≤ b ≤ c ≤ d, 0 up to a, 1 from b to c, 0 from d on.

    Below a of SMALL and above d of LARGE the membership stays that at the end: there is nothing smaller or larger.
    """

    small: list[float] = quantity([0.0, 0.0, 0.1, 0.2], unit="", low=0)
    medium: list[float] = quantity([0.1, 0.2, 0.3, 0.4], unit="", low=0)
    large: list[float] = quantity([0.3, 0.4, 0.4, 0.4], unit="", low=0)

    def table(self) -> np.ndarray:
        """Corners of the three, (3, 4)."""
        return np.array([self.small, self.medium, self.large], float)


@dataclass(kw_only=True)
class GradeTerms:
    """POOR, LOW, MODERATE and HIGH traversability: trapezoids as in `SizeTerms`.

    The paper prints no numbers (its Fig. 7). With these, flat ground has the risk 1/τ = 17, which is what its Fig. 12
    implies: at r_limit 85 a gain of 0.8 instead of 1.0 (Eq. 9).
    """

    poor: list[float] = quantity([0.0, 0.0, 0.0, 0.02206], unit="", low=0)
    low: list[float] = quantity([0.0, 0.02206, 0.02206, 0.04412], unit="", low=0)
    moderate: list[float] = quantity([0.02206, 0.04412, 0.04412, 0.06618], unit="", low=0)
    high: list[float] = quantity([0.04412, 0.06618, 0.06618, 0.06618], unit="", low=0)

    def table(self) -> np.ndarray:
        """Corners of the four, (4, 4)."""
        return np.array([self.poor, self.low, self.moderate, self.high], float)


def default_rules() -> list[list[str]]:
    """The 27 rules: any LARGE is POOR, because a robot stops at whatever it cannot do; else by how many are MEDIUM."""
    rules = []
    for sizes in product(SIZES, repeat=3):
        grade = "POOR" if "LARGE" in sizes else ("HIGH", "MODERATE", "LOW", "LOW")[sizes.count("MEDIUM")]
        rules.append([*sizes, grade])
    return rules


@dataclass(kw_only=True)
class FuzzyConfig:
    """Terms of the features, of traversability, and the rules between them."""

    # [rad]
    pitch_slope: SizeTerms = field(default_factory=SizeTerms)
    roll_slope: SizeTerms = field(default_factory=SizeTerms)
    # [m²]
    roughness: SizeTerms = field(default_factory=SizeTerms)
    # Pitch slope, roll slope, roughness, and the traversability that follows; one row for each of the 27 combinations.
    rules: list[list[str]] = field(default_factory=default_rules)
    traversability: GradeTerms = field(default_factory=GradeTerms)
    # Points at which the centroid is computed.
    samples: int = quantity(101, unit="points", low=11, high=10001)


@dataclass(frozen=True, eq=False)
class Inference:
    """What was inferred for N sets of features.

    Attributes:
        traversability: τ, (N,), of Eq. 7.
        activations: how far each grade is met, (N, 4), in the order of `GRADES`.
    """

    traversability: np.ndarray
    activations: np.ndarray

    @property
    def risk(self) -> np.ndarray:
        """r = 1/τ, (N,)."""
        return 1.0 / self.traversability


class Mamdani:
    """A table of rules, compiled. Read-only.

    Raises:
        ConfigError: a term is not a trapezoid, or the table of rules has a hole, see `check_fuzzy`.
    """

    def __init__(self, config: FuzzyConfig, *, where: object = "fuzzy"):
        check_fuzzy(config, where=where)
        self.config = config
        self._sizes = np.stack([getattr(config, name).table() for name in INPUTS])
        self._sizes[:, 0, :2], self._sizes[:, 2, 2:] = -1e300, 1e300
        self._rules = np.zeros((3, 3, 3), np.int64)
        for *sizes, grade in config.rules:
            self._rules[tuple(SIZES.index(size) for size in sizes)] = GRADES.index(grade)
        grades = config.traversability.table()
        self._universe = np.linspace(grades.min(), grades.max(), config.samples)
        self._grades = np.stack([trapezoid(self._universe, corners) for corners in grades])

    def __deepcopy__(self, memo: dict) -> "Mamdani":
        return self

    @cached_property
    def lowest(self) -> float:
        """τ where POOR alone holds: also that of ground of which nothing is known."""
        poor = self._grades[0]
        return float(np.trapezoid(self._universe * poor, self._universe) / np.trapezoid(poor, self._universe))

    def infer(self, features: np.ndarray) -> Inference:
        """Infers τ of pitch slope [rad], roll slope [rad] and roughness [m²], (N, 3).

        Min for AND, min for the implication, max over the rules, centroid. Where a feature is not finite, τ is
        `lowest`. The centroid of a clipped term is not that of the whole one: where nearly all is POOR, τ can rise by
        up to a fifth while a feature grows.
        """
        features = np.ascontiguousarray(features, float).reshape(-1, 3)
        tau, activations = infer_all(features, self._sizes, self._rules, self._grades, self._universe, self.lowest)
        return Inference(tau, activations)


def trapezoid(x: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Membership of x in a trapezoid of corners a ≤ b ≤ c ≤ d; sides may be upright."""
    a, b, c, d = corners
    rise = np.where(x >= b, 1.0, (x - a) / (b - a) if b > a else 0.0)
    fall = np.where(x <= c, 1.0, (d - x) / (d - c) if d > c else 0.0)
    return np.clip(np.minimum(rise, fall), 0.0, 1.0)


def check_fuzzy(config: FuzzyConfig, *, where: object = "", key: str = "") -> None:
    """Raises `ConfigError` for a term that is no trapezoid, terms that leave a gap, and rules that are not 27."""
    prefix = f"{key}." if key else ""
    for name in INPUTS:
        terms = getattr(config, name)
        _check_terms(terms, ("small", "medium", "large"), where, prefix + name)
    _check_terms(config.traversability, ("poor", "low", "moderate", "high"), where, prefix + "traversability")
    found: dict[tuple[str, ...], str] = {}
    for i, rule in enumerate(config.rules):
        row = f"{prefix}rules[{i}]"
        if len(rule) != 4 or any(size not in SIZES for size in rule[:3]) or rule[3] not in GRADES:
            valid = f"three of {', '.join(SIZES)}, then one of {', '.join(GRADES)}"
            raise ConfigError("not a rule", where=where, key=row, value=rule, valid=valid)
        if tuple(rule[:3]) in found:
            raise ConfigError("there is a rule for this already", where=where, key=row, value=rule)
        found[tuple(rule[:3])] = rule[3]
    for sizes in _combinations():
        if sizes not in found:
            raise ConfigError("a rule is missing", where=where, key=f"{prefix}rules", valid=f"one for {list(sizes)}")


def _combinations() -> Iterator[tuple[str, ...]]:
    return product(SIZES, repeat=3)


def _check_terms(terms: object, names: tuple[str, ...], where: object, key: str) -> None:
    corners = []
    for name in names:
        value = getattr(terms, name)
        if len(value) != 4 or any(a > b for a, b in pairwise(value)):
            valid = "four numbers a <= b <= c <= d"
            raise ConfigError("not a trapezoid", where=where, key=f"{key}.{name}", value=value, valid=valid)
        corners.append(value)
    for (_, _, _, end), (start, *_), name in zip(corners[:-1], corners[1:], names[1:], strict=True):
        if start > end:
            valid = f"a first corner of at most {end:g}, where the term before ends"
            raise ConfigError("a gap between terms", where=where, key=f"{key}.{name}", value=start, valid=valid)
    if corners[-1][-1] <= corners[0][0]:
        raise ConfigError("terms without width", where=where, key=key, value=corners[-1][-1])
