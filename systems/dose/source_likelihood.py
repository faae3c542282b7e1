"""The likelihood of counts under a background and point sources, and its maximum."""

from dataclasses import dataclass, replace

import numpy as np

from .voxel_shadow import VoxelShadow

# Nearer than this, an inverse square is not believed [m].
MIN_DISTANCE = 0.2
# Lowest background that is considered [uSv/h]; the logarithm needs one.
_MIN_RATE = 1e-4
# Share of the variance of the shadow between neighbouring places that counts as doubt about each of them.
_EDGE_DOUBT = 0.25


@dataclass(frozen=True, eq=False)
class CountRows:
    """Counts at places, of one or more readings each.

    Attributes:
        p_MG: (N, 3) where [m].
        counts: (N,) how many.
        exposure: (N,) expected counts per dose rate: sensitivity times live time [1/(uSv/h)].
        places: (L, 3) positions that stand for those within some distance, for what varies slowly [m].
        place: (N,) index into `places`.
        beside: (L, L) equal weights of the places within 0.75 m of each; rows sum to 1.
    """

    p_MG: np.ndarray
    counts: np.ndarray
    exposure: np.ndarray
    places: np.ndarray
    place: np.ndarray
    beside: np.ndarray


@dataclass(frozen=True, eq=False)
class SourceModel:
    """A background and K point sources.

    Attributes:
        background: [uSv/h].
        p_MQ: (K, 3) positions [m].
        strength: (K,) dose rate at 1 m [uSv/h].
    """

    background: float
    p_MQ: np.ndarray
    strength: np.ndarray


def merge_rows(p_MG: np.ndarray, counts: np.ndarray, exposure: np.ndarray, limit: int) -> CountRows:
    """Adds up readings in cubes of 5 cm, or of more until there are at most `limit`; places are cubes of 0.5 m."""
    size = 0.05
    while True:
        _, group = np.unique(np.floor(p_MG / size).astype(np.int64), axis=0, return_inverse=True)
        if group.max(initial=0) < limit:
            break
        size *= 1.5
    group = group.reshape(-1)
    weight = np.bincount(group, exposure)
    centre = np.stack([np.bincount(group, exposure * p_MG[:, i]) / weight for i in range(3)], axis=1)
    _, place = np.unique(np.floor(centre / max(0.5, size)).astype(np.int64), axis=0, return_inverse=True)
    place = place.reshape(-1)
    share = np.bincount(place)
    places = np.stack([np.bincount(place, centre[:, i]) / share for i in range(3)], axis=1)
    beside = (np.linalg.norm(places[:, None] - places[None], axis=2) < 0.75).astype(float)
    beside /= np.maximum(beside.sum(axis=1, keepdims=True), 1)
    return CountRows(centre, np.bincount(group, counts).astype(float), weight, places, place, beside)


def kernel(p_MQ: np.ndarray, p_MP: np.ndarray) -> np.ndarray:
    """Inverse square of the distance from every Q (C, 3) to every P (N, 3), (C, N) [1/m²]."""
    square = np.square(p_MQ[:, None] - p_MP[None]).sum(axis=2)
    return 1 / np.maximum(square, MIN_DISTANCE**2)


def row_rates(
    p_MQ: np.ndarray, rows: CountRows, shadow: VoxelShadow | None, error: float
) -> tuple[np.ndarray, np.ndarray]:
    """Dose rate of a source of strength 1 at each Q in every row, and its standard deviation, (C, N) each.

    Args:
        error: relative error of a dose rate in plain view: extended sources, scattered rays, calibration.
    """
    rate = kernel(p_MQ, rows.p_MG)
    if shadow is None:
        return rate, error * rate
    passed, doubt = shadow.transmission(p_MQ, rows.places)
    # At the edge of a shadow, where the places around differ, nothing is sure.
    around = passed @ rows.beside.T
    edge = np.maximum(np.square(passed) @ rows.beside.T - np.square(around), 0.0)
    doubt = np.sqrt(np.square(doubt) + _EDGE_DOUBT * edge)
    # Rows at one place share its error: were each given it as its own, the sum would be surer than any of them.
    doubt *= np.sqrt(np.bincount(rows.place, minlength=len(rows.places)))
    spread = rate * np.hypot(error * passed, doubt)[:, rows.place]
    rate *= passed[:, rows.place]
    return rate, spread


def expected(
    model: SourceModel, rows: CountRows, shadow: VoxelShadow | None, error: float
) -> tuple[np.ndarray, np.ndarray]:
    """Expected dose rate of all of it and the standard deviation of the sources' part (N,) [uSv/h]."""
    rate, spread = row_rates(model.p_MQ, rows, shadow, error)
    return max(model.background, _MIN_RATE) + model.strength @ rate, np.sqrt(model.strength**2 @ spread**2)


