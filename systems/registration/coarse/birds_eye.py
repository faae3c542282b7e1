"""Where two views may lie to each other: images of them from above, correlated at all shifts and yaws."""

import numpy as np
import scipy.fft
from numba import njit

from .view import View

# Pixels along the edge of the squares of which only the highest value of the correlation counts.
BLOCK = 4
# Highest values of one yaw that are kept.
PER_YAW = 100


def correlate_views(
    source: View,
    target: View,
    yaws: np.ndarray,
    centre: np.ndarray,
    span: float,
    reach: float,
    pixel: float,
    free_weight: float,
    count: int,
) -> np.ndarray:
    """The `count` highest values over `yaws` [rad] and all shifts within `span` [m] of `centre` (2,), falling.

    Surfaces that lie on each other and face the same way count for a pose, by the product of their normals (the images
    are vectors, as complex numbers, and an opposite face counts against it), occupied on occupied counts as well, and
    occupied on what the other saw as free floor counts against it with `free_weight`. By FFT for all shifts of one yaw.

    Args:
        reach: columns nearer to the sensors than this take part [m].

    Returns:
        rows value, yaw, x, y: the pose of L of the source in L of the target.
    """
    a, b = (_nearer(view, reach) for view in (target, source))
    span = min(span, 2 * reach)
    # What is shifted out of the image on one side comes in on the other, only beyond the shifts that are looked at.
    size = 2 * int((2 * reach + span + float(np.abs(centre).max())) / pixel / 2 + 1)
    size = scipy.fft.next_fast_len(size, real=True)
    identity = np.eye(2)
    facing_x, facing_y, filled = (_blurred(image) for image in _images(*a, identity, pixel, size))
    free = _filled(_free_floor(target, reach, pixel), identity, pixel, size) * (filled == 0)
    # What each image of the source meets in the target, as spectra.
    meets = scipy.fft.rfft2(np.stack([facing_x, facing_y, filled - free_weight * free, -free_weight * filled]))
    free_S = _free_floor(source, reach, pixel)
    rows = []
    for yaw in yaws:
        R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        images = np.stack([*_images(*b, R, pixel, size), _filled(free_S, R, pixel, size)])
        values = scipy.fft.irfft2((meets * scipy.fft.rfft2(images).conj()).sum(axis=0), (size, size))
        best, x, y = _block_peaks(values, centre / pixel, int(span / pixel))
        top = np.argpartition(-best, min(PER_YAW, len(best) - 1))[:PER_YAW]
        rows.append(np.column_stack([best[top], np.full(len(top), yaw), x[top] * pixel, y[top] * pixel]))
    peaks = np.vstack(rows)
    peaks = peaks[np.isfinite(peaks[:, 0])]
    return peaks[np.argsort(-peaks[:, 0], kind="stable")[:count]]


def _nearer(view: View, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Centres and normals, times flatness (0 where their signs mean nothing), of the columns within `reach` [m]."""
    columns = view.columns
    near = np.linalg.norm(columns.centres, axis=1) < reach
    signed = view.p_LV is not None
    return columns.centres[near], signed * (columns.normals * columns.flatness[:, None])[near]


@njit(cache=True)
def _images(
    points: np.ndarray, vectors: np.ndarray, R: np.ndarray, pixel: float, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both parts of the vectors and ones, where the turned points are, (size, size) each."""
    facing_x, facing_y = np.zeros((size, size), np.float32), np.zeros((size, size), np.float32)
    filled = np.zeros((size, size), np.float32)
    for i in range(len(points)):
        x = int(np.round((R[0, 0] * points[i, 0] + R[0, 1] * points[i, 1]) / pixel)) % size
        y = int(np.round((R[1, 0] * points[i, 0] + R[1, 1] * points[i, 1]) / pixel)) % size
        facing_x[x, y] = R[0, 0] * vectors[i, 0] + R[0, 1] * vectors[i, 1]
        facing_y[x, y] = R[1, 0] * vectors[i, 0] + R[1, 1] * vectors[i, 1]
        filled[x, y] = 1.0
    return facing_x, facing_y, filled


@njit(cache=True)
def _filled(points: np.ndarray, R: np.ndarray, pixel: float, size: int) -> np.ndarray:
    image = np.zeros((size, size), np.float32)
    for i in range(len(points)):
        x = int(np.round((R[0, 0] * points[i, 0] + R[0, 1] * points[i, 1]) / pixel)) % size
        y = int(np.round((R[1, 0] * points[i, 0] + R[1, 1] * points[i, 1]) / pixel)) % size
        image[x, y] = 1.0
    return image


@njit(cache=True)
def _block_peaks(values: np.ndarray, centre: np.ndarray, span: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Highest value of every block of shifts within `span` of `centre`, and its shift [pixels]."""
    size = len(values)
    blocks = (2 * span) // BLOCK + 1
    best = np.full(blocks * blocks, -np.inf)
    x, y = np.zeros(blocks * blocks), np.zeros(blocks * blocks)
    low0, low1 = int(np.round(centre[0])) - span, int(np.round(centre[1])) - span
    for i in range(2 * span + 1):
        for j in range(2 * span + 1):
            if (i - span) ** 2 + (j - span) ** 2 > span * span:
                continue
            value = values[(low0 + i) % size, (low1 + j) % size]
            block = i // BLOCK * blocks + j // BLOCK
            if value > best[block]:
                best[block] = value
                x[block], y[block] = low0 + i, low1 + j
    return best, x, y


def _blurred(image: np.ndarray) -> np.ndarray:
    """Spread over a pixel and half: between two yaws a far wall moves by that much."""
    weights = np.array([0.25, 0.75, 1.0, 0.75, 0.25], np.float32)
    for axis in (0, 1):
        image = sum(w * np.roll(image, k - 2, axis) for k, w in enumerate(weights))
    return image / np.float32(weights.sum() ** 2) * np.float32(2.0)


def _free_floor(view: View, reach: float, pixel: float) -> np.ndarray:
    """Places (K, 2) on the way from the sensor to the nearest column of each direction, one a pixel; none unseen."""
    if view.p_LV is None:
        return np.zeros((0, 2))
    centres = view.columns.centres
    distance = np.linalg.norm(centres, axis=1)
    # A column is as wide as its cell: nearby it fills more than one degree.
    sector = ((np.arctan2(centres[:, 1], centres[:, 0]) + np.pi) / np.deg2rad(2.0)).astype(int) % 180
    nearest = np.full(180, 0.0)
    order = np.argsort(-distance)
    nearest[sector[order]] = distance[order]  # the nearest is written last
    steps = np.arange(pixel, min(reach, float(distance.max())), pixel)
    angle = np.deg2rad(2 * np.arange(180) + 1.0) - np.pi
    places = steps[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.ascontiguousarray(places[steps[:, None] < nearest - 2 * pixel])
