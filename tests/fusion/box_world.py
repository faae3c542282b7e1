"""A floor, walls and boxes in closed form, and what cameras and lamps see of them."""

import numpy as np
from naraha.systems.sensing.camera_model import R_OPTICAL, CameraModel
from pydrake.math import RigidTransform, RollPitchYaw

DEPTH = CameraModel.from_fov(320, 240, np.deg2rad(69.4), np.deg2rad(42.5))
NIR = CameraModel.from_fov(128, 128, np.deg2rad(8), np.deg2rad(8))


def looking(x=0.0, y=0.0, z=0.0, pitch=0.0, yaw=0.0):
    """Pose of a camera that looks along x, turned downwards by `pitch` and to the left by `yaw`."""
    return RigidTransform(RollPitchYaw(0, pitch, yaw), [x, y, z]) @ RigidTransform(R_OPTICAL)


class BoxWorld:
    """Axis-aligned boxes (low, high corner), each with a reflectance; rays from outside of them."""

    def __init__(self, boxes, reflectances):
        self.low, self.high = (np.array([box[i] for box in boxes], float) for i in (0, 1))
        self.reflectances = np.append(np.array(reflectances, float), 0.0)

    def cast(self, start, directions):
        """Distance (inf for none), index of the box (-1) and outward normal."""
        directions = np.asarray(directions, float)
        best = np.full(len(directions), np.inf)
        box, normal = np.full(len(directions), -1), np.zeros((len(directions), 3))
        for i, (low, high) in enumerate(zip(self.low, self.high, strict=True)):
            with np.errstate(divide="ignore", invalid="ignore"):
                a, b = (low - start) / directions, (high - start) / directions
            enter, leave = np.fmin(a, b), np.fmax(a, b)
            axis = enter.argmax(axis=1)
            near, far = enter.max(axis=1), leave.min(axis=1)
            hit = (near > 1e-9) & (near <= far) & (near < best)
            best[hit], box[hit] = near[hit], i
            normal[hit] = 0
            normal[hit, axis[hit]] = -np.sign(directions[hit, axis[hit]])
        return best, box, normal

    def sees(self, eye, points, footprint=0.0):
        """Whether the eye sees the points, and as far around them as `footprint` [rad] from the eye."""
        v = points - eye
        distance = np.linalg.norm(v, axis=1)
        side = np.cross(v, [0, 0, 1.0])
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        up = np.cross(side, v) / distance[:, None]
        seen = np.ones(len(points), bool)
        for a, b in [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)] if footprint else [(0, 0)]:
            shifted = v + footprint * distance[:, None] * (a * side + b * up)
            t, _, _ = self.cast(eye, shifted)
            seen &= t >= 1 - 2e-3 - (0.05 + 4 * footprint if a or b else 0)
        return seen

    def view(self, camera, X_WC):
        """Points (H·W, 3) where the pixels' rays end, box and normal of each; at infinity where there is none."""
        d = camera.d_C.astype(float) @ X_WC.rotation().matrix().T
        t, box, normal = self.cast(X_WC.translation(), d)
        with np.errstate(invalid="ignore"):
            points = X_WC.translation() + t[:, None] * d
        points[~np.isfinite(t)] = np.inf
        return points, box, normal

    def depth(self, camera, X_WC, noise=0.0, rng=None):
        """Depth image (H, W) float32 with standard deviation `noise` z²; infinite where there is nothing."""
        d = camera.d_C.astype(float)
        t, _, _ = self.cast(X_WC.translation(), d @ X_WC.rotation().matrix().T)
        z = t * d[:, 2]
        if noise:
            z = z + noise * np.where(np.isfinite(z), z, 0) ** 2 * rng.standard_normal(len(z))
        return z.reshape(camera.shape).astype(np.float32)

    def reflectance_at(self, points, box):
        """Reflectance of box `box` at `points`; that of the first box is a smooth texture."""
        value = self.reflectances[box].copy()
        textured = box == 0
        x, y, _ = np.asarray(points)[textured].T
        value[textured] = 0.5 + 0.2 * np.sin(2 * x) + 0.2 * np.cos(3 * y)
        return value

    def radiance(self, camera, X_WC, p_WL, ambient=0.0):
        """Radiance image (H, W) float32 under a lamp at `p_WL`."""
        points, box, normal = self.view(camera, X_WC)
        hit = np.flatnonzero(box >= 0)
        light = np.zeros(len(points))
        to_lamp = p_WL - points[hit]
        r = np.linalg.norm(to_lamp, axis=1)
        cosine = np.maximum(np.einsum("ij,ij->i", to_lamp, normal[hit]) / r, 0)
        light[hit] = cosine / r**2 * self.sees(np.asarray(p_WL, float), points[hit]) + ambient
        rho = np.zeros(len(points))
        rho[hit] = self.reflectance_at(points[hit], box[hit])
        return (rho * light).reshape(camera.shape).astype(np.float32)


# Floor, wall 4 m ahead, and a pillar 2 m ahead.
PILLAR_HALL = BoxWorld(
    [([-1, -6, -1], [9, 6, 0]), ([4, -6, 0], [5, 6, 3]), ([2, -0.15, 0], [2.3, 0.15, 3])], [0.5, 0.8, 0.1]
)
# A floor with texture, walls on three sides and two boxes.
BOX_ROOM = BoxWorld(
    [
        ([-1, -6, -1], [9, 6, 0]),
        ([4.5, -6, 0], [5, 6, 3]),
        ([-1, -3.0, 0], [5, -2.9, 3]),
        ([-1, 2.9, 0], [5, 3.0, 3]),
        ([2.6, 0.5, 0], [3.0, 1.0, 0.5]),
        ([3.2, -1.2, 0], [3.6, -0.6, 0.8]),
    ],
    [0.5, 0.8, 0.6, 0.6, 0.3, 0.2],
)