def log_likelihood(rows: CountRows, rate: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Extended quasi-likelihood of the counts for dose rates and their deviations (..., N) [uSv/h], (...).

    The variance of a count is φ m, φ = 1 + s²/m, with m the mean and s the deviation of the mean because obstacles are
    not known well. With D the Poisson deviance, Q⁺ = −½ Σ (D/φ + log φ): Nelder and Pregibon, An extended
    quasi-likelihood function, Biometrika 1987. Without s it is the Poisson likelihood against the best possible.
    """
    mean = rows.exposure * rate
    phi = 1 + np.square(rows.exposure * spread) / mean
    return _quasi(rows.counts, mean, phi) - 0.5 * np.log(phi).sum(axis=-1)


def _quasi(n: np.ndarray, mean: np.ndarray, phi: np.ndarray) -> np.ndarray:
    best = n * np.log(np.maximum(n, 1)) - n
    return ((n * np.log(mean) - mean - best) / phi).sum(axis=-1)


def dispersion(rows: CountRows, rate: np.ndarray, spread: np.ndarray, parameters: int) -> float:
    """How much more than expected the counts scatter, Pearson's χ² per degree of freedom, at least 1."""
    mean = rows.exposure * rate
    chi2 = float((np.square(rows.counts - mean) / (mean + np.square(rows.exposure * spread))).sum())
    return max(chi2 / max(len(mean) - parameters, 1), 1.0)


def profile(
    rows: CountRows, rates: tuple[np.ndarray, np.ndarray], others: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Best background b and strength w of one more source, for many candidate positions at once.

    The mean is exposure (others + b + w rate). For given φ the quasi-likelihood is concave in (b, w): Newton steps, and
    where one does not climb, a step of expectation-maximisation, which always does; then φ follows.

    Args:
        rates: of a source of strength 1, and deviation, (C, N) each, as from `row_rates`.
        others: dose rate of known sources, and deviation, (N,) each [uSv/h].

    Returns:
        Log-likelihood, b and w of every candidate, (C,) each.
    """
    n, e = rows.counts, rows.exposure
    k, fixed = rates[0] * e, others[0] * e
    b = np.full(len(k), max(float(n.sum() / e.sum()) / 2, _MIN_RATE))
    w = 0.5 * n.sum() / k.sum(axis=1)
    phi = np.ones_like(k)
    for outer in range(3):
        if outer:
            variance = np.square(e) * (np.square(others[1]) + np.square(w[:, None] * rates[1]))
            phi = 1 + variance / (fixed + b[:, None] * e + w[:, None] * k)
        b, w = _climb(n, e, k / phi, k, fixed, phi, b, w)
    rate = others[0] + b[:, None] + w[:, None] * rates[0]
    return log_likelihood(rows, rate, np.hypot(others[1], w[:, None] * rates[1])), b, w


def _climb(
    n: np.ndarray,
    e: np.ndarray,
    k_phi: np.ndarray,
    k: np.ndarray,
    fixed: np.ndarray,
    phi: np.ndarray,
    b: np.ndarray,
    w: np.ndarray,
    steps: int = 6,
) -> tuple[np.ndarray, np.ndarray]:
    """Maximises the quasi-likelihood over (b, w) for given φ."""
    e_phi = e / phi
    sum_b, sum_w = e_phi.sum(axis=1), k_phi.sum(axis=1)
    mean = fixed + b[:, None] * e + w[:, None] * k
    value = _quasi(n, mean, phi)
    for _ in range(steps):
        ratio = n / mean
        curvature = ratio / mean
        grow_b, grow_w = (ratio * e_phi).sum(axis=1), (ratio * k_phi).sum(axis=1)
        h_bb, h_bw = (curvature * e_phi) @ e, (curvature * k_phi) @ e
        h_ww = (curvature * k_phi * k).sum(axis=1)
        determinant = np.maximum(h_bb * h_ww - h_bw**2, 1e-12 * h_bb * h_ww + 1e-300)
        g_b, g_w = grow_b - sum_b, grow_w - sum_w
        new_b = np.maximum(b + (h_ww * g_b - h_bw * g_w) / determinant, _MIN_RATE)
        new_w = np.maximum(w + (h_bb * g_w - h_bw * g_b) / determinant, 0.0)
        mean = fixed + new_b[:, None] * e + new_w[:, None] * k
        new = _quasi(n, mean, phi)
        worse = ~(new >= value)
        if worse.any():
            new_b[worse] = np.maximum(b * grow_b / sum_b, _MIN_RATE)[worse]
            new_w[worse] = (w * grow_w / sum_w)[worse]
            mean[worse] = fixed + new_b[worse, None] * e + new_w[worse, None] * k[worse]
            new[worse] = _quasi(n, mean[worse], phi[worse])
        gain = float(np.max(new - value, initial=0.0))
        b, w, value = new_b, new_w, new
        if gain < 1e-3:
            break
    return b, w


def jacobian(model: SourceModel, p_MP: np.ndarray, transmission: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Dose rate at P and its derivatives by background, and by log strength and position of each source.

    Args:
        p_MP: (N, 3) [m]. transmission: exp(−optical depth) from every source to every P, (K, N); held as it is.

    Returns:
        (N,) [uSv/h] and (N, 1 + 4 K).
    """
    count = len(model.strength)
    derivatives = np.zeros((len(p_MP), 1 + 4 * count))
    derivatives[:, 0] = 1
    rate = np.full(len(p_MP), max(model.background, _MIN_RATE))
    for i in range(count):
        way = p_MP - model.p_MQ[i]
        square = np.square(way).sum(axis=1)
        part = model.strength[i] * transmission[i] / np.maximum(square, MIN_DISTANCE**2)
        rate += part
        derivatives[:, 1 + 4 * i] = part
        slope = np.where(square > MIN_DISTANCE**2, 2 * part / np.maximum(square, MIN_DISTANCE**2), 0.0)
        derivatives[:, 2 + 4 * i : 5 + 4 * i] = slope[:, None] * way
    return rate, derivatives


@dataclass(frozen=True)
class HeightPrior:
    """How high sources stand, because dose rates measured from one height say little about it.

    z is between `low` and `high` and normal about `mean` over `low` with deviation `sigma` [m].
    """

    low: float
    high: float
    mean: float
    sigma: float

    def log(self, z: np.ndarray) -> np.ndarray:
        """Log of the prior density, but for a constant."""
        return -0.5 * np.square((z - self.low - self.mean) / self.sigma)


def refine(
    model: SourceModel,
    rows: CountRows,
    shadow: VoxelShadow | None,
    prior: HeightPrior,
    error: float,
    steps: int = 20,
) -> tuple[SourceModel, np.ndarray, float]:
    """Moves all sources and strengths together to the nearest maximum of likelihood times prior (Fisher scoring).

    Returns:
        The model, the covariance of its parameters in the order of `jacobian` (1 + 4 K square), and its
        log-likelihood, without the prior.
    """

    def posterior(candidate: SourceModel) -> float:
        value = log_likelihood(rows, *expected(candidate, rows, shadow, error))
        return float(value) + float(prior.log(candidate.p_MQ[:, 2]).sum())

    damping, value = 1e-3, posterior(model)
    for _ in range(steps):
        gradient, information = _scores(model, rows, shadow, prior, error)
        gain = 0.0
        while damping < 1e5:
            step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
            candidate = _moved(model, step, prior)
            new = posterior(candidate)
            if new > value:
                gain, model, value = new - value, candidate, new
                damping = max(damping / 10, 1e-6)
                break
            damping *= 10
        if gain < 1e-3:
            break
    _, information = _scores(model, rows, shadow, prior, error)
    likelihood = float(log_likelihood(rows, *expected(model, rows, shadow, error)))
    return model, np.linalg.pinv(information), likelihood


def _scores(
    model: SourceModel, rows: CountRows, shadow: VoxelShadow | None, prior: HeightPrior, error: float
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient of the log posterior, and Fisher's information with that of the prior."""
    transmission = np.ones((len(model.strength), len(rows.counts)))
    if shadow is not None:
        transmission = shadow.transmission(model.p_MQ, rows.places)[0][:, rows.place]
    rate, derivatives = jacobian(model, rows.p_MG, transmission)
    spread = expected(model, rows, shadow, error)[1]
    phi = 1 + rows.exposure * spread**2 / rate
    gradient = derivatives.T @ ((rows.counts / rate - rows.exposure) / phi)
    information = (derivatives * (rows.exposure / rate / phi)[:, None]).T @ derivatives
    for i in range(len(model.strength)):
        gradient[4 + 4 * i] += (prior.low + prior.mean - model.p_MQ[i, 2]) / prior.sigma**2
        information[4 + 4 * i, 4 + 4 * i] += prior.sigma**-2
    information[np.diag_indices(len(information))] += 1e-9
    return gradient, information


def _moved(model: SourceModel, step: np.ndarray, prior: HeightPrior) -> SourceModel:
    parts = step[1:].reshape(-1, 4)
    # A step is at most a factor of e in strength and half a metre.
    p_MQ = model.p_MQ + np.clip(parts[:, 1:], -0.5, 0.5)
    p_MQ[:, 2] = np.clip(p_MQ[:, 2], prior.low, prior.high)
    strength = model.strength * np.exp(np.clip(parts[:, 0], -1, 1))
    return replace(model, background=max(model.background + step[0], _MIN_RATE), p_MQ=p_MQ, strength=strength)
