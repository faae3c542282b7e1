"""A model of a wheeled or tracked robot, loaded by its package URL."""

import numpy as np
from naraha.models import MODELS_DIR
from pydrake.geometry import Role
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from tests.models.test_crawler import support


class GroundRobot:
    """The robot stands with its base's origin at the given height over z = 0."""

    def __init__(self, name, height):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 0.004)
        parser = Parser(self.plant)
        parser.package_map().Add("naraha", str(MODELS_DIR))
        (self.model,) = parser.AddModels(url=f"package://naraha/{name}/{name}.urdf")
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()
        self.plant_context = self.plant.GetMyContextFromRoot(self.context)
        base = self.plant.GetBodyByName("base")
        self.plant.SetFreeBodyPose(self.plant_context, base, RigidTransform([0, 0, height]))
        self.inspector = self.scene_graph.model_inspector()

    def bodies(self):
        return [self.plant.get_body(i) for i in self.plant.GetBodyIndices(self.model)]

    def pose(self, frame):
        return self.plant.GetFrameByName(frame).CalcPoseInWorld(self.plant_context)

    def ids(self, role, links=None):
        """Geometries with a role, on all links or on those named."""
        return [
            geometry
            for body in self.bodies()
            if links is None or body.name() in links
            for geometry in self.inspector.GetGeometries(self.plant.GetBodyFrameIdOrThrow(body.index()), role)
        ]

    def reach(self, role, direction, links=None):
        """Farthest extent along a unit vector of the world [m]."""
        reaches = []
        for geometry in self.ids(role, links):
            body = self.plant.GetBodyFromFrameId(self.inspector.GetFrameId(geometry))
            X_WG = self.pose(body.name()) @ self.inspector.GetPoseInFrame(geometry)
            reaches.append(support(self.inspector.GetShape(geometry), X_WG, np.array(direction)))
        return max(reaches)

    def size(self, role=Role.kPerception, links=None):
        """Length, width and height over z = 0 [m]."""
        x, y = (
            self.reach(role, axis, links) + self.reach(role, [-a for a in axis], links)
            for axis in np.eye(3)[:2].tolist()
        )
        return np.array([x, y, self.reach(role, [0, 0, 1], links)])

    def check_never_touches_itself(self):
        ids = self.ids(Role.kProximity)
        for i, one in enumerate(ids):
            assert all(self.inspector.CollisionFiltered(one, other) for other in ids[i + 1 :])

    def check_sensors_see_what_is_drawn(self):
        for body in self.bodies():
            drawn = len(self.ids(Role.kIllustration, [body.name()]))
            assert len(self.ids(Role.kPerception, [body.name()])) == drawn
            assert drawn > 0 or body.name() == "imu"
