"""Voxels as few boxes, and those as collision geometry of a MultibodyPlant (S0-h)."""

from collections.abc import Sequence

import numpy as np
from numba import njit
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant

from ..errors import InputError

# A block of more voxels comes from a stray point kilometres away.
_MOST = 200_000_000


def merge_voxels(index: np.ndarray) -> np.ndarray:
    """Merges voxels into boxes that do not overlap and fill exactly the same space.

    From the first voxel that is left a box grows as far as it can along one axis after the other; the best of the six
    orders of the axes is taken, over all. Fewest boxes is a hard problem; a solid block becomes one.

    Args:
        index: (N, 3) indices of voxels; repeated ones count once.

    Returns:
        (B, 6) int64: first index and first index beyond, of every box.

    Raises:
        InputError: the voxels reach too far.
    """
    index = np.asarray(index, np.int64).reshape(-1, 3)
    if not len(index):
        return np.zeros((0, 6), np.int64)
    low = index.min(axis=0)
    shape = index.max(axis=0) - low + 1
    if float(np.prod(shape.astype(float))) > _MOST:
        raise InputError(
            "the voxels reach too far", where="merge_voxels", value=shape.tolist(), valid=f"{_MOST} voxels"
        )
    filled = np.zeros(shape, bool)
    filled[tuple((index - low).T)] = True
    best = None
    for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
        boxes = _merge(np.ascontiguousarray(filled.transpose(order)))
        if best is None or len(boxes) < len(best[0]):
            best = boxes, order
    assert best is not None
    boxes, order = best
    back = np.argsort(order)
    return np.concatenate([boxes[:, :3][:, back] + low, boxes[:, 3:][:, back] + low], axis=1)


def add_boxes(
    plant: MultibodyPlant,
    boxes: np.ndarray,
    voxel: float,
    *,
    name: str = "voxels",
    friction: float = 0.9,
    rgba: Sequence[float] = (0.6, 0.6, 0.62, 1.0),
) -> list[str]:
    """Registers boxes of voxels as collision and visual geometry of the world body, before `Finalize`.

    Args:
        boxes: (B, 6) as of `merge_voxels`; voxel (0, 0, 0) begins at the origin of the world.
        voxel: edge of a voxel [m]. friction: static and dynamic.

    Returns:
        Names of the collision geometries, `<name>_0` and so on.

    Raises:
        InputError: the plant is finalized, or voxel or friction is not usable.
    """
    if plant.is_finalized():
        raise InputError("the plant is finalized", where="add_boxes", valid="before Finalize()")
    if not (np.isfinite(voxel) and voxel > 0):
        raise InputError("not an edge", where="add_boxes", key="voxel", value=voxel, valid="> 0 m")
    if not (np.isfinite(friction) and friction >= 0):
        raise InputError("not a friction", where="add_boxes", key="friction", value=friction, valid=">= 0")
    names = []
    for number, box in enumerate(np.asarray(boxes, float)):
        X_WG = RigidTransform(0.5 * voxel * (box[:3] + box[3:]))
        shape, title = Box(*(voxel * (box[3:] - box[:3]))), f"{name}_{number}"
        surface = CoulombFriction(friction, friction)
        plant.RegisterCollisionGeometry(plant.world_body(), X_WG, shape, title, surface)
        plant.RegisterVisualGeometry(plant.world_body(), X_WG, shape, title, np.asarray(rgba, float))
        names.append(title)
    return names


@njit(cache=True)
def _merge(filled: np.ndarray) -> np.ndarray:
    left = filled.copy()
    nx, ny, nz = left.shape
    boxes = np.empty((left.sum(), 6), np.int64)
    count = 0
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                if not left[x, y, z]:
                    continue
                c = z + 1
                while c < nz and left[x, y, c]:
                    c += 1
                b = y + 1
                while b < ny and left[x, b, z:c].all():
                    b += 1
                a = x + 1
                while a < nx and left[a, y:b, z:c].all():
                    a += 1
                left[x:a, y:b, z:c] = False
                boxes[count, 0], boxes[count, 1], boxes[count, 2] = x, y, z
                boxes[count, 3], boxes[count, 4], boxes[count, 5] = a, b, c
                count += 1
    return boxes[:count].copy()
