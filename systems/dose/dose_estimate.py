"""Dose rate from counts: the background, the most likely sources, and how sure that is."""

from dataclasses import dataclass

import numpy as np

from ..config import check_config, quantity
from ..sensing.gamma_counter import GAMMA_CS137
from .dose_field import DoseField, DoseHealth, DoseReadings, SourceEstimate
from .source_likelihood import (
    CountRows,
    HeightPrior,
    SourceModel,
    dispersion,
    expected,
    log_likelihood,
    merge_rows,
    refine,
    row_rates,
)
from .source_posterior import SourceCells, coarse_cells, locate
from .voxel_shadow import VoxelShadow

# Other places of a source that are less probable than this are not listed.
_MIN_ALTERNATIVE = 0.01
# Cells from which the fit of a new source is started: shadows have edges, and the fit stops at them.
_STARTS = 6
# Counts that scatter more than this about the model are not explained by it (χ² per degree of freedom).
_MAX_DISPERSION = 1.6


@dataclass(kw_only=True)
class DoseConfig:
    """How sources are looked for. The physics is that of Cs-137 point sources without build-up."""

    # Counts per dose rate of the counter, from its calibration.
    sensitivity: float = quantity(1000.0, unit="(counts/s)/(uSv/h)", above=0.0)
    # Sources at most.
    max_sources: int = quantity(3, unit="sources", low=0, high=20)
    # A source must raise the log-likelihood by this, and by half of BIC's 4 log(rows). 12 is 1 in 10000 by
    # chance, but shadows that the map draws wrong make small sources up.
    min_gain: float = quantity(20.0, low=0.0)
    # Places, 0.5 m apart, without which no source is looked for.
    min_places: int = quantity(6, unit="places", low=3)
    # Sources are looked for this far around the readings, though not outside of the map.
    reach: float = quantity(5.0, unit="m", above=0.0)
    # z of the floor in M, and how high over it sources can be.
    floor: float = quantity(0.0, unit="m")
    max_height: float = quantity(2.5, unit="m", above=0.0)
    # Where over the floor sources are expected: readings from one height cannot say, and most lie low. Assumed.
    height_mean: float = quantity(0.3, unit="m", low=0.0)
    height_sigma: float = quantity(0.5, unit="m", above=0.0)
    # Attenuation of what stands in the map, that of concrete at 662 keV; 0 to leave the map out of it.
    attenuation: float = quantity(17.8, unit="1/m", low=0.0)
    # Largest optical depth of an obstacle: the map does not say what it is made of.
    max_depth: float = quantity(5.0, low=0.0)
    # Relative error of the model for a source in plain view. Assumed.
    model_error: float = quantity(0.03, low=0.0, high=1.0)
    # Obstacles this near to a source or to a reading do not count: they are the source and the robot.
    clearance: float = quantity(0.35, unit="m", low=0.0)
    # Edge of the voxels in which the map is read.
    voxel: float = quantity(0.1, unit="m", above=0.0)
    # Readings are added up in cubes until there are at most so many.
    max_rows: int = quantity(400, unit="rows", low=10)
    # A dose rate counts as measured within this distance of a reading.
    measured_distance: float = quantity(1.0, unit="m", above=0.0)
    # A source is ambiguous when another place has more than 1 less this; uncertain when its place is less sure. After
    # the first source, uncertain ones are not reported.
    min_probability: float = quantity(0.9, low=0.0, high=1.0)
    max_sigma: float = quantity(1.0, unit="m", above=0.0)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Sources by falling strength, the covariance of `jacobian`'s parameters, the dispersion, and each posterior."""

    model: SourceModel
    covariance: np.ndarray
    scatter: float = 1.0
    cells: tuple[SourceCells, ...] = ()


