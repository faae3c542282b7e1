"""How far a straight line runs inside closed surfaces."""

import numpy as np

# Hits of one solid from the same side that are nearer to each other than this are one: a ray through an edge meets
# both of its triangles [m].
_SAME_HIT = 2e-5


def outward_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals of a closed surface, away from what it encloses, (T, 3) float32; all zero where it is not closed.

    Args:
        vertices: (V, 3) [m]. triangles: (T, 3) indices, all turned the same way.
    """
    corners = vertices.astype(float)[triangles]
    corners -= corners.mean(axis=(0, 1))
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    size = np.linalg.norm(areas, axis=1)
    volume = np.einsum("ij,ij->", corners[:, 0], areas) / 3
    # The area vectors of a closed surface add up to nothing; without volume there is no inside.
    if np.linalg.norm(areas.sum(axis=0)) > 1e-4 * size.sum() or abs(volume) < 1e-12:
        return np.zeros((len(triangles), 3), np.float32)
    return (np.sign(volume) * areas / np.maximum(size, 1e-30)[:, None]).astype(np.float32)


def inside_lengths(
    ray: np.ndarray, solid: np.ndarray, distance: np.ndarray, outward: np.ndarray, length: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Length inside each solid of the first part of each ray, from all hits of the whole rays.

    The length inside is the sum of min(t, L) over the exits less that over the entries: a ray that starts inside has
    an exit without an entry, and one that ends inside has the exit beyond its end L.

    Args:
        ray, solid: (H,) which ray met which solid.
        distance: (H,) where on the ray [m].
        outward: (H,) positive at an exit, negative at an entry; hits with 0 do not count.
        length: (N,) length of the part of every ray that counts [m].

    Returns:
        Pairs of ray and solid that met, and the length inside [m], each (K,).
    """
    order = np.lexsort((distance, outward > 0, solid, ray))
    order = order[outward[order] != 0]
    ray, solid, distance, leaves = ray[order], solid[order], distance[order].astype(float), outward[order] > 0
    new_pair = np.ones(len(ray), bool)
    new_pair[1:] = (ray[1:] != ray[:-1]) | (solid[1:] != solid[:-1])
    new_hit = new_pair.copy()
    new_hit[1:] |= (leaves[1:] != leaves[:-1]) | (np.diff(distance) > _SAME_HIT)
    starts = np.flatnonzero(new_pair)
    if not len(starts):
        return ray[:0], solid[:0], np.zeros(0)
    signed = np.where(leaves, 1.0, -1.0) * np.minimum(distance, length[ray]) * new_hit
    inside = np.add.reduceat(signed, starts)
    return ray[starts], solid[starts], np.clip(inside, 0.0, length[ray[starts]])
