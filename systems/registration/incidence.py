"""At what angle the shots of a scan met the surfaces."""

import numpy as np
from open3d.t.geometry import PointCloud

from .config import SurfacesConfig
from .surfel_kernels import image_means, image_surfels
from .surfels import BLOCK_GATE, block_shape, is_organised, usable_points


def incidence_cosines(cloud: PointCloud, config: SurfacesConfig | None = None) -> np.ndarray:
    """Cosine of the angle between every shot and the normal of what it met, (N,) in [0, 1].

    NaN where the neighbours in the range image make no plane, and for clouds without `ring` and `column`. The cloud is
    in the frame of its sensor.
    """
    config = config or SurfacesConfig()
    cosines = np.full(len(cloud.point.positions) if "positions" in cloud.point else 0, np.nan)
    usable = usable_points(cloud)
    if not is_organised(cloud) or len(usable) == 0:
        return cosines
    points = np.ascontiguousarray(cloud.point.positions.numpy()[usable], np.float32)
    row, column = (cloud.point[name].numpy().ravel()[usable].astype(np.int32) for name in ("ring", "column"))
    height, width, rows, columns = block_shape(row, column)
    means, counts, middle = image_means(points, row, column, rows, columns, height, width, BLOCK_GATE)
    data, which = image_surfels(means, counts, middle, config.radius, config.widening, 0.0, config.thickness)
    normals = np.full((rows * columns, 3), np.nan)
    block = row // height * columns + column // width
    normals[block[which]] = data[:, 3:6]
    distance = np.linalg.norm(points, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosines[usable] = np.abs(np.einsum("ij,ij->i", points, normals[block])) / distance
    return np.minimum(cosines, 1.0)
