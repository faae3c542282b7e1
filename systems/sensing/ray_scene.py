"""Ray casting into the geometry of a SceneGraph, which Drake itself does not offer."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from pydrake.geometry import FrameId, GeometryId, RenderLabel, Role, SceneGraphInspector
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from ..errors import WorldError
from .solids import inside_lengths, outward_normals
from .surfaces import SurfaceArrays, SurfaceTable, name_matches, surface_arrays
from .triangulate import triangulate

_ROLE_NAMES = {Role.kPerception: "perception", Role.kIllustration: "illustration", Role.kProximity: "proximity"}


@dataclass(frozen=True, eq=False)
class RayHits:
    """What N rays met first.

    Attributes:
        distance: (N,) float32 [m], infinite where a ray met nothing.
        geometry: (N,) int32, index into `RayScene.names`, -1 where a ray met nothing.
        normal_W: (N, 3) float32, unit normal of the triangle that was hit; either side of the surface can be the front.
        incidence_cos: (N,) float32, cosine of the angle between ray and normal, 0 to 1; 0 where a ray met nothing.
        surface: properties of all geometries; see `lookup`.
    """

    distance: np.ndarray
    geometry: np.ndarray
    normal_W: np.ndarray
    incidence_cos: np.ndarray
    surface: SurfaceArrays

    def lookup(self, name: str) -> np.ndarray:
        """Property `name` of `SurfaceArrays` for every ray, (N,): `hits.lookup("temperature")`."""
        # Index -1 means the last entry, as when indexing with it, but three times as fast.
        return getattr(self.surface, name).take(self.geometry, mode="wrap")


@dataclass(frozen=True)
class RaySource:
    """A geometry that is a radioactive source.

    Attributes:
        name: of the geometry.
        frame: its frame F, None where it never moves.
        p_FQ: centre of its bounding box in F, in W without a frame [m].
        activity: [MBq].
    """

    name: str
    frame: FrameId | None
    p_FQ: tuple[float, float, float]
    activity: float


@dataclass(frozen=True, eq=False)
class _MovingFrame:
    """Geometry of one frame F: its ray-casting scene in F and the sphere around it."""

    scene: o3d.t.geometry.RaycastingScene
    first_geometry: int
    p_FC: np.ndarray
    radius: float


def welded_frames(plant: MultibodyPlant, body: RigidBody) -> dict[FrameId, RigidTransform]:
    """Pose X_BF of every SceneGraph frame F that is welded to `body` B, directly or through others, B's own included.

    MultibodyPlant gives every body a frame of its own, also those that are welded to the world: a `RayScene` must be
    told by `welded_frames(plant, plant.world_body())` that they never move, a `Lidar` which of them ride with it.
    """
    context = plant.CreateDefaultContext()
    frames = {}
    for other in plant.GetBodiesWeldedTo(body):
        frame = plant.GetBodyFrameIdIfExists(other.index())
        if frame is not None:
            frames[frame] = plant.CalcRelativeTransform(context, body.body_frame(), other.body_frame())
    return frames


class RayScene:
    """Triangles of a SceneGraph, ready for ray casting, with the surface properties of every geometry.

    Drake has queries for signed distance, penetration and rendered images but none for rays. Here every shape with the
    wanted role becomes triangles of an Open3D `RaycastingScene` (Embree): one scene for everything that never moves,
    and one for every moving frame, in that frame, where only rays that meet its bounding sphere are cast. Nothing is
    rebuilt when bodies move. The scene is that of the moment of construction: later changes of the SceneGraph do not
    show. Deformable bodies are left out, and so are geometries with the render label `kDoNotRender`.

    Attributes:
        names: scoped name of every geometry, first those that never move.
        frames: frame of every geometry.
        surface: properties of every geometry.
        moving_frames: frames that have geometry and can move.
        triangles: number of triangles.
        sources: the geometries whose surface has an activity.
    """

    def __init__(
        self,
        inspector: SceneGraphInspector,
        surfaces: SurfaceTable | None = None,
        *,
        role: Role = Role.kPerception,
        fixed_frames: Mapping[FrameId, RigidTransform] | None = None,
        exclude: Sequence[str] = (),
        threads: int = 1,
    ):
        """
        Args:
            inspector: `scene_graph.model_inspector()`, or that of a query object.
            surfaces: properties by geometry name; dull grey concrete for all when not given.
            role: which geometries count. If none has it at all, those with the illustration role, and if there are
                none either, the proximity role.
            fixed_frames: poses X_WF of frames that never move; see `welded_frames`. Geometry anchored to the world
                always counts as such.
            exclude: patterns of geometry names to leave out, matched as in `SurfaceTable`.
            threads: for casting; one thread is right when several simulations run side by side, 0 takes all.

        Raises:
            WorldError: there is no geometry, or a shape or mesh file is not supported.
        """
        table = SurfaceTable() if surfaces is None else surfaces
        fixed = {inspector.world_frame_id(): RigidTransform(), **(fixed_frames or {})}
        seen = _with_role(inspector, role)
        chosen = [g for g in seen if not any(name_matches(inspector.GetName(g), pattern) for pattern in exclude)]
        if not chosen:
            raise WorldError("no geometry that rays could hit", where="ray scene", valid=list(_ROLE_NAMES.values()))
        by_frame: dict[FrameId, list[GeometryId]] = {}
        for geometry in chosen:
            by_frame.setdefault(inspector.GetFrameId(geometry), []).append(geometry)
        self.threads = threads
        self.triangles = 0
        self.frames: list[FrameId] = []
        names: list[str] = []
        outward: list[np.ndarray] = []
        centres: list[np.ndarray] = []
        self._static = o3d.t.geometry.RaycastingScene()
        self._moving: dict[FrameId, _MovingFrame] = {}
        # What never moves, then frame by frame, so that Open3D's geometry ids are indices into `names`.
        for frame in sorted(by_frame, key=lambda f: f not in fixed):
            scene = self._static if frame in fixed else o3d.t.geometry.RaycastingScene()
            first = len(names)
            corners = []
            for geometry in by_frame[frame]:
                name = inspector.GetName(geometry)
                vertices, triangles = _surface(inspector, geometry, fixed.get(frame, RigidTransform()))
                scene.add_triangles(o3d.core.Tensor.from_numpy(vertices), o3d.core.Tensor.from_numpy(triangles))
                self.triangles += len(triangles)
                corners.append(vertices)
                outward.append(outward_normals(vertices, triangles))
                centres.append((vertices.min(axis=0) + vertices.max(axis=0)) / 2)
                names.append(name)
                self.frames.append(frame)
            if frame not in fixed:
                self._moving[frame] = _MovingFrame(scene, first, *_ball_around(np.concatenate(corners).astype(float)))
        self._has_static = len(self._moving) < len(by_frame)
        self.names = tuple(names)
        self.moving_frames = tuple(self._moving)
        self.surface = surface_arrays([table.lookup(name) for name in names])
        # Normals of all triangles, geometry after geometry, and where each geometry's begin.
        self._outward = np.concatenate(outward)
        self._first_triangle = np.cumsum([0, *(len(normals) for normals in outward[:-1])])
        self.sources = tuple(
            RaySource(
                names[i],
                self.frames[i] if self.frames[i] in self._moving else None,
                (float(centres[i][0]), float(centres[i][1]), float(centres[i][2])),
                float(self.surface.activity[i]),
            )
            for i in np.flatnonzero(self.surface.activity > 0)
        )

    def geometries_of(self, frames: Collection[FrameId]) -> np.ndarray:
        """Which geometries belong to `frames`, (G + 1,) bool, to be indexed by `RayHits.geometry` (-1 gives False)."""
        wanted = set(frames)
        return np.array([frame in wanted for frame in self.frames] + [False])

    def cast(
        self,
        p_WR: np.ndarray,
        d_W: np.ndarray,
        X_WF: Mapping[FrameId, RigidTransform] | None = None,
        *,
        static: bool = True,
    ) -> RayHits:
        """First hit of every ray, on either side of a surface.

        Args:
            p_WR: where the rays start, (N, 3), or (3,) for all [m].
            d_W: unit directions, (N, 3).
            X_WF: poses of the moving frames. Frames without a pose are not there; poses of others do no harm.
            static: whether to include what never moves.
        """
        rays = np.empty((len(d_W), 6), np.float32)
        p_WR, d_W = np.asarray(p_WR), np.asarray(d_W)
        for axis in range(3):  # column by column: rows of three are slow in numpy, here and below
            rays[:, axis] = p_WR[..., axis]
            rays[:, 3 + axis] = d_W[:, axis]
        if static and self._has_static:
            distance, geometry, normal_W = self._cast_scene(self._static, rays)
        else:
            distance = np.full(len(rays), np.inf, np.float32)
            geometry = np.full(len(rays), -1, np.int32)
            normal_W = np.zeros((len(rays), 3), np.float32)
        moving = [(self._moving[frame], X) for frame, X in (X_WF or {}).items() if frame in self._moving]
        if moving and len(rays):
            self._cast_moving(rays, moving, distance, geometry, normal_W)
        incidence_cos = normal_W[:, 0] * rays[:, 3]
        incidence_cos += normal_W[:, 1] * rays[:, 4]
        incidence_cos += normal_W[:, 2] * rays[:, 5]
        np.minimum(np.abs(incidence_cos, out=incidence_cos), 1, out=incidence_cos)
        return RayHits(distance, geometry, normal_W, incidence_cos, self.surface)

    def attenuation_along(
        self, p_WA: np.ndarray, p_WB: np.ndarray, X_WF: Mapping[FrameId, RigidTransform] | None = None
    ) -> np.ndarray:
        """Optical depth of the straight lines from A to B for gamma rays, (N,).

        The sum of `Surface.attenuation` times the length inside over the solids that a line crosses; where solids
        overlap, each counts. Surfaces that are not closed, such as a half space, enclose nothing and do not count.

        Args:
            p_WA: (N, 3) [m]. p_WB: (N, 3), or (3,) for all [m].
            X_WF: poses of the moving frames. Frames without a pose are not there.
        """
        p_WA = np.asarray(p_WA, float)
        way = np.asarray(p_WB, float) - p_WA
        length = np.linalg.norm(way, axis=1)
        d_W = np.divide(way, length[:, None], out=np.tile([0.0, 0.0, 1.0], (len(way), 1)), where=length[:, None] > 0)
        depth = np.zeros(len(way))
        if self._has_static:
            self._add_depth(depth, self._static, 0, p_WA, d_W, length)
        for frame, X in (X_WF or {}).items():
            if frame in self._moving:
                X_FW = X.inverse().GetAsMatrix4()
                p_FA, d_F = p_WA @ X_FW[:3, :3].T + X_FW[:3, 3], d_W @ X_FW[:3, :3].T
                self._add_depth(depth, self._moving[frame].scene, self._moving[frame].first_geometry, p_FA, d_F, length)
        return depth

    def _add_depth(
        self,
        depth: np.ndarray,
        scene: o3d.t.geometry.RaycastingScene,
        first_geometry: int,
        p_FA: np.ndarray,
        d_F: np.ndarray,
        length: np.ndarray,
    ) -> None:
        """Adds to `depth` (N,) that of the solids of one scene, for lines in its frame."""
        if not len(length):
            return
        rays = o3d.core.Tensor.from_numpy(np.hstack([p_FA, d_F]).astype(np.float32))
        hits = {name: tensor.numpy() for name, tensor in scene.list_intersections(rays, nthreads=self.threads).items()}
        ray = hits["ray_ids"].astype(int)
        geometry = hits["geometry_ids"].astype(int) + first_geometry
        normals = self._outward[self._first_triangle[geometry] + hits["primitive_ids"].astype(int)]
        outward = np.einsum("ij,ij->i", normals, d_F[ray])
        ray, geometry, inside = inside_lengths(ray, geometry, hits["t_hit"], outward, length)
        np.add.at(depth, ray, self.surface.attenuation[geometry] * inside)

    def distance_to_surface(self, p_WP: np.ndarray) -> np.ndarray:
        """Unsigned distance from points (N, 3) [m] to the nearest surface that never moves, (N,) float32 [m]."""
        points = np.ascontiguousarray(p_WP, np.float32).reshape(-1, 3)
        if not self._has_static:
            return np.full(len(points), np.inf, np.float32)
        return self._static.compute_distance(o3d.core.Tensor.from_numpy(points), nthreads=self.threads).numpy()

    def nearest_geometry(self, p_WP: np.ndarray) -> np.ndarray:
        """The geometry that never moves whose surface is nearest to each point (N, 3) [m], (N,) index into `names`.

        Raises:
            WorldError: there is nothing that never moves.
        """
        if not self._has_static:
            raise WorldError("no geometry that never moves", where="ray scene")
        points = np.ascontiguousarray(p_WP, np.float32).reshape(-1, 3)
        found = self._static.compute_closest_points(o3d.core.Tensor.from_numpy(points), nthreads=self.threads)
        return found["geometry_ids"].numpy().astype(np.int32)

    def _cast_scene(self, scene: o3d.t.geometry.RaycastingScene, rays: np.ndarray) -> tuple[np.ndarray, ...]:
        hits = scene.cast_rays(o3d.core.Tensor.from_numpy(rays), nthreads=self.threads)
        # Open3D's id of a miss is the largest uint32, which is -1 as int32.
        return hits["t_hit"].numpy(), hits["geometry_ids"].numpy().view(np.int32), hits["primitive_normals"].numpy()

    def _cast_moving(
        self,
        rays: np.ndarray,
        moving: list[tuple[_MovingFrame, RigidTransform]],
        distance: np.ndarray,
        geometry: np.ndarray,
        normal_W: np.ndarray,
    ) -> None:
        """Casts into every moving frame and overwrites hits that are nearer than those so far."""
        starts = np.ascontiguousarray(rays[:, :3].T)
        low, high = starts.min(axis=1).astype(float), starts.max(axis=1).astype(float)
        spread = float(np.linalg.norm(high - low)) / 2
        matrices = [X.GetAsMatrix4() for _, X in moving]
        centres = np.array([X[:3, :3] @ frame.p_FC + X[:3, 3] for (frame, _), X in zip(moving, matrices, strict=True)])
        to_centre = centres - (low + high) / 2
        # A ray from outside meets a sphere when its direction has d·c >= sqrt(c² − r²), c the way to the centre.
        # The sphere is grown by the spread of the origins, so that one origin stands for all.
        radius = np.array([frame.radius for frame, _ in moving]) + spread
        tangent = np.einsum("ij,ij->i", to_centre, to_centre) - radius**2
        threshold = np.where(tangent > 0, np.sqrt(np.maximum(tangent, 0)), -np.inf)
        along = to_centre.astype(np.float32) @ rays[:, 3:].T
        for i, ((frame, _), X) in enumerate(zip(moving, matrices, strict=True)):
            candidates = np.flatnonzero(along[i] >= np.float32(threshold[i] * (1 - 1e-5)))
            if not len(candidates):
                continue
            R_WF = X[:3, :3].astype(np.float32)
            rays_F = rays.take(candidates, axis=0)
            rays_F[:, :3] -= X[:3, 3].astype(np.float32)
            rays_F = (rays_F.reshape(-1, 3) @ R_WF).reshape(-1, 6)
            near, hit, normal_F = self._cast_scene(frame.scene, rays_F)
            nearer = np.flatnonzero(near < distance[candidates])
            rays_hit = candidates[nearer]
            distance[rays_hit] = near[nearer]
            geometry[rays_hit] = hit[nearer] + frame.first_geometry
            normal_W[rays_hit] = normal_F[nearer] @ R_WF.T


def _surface(
    inspector: SceneGraphInspector, geometry: GeometryId, X_PF: RigidTransform
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in P of a geometry of frame F, (n, 3) float32 [m], and its triangles, (m, 3)."""
    vertices, triangles = triangulate(inspector.GetShape(geometry), inspector.GetName(geometry))
    pose = (X_PF @ inspector.GetPoseInFrame(geometry)).GetAsMatrix4()
    return (vertices @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32), triangles


def _ball_around(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Middle (3,) and radius of a ball that holds points (n, 3) and a little more, so that rounding loses none."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return middle, float(np.linalg.norm(points - middle, axis=1).max()) * (1 + 1e-5)


def _with_role(inspector: SceneGraphInspector, role: Role) -> list[GeometryId]:
    for candidate in (role, Role.kIllustration, Role.kProximity):
        found = [g for g in inspector.GetAllGeometryIds(candidate) if not inspector.IsDeformableGeometry(g)]
        if found:
            return [g for g in found if not _hidden(inspector, g)]
    return []


def _hidden(inspector: SceneGraphInspector, geometry: GeometryId) -> bool:
    properties = inspector.GetPerceptionProperties(geometry)
    if properties is None or not properties.HasProperty("label", "id"):
        return False
    return bool(properties.GetProperty("label", "id") == RenderLabel.kDoNotRender)
