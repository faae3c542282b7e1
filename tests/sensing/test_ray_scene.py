"""Rays into SceneGraph geometry, against distances that are known on paper."""

import base64
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.errors import WorldError
from naraha.systems.sensing import RayScene, Surface, SurfaceTable, welded_frames
from naraha.systems.sensing.triangulate import triangulate
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    HalfSpace,
    InMemoryMesh,
    Mesh,
    MeshcatCone,
    RenderLabel,
    Role,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

# A tetrahedron with its right angle at the origin, seen from (1, 1, 1) its slanted face is 1/√3 away from the origin.
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
X, Y, Z = np.eye(3)


def unit(vector):
    return np.asarray(vector, float) / np.linalg.norm(vector)


def random_directions(rng, count):
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def obj_file(folder):
    path = folder / "tetrahedron.obj"
    path.write_text(OBJ)
    return path


def gltf_file(folder):
    """A tetrahedron whose corner on glTF's y axis, which is up, is 3 away."""
    corners = np.float32([[0, 0, 0], [1, 0, 0], [0, 3, 0], [0, 0, 2]])
    faces = np.uint16([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    data = corners.tobytes() + faces.tobytes()
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [
            {
                "byteLength": len(data),
                "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode(),
            }
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": corners.nbytes},
            {"buffer": 0, "byteOffset": corners.nbytes, "byteLength": faces.nbytes},
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 4,
                "type": "VEC3",
                "min": [0, 0, 0],
                "max": [1, 3, 2],
            },
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
    }
    path = folder / "tetrahedron.gltf"
    path.write_text(json.dumps(content))
    return path


# --- shapes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shape", "start", "direction", "distance", "cosine"),
    [
        (Box(2, 4, 6), 5 * X, -X, 4, 1),
        (Box(2, 4, 6), 5 * Y, -Y, 3, 1),
        (Box(2, 4, 6), -5 * Z, Z, 2, 1),
        (Box(2, 4, 6), [3, 0, 0], unit([-1, 0, 1]), np.sqrt(8), np.sqrt(0.5)),
        (HalfSpace(), [300, -200, 2], unit([1, 1, -1]), 2 * np.sqrt(3), 1 / np.sqrt(3)),
        (Sphere(0.5), 3 * X, -X, 2.5, 1),
        (Sphere(0.5), 3 * Z, -Z, 2.5, 1),
        (Ellipsoid(1, 2, 3), 5 * X, -X, 4, 1),
        (Ellipsoid(1, 2, 3), 5 * Y, -Y, 3, 1),
        (Ellipsoid(1, 2, 3), 5 * Z, -Z, 2, 1),
        (Cylinder(0.5, 2), 3 * Z, -Z, 2, 1),
        (Cylinder(0.5, 2), 3 * X, -X, 2.5, 1),
        (Cylinder(0.5, 2), [0.3, 0.2, -3], Z, 2, 1),
        (Capsule(0.5, 2), 3 * Z, -Z, 1.5, 1),
        (Capsule(0.5, 2), [3, 0, 0.7], -X, 2.5, 1),
    ],
)
def test_distance_and_incidence_of_a_shape_are_those_on_paper(make_world, shape, start, direction, distance, cosine):
    hits = make_world().add(shape).rays().cast(np.array(start), direction[None])
    # Round shapes are polyhedra of 64 sides: a vertex may be hit, where the normal is that of a neighbouring triangle.
    np.testing.assert_allclose(hits.distance, [distance], rtol=1e-6)
    np.testing.assert_allclose(hits.incidence_cos, [cosine], atol=6e-3)
    np.testing.assert_allclose(np.linalg.norm(hits.normal_W, axis=1), 1, rtol=1e-6)


