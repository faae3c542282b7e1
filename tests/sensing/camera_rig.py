"""A camera on a box that moves through a world of shapes, for the tests of cameras."""

import numpy as np
from naraha.systems.sensing.camera_model import R_OPTICAL
from pydrake.common.value import AbstractValue
from pydrake.geometry import Box, FramePoseVector, SceneGraph
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

FORWARD = RigidTransform(R_OPTICAL)


class Slide(LeafSystem):
    """Moves frames along straight lines: frame k is at start_k + velocity_k t."""

    def __init__(self, motions):
        super().__init__()
        self.motions = motions
        poses = AbstractValue.Make(FramePoseVector())
        self.DeclareAbstractOutputPort("poses", lambda: poses.Clone(), self.CalcPoses, {self.time_ticket()})

    def CalcPoses(self, context, output):
        poses = FramePoseVector()
        for frame, (start, velocity) in self.motions.items():
            poses.set_value(frame, start @ RigidTransform(context.get_time() * np.asarray(velocity, float)))
        output.set_value(poses)


class Station:
    """`make(scene=..., parent_frame=..., **options)` gives the camera; it rides on frame `base`."""

    def __init__(self, make_world, make, *, surfaces=None, velocity=(0, 0, 0), start=None, inputs=None, **options):
        builder = DiagramBuilder()
        world = make_world(builder.AddSystem(SceneGraph()))
        # A wall at x = 5 and the box that carries the camera, which looks along x from its front.
        world.add(Box(1, 40, 40), [5.5, 0, 0], "wall")
        base, arm = world.frame("base"), world.frame("arm")
        world.add(Box(0.4, 0.3, 0.2), [-0.3, 0, 0], "base", base).add(Box(0.1, 0.1, 0.4), name="arm", frame=arm)
        start = RigidTransform() if start is None else start
        out_of_sight = (RigidTransform([-3.0, 0, 0]), (0, 0, 0))
        motions = {base: (start, velocity), arm: options.pop("arm", out_of_sight)}
        slide = builder.AddSystem(Slide(motions))
        self.camera = builder.AddSystem(
            make(scene=world.rays(surfaces), parent_frame=base, own_frames=[arm], **options)
        )
        builder.Connect(slide.GetOutputPort("poses"), world.scene_graph.get_source_pose_port(world.source))
        builder.Connect(world.scene_graph.GetOutputPort("query"), self.camera.GetInputPort("geometry_query"))
        for name, system in (inputs or {}).items():
            builder.Connect(builder.AddSystem(system).get_output_port(), self.camera.GetInputPort(name))
        for i in range(self.camera.num_output_ports()):
            port = self.camera.get_output_port(i)
            builder.ExportOutput(port, port.get_name())
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)

    def read(self, name, time=None, simulator=None):
        """Value of an output at a time, as an array."""
        simulator = simulator or self.simulator
        if time is not None:
            simulator.AdvanceTo(time)
        value = self.diagram.GetOutputPort(name).Eval(simulator.get_context())
        return value if isinstance(value, np.ndarray) else value.data[:, :, 0].copy()
