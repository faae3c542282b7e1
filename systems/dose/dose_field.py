"""What is known about the dose rate: readings, sources, and the field that they make."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from ..errors import InputError
from .source_likelihood import SourceModel, jacobian
from .source_posterior import SourceCells
from .voxel_shadow import VoxelShadow

# Points are rated in pieces, so that memory stays small.
_POINTS_AT_ONCE = 20_000


@dataclass(frozen=True, eq=False)
class DoseReadings:
    """What was counted where. Read-only arrays.

    Attributes:
        time: (N,) middle of the reading [s].
        counts: (N,) int.
        live_time: (N,) [s].
        p_MG: (N, 3) where the counter was [m].
    """

    time: np.ndarray = field(default_factory=lambda: np.zeros(0))
    counts: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    live_time: np.ndarray = field(default_factory=lambda: np.zeros(0))
    p_MG: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        if not len(self.time) == len(self.counts) == len(self.live_time) == len(self.p_MG):
            lengths = [len(self.time), len(self.counts), len(self.live_time), len(self.p_MG)]
            raise InputError("arrays differ in length", where="dose readings", value=lengths)
        for array in (self.time, self.counts, self.live_time, self.p_MG):
            array.setflags(write=False)

    def __deepcopy__(self, memo: dict) -> "DoseReadings":
        return self

    def usable(self) -> np.ndarray:
        """Readings with a live time, a count that is not negative and a finite place, (N,) bool."""
        fine = np.isfinite(self.p_MG).all(axis=1) & np.isfinite(self.live_time) & np.isfinite(self.counts)
        return fine & (self.live_time > 0) & (self.counts >= 0)


@dataclass(frozen=True, eq=False)
class SourceEstimate:
    """A source that the counts ask for.

    Attributes:
        p_M: most likely position (3) [m].
        covariance: of the position (3, 3) [m²], within the most likely place.
        activity_mbq: activity, were it Cs-137 and not shielded by its own body [MBq]. activity_sigma: its deviation.
        dose_rate_1m: at 1 m, background not included [uSv/h].
        probability: that it is at this place and not at one of the `alternatives`.
        alternatives: other places, as position (3) [m], dose rate at 1 m [uSv/h], probability.
        cells: the posterior of its position.
    """

    p_M: np.ndarray
    covariance: np.ndarray
    activity_mbq: float
    activity_sigma: float
    dose_rate_1m: float
    probability: float
    alternatives: tuple[tuple[np.ndarray, float, float], ...]
    cells: SourceCells

    @property
    def horizontal_sigma(self) -> float:
        """Largest standard deviation in plan [m]."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))


@dataclass(frozen=True)
class DoseHealth:
    """How far a dose field can be trusted.

    Attributes:
        state: "good", "few readings", "ambiguous" (a source can be elsewhere), "uncertain" (its place is vague) or
            "poor fit" (the counts scatter more than the model allows; walls or sources are missing in it).
        reason: in words; "" when good.
        readings: used. skipped: without live time or pose.
        dispersion: Pearson's χ² per degree of freedom, 1 for a perfect model.
    """

    state: str
    reason: str
    readings: int
    skipped: int
    dispersion: float

    def __deepcopy__(self, memo: dict) -> "DoseHealth":
        return self


@dataclass(frozen=True, eq=False)
class DoseField:
    """Dose rate everywhere, background and sources, with its uncertainty. Read-only.

    Attributes:
        background: [uSv/h]. background_sigma: its standard deviation.
        sources: by falling strength.
        health: how far to trust it.
    """

    background: float
    background_sigma: float
    sources: tuple[SourceEstimate, ...]
    health: DoseHealth
    _model: SourceModel
    _covariance: np.ndarray
    _shadow: VoxelShadow | None
    _measured: np.ndarray
    _measured_distance: float

    def __deepcopy__(self, memo: dict) -> "DoseField":
        return self

    def rate(self, p_MP: np.ndarray) -> np.ndarray:
        """Dose rate at points (N, 3) [m], background included, (N,) [uSv/h]."""
        return self.rate_and_sigma(p_MP)[0]

    def sigma(self, p_MP: np.ndarray) -> np.ndarray:
        """Standard deviation of `rate`, (N,) [uSv/h]: of the fit to first order, and of other places of the sources."""
        return self.rate_and_sigma(p_MP)[1]

    def measured_near(self, p_MP: np.ndarray) -> np.ndarray:
        """Whether points (N, 3) are near a reading, (N,) bool."""
        p_MP = np.asarray(p_MP, float).reshape(-1, 3)
        if not len(self._measured) or not len(p_MP):
            return np.zeros(len(p_MP), bool)
        finite = np.isfinite(p_MP).all(axis=1)
        distance = cKDTree(self._measured).query(np.where(finite[:, None], p_MP, 0.0))[0]
        return (distance <= self._measured_distance) & finite

    def rate_and_sigma(self, p_MP: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both at once, in half the time."""
        p_MP = np.asarray(p_MP, float).reshape(-1, 3)
        rate, variance = np.zeros(len(p_MP)), np.zeros(len(p_MP))
        for first in range(0, len(p_MP), _POINTS_AT_ONCE):
            some = slice(first, first + _POINTS_AT_ONCE)
            mean, slope = jacobian(self._model, p_MP[some], self._transmission(self._model.p_MQ, p_MP[some]))
            rate[some] = mean
            variance[some] = np.einsum("ni,ij,nj->n", slope, self._covariance, slope)
            for i, source in enumerate(self.sources):
                for place, strength, probability in source.alternatives:
                    elsewhere = SourceModel(0.0, place[None], np.array([strength]))
                    there = jacobian(elsewhere, p_MP[some], self._transmission(place[None], p_MP[some]))[1][:, 1]
                    variance[some] += probability * (there - slope[:, 1 + 4 * i]) ** 2
        return rate, np.sqrt(variance)

    def _transmission(self, p_MQ: np.ndarray, p_MP: np.ndarray) -> np.ndarray:
        if self._shadow is None or not len(p_MQ):
            return np.ones((len(p_MQ), len(p_MP)))
        # One source to many points: the cheap way round is many lines with one end each.
        return self._shadow.transmission(p_MP, p_MQ)[0].T