@pytest.mark.parametrize(
    ("shape", "radius"),
    [
        (Sphere(0.5), lambda d: np.full(len(d), 0.5)),
        (Ellipsoid(1, 2, 3), lambda d: 1 / np.linalg.norm(d / [1, 2, 3], axis=1)),
        (Cylinder(0.5, 2), lambda d: np.minimum(0.5 / np.hypot(d[:, 0], d[:, 1]), 1 / np.abs(d[:, 2]))),
        (Box(2, 4, 6), lambda d: np.min([1, 2, 3] / np.abs(d), axis=1)),
    ],
)
def test_shape_is_closed_and_inscribed_within_a_part_in_four_hundred(make_world, shape, radius):
    directions = random_directions(np.random.default_rng(3), 20000)
    distance = make_world().add(shape).rays().cast(np.zeros(3), directions).distance
    ratio = distance / radius(directions)
    assert ratio.max() < 1 + 1e-5
    assert ratio.min() > 1 - 1 / 400


def test_capsule_is_closed_and_its_surface_is_its_radius_away_from_its_axis(make_world):
    directions = random_directions(np.random.default_rng(4), 20000)
    distance = make_world().add(Capsule(0.5, 2)).rays().cast(np.zeros(3), directions).distance
    points = distance[:, None] * directions
    points[:, 2] -= np.clip(points[:, 2], -1, 1)
    away = np.linalg.norm(points, axis=1)
    assert away.max() < 0.5 * (1 + 1e-5)
    assert away.min() > 0.5 * (1 - 1 / 400)


def test_mesh_and_its_hull_are_hit_where_they_are(make_world, tmp_path):
    path = str(obj_file(tmp_path))
    memory = InMemoryMesh(mesh_file=MemoryFile(OBJ.encode(), ".obj", "tetrahedron.obj"))
    for shape in (Mesh(path, 2.0), Convex(path, 2.0), Mesh(memory, [2, 2, 2])):
        hits = make_world().add(shape).rays().cast(np.array([2.0, 2, 2]), unit([-1, -1, -1])[None])
        np.testing.assert_allclose(hits.distance, [2 * np.sqrt(3) - 2 / np.sqrt(3)], rtol=1e-6)
        np.testing.assert_allclose(hits.incidence_cos, [1], rtol=1e-6)


def test_scale_of_a_mesh_can_differ_by_axis(tmp_path):
    vertices, _ = triangulate(Mesh(str(obj_file(tmp_path)), [1, 2, 3]))
    np.testing.assert_allclose(vertices.max(axis=0), [1, 2, 3])


def test_gltf_mesh_stands_where_drake_puts_it(tmp_path):
    shape = Mesh(str(gltf_file(tmp_path)), 1.0)
    vertices, triangles = triangulate(shape)
    hull = shape.GetConvexHull()
    corners = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    np.testing.assert_allclose(vertices.min(axis=0), corners.min(axis=0), atol=1e-6)
    np.testing.assert_allclose(vertices.max(axis=0), corners.max(axis=0), atol=1e-6)
    assert vertices[:, 2].max() == pytest.approx(3)
    assert len(triangles) == 4


def test_unusable_shapes_are_named(make_world, tmp_path):
    other = tmp_path / "shape.xyz"
    other.write_text("0 0 0\n")
    with pytest.raises(WorldError, match=r"wreck: unsupported kind of mesh file.*\.obj"):
        make_world().add(Mesh(str(other), 1.0), name="wreck").rays()
    with pytest.raises(WorldError, match="wreck: no such mesh file"):
        triangulate(Mesh(str(tmp_path / "none.obj"), 1.0), "wreck")
    (tmp_path / "empty.obj").write_text("v 0 0 0\n")
    with pytest.raises(WorldError, match="wreck: cannot read mesh"):
        triangulate(Mesh(str(tmp_path / "empty.obj"), 1.0), "wreck")
    with pytest.raises(WorldError, match="wreck: unsupported shape"):
        triangulate(MeshcatCone(1, 1, 1), "wreck")


# --- what is in the scene -------------------------------------------------------------------------------------------


def room(world, size=(10.0, 8.0, 4.0)):
    """Walls, floor and ceiling whose inner faces are at ± half the size."""
    for axis, name in enumerate("xyz"):
        for sign in (-1, 1):
            thick = np.array(size) + 0.2
            thick[axis] = 0.1
            world.add(Box(*thick), sign * (np.array(size) / 2 + 0.05) * np.eye(3)[axis], f"wall_{name}{sign}")
    return world


