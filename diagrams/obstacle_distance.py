"""How near a robot comes to what it must not touch, by the truth."""

from collections.abc import Sequence

import numpy as np
from naraha.models.worlds import Solid, World
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram

from .wiring import subsystem

# [m] What stands higher over the floor than this and is no ramp is an obstacle, for every robot.
_TALL = 0.5
# Surfaces that robots are meant to drive on, however high they reach.
_DRIVABLE = ("floor", "ramp", "stair")
# [m] Farther away than this nothing is looked for; heights over B at which it is.
_FARTHEST, _HEIGHTS = 3.0, (0.05, 0.2)


class ObstacleDistance:
    """Distance from the outline of a robot to the nearest wall, pillar or other tall thing."""

    def __init__(self, diagram: Diagram, world: World, footprint: Sequence[float]):
        """
        Args:
            diagram: with a subsystem `station`. footprint: length and width of the robot [m].
        """
        self._diagram = diagram
        self._scene_graph = subsystem(diagram, "station", "scene_graph")
        tall = {
            solid.name
            for solid in world.solids
            if solid.collides and world.surfaces[solid.surface].label not in _DRIVABLE and top_of(solid) > _TALL
        }
        inspector = self._scene_graph.model_inspector()
        # A world's collision geometry is named after its solid.
        self._obstacles = {
            geometry
            for geometry in inspector.GetAllGeometryIds()
            if inspector.GetFrameId(geometry) == inspector.world_frame_id()
            and inspector.GetName(geometry).split("::")[-1].removesuffix("_collision") in tall
        }
        share = np.linspace(-0.5, 0.5, 7)
        length, width = footprint
        sides = [(s, e) for s in share for e in (-0.5, 0.5)] + [(e, s) for s in share for e in (-0.5, 0.5)]
        outline = np.array(sides) * [length, width]
        self._outline = np.vstack([np.column_stack([outline, np.full(len(outline), z)]) for z in _HEIGHTS])

    def nearest(self, context: Context, X_WB: RigidTransform) -> float:
        """Distance now [m]; 0 or less when something is touched, infinite when nothing is near."""
        port = self._scene_graph.GetOutputPort("query")
        query = port.Eval(self._scene_graph.GetMyContextFromRoot(context))
        nearest = float("inf")
        for p_WQ in (X_WB @ self._outline.T).T:
            for found in query.ComputeSignedDistanceToPoint(p_WQ, min(nearest, _FARTHEST)):
                if found.id_G in self._obstacles:
                    nearest = min(nearest, found.distance)
        return nearest


def top_of(solid: Solid) -> float:
    """Height of the highest point of a solid [m]."""
    if solid.sphere:
        return solid.xyz[2] + solid.sphere[0]
    radius, length = solid.cylinder or (0.0, 0.0)
    half = 0.5 * np.array(solid.box or [2 * radius, 2 * radius, length])
    return solid.xyz[2] + float(np.abs(solid.X_WG().rotation().matrix()[2]) @ half)
