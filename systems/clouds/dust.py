"""Shots that dust has sent back: single ones, nearer or farther than all that were shot beside them."""

from dataclasses import replace

import numpy as np
import open3d as o3d

from ..sensing import Scan

# A shot is compared with as many to either side in its ring: next to a thin pole or a lost shot one is not enough.
_BESIDE = 2


def without_dust(scan: Scan, gap: float) -> Scan:
    """The scan without the shots whose ranges differ by more than `gap` [m] from all that are near them in their ring.

    What is thinner than two shots are apart is lost with the dust. A scan without `ring` and `column` stays as it is.
    """
    rings, columns = scan.attribute("ring"), scan.attribute("column")
    if rings is None or columns is None or not len(rings):
        return scan
    rings, columns = rings.astype(int), columns.astype(int)
    ranges = np.full((rings.max() + 1, columns.max() + 1 + 2 * _BESIDE), np.inf, np.float32)
    own = np.linalg.norm(scan.p_SP, axis=1)
    ranges[rings, columns + _BESIDE] = own
    beside = np.arange(2 * _BESIDE + 1)[np.arange(2 * _BESIDE + 1) != _BESIDE]
    near = np.abs(ranges[rings[:, None], columns[:, None] + beside] - own[:, None]) <= gap
    return replace(scan, cloud_S=scan.cloud_S.select_by_mask(o3d.core.Tensor(near.any(axis=1))))