def estimate_dose(readings: DoseReadings, config: DoseConfig, map_points: np.ndarray | None = None) -> DoseField:
    """Background and sources from counts alone; walls from the points of a map where there is one.

    Sources are added one by one, each where the posterior over cells is densest (`locate`), and all of them fitted
    together after each (`refine`), as long as the log-likelihood, divided by the dispersion, rises by more than chance
    would let it. Then the posterior of each is computed with the others held. Without a usable reading the field is
    NaN, its deviation infinite.

    Args:
        map_points: points of occupied voxels in M, (P, 3) [m], with spacing of at most `config.voxel`.

    Raises:
        ConfigError: a value of `config` is out of its range.
    """
    check_config(config, where="dose")
    usable = readings.usable()
    p_MG, exposure = readings.p_MG[usable], config.sensitivity * readings.live_time[usable]
    rows = merge_rows(p_MG, readings.counts[usable], exposure, config.max_rows)
    shadow = None
    if map_points is not None and len(map_points) and min(config.attenuation, config.max_depth) > 0:
        shadow = VoxelShadow(
            map_points,
            voxel=config.voxel,
            attenuation=config.attenuation,
            max_depth=config.max_depth,
            clearance=config.clearance,
        )
    fit = _fit(rows, shadow, config)
    sources = tuple(_source(fit, i) for i in range(len(fit.cells)))
    return DoseField(
        background=fit.model.background,
        background_sigma=float(np.sqrt(fit.covariance[0, 0])),
        sources=sources,
        health=_health(sources, rows, len(p_MG), int((~usable).sum()), fit.scatter, config),
        _model=fit.model,
        _covariance=fit.covariance,
        _shadow=shadow,
        _measured=p_MG,
        _measured_distance=config.measured_distance,
    )


def _fit(rows: CountRows, shadow: VoxelShadow | None, config: DoseConfig) -> _Fit:
    nothing = np.zeros((0, 3)), np.zeros(0)
    exposure, total = rows.exposure.sum(), rows.counts.sum()
    if not exposure:
        return _Fit(SourceModel(np.nan, *nothing), np.array([[np.inf]]))
    model, covariance = SourceModel(total / exposure, *nothing), np.array([[max(total, 1) / exposure**2]])
    error = config.model_error
    rates = expected(model, rows, shadow, error)
    value, scatter = float(log_likelihood(rows, *rates)), dispersion(rows, *rates, 1)
    if len(rows.places) < config.min_places or not config.max_sources or not total:
        return _Fit(model, covariance * scatter, scatter)

    prior = HeightPrior(config.floor, config.floor + config.max_height, config.height_mean, config.height_sigma)
    centres, sizes = coarse_cells(*_search_area(rows, shadow, config), config.floor, config.max_height)
    coarse = centres, sizes, row_rates(centres, rows, shadow, error)
    enough = max(config.min_gain, 2 * np.log(len(rows.counts)))
    while len(model.strength) < config.max_sources:
        known = expected(model, rows, shadow, error)
        others = known[0] - max(model.background, 0), known[1]
        cells = locate(rows, others, coarse, shadow, prior, error=error, scale=scatter)
        wider, wider_covariance, wider_value = max(
            (refine(_with_source(model, cells, i), rows, shadow, prior, error) for i in cells.starts(_STARTS)),
            key=lambda fit: fit[2] + prior.log(fit[0].p_MQ[:, 2]).sum(),
        )
        wider_scatter = dispersion(rows, *expected(wider, rows, shadow, error), 1 + 4 * len(wider.strength))
        if (wider_value - value) / wider_scatter < enough:
            break
        # A further source that cannot be placed is rather an error of the shadows: drawn anywhere, it would mislead.
        spread = cells.moments()[1][:2, :2]
        if len(model.strength) and np.linalg.eigvalsh(spread)[-1] > config.max_sigma**2:
            break
        model, covariance, value, scatter = wider, wider_covariance, wider_value, wider_scatter

    order = np.argsort(-model.strength, kind="stable")
    columns = np.concatenate([[0], *(1 + 4 * i + np.arange(4) for i in order)]).astype(int)
    model = SourceModel(model.background, model.p_MQ[order], model.strength[order])
    posteriors = []
    for i in range(len(order)):
        rest = np.arange(len(order)) != i
        held = SourceModel(0.0, model.p_MQ[rest], model.strength[rest])
        others = expected(held, rows, shadow, error)
        posteriors.append(locate(rows, others, coarse, shadow, prior, error=error, scale=scatter))
    return _Fit(model, scatter * covariance[np.ix_(columns, columns)], scatter, tuple(posteriors))


