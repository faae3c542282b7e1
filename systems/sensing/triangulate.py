"""Drake's shapes as triangles."""

import tempfile
from pathlib import Path

import numpy as np
import open3d as o3d
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    HalfSpace,
    Mesh,
    ReadObjToTriangleSurfaceMesh,
    Shape,
    Sphere,
)

from ..errors import WorldError

# Half the width of the square that stands for a half space [m]; wide enough for any scene here.
HALF_SPACE_EXTENT = 1000.0
# Sides of a circle: the flat sides of a cylinder are at most 1 − cos(π/64) = 0.12 % of its radius inside.
CIRCLE_SIDES = 64


def triangulate(shape: Shape, name: str = "") -> tuple[np.ndarray, np.ndarray]:
    """Surface of `shape` in its own geometry frame.

    Round shapes are inscribed polyhedra. A half space is a square of 2 km about its origin. `Mesh` is taken as it is
    (.obj, and .gltf, .glb, .stl and .ply through Open3D), `Convex` as its hull.

    Args:
        name: of the geometry, for errors.

    Returns:
        Vertices (V, 3) float32 [m] and triangles (T, 3) uint32.

    Raises:
        WorldError: the kind of shape or of mesh file is not supported, or the file cannot be read.
    """
    if isinstance(shape, Box):
        vertices, triangles = _box(np.asarray(shape.size()) / 2)
    elif isinstance(shape, HalfSpace):
        corners = HALF_SPACE_EXTENT * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        vertices, triangles = corners, np.array([[0, 1, 2], [0, 2, 3]])
    elif isinstance(shape, Sphere):
        vertices, triangles = _ellipsoid(np.full(3, shape.radius()))
    elif isinstance(shape, Ellipsoid):
        vertices, triangles = _ellipsoid(np.array([shape.a(), shape.b(), shape.c()]))
    elif isinstance(shape, Cylinder):
        half = shape.length() / 2
        vertices, triangles = _turned(
            np.array([[0, -half], [shape.radius(), -half], [shape.radius(), half], [0, half]])
        )
    elif isinstance(shape, Capsule):
        arc = np.linspace(0, np.pi / 2, CIRCLE_SIDES // 4 + 1)
        cap = np.stack([shape.radius() * np.cos(arc), shape.length() / 2 + shape.radius() * np.sin(arc)], -1)
        cap[-1, 0] = 0
        vertices, triangles = _turned(np.vstack([cap[::-1] * [1, -1], cap]))
    elif isinstance(shape, Convex):
        vertices, triangles = _hull(shape)
    elif isinstance(shape, Mesh):
        vertices, triangles = _mesh(shape, name)
    else:
        raise WorldError("unsupported shape", where=name, value=type(shape).__name__, valid="Drake's solid shapes")
    return np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(triangles, np.uint32)


def _box(half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    vertices = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return vertices, np.array([[f[0], f[i], f[i + 1]] for f in faces for i in (1, 2)])


def _turned(profile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Surface of revolution about z of a profile (K, 2) of radius and z, from the bottom up.

    The radius at a pole must be 0 and not merely tiny, or rays along the axis slip through.
    """
    turn = 2 * np.pi * np.arange(CIRCLE_SIDES) / CIRCLE_SIDES
    radius, z = profile.T
    across = np.stack([np.outer(radius, np.cos(turn)), np.outer(radius, np.sin(turn))], -1)
    vertices = np.concatenate([across, np.broadcast_to(z[:, None, None], (*across.shape[:2], 1))], -1).reshape(-1, 3)
    here = np.arange(len(profile) - 1)[:, None] * CIRCLE_SIDES + np.arange(CIRCLE_SIDES)
    beside = np.roll(here, -1, axis=1)
    lower = np.stack([here, beside, beside + CIRCLE_SIDES], -1)
    upper = np.stack([here, beside + CIRCLE_SIDES, here + CIRCLE_SIDES], -1)
    # A pole has all its vertices at one point; triangles there with two equal corners are left out.
    triangles = np.concatenate([lower[radius[:-1] > 0], upper[radius[1:] > 0]])
    return vertices, triangles.reshape(-1, 3)


def _ellipsoid(radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    arc = np.linspace(-np.pi / 2, np.pi / 2, CIRCLE_SIDES // 2 + 1)
    profile = np.stack([np.cos(arc), np.sin(arc)], -1)
    profile[[0, -1], 0] = 0
    vertices, triangles = _turned(profile)
    return vertices * radii, triangles


def _hull(shape: Convex | Mesh) -> tuple[np.ndarray, np.ndarray]:
    hull = shape.GetConvexHull()
    vertices = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    triangles = []
    for e in range(hull.num_elements()):
        polygon = hull.element(e)
        corners = [polygon.vertex(i) for i in range(polygon.num_vertices())]
        triangles += [[corners[0], corners[i], corners[i + 1]] for i in range(1, len(corners) - 1)]
    return vertices, np.array(triangles)


def _mesh(shape: Mesh, name: str) -> tuple[np.ndarray, np.ndarray]:
    suffix = shape.extension()
    if suffix not in (".obj", ".gltf", ".glb", ".stl", ".ply"):
        valid = (".obj", ".gltf", ".glb", ".stl", ".ply")
        raise WorldError("unsupported kind of mesh file", where=name, value=suffix, valid=valid)
    source = shape.source()
    if source.is_path():
        return _read_mesh(Path(source.path()), shape.scale3(), name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"mesh{suffix}"
        path.write_bytes(source.in_memory().mesh_file.contents())
        for relative, file in source.in_memory().supporting_files.items():
            target = Path(folder) / relative
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(file.read_bytes() if isinstance(file, Path) else file.contents())
        return _read_mesh(path, shape.scale3(), name)


def _read_mesh(path: Path, scale: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    if not path.is_file():
        raise WorldError("no such mesh file", where=name, value=str(path))
    if path.suffix.lower() == ".obj":
        try:
            mesh = ReadObjToTriangleSurfaceMesh(path, scale3=scale)
        except RuntimeError as error:
            raise WorldError(f"cannot read mesh {path}: {error}", where=name) from None
        return np.array(mesh.vertices()), np.array([[t.vertex(i) for i in range(3)] for t in mesh.triangles()])
    mesh = o3d.t.io.read_triangle_mesh(str(path))
    if mesh.is_empty():
        raise WorldError("no triangles in mesh file", where=name, value=str(path))
    vertices = mesh.vertex.positions.numpy().astype(float)
    if path.suffix.lower() in (".gltf", ".glb"):
        vertices = vertices[:, [0, 2, 1]] * [1, -1, 1]  # glTF has y up, Drake has z up
    return vertices * scale, mesh.triangle.indices.numpy()