def test_room_is_hit_at_the_nearest_of_its_planes(make_world):
    scene = room(make_world()).rays()
    assert scene.triangles == 72
    rng = np.random.default_rng(1)
    half = np.array([5.0, 4, 2])
    starts = rng.uniform(-0.95, 0.95, (5000, 3)) * half
    directions = random_directions(rng, 5000)
    hits = scene.cast(starts, directions)
    to_planes = (np.sign(directions) * half - starts) / directions
    np.testing.assert_allclose(hits.distance, to_planes.min(axis=1), rtol=2e-5)
    axis = to_planes.argmin(axis=1)
    np.testing.assert_allclose(hits.incidence_cos, np.abs(directions[range(5000), axis]), atol=1e-6)
    names = [f"wall_{'xyz'[a]}{int(np.sign(directions[i, a]))}" for i, a in enumerate(axis)]
    assert [scene.names[g] for g in hits.geometry] == names


def test_empty_space_gives_no_hit(make_world):
    hits = make_world().add(Box(1, 1, 1), name="box").rays().cast(np.array([0, 0, 2.0]), Z[None])
    assert np.isinf(hits.distance[0])
    assert hits.geometry[0] == -1
    assert hits.incidence_cos[0] == 0
    assert hits.lookup("lidar_reflectivity")[0] == 0
    assert hits.lookup("label_id")[0] == -1
    assert np.isnan(hits.lookup("temperature")[0])


def test_no_rays_give_no_hits(make_world):
    world = make_world()
    frame = world.frame("f")
    hits = world.add(Sphere(1), frame=frame).rays().cast(np.zeros((0, 3)), np.zeros((0, 3)), {frame: RigidTransform()})
    assert hits.distance.shape == hits.geometry.shape == hits.incidence_cos.shape == (0,)


def test_every_hit_has_the_properties_of_its_surface(make_world):
    world = make_world().add(HalfSpace(), name="floor").add(Box(2, 2, 0.02), [5, 0, 0.01], "puddle")
    frame = world.frame("stove")
    world.add(Box(1, 1, 1), name="stove", frame=frame)
    table = SurfaceTable(
        by_pattern={
            "puddle": Surface(label="water", nir_reflectance=0.02),
            "stove": Surface(label="heat", temperature=80, activity=3),
        },
        default=Surface(label="floor"),
    )
    scene = world.rays(table)
    starts = np.array([[0, 0, 2], [5, 0, 2], [-5, 0, 2.0]])
    hits = scene.cast(starts, np.tile(-Z, (3, 1)), {frame: RigidTransform([-5, 0, 0.5])})
    np.testing.assert_allclose(hits.distance, [2, 1.98, 1], rtol=1e-6)
    assert [hits.surface.labels[i] for i in hits.lookup("label_id")] == ["floor", "water", "heat"]
    np.testing.assert_array_equal(hits.lookup("temperature"), np.float32([20, 20, 80]))
    np.testing.assert_array_equal(hits.lookup("nir_reflectance"), np.float32([0.4, 0.02, 0.4]))
    np.testing.assert_array_equal(hits.lookup("activity"), np.float32([0, 0, 3]))


def test_geometries_can_be_left_out_by_name_or_render_label(make_world):
    world = make_world().add(Box(1, 1, 1), [2, 0, 0], "curtain_1").add(Box(1, 1, 1), [4, 0, 0], "wall")
    world.add(Box(1, 1, 1), [-4, 0, 0], "ghost", label=RenderLabel.kDoNotRender)
    scene = world.rays(exclude=["curtain*"])
    assert scene.names == ("wall",)
    np.testing.assert_allclose(scene.cast(np.zeros(3), np.array([X, -X])).distance, [3.5, np.inf])


