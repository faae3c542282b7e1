"""Rays per second and time of a LiDAR scan, against bare Open3D and MuJoCo, on one core in one run.

Scenes: `terrain`, rough ground of 50 000 triangles with 40 boxes on it, and `room`, walls and 40 boxes. A VLP-16 of
28 800 rays stands in the middle. Ours are measured with the properties of every hit looked up, and as a whole scan:
sweep, casting (also at four flippers and a box that move), noise, dropout and cloud. MuJoCo casts into the same
geometry, with normals. Without `--scene` both run; values of the room then have `room_` after the contestant's name.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import open3d as o3d
from naraha.systems.sensing import LidarConfig, RayScene, Surface, SurfaceTable
from naraha.systems.sensing.lidar import configured_pattern, make_cloud, simulate_returns, sweep_rays
from naraha.systems.sensing.triangulate import triangulate
from pydrake.geometry import (
    Box,
    FrameId,
    GeometryFrame,
    GeometryInstance,
    Mesh,
    PerceptionProperties,
    SceneGraph,
    Shape,
)
from pydrake.math import RigidTransform, RollPitchYaw

from .report import print_table, time_in_turns, use_one_core, write_json

SENSOR = np.array([0.0, 0.0, 1.0])
CELLS = 158  # 2 · 158² = 49 928 triangles


def terrain() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of rough ground of 40 × 40 m, below 0.5 m within 5 m of the middle."""
    x, y = np.meshgrid(*[np.linspace(-20, 20, CELLS + 1)] * 2, indexing="ij")
    z = 0.3 * np.sin(x) * np.cos(0.7 * y) + 0.05 * np.random.default_rng(0).standard_normal(x.shape)
    z += 0.02 * np.maximum(0, np.hypot(x, y) - 5) ** 2
    corner = (np.arange(CELLS)[:, None] * (CELLS + 1) + np.arange(CELLS)).ravel()
    over, beside = corner + CELLS + 1, corner + 1
    faces = np.concatenate([np.stack([corner, over, over + 1], -1), np.stack([corner, over + 1, beside], -1)])
    return np.stack([x, y, z], -1).reshape(-1, 3), faces


def shapes(scene: str, folder: Path) -> list[tuple[str, Shape, RigidTransform]]:
    """Name, shape and pose of everything that stands still."""
    rng = np.random.default_rng(2)
    found: list[tuple[str, Shape, RigidTransform]] = []
    if scene == "terrain":
        vertices, faces = terrain()
        path = folder / "terrain.obj"
        lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
        path.write_text("\n".join(lines) + "\n")
        found.append(("ground", Mesh(str(path), 1.0), RigidTransform()))
    else:
        for axis, half in enumerate((12.0, 8.0, 2.0)):
            size = np.array([24.2, 16.2, 4.2])
            size[axis] = 0.1
            for sign in (-1, 1):
                centre = [0, 0, 2] + sign * (half + 0.05) * np.eye(3)[axis]
                found.append((f"wall_{axis}{sign}", Box(*size), RigidTransform(centre)))
    for i in range(40):
        angle, distance = rng.uniform(0, 2 * np.pi), rng.uniform(2.5, 7.5)
        size, yaw = rng.uniform([0.2, 0.2, 0.5], [1.0, 1.0, 2.0]), rng.uniform(0, np.pi)
        pose = RigidTransform(
            RollPitchYaw(0, 0, yaw), [distance * np.cos(angle), distance * np.sin(angle), size[2] / 2]
        )
        found.append((f"box_{i}", Box(*size), pose))
    return found


def build(scene: str, folder: Path) -> tuple[RayScene, dict[FrameId, RigidTransform], list[FrameId]]:
    """Scene for rays, poses of what moves, and the frames of these that belong to the robot."""
    scene_graph = SceneGraph()
    source = scene_graph.RegisterSource("benchmark")

    def instance(name: str, shape: Shape, pose: RigidTransform) -> GeometryInstance:
        geometry = GeometryInstance(pose, shape, name)
        geometry.set_perception_properties(PerceptionProperties())
        return geometry

    for name, shape, pose in shapes(scene, folder):
        scene_graph.RegisterAnchoredGeometry(source, instance(name, shape, pose))
    poses = {}
    for i in range(5):
        frame = scene_graph.RegisterFrame(source, GeometryFrame(f"moving_{i}"))
        size = (1.0, 1.0, 1.5) if i == 4 else (0.4, 0.08, 0.12)
        place = [1.8, 0.5, 0.9] if i == 4 else [0.6 * (-1) ** i, 0.25 * (-1) ** (i // 2), 0.85]
        scene_graph.RegisterGeometry(source, frame, instance(f"moving_{i}", Box(*size), RigidTransform()))
        poses[frame] = RigidTransform(place)
    surfaces = SurfaceTable(by_pattern={"box_*": Surface(label="box", lidar_reflectivity=0.6)})
    return RayScene(scene_graph.model_inspector(), surfaces, threads=1), poses, list(poses)[:4]


def bare_open3d(scene: str, folder: Path, rays: np.ndarray) -> Callable[[], object]:
    casting = o3d.t.geometry.RaycastingScene()
    for _, shape, pose in shapes(scene, folder):
        vertices, triangles = triangulate(shape)
        X = pose.GetAsMatrix4().astype(np.float32)
        vertices = np.ascontiguousarray(vertices @ X[:3, :3].T + X[:3, 3])
        casting.add_triangles(o3d.core.Tensor.from_numpy(vertices), o3d.core.Tensor.from_numpy(triangles))
    tensor = o3d.core.Tensor.from_numpy(rays)
    return lambda: casting.cast_rays(tensor, nthreads=1)


def bare_mujoco(scene: str, folder: Path, directions: np.ndarray) -> tuple[Callable[[], object], np.ndarray] | None:
    """A call of `mj_multiRay` and the array of distances that it fills, or None where MuJoCo is not installed."""
    try:
        import mujoco
    except ImportError:
        return None
    spec = mujoco.MjSpec()
    for name, shape, pose in shapes(scene, folder):
        place = {"pos": pose.translation(), "quat": pose.rotation().ToQuaternion().wxyz()}
        if isinstance(shape, Box):
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=shape.size() / 2, **place)
        else:
            vertices, triangles = triangulate(shape)
            mesh = spec.add_mesh(name=name, uservert=vertices.ravel(), userface=triangles.astype(np.int32).ravel())
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, **place)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    count = len(directions)
    directions = np.ascontiguousarray(directions, float).ravel()
    geometry, distance, normal = np.zeros(count, np.int32), np.zeros(count), np.zeros(3 * count)

    def cast() -> None:
        mujoco.mj_multiRay(
            model, data, SENSOR, directions, None, True, -1, geometry, distance, normal, count, mujoco.mjMAXVAL
        )

    return cast, distance


