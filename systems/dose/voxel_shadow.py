"""What a map of surfaces says about gamma rays: which straight lines run through something solid, and how far."""

import numpy as np
from scipy import ndimage

# Rays are cast in pieces of about this many samples, so that memory stays small and in the cache.
_SAMPLES_AT_ONCE = 400_000
# Cells of the map at most; a map that is larger is cut to its middle, which no survey here comes near.
_MAX_CELLS = 60_000_000


class VoxelShadow:
    """Solid voxels of a map M (z up), and the optical depth along lines through them.

    A LiDAR sees surfaces. Solid is what stands: occupied voxels in an upright run of at least `min_height`, gaps of one
    voxel closed, and, layer by layer, what such voxels enclose, up to `max_core`: the core of a pillar or of a crate is
    solid, a room is not. Floors, puddles and single stones do not count; a horizontal slab is not found.
    Read-only after construction.
    """

    def __init__(
        self,
        points: np.ndarray,
        *,
        voxel: float,
        attenuation: float,
        max_depth: float,
        clearance: float,
        min_height: float = 0.3,
        max_core: float = 1.5,
    ):
        """
        Args:
            points: of the map, (N, 3) [m]; those that are not finite are left out.
            voxel: edge length [m], not below the map's spacing.
            attenuation: of what is solid, per metre of solid voxels [1/m].
            max_depth: largest optical depth that is believed, because the map does not know the material.
            clearance: at either end of a line, this much of it does not count [m]: a source is itself in the map.
            min_height: [m]. max_core: largest area of an enclosed core in a layer [m²].
        """
        points = np.asarray(points, float).reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        self._voxel, self._attenuation, self._max_depth, self._clearance = voxel, attenuation, max_depth, clearance
        self.bounds = None if not len(points) else (points.min(axis=0), points.max(axis=0))
        self._origin, self._solid = _solid_voxels(points, voxel, round(min_height / voxel), max_core / voxel**2)
        self._flat = self._solid.ravel()

    def __deepcopy__(self, memo: dict) -> "VoxelShadow":
        return self

    def transmission(self, p_MA: np.ndarray, p_MB: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Share of the rays that passes from every A (N, 3) to every B (K, 3), and its deviation, (N, K) each.

        The map does not know the material: it may be a third or one and a half times as dense as assumed.
        """
        depth = self.depth(p_MA, p_MB)
        thin, thick = np.exp(-depth / 3), np.exp(-1.5 * depth)
        return np.exp(-depth), (thin - thick) / 2

    def depth(self, p_MA: np.ndarray, p_MB: np.ndarray) -> np.ndarray:
        """Optical depth of the lines from every A (N, 3) to every B (K, 3), (N, K) float32."""
        p_MA, p_MB = np.atleast_2d(p_MA), np.atleast_2d(p_MB)
        depth = np.zeros((len(p_MA), len(p_MB)), np.float32)
        if not self._solid.any() or not depth.size:
            return depth
        low, high = np.minimum(p_MA.min(axis=0), p_MB.min(axis=0)), np.maximum(p_MA.max(axis=0), p_MB.max(axis=0))
        samples = max(int(np.ceil(np.linalg.norm(high - low) / self._voxel)), 1)
        step = max(_SAMPLES_AT_ONCE // (samples * len(p_MB)), 1)
        for first in range(0, len(p_MA), step):
            some = slice(first, first + step)
            depth[some] = self._depth(p_MA[some], p_MB)
        return np.minimum(depth * np.float32(self._attenuation), np.float32(self._max_depth))

    def _depth(self, p_MA: np.ndarray, p_MB: np.ndarray) -> np.ndarray:
        """Length inside solid voxels [m] of the lines from every A to every B."""
        way = p_MB[None] - p_MA[:, None]
        length = np.linalg.norm(way, axis=2)
        counted = np.maximum(length - 2 * self._clearance, 0.0)
        samples = max(int(np.ceil(counted.max() / self._voxel)), 1)
        # Lines of all lengths have the same number of samples, in the middles of equal pieces.
        middle = ((np.arange(samples) + 0.5) / samples).astype(np.float32)
        safe = np.maximum(length, 1e-9)
        start, share = (self._clearance / safe).astype(np.float32), (counted / safe).astype(np.float32)
        at = start[..., None] + share[..., None] * middle
        index = np.zeros(at.shape, np.int32)
        for axis in range(3):
            origin = ((p_MA[:, axis] - self._origin[axis]) / self._voxel).astype(np.float32)
            along = at * (way[..., axis] / self._voxel).astype(np.float32)[..., None]
            along += origin[:, None, None]
            # What is outside is put into the outermost voxels, which are empty.
            np.clip(along, 0, self._solid.shape[axis] - 1, out=along)
            index *= self._solid.shape[axis]
            index += along.astype(np.int32)
        return np.count_nonzero(self._flat.take(index), axis=2) * (counted / samples)


def _solid_voxels(points: np.ndarray, voxel: float, run: int, core: float) -> tuple[np.ndarray, np.ndarray]:
    """Corner of the grid [m] and which voxels are solid, (X, Y, Z) bool."""
    if not len(points):
        return np.zeros(3), np.zeros((1, 1, 1), bool)
    low = np.floor(points.min(axis=0) / voxel) - 2
    shape = (np.floor(points.max(axis=0) / voxel) - low + 3).astype(np.int64)
    if np.prod(shape.astype(float)) > _MAX_CELLS:
        middle = np.median(points, axis=0)
        half = voxel * _MAX_CELLS ** (1 / 3) / 2
        return _solid_voxels(points[(np.abs(points - middle) < half * 0.95).all(axis=1)], voxel, run, core)
    occupied = np.zeros(shape, bool)
    occupied[tuple((np.floor(points / voxel) - low).astype(np.int64).T)] = True
    standing = _eroded(_dilated(occupied, 3, 2), 3, 2)
    standing = _opened(standing, max(run, 1), 2)
    # Fill every layer: what no way leads out of, after gaps of one voxel are closed.
    rim = _eroded(_eroded(_dilated(_dilated(standing, 3, 0), 3, 1), 3, 0), 3, 1)
    layer = ndimage.generate_binary_structure(3, 1)
    layer[:, :, [0, 2]] = False
    enclosed, count = ndimage.label(~rim, layer)
    size = np.bincount(enclosed.ravel(), minlength=count + 1)
    small = size <= core
    small[0] = False
    return low * voxel, standing | small[enclosed]


def _dilated(mask: np.ndarray, width: int, axis: int) -> np.ndarray:
    """Dilation by a line of odd `width` along one axis: some times as fast as that of scipy.ndimage."""
    grown = mask.copy()
    for shift in range(1, width // 2 + 1):
        ahead, behind = _shifted(mask.ndim, axis, shift)
        grown[ahead] |= mask[behind]
        grown[behind] |= mask[ahead]
    return grown


def _eroded(mask: np.ndarray, width: int, axis: int) -> np.ndarray:
    """Erosion by a line of odd `width` along one axis; the border of the mask must be empty."""
    return ~_dilated(~mask, width, axis)


def _opened(mask: np.ndarray, run: int, axis: int) -> np.ndarray:
    """What lies in runs of at least `run` along one axis."""
    first = mask.copy()
    for shift in range(1, run):
        ahead, behind = _shifted(mask.ndim, axis, shift)
        first[behind] &= mask[ahead]
        first[(*behind[:axis], slice(max(mask.shape[axis] - shift, 0), None))] = False
    opened = first.copy()
    for shift in range(1, run):
        ahead, behind = _shifted(mask.ndim, axis, shift)
        opened[ahead] |= first[behind]
    return opened


def _shifted(dimensions: int, axis: int, shift: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Slices of all but the first, and of all but the last `shift` layers along an axis."""
    whole = [slice(None)] * axis
    return (*whole, slice(shift, None)), (*whole, slice(None, -shift))