def test_role_falls_back_only_when_nothing_has_it(make_world):
    world = make_world().add(Box(1, 1, 1), [4, 0, 0], "collision", role=Role.kProximity)
    assert world.rays().names == ("collision",)
    world.add(Box(1, 1, 1), [4, 0, 0], "drawing", role=Role.kIllustration)
    assert world.rays().names == ("drawing",)
    world.add(Box(1, 1, 1), [4, 0, 0], "seen")
    assert world.rays().names == ("seen",)
    assert world.rays(role=Role.kProximity).names == ("collision",)


def test_scene_without_geometry_is_refused(make_world):
    with pytest.raises(WorldError, match="no geometry that rays could hit"):
        make_world().rays()
    with pytest.raises(WorldError, match="no geometry that rays could hit"):
        make_world().add(Sphere(1), name="ball").rays(exclude=["*"])


# --- moving frames --------------------------------------------------------------------------------------------------

poses = st.builds(
    lambda rpy, p: RigidTransform(RollPitchYaw(rpy), np.array(p)),
    st.tuples(*[st.floats(-3, 3)] * 3),
    st.tuples(*[st.floats(-4, 4)] * 3),
)


@settings(max_examples=60, deadline=None)
@given(X_WF=poses, spread=st.sampled_from([0.0, 0.05, 6.0]), seed=st.integers(0, 100))
def test_moving_geometry_is_hit_as_if_it_were_anchored_at_its_pose(make_world, X_WF, spread, seed):
    """Also tests that no ray that meets the geometry is left out by its bounding sphere."""
    parts = [(Box(1, 2, 0.5), RigidTransform([1, 0, 0])), (Sphere(0.3), RigidTransform([0, 1, 1]))]
    moving, anchored = make_world(), make_world()
    frame = moving.frame("f")
    for world in (moving, anchored):
        world.add(HalfSpace(), [0, 0, -1], "floor")
    for i, (shape, X_FG) in enumerate(parts):
        moving.add(shape, X_FG, f"part_{i}", frame)
        anchored.add(shape, X_WF @ X_FG, f"part_{i}")
    rng = np.random.default_rng(seed)
    starts = rng.uniform(-spread, spread, (3000, 3)).astype(np.float32)
    directions = random_directions(rng, 3000).astype(np.float32)
    a = moving.rays().cast(starts, directions, {frame: X_WF})
    b = anchored.rays().cast(starts, directions)
    same = np.isclose(a.distance, b.distance, rtol=1e-4, atol=1e-5)
    # Single rays that graze an edge may differ by rounding.
    assert np.count_nonzero(~same) <= 3
    np.testing.assert_array_equal(a.geometry[same], b.geometry[same])
    # Where two facets of the sphere meet, either normal may be told at the same distance.
    other_facet = same & ~np.isclose(a.incidence_cos, b.incidence_cos, rtol=0, atol=1e-3)
    assert np.count_nonzero(other_facet) + np.count_nonzero(~same) <= 3
    assert all(scene.names[i].endswith("part_1") for scene in [moving.rays()] for i in a.geometry[other_facet])


@pytest.mark.parametrize("distance", [0.6, 2.0, 40.0])
def test_moving_ball_that_fills_its_bounding_sphere_is_hit_up_to_its_limb(make_world, distance):
    world = make_world()
    frame = world.frame("ball")
    scene = world.add(Sphere(0.5), name="ball", frame=frame).rays()
    limb = np.arcsin(0.5 / distance)
    off, around = np.random.default_rng(0).uniform([0, 0], [1.5 * limb, 2 * np.pi], (20000, 2)).T
    off = np.minimum(off, np.pi)
    directions = np.stack([np.cos(off), np.sin(off) * np.cos(around), np.sin(off) * np.sin(around)], -1)
    hit = np.isfinite(scene.cast(np.zeros(3), directions, {frame: RigidTransform([distance, 0, 0])}).distance)
    assert hit[off < 0.995 * limb].all()
    assert not hit[off > limb].any()