def measure(scene: str, repeats: int) -> dict[str, object]:
    """Times of all contestants on `scene`, by the names under which they are reported."""
    config = LidarConfig()
    pattern = configured_pattern(config)
    start = RigidTransform(SENSOR).GetAsMatrix4()
    end = (RigidTransform(SENSOR) @ RigidTransform(RollPitchYaw(0, 0, 0.05), [0.05, 0, 0])).GetAsMatrix4()
    own_distance = np.full(pattern.rays, np.inf, np.float32)
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ours, poses, own_frames = build(scene, folder)
        rays = np.concatenate([np.broadcast_to(SENSOR.astype(np.float32), pattern.d_S.shape), pattern.d_S], axis=1)
        open3d = bare_open3d(scene, folder, rays)
        mujoco = bare_mujoco(scene, folder, pattern.d_S)
    own_geometry = ours.geometries_of(own_frames)

    def cast_with_properties() -> tuple[np.ndarray, ...]:
        hits = ours.cast(SENSOR, pattern.d_S)
        names = (
            "lidar_reflectivity",
            "nir_reflectance",
            "specular",
            "temperature",
            "emissivity",
            "activity",
            "label_id",
        )
        return hits.distance, hits.incidence_cos, *(hits.lookup(name) for name in names)

    def scan() -> o3d.t.geometry.PointCloud:
        returns = simulate_returns(
            *sweep_rays(pattern, start, end),
            ours,
            rng,
            config=config,
            pattern=pattern,
            X_WF=poses,
            own_geometry=own_geometry,
            own_distance=own_distance,
        )
        return make_cloud(pattern, returns)

    contestants: dict[str, Callable[[], object]] = {
        "naraha": cast_with_properties,
        "open3d": open3d,
        "naraha_scan": scan,
    }
    times = time_in_turns(contestants, repeats=repeats)
    distance = cast_with_properties()[0]
    results: dict[str, object] = {
        "rays": pattern.rays,
        "triangles": ours.triangles,
        "hits": float(np.isfinite(distance).mean()),
        "naraha_rays_per_s": pattern.rays / times["naraha"],
        "open3d_rays_per_s": pattern.rays / times["open3d"],
        "naraha_scan_ms": 1e3 * times["naraha_scan"],
    }
    if mujoco is not None:
        cast, mujoco_distance = mujoco
        seconds = time_in_turns({"mujoco": cast}, repeats=min(repeats, 3))["mujoco"]
        results["mujoco_rays_per_s"] = pattern.rays / seconds
        both = np.isfinite(distance) & (mujoco_distance >= 0)
        results["mujoco_median_difference_m"] = float(np.median(np.abs(distance - mujoco_distance)[both]))
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=("terrain", "room"), help="both when not given")
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    parser.add_argument("--repeats", type=int, default=50, help="of every measurement, whose median counts")
    arguments = parser.parse_args()
    use_one_core()
    results: dict[str, object] = {}
    for scene in (arguments.scene,) if arguments.scene else ("terrain", "room"):
        found = measure(scene, arguments.repeats)
        rows = [
            (name, found[f"{name}_rays_per_s"] / 1e6)  # type: ignore[operator]
            for name in ("naraha", "open3d", "mujoco")
            if f"{name}_rays_per_s" in found
        ]
        print_table(f"{scene}: {found['triangles']} triangles, one core", ("cast", "million rays/s"), rows)
        print(f"whole scan of {found['rays']} rays: {found['naraha_scan_ms']:.2f} ms")
        if arguments.scene or scene == "terrain":
            results.update(found)
        else:
            for key, value in found.items():
                head, _, tail = key.partition("_")
                results[f"{head}_room_{tail}" if tail else f"room_{head}"] = value
    write_json(arguments.json, results)


if __name__ == "__main__":
    main()
