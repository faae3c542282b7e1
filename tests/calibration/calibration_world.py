"""Rooms full of boxes and pillars, and what a depth camera, a near-infrared and a thermal camera see of them."""

from dataclasses import dataclass

import numpy as np
from naraha.systems.calibration.edge_calibration import CalibrationView
from naraha.systems.calibration.pose_fit import changed, head_rotations
from naraha.systems.sensing import RayScene, Surface, SurfaceTable
from naraha.systems.sensing.camera_model import CameraModel
from pydrake.geometry import Box, Cylinder, GeometryInstance, PerceptionProperties, SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

DEPTH = CameraModel.from_fov(640, 480, np.deg2rad(69.4), np.deg2rad(42.5))
NIR = CameraModel.from_fov(128, 128, np.deg2rad(8), np.deg2rad(8))
THERMAL = CameraModel.from_fov(80, 60, np.deg2rad(41), np.deg2rad(31))
DEPTH_NOISE = 0.0032  # [1/m], times z²
# Optical axes of a camera that looks along x of a frame with z up.
LOOK_X = RollPitchYaw(-np.pi / 2, 0, -np.pi / 2).ToRotationMatrix()
# The depth camera is in the origin of the world, half a metre over the floor; the mount is 10 cm beside it.
X_WD = RigidTransform(LOOK_X)
X_DN = RigidTransform(LOOK_X.inverse(), [-0.1, -0.02, 0.0])
p_WL = np.array([-0.05, 0.02, -0.12])


