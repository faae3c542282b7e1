"""What rays see in mirroring surfaces."""

import numpy as np

from .ray_scene import RayHits

# Where a mirrored ray starts, along itself, so that it does not meet the mirror again [m].
_START = np.float32(1e-3)


def mirror_share(reflectivity: np.ndarray, specular: np.ndarray, incidence_cos: np.ndarray) -> np.ndarray:
    """Share of a ray's light that goes on along the mirrored ray: s F(θ), s the mirrored share of the surface.

    F is the reflectance of a smooth transparent body by Fresnel's equations, for unpolarised light:
    F = ½ ((c − n t)² / (c + n t)² + (n c − t)² / (n c + t)²), with c = cos θ, t = √(1 − (sin θ / n)²). The refractive
    index n is the one that gives the surface's reflectivity ρ at normal incidence, √ρ = (n − 1)/(n + 1); still water,
    ρ = 0.02, has 1.33. Assumed: painted or worn metal is treated alike, with s the share that is smooth and F rising
    from its ρ to 1. At any angle that is within some tenths of the reflectance of bare metal, which absorbs.

    Args:
        reflectivity, specular, incidence_cos: ρ, s and cos θ, (N,).
    """
    root = np.sqrt(np.clip(reflectivity, 1e-6, 0.999))
    n = (1 + root) / (1 - root)
    c = np.asarray(incidence_cos)
    t = np.sqrt(1 - (1 - c * c) / (n * n))
    return specular * (((c - n * t) / (c + n * t)) ** 2 + ((n * c - t) / (n * c + t)) ** 2) / 2


def mirrored_rays(
    p_WR: np.ndarray, d_W: np.ndarray, hits: RayHits, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The mirror images of some rays at what they hit, going away from it.

    Args:
        p_WR, d_W: all rays, as given to `RayScene.cast`.
        hits: what they met.
        rays: (M,) indices of the rays that are wanted; they must have met something.

    Returns:
        Starts (M, 3) and unit directions (M, 3), float32, and the ways of light up to the starts (M,) float32 [m].
    """
    d, n, distance = d_W[rays].astype(np.float32), hits.normal_W[rays], hits.distance[rays]
    mirrored = d - 2 * np.einsum("ij,ij->i", d, n)[:, None] * n
    p_WR = np.asarray(p_WR, np.float32)
    start = (p_WR[rays] if p_WR.ndim == 2 else p_WR) + distance[:, None] * d + _START * mirrored
    return start, mirrored, distance + _START
