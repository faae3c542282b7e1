"""An illuminance meter on a body that is put where the test wants it."""

import numpy as np
from naraha.systems.sensing import IlluminanceMeter, IlluminanceMeterConfig, Lamp, RayScene, make_emitters
from pydrake.geometry import Box
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder


def scene_of(boxes):
    """A ray scene of boxes that never move, name → (size, middle)."""
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.01)
    for name, (size, middle) in boxes.items():
        plant.RegisterVisualGeometry(plant.world_body(), RigidTransform(middle), Box(*size), name, np.ones(4))
    plant.Finalize()
    return RayScene(scene_graph.model_inspector())


class MeterRig:
    """The plate sits 0.8 m over the origin of a free body, its normal along the body's z axis.

    roof: "robot" puts a plate of the body itself over the meter, "other" one of another body.
    """

    def __init__(self, config, lamps, *, seed=0, roof=None):
        builder = DiagramBuilder()
        self.plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.01)
        inertia = SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1)
        self.body, other = (self.plant.AddRigidBody(name, inertia) for name in ("base", "other"))
        self.plant.RegisterVisualGeometry(self.body, RigidTransform(), Box(0.1, 0.1, 0.1), "hull", np.ones(4))
        for body in (self.body, other):
            self.plant.SetDefaultFloatingBaseBodyPose(body, RigidTransform())
        if roof is not None:
            carrier = self.body if roof == "robot" else other
            self.plant.RegisterVisualGeometry(carrier, RigidTransform([0, 0, 1.5]), Box(1, 1, 0.1), "roof", np.ones(4))
        self.plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
        self.plant.Finalize()
        self.frame, self.X_PI = self.plant.GetBodyFrameIdOrThrow(self.body.index()), RigidTransform([0, 0, 0.8])
        self.meter = builder.AddSystem(
            IlluminanceMeter(
                config,
                emitters=make_emitters(lamps),
                scene=RayScene(scene_graph.model_inspector()),
                parent_frame=self.frame,
                X_PI=self.X_PI,
                seed=seed,
            )
        )
        builder.Connect(scene_graph.get_query_output_port(), self.meter.GetInputPort("geometry_query"))
        self.diagram = builder.Build()

    def read(self, x, tilt):
        """Both outputs with the body at (x, 0, 0), pitched by `tilt` [rad]."""
        own = self.meter.GetMyContextFromRoot(self.put(x, tilt))
        return {name: self.meter.GetOutputPort(name).Eval(own)[0] for name in ("illuminance", "cheat.illuminance")}

    def put(self, x, tilt):
        """The diagram's context with the body there."""
        simulator = Simulator(self.diagram)
        context = simulator.get_mutable_context()
        pose = RigidTransform(RollPitchYaw(0, tilt, 0), [x, 0, 0])
        self.plant.SetFreeBodyPose(self.plant.GetMyMutableContextFromRoot(context), self.body, pose)
        simulator.AdvanceTo(0.01)
        return context


def meter_example(seed):
    """For the contract test."""
    rig = MeterRig(IlluminanceMeterConfig(period=0.1), [Lamp(xyz=[1.0, 0, 3.0])], seed=seed)
    return rig.diagram, rig.meter
