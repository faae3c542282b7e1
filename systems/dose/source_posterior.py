"""Where one more source can be: the posterior over cells of space, fine where it matters."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from .source_likelihood import CountRows, HeightPrior, profile, row_rates
from .voxel_shadow import VoxelShadow

# Edge of the coarse cells [m], grown where that would make more than the number below; they are halved so many times.
_COARSE, _MAX_COARSE, _HALVINGS = 1.0, 700, 3
# Layers of the coarse cells; they are halved once.
_LAYERS = 3
# Cells that are divided further at each level, the likeliest.
_DIVIDED = 96
# Share of the probability that is looked at when cells are grouped.
_SHARE = 0.999


@dataclass(frozen=True, eq=False)
class SourceCells:
    """Posterior of the position of one source, all other sources held.

    Attributes:
        p_MC: (C, 3) centres of the cells [m].
        size: (C, 3) edges of the cells [m].
        probability: (C,) sums to 1.
        strength: (C,) best strength of a source there, its dose rate at 1 m [uSv/h].
        background: (C,) best background with it [uSv/h].
        group: (C,) which cells belong together: 0 for the group with the largest share, -1 for improbable cells.
    """

    p_MC: np.ndarray
    size: np.ndarray
    probability: np.ndarray
    strength: np.ndarray
    background: np.ndarray
    group: np.ndarray

    def group_probability(self) -> np.ndarray:
        """Probability of every group, falling."""
        return np.bincount(self.group[self.group >= 0], self.probability[self.group >= 0])

    def best(self, group: int = 0) -> int:
        """Index of the cell with the largest density in a group."""
        density = np.where(self.group == group, self.probability / self.size.prod(axis=1), -1.0)
        return int(np.argmax(density))

    def starts(self, count: int, apart: float = 0.4) -> list[int]:
        """The densest cells that are some distance apart [m], at most `count`, by falling density."""
        chosen: list[int] = []
        for i in np.argsort(-self.probability / self.size.prod(axis=1), kind="stable")[:500]:
            if all(np.linalg.norm(self.p_MC[i] - self.p_MC[j]) > apart for j in chosen):
                chosen.append(int(i))
                if len(chosen) == count:
                    break
        return chosen

    def moments(self, group: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Mean (3) [m] and covariance (3, 3) [m²] of the position within a group, the width of the cells included."""
        inside = self.group == group
        weight = self.probability[inside] / self.probability[inside].sum()
        mean = weight @ self.p_MC[inside]
        away = self.p_MC[inside] - mean
        return mean, (weight[:, None] * away).T @ away + np.diag(weight @ self.size[inside] ** 2 / 12)

    def credible(self, share: float = 0.95) -> np.ndarray:
        """The fewest cells that hold `share` of the probability, (C,) bool, by falling density."""
        order = np.argsort(-self.probability / self.size.prod(axis=1))
        chosen = np.zeros(len(order), bool)
        chosen[order[: int(np.searchsorted(np.cumsum(self.probability[order]), share)) + 1]] = True
        return chosen


def coarse_cells(low: np.ndarray, high: np.ndarray, floor: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Centres and edges (C, 3) of cells over the rectangle from `low` to `high` (2) and `height` over the floor [m]."""
    edge = max(_COARSE, float(np.sqrt(np.prod(high - low) / _MAX_COARSE)))
    counts = np.maximum(np.ceil((high - low) / edge), 1).astype(int)
    sizes = [*((high - low) / counts), height / _LAYERS]
    axes = [low[i] + (np.arange(counts[i]) + 0.5) * sizes[i] for i in range(2)]
    axes.append(floor + (np.arange(_LAYERS) + 0.5) * sizes[2])
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return centres, np.tile(sizes, (len(centres), 1))


def locate(
    rows: CountRows,
    others: tuple[np.ndarray, np.ndarray],
    coarse: tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]],
    shadow: VoxelShadow | None,
    prior: HeightPrior,
    *,
    error: float,
    scale: float,
) -> SourceCells:
    """Posterior of one more source.

    Coarse cells are rated at their centres, and the likeliest divided, again and again. The strength and the background
    are those that suit each cell best. The prior is even in x and y and `prior` in z.

    Args:
        others: dose rate of the sources that are held at every row, and deviation, (N,) each [uSv/h].
        coarse: centres and edges from `coarse_cells`, and their `row_rates`.
        error: see `row_rates`.
        scale: dispersion that log-likelihoods are divided by.
    """
    p_MC, size, rates = coarse
    leaves: list[tuple[np.ndarray, ...]] = []
    for level in range(_HALVINGS + 1):
        if level:
            rates = row_rates(p_MC, rows, shadow, error)
        value, background, strength = profile(rows, rates, others)
        rating = value / scale + prior.log(p_MC[:, 2]) + np.log(size.prod(axis=1))
        divided = np.zeros(len(p_MC), bool)
        if level < _HALVINGS:
            divided[np.argsort(-rating, kind="stable")[:_DIVIDED]] = True
        kept = ~divided
        leaves.append(tuple(part[kept] for part in (p_MC, size, rating, strength, background)))
        p_MC, size = _halve(p_MC[divided], size[divided], upright=level == 0)
    p_MC, size, rating, strength, background = (np.concatenate(parts) for parts in zip(*leaves, strict=True))
    probability = np.exp(rating - rating.max())
    probability /= probability.sum()
    group = _group(p_MC, size, probability)
    return SourceCells(p_MC, size, probability, strength, background, group)


def _halve(p_MC: np.ndarray, size: np.ndarray, upright: bool) -> tuple[np.ndarray, np.ndarray]:
    ways = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in ((-1, 1) if upright else (0,))])
    centres = (p_MC[:, None] + ways * size[:, None] / 4).reshape(-1, 3)
    return centres, np.repeat(size / [2, 2, 2 if upright else 1], len(ways), axis=0)


def _group(p_MC: np.ndarray, size: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Cells that touch in plan and hold the bulk of the probability, as groups by falling share."""
    order = np.argsort(-probability)
    bulk = np.zeros(len(order), bool)
    bulk[order[: int(np.searchsorted(np.cumsum(probability[order]), _SHARE)) + 1]] = True
    # Cells over each other are one column.
    columns, column = np.unique(
        np.round(np.hstack([p_MC, size])[bulk][:, [0, 1, 3, 4]], 6), axis=0, return_inverse=True
    )
    column = column.reshape(-1)
    centre, edge = columns[:, :2], columns[:, 2:]
    gap = np.abs(centre[:, None] - centre[None])
    touch = (gap <= (edge[:, None] + edge[None]) / 2 + 1e-5).all(axis=2)
    count, label = connected_components(csr_array(touch), directed=False)
    label = label[column]
    rank = np.empty(count, int)
    rank[np.argsort(-np.bincount(label, probability[bulk]))] = np.arange(count)
    group = np.full(len(p_MC), -1)
    group[bulk] = rank[label]
    return group
