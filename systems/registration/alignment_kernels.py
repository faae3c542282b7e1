"""Partners of surfels and the normal equations of their distances, in numba."""

import math

import numpy as np
from numba import njit

from .grid_kernels import cell_key, find_slot


@njit(cache=True, fastmath=True)
def match(
    source: np.ndarray,
    evidence_S: np.ndarray,
    grid: tuple,
    X: np.ndarray,
    centre: np.ndarray,
    stride: int,
    width: float,
    cosine: float,
    signed: bool,
) -> np.ndarray:
    """Pairs every `stride`-th surfel of the source with the nearest of the target and sums up the normal equations.

    Args:
        source: surfels (N, 8): position, unit normal, variance of its direction, number of neighbours.
        evidence_S: class probabilities (N, K), -1 where not known; K may be 0.
        grid: of the target, see `SearchGrid`; partners are within half of its cell.
        X: pose of the source in the target (4, 4). centre: point (3,) of T that turns are about.
        width: of the Tukey loss on their distance e along the mean of both normals; pairs farther apart do not count.
        cosine: smallest between the normals of partners. signed: their sign matters.

    Returns:
        number of pairs, sum of weights w, and the means over w of e², of the variance of the mean normal, of J Jᵀ
        (upper triangle row by row, 21), of J e (6), of l (3) and of l lᵀ (upper triangle, 6), with l the lever arm from
        the centre and J = [l × n, n].
    """
    target, evidence_T, keys, ends, cell = grid
    sums = np.zeros(40)
    jacobian = np.empty(6)
    classes = evidence_S.shape[1]
    for s in range(0, len(source), stride):
        a, b, c = source[s, 0], source[s, 1], source[s, 2]
        x = X[0, 0] * a + X[0, 1] * b + X[0, 2] * c + X[0, 3]
        y = X[1, 0] * a + X[1, 1] * b + X[1, 2] * c + X[1, 3]
        z = X[2, 0] * a + X[2, 1] * b + X[2, 2] * c + X[2, 3]
        a, b, c = source[s, 3], source[s, 4], source[s, 5]
        u = X[0, 0] * a + X[0, 1] * b + X[0, 2] * c
        v = X[1, 0] * a + X[1, 1] * b + X[1, 2] * c
        w = X[2, 0] * a + X[2, 1] * b + X[2, 2] * c
        # The eight cells around the nearest corner of the grid hold all within half a cell.
        i0, j0, k0 = int(np.floor(x / cell - 0.5)), int(np.floor(y / cell - 0.5)), int(np.floor(z / cell - 0.5))
        nearest, best, same = -1, 0.25 * cell * cell, 0.0
        for i in range(i0, i0 + 2):
            for j in range(j0, j0 + 2):
                for k in range(k0, k0 + 2):
                    slot = find_slot(keys, cell_key(i, j, k))
                    for t in range(ends[slot, 0], ends[slot, 1]):
                        a, b, c = x - target[t, 0], y - target[t, 1], z - target[t, 2]
                        distance = a * a + b * b + c * c
                        if distance < best:
                            turn = u * target[t, 3] + v * target[t, 4] + w * target[t, 5]
                            if turn > cosine or (not signed and turn < -cosine):
                                nearest, best, same = t, distance, turn
        if nearest < 0:
            continue
        sign = 1.0 if same > 0 else -1.0
        # The mean of both normals: what is wrong with one of them counts half (symmetric ICP).
        u, v, w = sign * u + target[nearest, 3], sign * v + target[nearest, 4], sign * w + target[nearest, 5]
        length = 1 / math.sqrt(u * u + v * v + w * w)
        u, v, w = u * length, v * length, w * length
        e = (x - target[nearest, 0]) * u + (y - target[nearest, 1]) * v + (z - target[nearest, 2]) * w
        if abs(e) >= width:
            continue
        weight = (1 - (e / width) ** 2) ** 2  # Tukey
        if classes > 0:
            likelihood = 0.0
            for i in range(classes):
                likelihood += evidence_S[s, i] * evidence_T[nearest, i]
            if likelihood >= 0:  # else one of them is not known
                weight *= min(1.0, max(0.1, likelihood))
        lx, ly, lz = x - centre[0], y - centre[1], z - centre[2]
        jacobian[0], jacobian[1], jacobian[2] = ly * w - lz * v, lz * u - lx * w, lx * v - ly * u
        jacobian[3], jacobian[4], jacobian[5] = u, v, w
        sums[0] += 1
        sums[1] += weight
        sums[2] += weight * e * e
        sums[3] += weight * 0.25 * (source[s, 6] + target[nearest, 6])
        n = 4
        for i in range(6):
            for j in range(i, 6):
                sums[n] += weight * jacobian[i] * jacobian[j]
                n += 1
        for i in range(6):
            sums[n] += weight * jacobian[i] * e
            n += 1
        sums[31] += weight * lx
        sums[32] += weight * ly
        sums[33] += weight * lz
        sums[34] += weight * lx * lx
        sums[35] += weight * lx * ly
        sums[36] += weight * lx * lz
        sums[37] += weight * ly * ly
        sums[38] += weight * ly * lz
        sums[39] += weight * lz * lz
    if sums[1] > 0:
        sums[2:] /= sums[1]
    return sums


