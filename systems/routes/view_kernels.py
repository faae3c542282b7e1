"""Compiled sight lines over the cells of a grid, seen from above."""

import numpy as np
from numba import njit


@njit(cache=True)
def mark_view(
    covered: np.ndarray, opaque: np.ndarray, x: float, y: float, first: float, last: float, near: float, reach: float
) -> None:
    """Marks the cells that are seen from a point between two directions, up to what is opaque.

    Args:
        covered, opaque: (nx, ny) bool; `covered` is changed.
        x, y: in cells. first, last: directions [rad]. near, reach: [cells].
    """
    nx, ny = opaque.shape
    rays = max(int(np.ceil(1.5 * reach * (last - first))), 1)
    for ray in range(rays + 1):
        angle = first + (last - first) * ray / rays
        c, s = np.cos(angle), np.sin(angle)
        r = 0.0
        while r <= reach:
            i, j = int(np.floor(x + r * c)), int(np.floor(y + r * s))
            if i < 0 or j < 0 or i >= nx or j >= ny or opaque[i, j]:
                break
            if r >= near:
                covered[i, j] = True
            r += 0.5


@njit(cache=True)
def unseen_sectors(
    places: np.ndarray, worth: np.ndarray, opaque: np.ndarray, near: float, reach: float, sectors: int, rays: int
) -> np.ndarray:
    """What each place looks at in each sector: worth times area, (P, sectors) [cells].

    Args:
        places: (P, 2) in cells. worth: (nx, ny). opaque: (nx, ny) bool. near, reach: [cells]. rays: in each sector.
    """
    nx, ny = opaque.shape
    area = np.zeros((len(places), sectors))
    width = 2 * np.pi / (sectors * rays)
    for place in range(len(places)):
        for ray in range(sectors * rays):
            angle = (ray + 0.5) * width
            c, s = np.cos(angle), np.sin(angle)
            r = 0.5
            while r <= reach:
                i, j = int(np.floor(places[place, 0] + r * c)), int(np.floor(places[place, 1] + r * s))
                if i < 0 or j < 0 or i >= nx or j >= ny or opaque[i, j]:
                    break
                if r >= near:
                    area[place, ray // rays] += worth[i, j] * r * width
                r += 1.0
    return area
