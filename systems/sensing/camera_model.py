"""How a camera turns directions into pixels: pinhole with Brown's lens distortion."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.math import RotationMatrix

from ..errors import CameraError

# Orientation of an optical frame (x right, y down, z forward) in a frame with x forward, y left and z up.
R_OPTICAL = RotationMatrix(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))

_UNDISTORT_ITERATIONS = 30
# Directions this much outside the image are not projected: there the distortion polynomial may fold back into it.
_MARGIN = 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraModel:
    """Intrinsics A and lens distortion of a camera with W × H pixels.

    Camera frame C: x right, y down, z forward along the optical axis, as in Drake and OpenCV. A pixel's centre has
    whole coordinates: (u, v) = (0, 0) is the centre of the one in the upper left corner. Images are indexed [v, u].

    Attributes:
        width, height: [px].
        fx, fy, cx, cy: focal lengths and principal point [px]; A = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]].
        distortion: k1, k2, p1, p2, k3 of Brown's model, in the order of OpenCV.

    Raises:
        CameraError: a number is not finite, a size or a focal length not positive, or the distortion folds the image.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if len(self.distortion) != 5:
            raise CameraError("wrong length", where="camera", key="distortion", valid="k1, k2, p1, p2, k3")
        if not np.isfinite(numbers).all() or min(self.fx, self.fy) <= 0 or min(self.width, self.height) < 1:
            value = (self.width, self.height, self.fx, self.fy, self.cx, self.cy)
            raise CameraError("no camera has such intrinsics", where="camera", value=value, valid="finite, fx, fy > 0")

    @staticmethod
    def from_fov(
        width: int, height: int, fov_x: float, fov_y: float, distortion: tuple[float, ...] = (0.0,) * 5
    ) -> "CameraModel":
        """A camera whose pinhole, without distortion, sees `fov_x` × `fov_y` [rad] from edge to edge."""
        return CameraModel(
            width=width,
            height=height,
            fx=width / 2 / float(np.tan(fov_x / 2)),
            fy=height / 2 / float(np.tan(fov_y / 2)),
            cx=(width - 1) / 2,
            cy=(height - 1) / 2,
            distortion=tuple(distortion),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width [px], the shape of an image of this camera as an array."""
        return self.height, self.width

    @property
    def distorted(self) -> bool:
        return any(self.distortion)

    def project(self, p_CP: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixel coordinates of points, the perspective part of Eq. 1: m ≅ A p.

        Args:
            p_CP: (N, 3) [m].

        Returns:
            uv (N, 2) in the floating-point type of `p_CP`, and which points are in front of the camera and within the
            image, (N,). Pixels of the others mean nothing.
        """
        z = p_CP[:, 2]
        ahead = z > 0
        depth = np.where(ahead, z, 1)
        uv = np.empty((len(p_CP), 2), np.result_type(p_CP, np.float32))
        with np.errstate(over="ignore", invalid="ignore"):  # points almost in the plane z = 0, or at infinity
            x, y = p_CP[:, 0] / depth, p_CP[:, 1] / depth
            if self.distorted:
                low, high = self._bounds
                ahead &= (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
                x, y = self._distort(x, y)
            uv[:, 0] = self.fx * x + self.cx
            uv[:, 1] = self.fy * y + self.cy
        inside = ahead & (uv[:, 0] >= -0.5) & (uv[:, 0] < self.width - 0.5)
        inside &= (uv[:, 1] >= -0.5) & (uv[:, 1] < self.height - 0.5)
        return uv, inside

    @cached_property
    def xy(self) -> np.ndarray:
        """Where the ray of every pixel meets the plane z = 1, row by row, (H·W, 2)."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return self.undistort(np.stack([u.ravel(), v.ravel()], axis=1).astype(float))

    @cached_property
    def d_C(self) -> np.ndarray:
        """Unit direction of the ray of every pixel, row by row, (H·W, 3) float32."""
        rays = np.column_stack([self.xy, np.ones(len(self.xy))])
        return (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)

    def undistort(self, uv: np.ndarray) -> np.ndarray:
        """Where the rays of pixel coordinates (N, 2) meet the plane z = 1, (N, 2), by Newton's method.

        Raises:
            CameraError: the distortion folds the image: no ray or several belong to one of the pixels.
        """
        distorted = (np.asarray(uv, float) - [self.cx, self.cy]) / [self.fx, self.fy]
        if not self.distorted:
            return distorted
        x, y = distorted.T.copy()
        with np.errstate(all="ignore"):
            for _ in range(_UNDISTORT_ITERATIONS):
                xd, yd = self._distort(x, y)
                ex, ey = distorted[:, 0] - xd, distorted[:, 1] - yd
                if np.abs([ex, ey]).max(initial=0) < 1e-14:
                    break
                a, b, c = self._distortion_jacobian(x, y)
                det = a * c - b * b
                x, y = x + (c * ex - b * ey) / det, y + (a * ey - b * ex) / det
            error = np.abs(np.stack(self._distort(x, y)) - distorted.T).max(initial=0)
            a, b, c = self._distortion_jacobian(x, y)
            unfolded = (a > 0) & (a * c - b * b > 0)
        if not (error < 1e-9 and unfolded.all()):
            raise CameraError("the distortion folds the image", where="camera", key="distortion", value=self.distortion)
        return np.column_stack([x, y])

    def unproject(self, depth: np.ndarray) -> np.ndarray:
        """Points p_CP (H·W, 3) float32 [m] of a depth image (H, W), depth along z; not finite where the depth is not.

        Raises:
            CameraError: the image has another size.
        """
        self.check_image(depth)
        z = np.asarray(depth, np.float32).ravel()
        points = np.empty((len(z), 3), np.float32)
        xy = self._xy32
        with np.errstate(invalid="ignore"):  # 0 · inf on the axis
            points[:, 0], points[:, 1], points[:, 2] = xy[:, 0] * z, xy[:, 1] * z, z
        return points

    def check_image(self, image: np.ndarray, where: str = "image") -> None:
        """Raises `CameraError` when `image` does not have this camera's height and width."""
        if np.shape(image)[:2] != self.shape:
            raise CameraError("image and intrinsics disagree", where=where, value=np.shape(image), valid=self.shape)

    @cached_property
    def _xy32(self) -> np.ndarray:
        return np.asfortranarray(self.xy, np.float32)

    @cached_property
    def field_of_view(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest x and y in the plane z = 1 that the image shows, edges of pixels included, (2) each."""
        u, v = np.linspace(-0.5, self.width - 0.5, 33), np.linspace(-0.5, self.height - 0.5, 33)
        edges = [np.column_stack(np.broadcast_arrays(u, b)) for b in (-0.5, self.height - 0.5)]
        edges += [np.column_stack(np.broadcast_arrays(a, v)) for a in (-0.5, self.width - 0.5)]
        xy = self.undistort(np.vstack(edges))
        return xy.min(axis=0), xy.max(axis=0)

    @cached_property
    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = self.field_of_view
        margin = _MARGIN * (high - low)
        return low - margin, high + margin

    def _distort(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )

    def _distortion_jacobian(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives ∂xd/∂x, ∂xd/∂y = ∂yd/∂x and ∂yd/∂y of `_distort`."""
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
        return (
            radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
            slope * x * y + 2 * p1 * x + 2 * p2 * y,
            radial + slope * y * y + 6 * p1 * y + 2 * p2 * x,
        )
