"""From counts to classes: levels of intensity × near-infrared, heat and dose, and the probabilities of points."""

from dataclasses import dataclass

import numpy as np
from open3d.t.geometry import PointCloud

from .class_counts import EDGES, JOINT_EDGES, RANGE_CENTRES, ClassCounts, bin_of, channels, point_ranges
from .levels import Levels, find_levels
from .trend import RangeTrend, find_trend, without_trend

_INTENSITY, _NIR = ("dark", "usual", "bright"), ("dark", "bright")
# Classes in the order of the columns of `class_probabilities`: LiDAR intensity × near-infrared, then heat and dose.
CLASS_NAMES = (*(f"lidar_{a}_nir_{b}" for a in _INTENSITY for b in _NIR), "heat", "dose")
_SURFACES = len(_INTENSITY) * len(_NIR)
_BIN_CENTRES = np.sqrt(EDGES["intensity"][1:] * EDGES["intensity"][:-1])
# A class is rare below this share of the points, if it has any (S2-a names those with clearly fewer).
_RARE = 0.1
# Hot is as in hazards.HeatConfig: 15 K and 5 robust standard deviations above the median.
_EXCESS, _DEVIATIONS, _MAD_SCALE = 15.0, 5.0, 1.4826


@dataclass(frozen=True, eq=False)
class ClassModel:
    """What the classes are in the scans so far.

    The columns are always those of `CLASS_NAMES`, whatever was found: clouds of one run fit each other. A class that
    was not found has no share and no probability.

    Attributes:
        scans: number of scans that it was fitted to.
        intensity, nir: levels of LiDAR intensity and of near-infrared, where `bright` is not used.
        trends: how LiDAR intensity and near-infrared depend on range; their levels are those of values without it.
        heat, dose: of temperature and of dose rate, where only `bright` is used.
        shares: of every class, (K,), sum 1.
    """

    scans: int
    intensity: Levels
    nir: Levels
    trends: tuple[RangeTrend, RangeTrend]
    heat: Levels
    dose: Levels
    shares: np.ndarray

    def __deepcopy__(self, memo: dict) -> "ClassModel":
        return self

    @property
    def rare(self) -> tuple[str, ...]:
        """Names of the classes that have clearly fewer points than others, but some."""
        return tuple(name for name, share in zip(CLASS_NAMES, self.shares, strict=True) if 1e-4 < share < _RARE)

    @property
    def weak(self) -> tuple[str, ...]:
        """Channels that are there but have no two populations: their labels are soft."""
        levels = {"intensity": self.intensity, "nir": self.nir}
        return tuple(name for name, one in levels.items() if one.weak and not np.isnan(one.dark))


def fit_class_model(counts: ClassCounts) -> ClassModel:
    """The model of the counts so far; without any, one that knows nothing: equal shares, all points unknown."""
    edges = EDGES["intensity"]
    surface = [counts.histograms[name] for name in ("intensity", "nir")]
    trends = [find_trend(histogram, edges) for histogram in surface]
    flat = [without_trend(histogram, edges, trend) for histogram, trend in zip(surface, trends, strict=True)]
    intensity, nir = find_levels(flat[0], edges), find_levels(flat[1], edges, bright=False)
    temperature, rate = (counts.histograms[name].sum(axis=0) for name in ("temperature", "dose_rate"))
    heat = _hot(temperature, EDGES["temperature"])
    dose = find_levels(rate, EDGES["dose_rate"])
    if not np.isnan(dose.dark):
        dose = Levels(-np.inf, np.inf if dose.weak else dose.bright, dose.widths, dose.errors, False)
    marginals = [_level_shares(one, histogram, edges) for one, histogram in zip((intensity, nir), flat, strict=True)]
    table = np.outer(marginals[0], marginals[1][:2])
    if counts.joint.any():
        centres = np.sqrt(JOINT_EDGES[1:] * JOINT_EDGES[:-1])
        table = np.zeros_like(table)
        factors = zip(*(trend.factor(RANGE_CENTRES) for trend in trends), strict=True)
        for joint, (factor_I, factor_N) in zip(counts.joint, factors, strict=True):
            if joint.any():
                rows, columns = intensity.probabilities(centres / factor_I), nir.probabilities(centres / factor_N)
                table += np.nan_to_num(rows).T @ joint @ np.nan_to_num(columns[:, :2])
    table = table / table.sum()
    hot = _level_shares(heat, temperature, EDGES["temperature"])[2] * float(not np.isnan(heat.dark))
    radiant = _level_shares(dose, rate, EDGES["dose_rate"])[2] * float(not np.isnan(dose.dark))
    shares = np.concatenate([table.ravel() * (1 - hot) * (1 - radiant), [hot, (1 - hot) * radiant]])
    return ClassModel(counts.scans, intensity, nir, (trends[0], trends[1]), heat, dose, shares)


