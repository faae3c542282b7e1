"""The robot that carries a sensor, as the sensor's rays meet it."""

from collections.abc import Collection, Mapping

import numpy as np
from pydrake.geometry import FrameId, QueryObject
from pydrake.math import RigidTransform

from .ray_scene import RayScene


class OwnBody:
    """Which geometry of a scene is the robot itself, seen from a sensor that is fixed to its frame P.

    Attributes:
        parent_frame: SceneGraph frame P.
        rigid: pose X_PF of every frame that is welded to P, P included.
        moving: geometries of the frames that move against P, (G + 1,) bool, to be indexed by `RayHits.geometry`.
        all: geometries of the whole robot, likewise.
        other_frames: frames of the scene that are not welded to P, those of the robot included.
    """

    def __init__(
        self,
        scene: RayScene,
        parent_frame: FrameId,
        rigid_frames: Mapping[FrameId, RigidTransform] | None = None,
        own_frames: Collection[FrameId] = (),
    ):
        """
        Args:
            rigid_frames: poses X_PF of the frames that are welded to P, as from `welded_frames(plant, body)`.
            own_frames: further frames of the robot, which move against P, such as flippers.
        """
        self._scene = scene
        self.parent_frame = parent_frame
        self.rigid = {parent_frame: RigidTransform(), **(rigid_frames or {})}
        self.moving = scene.geometries_of(own_frames)
        self.all = scene.geometries_of([*own_frames, *(f for f in self.rigid if f in scene.moving_frames)])
        self.other_frames = tuple(frame for frame in scene.moving_frames if frame not in self.rigid)

    def distance(self, p_PR: np.ndarray, d_P: np.ndarray) -> np.ndarray:
        """Distance to what is welded to P along rays in P, (N,) float32 [m], infinite where it is not in the way."""
        return self._scene.cast(p_PR, d_P, self.rigid, static=False).distance

    def other_poses(self, query: QueryObject) -> dict[FrameId, RigidTransform]:
        """Poses X_WF of `other_frames`, for `RayScene.cast`. Copies: the query's own change with its context."""
        return {frame: RigidTransform(query.GetPoseInWorld(frame)) for frame in self.other_frames}

    def parent_pose(self, query: QueryObject) -> RigidTransform:
        """Pose X_WP, a copy."""
        return RigidTransform(query.GetPoseInWorld(self.parent_frame))

    def rigid_poses(self, X_WP: RigidTransform) -> dict[FrameId, RigidTransform]:
        """Poses X_WF of what is welded to P and has geometry, for `RayScene.cast`."""
        return {frame: X_WP @ X_PF for frame, X_PF in self.rigid.items() if frame in self._scene.moving_frames}
