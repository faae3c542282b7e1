"""Small SceneGraphs made of shapes, for the tests of what sensors see."""

import pytest
from naraha.systems.sensing import RayScene, SurfaceTable
from pydrake.geometry import (
    FrameId,
    GeometryFrame,
    GeometryInstance,
    IllustrationProperties,
    PerceptionProperties,
    ProximityProperties,
    Role,
    SceneGraph,
    Shape,
)
from pydrake.math import RigidTransform

PROPERTIES = {
    Role.kPerception: (PerceptionProperties, GeometryInstance.set_perception_properties),
    Role.kIllustration: (IllustrationProperties, GeometryInstance.set_illustration_properties),
    Role.kProximity: (ProximityProperties, GeometryInstance.set_proximity_properties),
}


class ShapeWorld:
    """A SceneGraph to which shapes are added by one call each."""

    def __init__(self, scene_graph: SceneGraph | None = None):
        self.scene_graph = SceneGraph() if scene_graph is None else scene_graph
        self.source = self.scene_graph.RegisterSource("test")

    def frame(self, name: str) -> FrameId:
        return self.scene_graph.RegisterFrame(self.source, GeometryFrame(name))

    def add(self, shape: Shape, pose=(0, 0, 0), name="shape", frame=None, role=Role.kPerception, label=None):
        X = pose if isinstance(pose, RigidTransform) else RigidTransform(list(pose))
        instance = GeometryInstance(X, shape, name)
        kind, assign = PROPERTIES[role]
        properties = kind()
        if label is not None:
            properties.AddProperty("label", "id", label)
        assign(instance, properties)
        if frame is None:
            self.scene_graph.RegisterAnchoredGeometry(self.source, instance)
        else:
            self.scene_graph.RegisterGeometry(self.source, frame, instance)
        return self

    def rays(self, surfaces: SurfaceTable | None = None, **options) -> RayScene:
        return RayScene(self.scene_graph.model_inspector(), surfaces, **options)


@pytest.fixture(scope="session")
def make_world():
    """`make_world()` gives an empty `ShapeWorld`, `make_world(scene_graph)` one around a SceneGraph."""
    return ShapeWorld