def class_probabilities(cloud: PointCloud, model: ClassModel) -> np.ndarray:
    """Probabilities of the classes for the points of a cloud in its sensor's frame, (N, K) float32, rows sum to 1.

    Where a channel is not known, its levels have the probabilities that they have among points like this one in the
    other channels: the point then says nothing about it. Where nothing is known, the row is `model.shares`.
    """
    count = len(cloud.point.positions) if "positions" in cloud.point else 0
    ranges, values = point_ranges(cloud), {}
    trends = dict(zip(("intensity", "nir"), model.trends, strict=True))
    for name, found in channels(cloud).items():
        if found is not None:
            values[name] = found / trends[name].factor(ranges) if name in trends else found
    if set(values) == {"intensity"}:
        # What has one channel has one row for each of its bins, and most scans have no other.
        rows = _rows({"intensity": np.append(_BIN_CENTRES, np.nan)}, len(_BIN_CENTRES) + 1, model)
        return rows[bin_of(values["intensity"], EDGES["intensity"])]
    return _rows(values, count, model)


def _rows(values: dict[str, np.ndarray], count: int, model: ClassModel) -> np.ndarray:
    """Probabilities (N, K) of N points with these channels, without trends."""
    levels = {"intensity": model.intensity, "nir": model.nir, "temperature": model.heat, "dose_rate": model.dose}
    known = {
        name: one.probabilities(values[name]) if name in values else np.full((count, 3), np.nan)
        for name, one in levels.items()
    }
    surfaces = model.shares[:_SURFACES].reshape(len(_INTENSITY), len(_NIR))
    joint = surfaces / max(float(surfaces.sum()), 1e-12)
    with np.errstate(divide="ignore", invalid="ignore"):
        nir_given = np.nan_to_num(joint / joint.sum(axis=1, keepdims=True))
        intensity_given = np.nan_to_num(joint / joint.sum(axis=0)).T
    intensity, nir = known["intensity"], known["nir"][:, :2]
    product = intensity[:, :, None] * nir[:, None, :]
    no_intensity, no_nir = np.isnan(intensity[:, 0]), np.isnan(nir[:, 0])
    product[no_nir] = intensity[no_nir, :, None] * nir_given
    product[no_intensity] = np.swapaxes(nir[no_intensity, :, None] * intensity_given, 1, 2)
    product[no_intensity & no_nir] = joint
    hot_share, dose_share = model.shares[_SURFACES:]
    hot = np.where(np.isnan(known["temperature"][:, 2]), hot_share, known["temperature"][:, 2])
    dose_share = dose_share / max(1 - hot_share, 1e-12)
    radiant = np.where(np.isnan(known["dose_rate"][:, 2]), dose_share, known["dose_rate"][:, 2])
    result = np.column_stack(
        [product.reshape(count, _SURFACES) * ((1 - hot) * (1 - radiant))[:, None], hot, (1 - hot) * radiant]
    )
    whole = result.sum(axis=1, keepdims=True)
    return np.where(whole > 0, result / np.where(whole > 0, whole, 1), model.shares).astype(np.float32)


def four_classes(probabilities: np.ndarray, model: ClassModel) -> np.ndarray:
    """The four classes of S2-a, (N,) uint8: 1 both high, 2 only LiDAR high, 3 only near-infrared high, 4 both low.

    LiDAR high is all but dark, where there is a dark level; else it is bright.

    Args:
        probabilities: from `class_probabilities`, (N, K); what heat and dose take is left out.
    """
    table = np.asarray(probabilities)[:, :_SURFACES].reshape(-1, len(_INTENSITY), len(_NIR))
    high = slice(1, 3) if np.isfinite(model.intensity.dark) else slice(2, 3)
    lidar_high = table[:, high].sum(axis=(1, 2)) > 0.5 * table.sum(axis=(1, 2))
    nir_high = table[:, :, 1].sum(axis=1) > 0.5 * table.sum(axis=(1, 2))
    return (1 + 2 * ~lidar_high + ~nir_high).astype(np.uint8)


def _hot(histogram: np.ndarray, edges: np.ndarray) -> Levels:
    """Bright is well above the median, in robust standard deviations; there need not be a valley."""
    if histogram.sum() == 0:
        return Levels(log=False)
    x = 0.5 * (edges[1:] + edges[:-1])
    ambient = _median(histogram, x)
    away = np.abs(x - ambient)
    order = np.argsort(away, kind="stable")
    deviation = _MAD_SCALE * _median(histogram[order], away[order])
    excess = max(_EXCESS, _DEVIATIONS * deviation)
    return Levels(-np.inf, ambient + excess, (1.0, 0.1 * excess), weak=False, log=False)


def _median(histogram: np.ndarray, x: np.ndarray) -> float:
    risen = np.cumsum(histogram)
    return float(x[np.searchsorted(risen, 0.5 * risen[-1])])


def _level_shares(levels: Levels, histogram: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Share of dark, usual and bright, (3,); without any values they are equal."""
    if np.isnan(levels.dark) or histogram.sum() == 0:
        return np.full(3, 1 / 3)
    centres = np.sqrt(edges[1:] * edges[:-1]) if levels.log else 0.5 * (edges[1:] + edges[:-1])
    return histogram @ levels.probabilities(centres) / histogram.sum()