@njit(cache=True, fastmath=True)
def lay_on(
    source: np.ndarray,
    evidence_S: np.ndarray,
    coarse: tuple,
    fine: tuple,
    X: np.ndarray,
    centre_S: np.ndarray,
    widths: np.ndarray,
    first_stride: int,
    iterations: int,
    tolerance: float,
    cosine: float,
    signed: bool,
    min_constraint: float,
    min_pairs: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lays the source on the target from the pose X (4, 4) on, see `align_surfaces` and `match`.

    Args:
        widths: (4,) of the loss: the first, from where on the fine grid is searched, the last; and the factor between.

    Returns:
        the pose, what `match` returns for it in the fine grid, and the point of T that it is about.
    """
    X = X.copy()
    width, last = widths[0], widths[2]
    centre = np.empty(3)
    for _ in range(iterations):
        wide = width > widths[1]
        _transform(X, centre_S, centre)
        if wide:
            means = match(source, evidence_S, coarse, X, centre, first_stride, width, cosine, signed)
        else:
            means = match(source, evidence_S, fine, X, centre, 1, width, cosine, signed)
        if means[0] * (first_stride if wide else 1) < min_pairs:
            break
        moved = _step(means, X, centre, min_constraint)
        if width <= last and moved < tolerance:
            break
        width = max(last, widths[3] * width)
    _transform(X, centre_S, centre)
    return X, match(source, evidence_S, fine, X, centre, 1, last, cosine, signed), centre


@njit(cache=True)
def _step(means: np.ndarray, X: np.ndarray, centre: np.ndarray, min_constraint: float) -> float:
    """Moves X by the Gauss-Newton step along the motions that are held, see `constraint`; returns how far [m]."""
    hessian, second = np.empty((6, 6)), np.empty((3, 3))
    _unpack(means[4:25], hessian)
    _unpack(means[34:40], second)
    size = second[0, 0] + second[1, 1] + second[2, 2]
    radius = np.sqrt(max(size, 1e-12))
    metric = (1 + 1e-9) * np.eye(6)
    for i in range(3):
        for j in range(3):
            metric[i, j] = ((size if i == j else 0.0) - second[i, j]) / radius**2 + (1e-9 if i == j else 0.0)
    x, y, z = means[31] / radius, means[32] / radius, means[33] / radius
    metric[3, 1], metric[3, 2], metric[4, 0] = z, -y, -z
    metric[4, 2], metric[5, 0], metric[5, 1] = x, y, -x
    slope = means[25:31].copy()
    for i in range(3):
        slope[i] /= radius
        for j in range(6):
            hessian[i, j] /= radius
            hessian[j, i] /= radius
            metric[i, j] = metric[j, i]
    # H v = λ M v with M = L Lᵀ: the eigenvectors of L⁻¹ H L⁻ᵀ are Lᵀ v.
    whiten = np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(metric)))
    unwhiten = np.ascontiguousarray(whiten.T)
    values, vectors = np.linalg.eigh(whiten @ hessian @ unwhiten)
    motions = unwhiten @ np.ascontiguousarray(vectors)
    step, moved = np.zeros(6), 0.0
    for i in range(6):
        if values[i] - means[3] >= min_constraint:
            share = -np.dot(np.ascontiguousarray(motions[:, i]), slope) / values[i]
            moved += share * share
            for j in range(6):
                step[j] += share * motions[j, i]
    R = _turn(step[:3] / radius)
    turned = R @ np.ascontiguousarray(X[:3, :3])
    shift = R @ (X[:3, 3] - centre) + centre + step[3:]
    X[:3, :3] = turned
    X[:3, 3] = shift
    return np.sqrt(moved)


@njit(cache=True)
def _turn(turn: np.ndarray) -> np.ndarray:
    """Rotation matrix of a turn vector [rad]: Rodrigues' formula."""
    angle = np.sqrt(np.sum(turn * turn))
    x, y, z = turn
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    a = np.sin(angle) / angle if angle > 1e-6 else 1.0
    b = (1 - np.cos(angle)) / angle**2 if angle > 1e-6 else 0.5
    return np.eye(3) + a * K + b * (K @ K)


@njit(cache=True)
def _transform(X: np.ndarray, point: np.ndarray, out: np.ndarray) -> None:
    for i in range(3):
        out[i] = X[i, 0] * point[0] + X[i, 1] * point[1] + X[i, 2] * point[2] + X[i, 3]


@njit(cache=True)
def _unpack(upper: np.ndarray, out: np.ndarray) -> None:
    """A symmetric matrix from its upper triangle, row by row."""
    n = 0
    for i in range(len(out)):
        for j in range(i, len(out)):
            out[i, j] = out[j, i] = upper[n]
            n += 1