def test_moving_frame_without_a_pose_is_not_there(make_world):
    world = make_world().add(HalfSpace(), name="floor")
    frame, empty = world.frame("box"), world.frame("empty")
    scene = world.add(Box(1, 1, 1), name="box", frame=frame).rays()
    start, down = np.array([0, 0, 3.0]), -Z[None]
    assert scene.moving_frames == (frame,)
    assert scene.cast(start, down).distance[0] == 3
    assert scene.cast(start, down, {empty: RigidTransform()}).distance[0] == 3
    assert scene.cast(start, down, {frame: RigidTransform([0, 0, 1])}).distance[0] == pytest.approx(1.5)
    assert scene.cast(start, down, {frame: RigidTransform([0, 0, -5])}).distance[0] == 3
    assert np.isinf(scene.cast(start, down, static=False).distance[0])


def test_geometries_of_frames_are_found_by_hit(make_world):
    world = make_world().add(HalfSpace(), name="floor")
    frame = world.frame("box")
    scene = world.add(Box(1, 1, 1), name="box", frame=frame).rays()
    starts = np.array([[0, 0, 3.0], [5, 0, 3.0], [0, 0, -1]])
    hits = scene.cast(starts, np.array([-Z, -Z, -Z]), {frame: RigidTransform([0, 0, 1])})
    np.testing.assert_array_equal(scene.geometries_of([frame])[hits.geometry], [True, False, False])
    np.testing.assert_array_equal(scene.geometries_of([])[hits.geometry], [False, False, False])


def test_more_threads_give_the_same_hits(make_world):
    world = room(make_world())
    directions = random_directions(np.random.default_rng(0), 5000)
    one, all_of_them = (world.rays(threads=n).cast(np.zeros(3), directions) for n in (1, 0))
    np.testing.assert_array_equal(one.distance, all_of_them.distance)
    np.testing.assert_array_equal(one.geometry, all_of_them.geometry)


# --- with a MultibodyPlant ------------------------------------------------------------------------------------------

URDF = """
<robot name="hall">
  <link name="pillar"><visual><origin xyz="0 0 1"/><geometry><box size="1 1 2"/></geometry></visual></link>
  <link name="beam"><visual><geometry><box size="4 0.2 0.2"/></geometry></visual></link>
  <link name="door">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><box size="0.1 1 2"/></geometry></visual>
  </link>
  <joint name="top" type="fixed"><parent link="pillar"/><child link="beam"/><origin xyz="0 0 2.5"/></joint>
  <joint name="hinge" type="revolute">
    <parent link="pillar"/><child link="door"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/>
  </joint>
</robot>
"""