def _with_source(model: SourceModel, cells: SourceCells, cell: int) -> SourceModel:
    strength = max(float(cells.strength[cell]), 1e-6)
    p_MQ = np.vstack([model.p_MQ, cells.p_MC[cell]])
    return SourceModel(float(cells.background[cell]), p_MQ, np.append(model.strength, strength))


def _search_area(rows: CountRows, shadow: VoxelShadow | None, config: DoseConfig) -> tuple[np.ndarray, np.ndarray]:
    """Corners (2) of the rectangle in which sources are looked for [m]."""
    low, high = rows.p_MG[:, :2].min(axis=0), rows.p_MG[:, :2].max(axis=0)
    near, far = low - config.reach, high + config.reach
    if shadow is not None and shadow.bounds is not None:
        # The readings themselves stay inside, wherever the map is.
        near = np.minimum(np.maximum(near, shadow.bounds[0][:2]), low)
        far = np.maximum(np.minimum(far, shadow.bounds[1][:2]), high)
    return near, np.maximum(far, near + config.voxel)


def _source(fit: _Fit, index: int) -> SourceEstimate:
    p_M, strength, cells = fit.model.p_MQ[index], float(fit.model.strength[index]), fit.cells[index]
    shares = cells.group_probability()
    grouped = np.flatnonzero(cells.group >= 0)
    own = int(cells.group[grouped[np.argmin(np.square(cells.p_MC[grouped] - p_M).sum(axis=1))]])
    alternatives = []
    for group, share in enumerate(shares):
        if group != own and share > _MIN_ALTERNATIVE:
            best = cells.best(group)
            alternatives.append((cells.p_MC[best], float(cells.strength[best]), float(share)))
    return SourceEstimate(
        p_M=p_M,
        covariance=cells.moments(own)[1],
        activity_mbq=strength / GAMMA_CS137,
        activity_sigma=strength / GAMMA_CS137 * float(np.sqrt(fit.covariance[1 + 4 * index, 1 + 4 * index])),
        dose_rate_1m=strength,
        probability=float(shares[own] / shares.sum()),
        alternatives=tuple(alternatives),
        cells=cells,
    )


def _health(
    sources: tuple[SourceEstimate, ...],
    rows: CountRows,
    readings: int,
    skipped: int,
    scatter: float,
    config: DoseConfig,
) -> DoseHealth:
    state, reason = "good", ""
    ambiguous = [i for i, source in enumerate(sources) if source.probability < config.min_probability]
    vague = [i for i, source in enumerate(sources) if source.horizontal_sigma > config.max_sigma]
    if len(rows.places) < config.min_places:
        state, reason = "few readings", f"readings at {len(rows.places)} places, {config.min_places} are needed"
    elif ambiguous:
        source = sources[ambiguous[0]]
        places = [source.p_M, *(place for place, _, _ in source.alternatives)]
        words = " or ".join(f"({place[0]:.1f}, {place[1]:.1f})" for place in places)
        state, reason = "ambiguous", f"source {ambiguous[0]} is at {words} m: measure away from the straight line"
    elif vague:
        sigma = sources[vague[0]].horizontal_sigma
        state, reason = "uncertain", f"the place of source {vague[0]} is known to {sigma:.1f} m only: measure nearer"
    elif scatter > _MAX_DISPERSION:
        state, reason = "poor fit", f"counts scatter {scatter:.1f} times as much as the model lets them"
    return DoseHealth(state, reason, readings, skipped, scatter)