@dataclass
class Room:
    """A room, rendered by rays. Different seeds have different furniture."""

    scene: RayScene
    rng: np.random.Generator

    @staticmethod
    def furnished(seed: int, objects: int = 9, hot: int = 3) -> "Room":
        """Boxes and pillars 1 to 4 m ahead, each with a reflectance and a temperature of its own, in a room."""
        rng = np.random.default_rng(1000 + seed)
        scene_graph = SceneGraph()
        source = scene_graph.RegisterSource("room")
        surfaces = {}

        def add(shape, X, name, temperature):
            instance = GeometryInstance(X, shape, name)
            instance.set_perception_properties(PerceptionProperties())
            scene_graph.RegisterAnchoredGeometry(source, instance)
            surfaces[name] = Surface(nir_reflectance=float(rng.uniform(0.15, 0.9)), temperature=temperature)

        yaw = RigidTransform(RollPitchYaw(0, 0, rng.uniform(-0.3, 0.3)), [0, 0, 0])
        add(Box(0.1, 40, 20), yaw @ RigidTransform([5.0, 0, 2]), "wall", 20.0)
        add(Box(40, 40, 0.1), RigidTransform([2.0, 0, -0.55]), "floor", 18.0)
        for i in range(objects):
            x = rng.uniform(1.0, 4.0)
            y = x * rng.uniform(-0.62, 0.62)
            temperature = float(rng.uniform(35, 70) if i < hot else rng.uniform(16, 26))
            height = rng.uniform(0.3, 1.6)
            X = RigidTransform(RollPitchYaw(*rng.uniform([-0.15, -0.15, 0], [0.15, 0.15, 3])), [x, y, height / 2 - 0.5])
            if i % 3 == 2:
                add(Cylinder(rng.uniform(0.04, 0.15), height), X, f"pillar_{i}", temperature)
            else:
                add(Box(*rng.uniform(0.1, 0.4, 2), height), X, f"box_{i}", temperature)
        scene = RayScene(scene_graph.model_inspector(), SurfaceTable(by_pattern=surfaces))
        return Room(scene, np.random.default_rng(2000 + seed))

    def depth(self, noise: float = DEPTH_NOISE) -> np.ndarray:
        hits = self.scene.cast(X_WD.translation(), DEPTH.d_C @ X_WD.rotation().matrix().T)
        z = hits.distance * DEPTH.d_C[:, 2]
        z += noise * z**2 * self.rng.standard_normal(len(z), np.float32)
        return z.reshape(DEPTH.shape)

    def nir(self, X_WC: RigidTransform) -> np.ndarray:
        """Lambert's law for a point lamp at p_WL, its shadows, auto exposure, noise of 1.5 in 256 steps."""

        def radiance(d_W):
            hits = self.scene.cast(X_WC.translation(), d_W)
            far = np.where(np.isfinite(hits.distance), hits.distance, 100)[:, None]
            to_lamp = p_WL - (X_WC.translation() + far * d_W)
            r = np.linalg.norm(to_lamp, axis=1)
            shade = self.scene.cast(p_WL, -to_lamp / r[:, None]).distance < r - 0.01
            cosine = np.abs((hits.normal_W * to_lamp).sum(axis=1)) / r
            return hits.lookup("nir_reflectance") * np.where(shade, 0.02, cosine + 0.02) / r**2

        image = self._mean_over_pixels(NIR, X_WC, 3, radiance)
        exposure = 200 / np.percentile(image, 95)
        noisy = exposure * image + 1.5 * self.rng.standard_normal(image.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    def thermal(self, X_WC: RigidTransform, camera: CameraModel = THERMAL, noise: float = 0.1) -> np.ndarray:
        """Temperature of the surfaces [deg C], mean over each pixel, with noise."""
        image = self._mean_over_pixels(
            camera, X_WC, 6, lambda d: self.scene.cast(X_WC.translation(), d).lookup("temperature")
        )
        return (image + noise * self.rng.standard_normal(image.shape)).astype(np.float32)

    @staticmethod
    def _mean_over_pixels(camera, X_WC, parts, look) -> np.ndarray:
        fine = CameraModel(
            width=camera.width * parts, height=camera.height * parts, fx=camera.fx * parts, fy=camera.fy * parts,
            cx=(camera.cx + 0.5) * parts - 0.5, cy=(camera.cy + 0.5) * parts - 0.5,
            distortion=camera.distortion,
        )  # fmt: skip
        values = look(fine.d_C @ X_WC.rotation().matrix().T)
        return values.reshape(camera.height, parts, camera.width, parts).mean(axis=(1, 3))


def small_change(rng, metres=0.03, degrees=2.0):
    """A change of that length and angle in a random direction."""
    w, t = rng.normal(size=(2, 3))
    return np.concatenate([np.deg2rad(degrees) * w / np.linalg.norm(w), metres * t / np.linalg.norm(t)])


def sweep_angles(step=7.0, pan=31.5, tilt=17.5):
    """A sweep in 7 degree steps over the view of the depth camera [rad], (V, 2)."""
    pans, tilts = np.arange(-pan, pan + 0.1, step), np.arange(-tilt, tilt + 0.1, step)
    return np.deg2rad([[p, t] for t in tilts for p in pans])


def nir_sweep(seed: int, angles: np.ndarray, rooms: int = 1) -> tuple[list[CalibrationView], RigidTransform]:
    """Views of a sweep, the depth image taken once a room, and the true X_HC."""
    rng = np.random.default_rng(seed)
    X_HC = changed(RigidTransform(LOOK_X, [0.05, 0.0, 0.03]), small_change(rng, 0.01, 1.5))
    views = []
    for r in range(rooms):
        room = Room.furnished(seed + 100 * r)
        depth = room.depth()
        for pan_tilt, R_NH in zip(angles, head_rotations(angles), strict=True):
            X_WC = X_WD @ X_DN @ RigidTransform(RotationMatrix(R_NH), np.zeros(3)) @ X_HC
            views.append(CalibrationView(depth, room.nir(X_WC), (float(pan_tilt[0]), float(pan_tilt[1]))))
    return views, X_HC


def thermal_views(seed: int, rooms: int, camera: CameraModel = THERMAL) -> tuple[list[CalibrationView], RigidTransform]:
    """One thermal image and one depth image of every room, and the true X_DC of the fixed camera."""
    rng = np.random.default_rng(seed)
    X_DC = changed(RigidTransform([0.06, -0.04, 0.0]), small_change(rng, 0.01, 1.5))
    views = []
    for r in range(rooms):
        room = Room.furnished(seed + 100 * r)
        views.append(CalibrationView(room.depth(), room.thermal(X_WD @ X_DC, camera)))
    return views, X_DC