def hall():
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.001)
    Parser(plant).AddModelsFromString(URDF, "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("pillar"), RigidTransform([3, 0, 0]))
    plant.Finalize()
    return plant, scene_graph.model_inspector()


def test_bodies_welded_to_the_world_count_as_static():
    plant, inspector = hall()
    fixed = welded_frames(plant, plant.world_body())
    scene = RayScene(inspector, fixed_frames=fixed)
    assert len(RayScene(inspector).moving_frames) == 3
    assert scene.moving_frames == (plant.GetBodyFrameIdOrThrow(plant.GetBodyByName("door").index()),)
    starts = np.array([[0, 0, 1], [4, 0, 5.0]])
    np.testing.assert_allclose(scene.cast(starts, np.array([X, -Z])).distance, [2.5, 2.4], rtol=1e-6)


def test_welded_frames_are_those_of_the_body_and_what_is_fixed_to_it():
    plant, _ = hall()
    frames = welded_frames(plant, plant.GetBodyByName("beam"))
    pillar = frames[plant.GetBodyFrameIdOrThrow(plant.GetBodyByName("pillar").index())]
    np.testing.assert_allclose(pillar.translation(), [0, 0, -2.5])
    door = plant.GetBodyByName("door")
    assert list(welded_frames(plant, door)) == [plant.GetBodyFrameIdOrThrow(door.index())]


def test_distance_to_surface_is_that_to_the_nearest_static_point(make_world):
    world = make_world().add(Box(2, 2, 2), name="box")
    frame = world.frame("moving")
    scene = world.add(Sphere(1), frame=frame).rays()
    points = np.array([[3, 0, 0], [2, 2, 0], [2, 2, 2], [0, 0, 0.25], [1, 0.3, 0.2]])
    np.testing.assert_allclose(scene.distance_to_surface(points), [2, np.sqrt(2), np.sqrt(3), 0.75, 0], atol=1e-6)
    only_moving = make_world()
    only_moving.add(Sphere(1), frame=only_moving.frame("moving"))
    assert np.isinf(only_moving.rays().distance_to_surface(np.zeros((1, 3)))).all()


# --- attenuation ----------------------------------------------------------------------------------------------------


def solid(attenuation):
    return Surface(attenuation=attenuation)


def test_depth_of_a_slab_grows_with_the_slant(make_world):
    scene = make_world().add(Box(0.2, 10, 10), name="slab").rays(SurfaceTable(default=solid(5.0)))
    starts = np.array([[-1, 0, 0], [-1, 0, 0], [-1, 0.3, 0.2], [-1, 0, 0]])
    ends = np.array([[1, 0, 0], [1, 2, 0], [1, 1.3, -0.8], [-0.2, 4, 0]])
    along = np.linalg.norm(ends - starts, axis=1) / np.abs(ends - starts)[:, 0]
    expected = 5.0 * 0.2 * along
    expected[3] = 0  # ends before the slab
    np.testing.assert_allclose(scene.attenuation_along(starts, ends), expected, rtol=1e-5)
    np.testing.assert_allclose(scene.attenuation_along(ends, starts), expected, rtol=1e-5)


def test_depths_of_several_solids_add_up(make_world):
    world = make_world().add(Box(0.2, 10, 10), [0, 0, 0], "near").add(Box(0.3, 10, 10), [0.25, 0, 0], "touching")
    world.add(Box(0.1, 10, 10), [3, 0, 0], "far").add(HalfSpace(), [0, 0, -1], "ground")
    table = SurfaceTable(by_pattern={"near": solid(2), "touching": solid(3), "far": solid(7), "ground": solid(100)})
    depth = world.rays(table).attenuation_along(np.array([[-1, 0.1, 0.2], [2, 0.1, 0.2], [-1, 0, 5]]), [5, 0.1, 0.2])
    direct = 0.2 * 2 + 0.3 * 3 + 0.1 * 7
    slanted = np.linalg.norm([6, 0.1, 4.8]) / 6 * direct
    np.testing.assert_allclose(depth, [direct, 0.7, slanted], rtol=1e-5)


@pytest.mark.parametrize("offset", [0.0, 0.1, 0.3, 0.45])
def test_depth_of_a_cylinder_is_that_of_its_chord(make_world, offset):
    scene = make_world().add(Cylinder(0.5, 2), name="post").rays(SurfaceTable(default=solid(10)))
    depth = scene.attenuation_along(np.array([[-2, offset, 0.1]]), np.array([2, offset, 0.1]))
    np.testing.assert_allclose(depth, [10 * 2 * np.sqrt(0.25 - offset**2)], rtol=8e-3)  # 64 sides


def test_line_that_starts_or_ends_inside_a_solid_counts_what_is_inside(make_world):
    scene = make_world().add(Box(2, 2, 2), name="box").rays(SurfaceTable(default=solid(4)))
    starts = np.array([[0.3, 0, 0.1], [3, 0, 0.1], [0.2, 0.1, 0.1], [0.5, 0.5, 0.5]])
    ends = np.array([[3, 0, 0.1], [0.3, 0, 0.1], [0.2, 0.6, 0.1], [0.5, 0.5, 0.5]])
    np.testing.assert_allclose(scene.attenuation_along(starts, ends), [2.8, 2.8, 2.0, 0.0], rtol=1e-5, atol=1e-6)


def test_line_through_edges_and_corners_of_triangles_counts_each_solid_once(make_world):
    scene = make_world().add(Box(2, 2, 2), name="box").rays(SurfaceTable(default=solid(1)))
    starts = np.array([[-3, 0, 0], [-3, 0.4, 0.4], [-3, -3, 0], [-2, -2, -2], [-3, 1.0, 0]])
    ends = np.array([[3, 0, 0], [3, 0.4, 0.4], [3, 3, 0], [2, 2, 2], [3, 1.001, 0]])
    depth = scene.attenuation_along(starts, ends)
    np.testing.assert_allclose(depth[:4], [2, 2, np.sqrt(8), np.sqrt(12)], rtol=1e-4)
    assert 0 <= depth[4] <= 2


@pytest.mark.parametrize("file", [obj_file, gltf_file])
def test_mesh_attenuates_whichever_way_its_triangles_turn(make_world, tmp_path, file):
    for scale in (2.0, [-2.0, 2.0, 2.0]):
        scene = make_world().add(Mesh(str(file(tmp_path)), scale), name="mesh").rays(SurfaceTable(default=solid(3)))
        inside = np.sign(scale if np.isscalar(scale) else scale[0]) * np.array([0.2, 0, 0]) + [0, 0.2, 0.2]
        if file is gltf_file:
            inside[1] *= -1
        below = inside - [0, 0, 1]
        depth = scene.attenuation_along(below[None], inside)
        np.testing.assert_allclose(depth, [3 * 0.2], rtol=1e-4)


@settings(max_examples=30, deadline=None)
@given(X_WF=poses, seed=st.integers(0, 100))
def test_moving_solids_attenuate_as_if_they_were_anchored(make_world, X_WF, seed):
    moving, anchored = make_world(), make_world()
    frame = moving.frame("f")
    moving.add(Box(1, 2, 0.5), [1, 0, 0], "box", frame).add(Sphere(0.4), [0, 0, 1], "ball")
    anchored.add(Box(1, 2, 0.5), X_WF @ RigidTransform([1, 0, 0]), "box").add(Sphere(0.4), [0, 0, 1], "ball")
    starts, ends = np.random.default_rng(seed).uniform(-4, 4, (2, 200, 3))
    depth = moving.rays().attenuation_along(starts, ends, {frame: X_WF})
    np.testing.assert_allclose(depth, anchored.rays().attenuation_along(starts, ends), atol=1e-3)
    without = moving.rays().attenuation_along(starts, ends)
    np.testing.assert_allclose(without, make_ball_alone(make_world).attenuation_along(starts, ends), atol=1e-5)


def make_ball_alone(make_world):
    return make_world().add(Sphere(0.4), [0, 0, 1], "ball").rays()


def test_sources_are_the_geometries_with_an_activity(make_world):
    world = make_world().add(Box(1, 1, 1), [1, 2, 3], "drum")
    frame = world.frame("cart")
    world.add(Sphere(0.2), [0, 0, 0.5], "vial", frame).add(Sphere(0.2), [5, 0, 0], "ball")
    table = SurfaceTable(by_pattern={"drum": Surface(activity=50), "vial": Surface(activity=3)})
    drum, vial = world.rays(table).sources
    assert (drum.name, drum.frame, drum.activity) == ("drum", None, 50)
    assert (vial.name, vial.frame, vial.activity) == ("vial", frame, 3)
    np.testing.assert_allclose(drum.p_FQ, [1, 2, 3])
    np.testing.assert_allclose(vial.p_FQ, [0, 0, 0.5], atol=1e-6)
    assert world.rays().sources == ()


def test_the_nearest_geometry_is_that_of_the_nearest_surface(make_world):
    scene = make_world().add(Box(1, 1, 1), [0, 0, 0], "near").add(Box(1, 1, 1), [4, 0, 0], "far").rays()
    points = np.array([[0.0, 0, 0.9], [1.9, 0, 0], [2.1, 0, 0], [4, 0, 0.1], [9, 9, 9]])
    found = [scene.names[i].rpartition("::")[2] for i in scene.nearest_geometry(points)]
    assert found == ["near", "near", "far", "far", "far"]
