"""Time to fuse one depth view of 640 × 480 with one image, on one core: the whole of Eq. 1 with hidden points left out.

`nir` is an image of 128 × 128 pixels, 8° × 8°, with a lamp; `wide` one of 640 × 480 as wide as the depth view, beside
it, without a lamp: the worst case. Both start at the depth image: unprojection, motion, projection, visibility,
sampling, reflectance and running sums. `unculled` projects every point in float64, rounds to pixels and looks them up,
the way that a few lines of numpy do it; `open3d` lets Open3D make a cloud of the depth image and project it with
`project_to_rgbd_image`. Neither knows hidden points, weights or reflectance.
"""

import argparse
from collections.abc import Callable

import numpy as np
import open3d as o3d
from naraha.systems.fusion.camera_view import CameraView, LampConfig
from naraha.systems.fusion.painting import paint
from naraha.systems.fusion.projection import move_rows
from naraha.systems.sensing.camera_model import R_OPTICAL, CameraModel
from pydrake.math import RigidTransform, RollPitchYaw

from .report import print_table, time_in_turns, use_one_core, write_json

DEPTH = CameraModel.from_fov(640, 480, *np.deg2rad([69.4, 42.5]))
NIR = CameraModel.from_fov(128, 128, *np.deg2rad([8.0, 8.0]))
X_BD = RigidTransform(RollPitchYaw(0, np.deg2rad(10), 0), [0.1, 0.0, 0.48]) @ RigidTransform(R_OPTICAL)
X_BC = RigidTransform(RollPitchYaw(0, np.deg2rad(12), 0.1), [0.1, -0.1, 0.48]) @ RigidTransform(R_OPTICAL)
LAMP = LampConfig(p_BL=[0.12, 0.0, 0.36])


def depth_view(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Depth image of a floor, a wall 4 m ahead and a pillar 2 m ahead, with the noise of a D415; and the normals."""
    d_B = DEPTH.d_C.astype(float) @ X_BD.rotation().matrix().T
    start = X_BD.translation()
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(d_B[:, 2] < 0, (-0.08 - start[2]) / d_B[:, 2], np.inf)
        wall = (4 - start[0]) / d_B[:, 0]
        pillar = (2 - start[0]) / d_B[:, 0]
    pillar[np.abs(start[1] + pillar * d_B[:, 1]) > 0.2] = np.inf
    surface = np.argmin([floor, wall, pillar], axis=0)
    depth = np.min([floor, wall, pillar], axis=0) * DEPTH.d_C[:, 2]
    depth += 0.003 * depth**2 * rng.standard_normal(len(depth))
    normals = np.array([[0, 0, 1], [-1, 0, 0], [-1, 0, 0]], np.float32)[surface]
    return depth.reshape(DEPTH.shape).astype(np.float32), normals


def fuse(
    depth: np.ndarray, normals: np.ndarray, image: np.ndarray, camera: CameraModel, lamp: LampConfig | None
) -> int:
    """Number of points that were painted."""
    p_BP = move_rows(DEPTH.unproject(depth), X_BD.rotation().matrix(), X_BD.translation()).T
    view = CameraView(0.1, X_BC, RigidTransform([0.02, 0.0, 0.0]), image)
    return paint(p_BP, normals, RigidTransform(), view, camera, lamp=lamp).newly


def unculled(depth: np.ndarray, image: np.ndarray, camera: CameraModel) -> int:
    """Everything projected, in the way of a first version."""
    v, u = np.mgrid[: DEPTH.height, : DEPTH.width]
    z = depth.astype(float)
    p_D = np.stack([(u - DEPTH.cx) / DEPTH.fx * z, (v - DEPTH.cy) / DEPTH.fy * z, z, np.ones_like(z)], -1)
    p_C = p_D.reshape(-1, 4) @ (X_BC.inverse() @ X_BD).GetAsMatrix4().T
    A = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    m = p_C[:, :3] @ A.T
    uv = np.round(m[:, :2] / m[:, 2:]).astype(int)
    inside = (m[:, 2] > 0) & (uv >= 0).all(axis=1) & (uv < [camera.width, camera.height]).all(axis=1)
    values = np.full(len(uv), np.nan)
    values[inside] = image[uv[inside, 1], uv[inside, 0]]
    return int(inside.sum())


def open3d_projection(depth: np.ndarray, camera: CameraModel) -> Callable[[], object]:
    def tensor(A: CameraModel) -> o3d.core.Tensor:
        return o3d.core.Tensor(np.array([[A.fx, 0, A.cx], [0, A.fy, A.cy], [0, 0, 1.0]]))

    image = o3d.t.geometry.Image(o3d.core.Tensor(depth[:, :, None]))
    colors = o3d.core.Tensor(np.ones((depth.size, 3), np.float32))
    extrinsics = o3d.core.Tensor((X_BC.inverse() @ X_BD).GetAsMatrix4())

    def project() -> object:
        cloud = o3d.t.geometry.PointCloud.create_from_depth_image(image, tensor(DEPTH), depth_scale=1.0, depth_max=20.0)
        cloud.point.colors = colors[: len(cloud.point.positions)]
        return cloud.project_to_rgbd_image(
            camera.width, camera.height, tensor(camera), extrinsics, depth_scale=1.0, depth_max=20.0
        )

    return project


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    parser.add_argument("--repeats", type=int, default=30, help="of every measurement, whose median counts")
    arguments = parser.parse_args()
    use_one_core()
    rng = np.random.default_rng(0)
    depth, normals = depth_view(rng)
    images = {"nir": (NIR, LAMP), "wide": (DEPTH, None)}
    results: dict[str, object] = {"points": depth.size}
    rows = []
    for name, (camera, lamp) in images.items():
        image = rng.uniform(0, 1, camera.shape).astype(np.float32)
        contestants: dict[str, Callable[[], object]] = {
            "naraha": lambda image=image, camera=camera, lamp=lamp: fuse(depth, normals, image, camera, lamp),
            "unculled": lambda image=image, camera=camera: unculled(depth, image, camera),
            "open3d": open3d_projection(depth, camera),
        }
        times = time_in_turns(
            contestants, repeats=arguments.repeats if name == "nir" else max(3, arguments.repeats // 5)
        )
        painted = fuse(depth, normals, image, camera, lamp)
        results[f"{name}_painted"] = painted
        results |= {f"{name}_{who}_ms": 1e3 * seconds for who, seconds in times.items()}
        results[f"{name}_times_unculled"] = times["naraha"] / times["unculled"]
        rows.append((name, painted, *(1e3 * times[who] for who in ("naraha", "unculled", "open3d"))))
    columns = ("image", "points painted", "naraha ms", "unculled ms", "open3d ms")
    print_table(f"depth view of {depth.size} points, one core", columns, rows)
    write_json(arguments.json, results)


if __name__ == "__main__":
    main()
