"""How well the classes of two clouds agree at every offset along one motion, and whether that has a distinct peak."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ..config import quantity
from .class_lanes import LEVELS, Cells, Floats, Ints, meetings


@dataclass(kw_only=True)
class ClassCorrelationConfig:
    """How classes are correlated, and when their answer is believed."""

    # [m] Size of a lane across and of a cell along it. The rings of a VLP-16 are 0.2 m apart at 6 m.
    lane: float = quantity(0.25, unit="m", above=0)
    cell: float = quantity(0.04, unit="m", above=0)
    # [m] How far a cell of the target stands for its lane to either side.
    reach: float = quantity(0.15, unit="m", above=0)
    # [m] Points of one lane this near share an opinion, and n of them count as n^power independent ones.
    opinion_reach: float = quantity(0.1, unit="m", low=0)
    opinion_power: float = quantity(0.4, low=0, high=1)
    # Share of wrong labels that is assumed on top of what the probabilities say: nothing is surer than this.
    label_error: float = quantity(0.1, low=0, high=1)
    # [m] Blocks within which labels are taken to be wrong together; what differs between blocks gives the errors.
    block: float = quantity(0.5, unit="m", above=0)
    # [m] Steps in which offsets are tried, and the standard deviation over which the result is smoothed.
    step: float = quantity(0.01, unit="m", above=0)
    smoothing: float = quantity(0.015, unit="m", low=0)
    # [m] Steps along the second of two free motions.
    coarse_step: float = quantity(0.1, unit="m", above=0)
    # Standard deviations over blocks by which the peak beats its best rival, and log likelihood ratio at least.
    min_contrast: float = quantity(1.7, above=0)
    min_evidence: float = quantity(5.0, unit="nats", low=0)
    # Share of its own height by which it must be ahead, where the guess does not decide: the peaks of a pattern that
    # repeats are never quite as high as each other.
    min_lead: float = quantity(0.1, low=0, high=1)


@dataclass(frozen=True, eq=False)
class Profile:
    """What the classes say of every offset along one motion.

    Attributes:
        offsets: (n,) [m].
        blocks: log likelihood ratio of every block of the surface, (B, n), as if all its cells were independent.
        spread: how many times more these vary than that, at least 1: they are divided by it to give nats.
        guess, weight: what the guess says of the offset [m], and the inverse of its variance [1/m²].
    """

    offsets: Floats
    blocks: Floats
    spread: float
    guess: float
    weight: float

    @property
    def prior(self) -> Floats:
        """Log probability of every offset by the guess, (n,) [nats]."""
        return -0.5 * self.weight * (self.offsets - self.guess) ** 2

    def near(self, k: int, width: float) -> Floats:
        """Mean of every block around offset k, (B,), with Gaussian weights `width` steps wide."""
        away = np.arange(len(self.offsets)) - k
        chosen = np.abs(away) <= max(4 * width, 0.5)
        weights = np.exp(-0.5 * (away[chosen] / max(width, 1e-6)) ** 2)
        return self.blocks[:, chosen] @ (weights / weights.sum())


@dataclass(frozen=True)
class Peak:
    """The best offset of a profile.

    Attributes:
        offset, variance: [m], [m²].
        curvature: second derivative of the log probability there, with the opposite sign.
        width: half its width at half its height [m].
        contrast, evidence, reason: as in `ClassFix`; it is distinct when there is no reason against it.
    """

    offset: float = np.nan
    variance: float = np.inf
    curvature: float = 0.0
    width: float = np.inf
    contrast: float = 0.0
    evidence: float = 0.0
    reason: str = ""


def evidence_table(source: Cells, target: Cells, shares: Floats) -> tuple[Floats, Floats, Floats]:
    """Evidence that two cells are the same place, for every code of `source` (rows) and of `target` (columns).

    log Σ_k p_k q_k / π_k with the mean probabilities p and q of the codes, less its means over rows and columns: then
    cells that meet by chance give 0 on average, whatever their codes. Also returned are the mean squares of its rows,
    over the codes of the target as often as they occur, and of its columns.
    """
    codes = LEVELS * len(shares)
    often, mean = [], []
    for cells in (source, target):
        count = np.bincount(cells.code, minlength=codes)
        total = np.stack([np.bincount(cells.code, column, codes) for column in cells.prob.T], axis=1)
        often.append(count / max(len(cells.code), 1))
        mean.append(total / np.maximum(count, 1)[:, None])
    table = np.log(np.maximum((mean[0] / shares) @ mean[1].T, 1e-9))
    table[often[0] == 0], table[:, often[1] == 0] = 0, 0
    rows, columns = table @ often[1], often[0] @ table
    table += often[0] @ rows - rows[:, None] - columns
    table[often[0] == 0], table[:, often[1] == 0] = 0, 0
    return table, table**2 @ often[1], often[0] @ table**2


def block_numbers(points: Floats, size: float) -> Ints:
    """Number of the cube of `size` [m] that each point (N, 3) lies in, (N,), without gaps."""
    cell = np.floor(points / size).astype(np.int64)
    cell -= cell.min(axis=0)
    shape = cell.max(axis=0) + 1
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    if shape.prod() > 2e6:
        return np.unique(key, return_inverse=True)[1]
    used = np.zeros(int(shape.prod()), np.int64)
    used[key] = 1
    return (np.cumsum(used) - 1)[key]


def class_profile(
    source: Cells,
    target: Cells,
    blocks: Ints,
    table: tuple[Floats, Floats, Floats],
    span: float,
    prior: tuple[float, float],
    config: ClassCorrelationConfig,
    count: int = 0,
) -> Profile:
    """What the classes say of all offsets within `span` [m], from cells in the same lanes.

    The sums are divided by the root of the mean squares that what overlaps at an offset, of either cloud, would give by
    chance, as in normalised cross-correlation: overlap is most without any motion, and would pull there, in a smooth
    corridor by 5 to 15 mm.

    Args:
        blocks: number of the block of every cell of the source.
        table: from `evidence_table`.
        prior: offset [m] by the guess and the inverse of its variance [1/m²].
        count: number of blocks, when the last ones may be missing among `blocks`.
    """
    span = config.step * round(span / config.step)
    args = (source.lane, source.place, source.code, blocks, target.lane, target.place, target.code)
    score, (square, mean_S, mean_T) = meetings(*args, *table, config.reach, span, config.step, count)
    power = np.sqrt(np.maximum(mean_S, 0) * np.maximum(mean_T, 0))
    usual = max(float(power.mean()), 1e-12)
    some = score[:, ::5]
    chance = np.einsum("ij,ij->j", some, some) / np.maximum(square[::5], 1e-9)
    score *= np.asarray(usual / np.maximum(power, 0.3 * usual), np.float64)
    offsets = np.asarray(config.step * np.arange(len(power)) - span, np.float64)
    return Profile(offsets, score, max(float(np.median(chance)), 1.0), *prior)


def find_peak(profile: Profile, config: ClassCorrelationConfig) -> Peak:
    """The best offset, fitted by a parabola over the upper part of its peak, and whether it can be believed.

    It must beat its best rival, outside its own peak, by `min_contrast` standard deviations of the differences between
    blocks and by `min_evidence`; the guess, when it says something, counts on both sides.
    """
    x, spread = profile.offsets, profile.spread
    blur = config.smoothing / config.step
    data = gaussian_filter1d(profile.blocks.sum(axis=0), blur, mode="nearest")
    total = data + spread * profile.prior
    best = int(total.argmax())
    evidence = float(data[best] / spread)
    if not np.ptp(data) > 1e-6 * spread:
        return Peak(reason="the classes do not vary along it")
    if not 1 < best < len(x) - 2:
        return Peak(evidence=evidence, reason="the best offset is at the end of the interval")
    low = data < 0.5 * (data[best] + np.median(data))
    before, after = np.flatnonzero(low[:best]), np.flatnonzero(low[best:])
    if not len(before) or not len(after):
        return Peak(evidence=evidence, reason="there is no peak within the interval")
    left, right = int(before[-1]), best + int(after[0])
    width = 0.5 * (x[right] - x[left])
    outside = total.copy()
    outside[max(left - 2, 0) : right + 3] = -np.inf
    rival = int(outside.argmax())
    if not np.isfinite(outside[rival]):
        return Peak(evidence=evidence, reason="there is no peak within the interval")
    ahead = spread * float(profile.prior[best] - profile.prior[rival])
    contrast = lead(profile.near(best, blur) - profile.near(rival, blur), ahead)
    # The parabola of every block: constant, slope, half the curvature.
    half = int(np.clip(0.7 * width, 0.04, 0.15) / config.step)
    near = slice(max(best - half, 0), best + half + 1)
    offset = x[near] - x[best]
    powers = np.linalg.pinv(np.stack([np.ones_like(offset), offset, offset**2], axis=1)).T
    fit = profile.blocks @ gaussian_filter1d(_placed(powers, near, len(x)), blur, axis=0, mode="nearest")
    pull = spread * profile.weight
    curvature = pull - 2 * fit[:, 2].sum()
    if not curvature > 0:
        return Peak(contrast=contrast, evidence=evidence, reason="there is no peak within the interval")
    shift = (fit[:, 1].sum() - pull * (x[best] - profile.guess)) / curvature
    slopes = fit[:, 1] + 2 * shift * fit[:, 2]
    variance = float(((slopes**2).sum() + spread * pull) / curvature**2)
    reason = ""
    if contrast < config.min_contrast or not leads(data[best], data[rival], ahead, spread, config):
        reason = f"the next best offset, {x[rival]:+.2f} m, is about as good as {x[best]:+.2f} m"
    elif evidence < config.min_evidence or abs(shift) > max(width, 2 * config.step):
        reason = "the classes agree no more than by chance"
    return Peak(float(x[best] + shift), variance, float(curvature / spread), float(width), contrast, evidence, reason)


def _placed(values: Floats, rows: slice, count: int) -> Floats:
    placed = np.zeros((count, values.shape[1]))
    placed[rows] = values
    return placed


def leads(best: float, rival: float, ahead: float, spread: float, config: ClassCorrelationConfig) -> bool:
    """Whether a sum `best` is far enough from that of its rival, when the guess puts it `ahead`."""
    enough = spread * config.min_evidence
    return best + ahead - rival >= enough and (ahead >= enough or best - rival >= config.min_lead * best)


def lead(differences: Floats, head_start: float = 0.0) -> float:
    """By how many standard deviations independent `differences` (B,) of mean 0 would be as far ahead."""
    return float((differences.sum() + head_start) / max(np.sqrt((differences**2).sum()), 1e-12))
