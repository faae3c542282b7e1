"""A snake with its driver on given ground, for physics tests."""

import numpy as np
from naraha.models.snake.snake_model import SnakeModel
from naraha.models.snake.urdf import snake_urdf
from naraha.systems.drive.snake_driver import ApplyDriverConfig, SnakeDriver
from naraha.systems.snake import (
    BodyPath,
    NullSpaceConfig,
    NullSpaceRecovery,
    RecoveryCommand,
    ShiftControl,
    ShiftControlConfig,
    SnakeBody,
)
from pydrake.common.value import Value
from pydrake.geometry import Box
from pydrake.manipulation import ApplyDriverConfigs
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource

FLOOR = ((0.0, 0.0, -0.5), (30.0, 30.0, 1.0))


class Snake:
    """The plant with a snake on boxes of ground, its driver, and its commands as fixed inputs.

    Args:
        boxes: (position of the centre, size) of every box of ground. head: position of the nose.
        angles: joint angles at the start [rad].
        extend: called with the builder, the plant and the driver before the diagram is built.
    """

    def __init__(
        self, model=None, *, boxes=(FLOOR,), driver=None, head=None, angles=None, time_step=0.005, extend=None
    ):
        self.model = model or SnakeModel()
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=time_step, discrete_contact_approximation="lagged")
        self.plant, self.scene_graph = AddMultibodyPlant(config, builder)
        (self.instance,) = Parser(self.plant).AddModelsFromString(snake_urdf(self.model), "urdf")
        for i, (position, size) in enumerate(boxes):
            X_WG = RigidTransform(position)
            self.plant.RegisterCollisionGeometry(
                self.plant.world_body(), X_WG, Box(*size), f"ground{i}", CoulombFriction(0.8, 0.8)
            )
        self.plant.Finalize()
        ApplyDriverConfigs(
            driver_configs={"snake": driver or SnakeDriver()},
            sim_plant=self.plant,
            models_from_directives=[],
            lcm_buses=None,
            builder=builder,
        )
        self.driver = builder.GetSubsystemByName("snake.driver")
        if extend is not None:
            extend(builder, self.plant, self.driver)
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        self.plant_context = self.plant.GetMyContextFromRoot(self.context)
        self.driver_context = self.driver.GetMyContextFromRoot(self.context)
        start = [0, 0, self.model.wheel_radius] if head is None else head
        pose = start if isinstance(start, RigidTransform) else RigidTransform(start)
        self.plant.SetFreeBodyPose(self.plant_context, self.body("F0"), pose)
        names = self.model.joint_names()
        for name, angle in zip(names, np.zeros(len(names)) if angles is None else angles, strict=True):
            self.plant.GetJointByName(name).set_angle(self.plant_context, angle)

    def body(self, name):
        return self.plant.GetBodyByName(name, self.instance)

    def X_W(self, name):
        return self.plant.EvalBodyPoseInWorld(self.plant_context, self.body(name))

    def command(self, **values):
        """Fixes input ports of the driver, for example `joint_command=...`; a number holds for all entries."""
        for name, value in values.items():
            port = self.driver.GetInputPort(name)
            port.FixValue(self.driver_context, np.broadcast_to(np.asarray(value, dtype=float), port.size()).copy())

    def drive(self, speed):
        """Commands the speed [m/s] of all wheels."""
        self.command(wheel_speed_command=speed / self.model.wheel_radius)

    def run(self, seconds):
        self.simulator.AdvanceTo(self.context.get_time() + seconds)

    def output(self, name):
        return self.driver.GetOutputPort(name).Eval(self.driver_context)


def snake_body(model):
    return SnakeBody(model.half_length, model.wheel_radius, model.tread, np.array(model.joint_limits()))


def controlled_snake():
    """A diagram of a snake of five units with its driver, shift control along a bend and a recovery that has begun."""
    model = SnakeModel(units=5)
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlant(MultibodyPlantConfig(time_step=0.005), builder)
    Parser(plant).AddModelsFromString(snake_urdf(model), "urdf")
    X_WG, size = RigidTransform(FLOOR[0]), FLOOR[1]
    plant.RegisterCollisionGeometry(plant.world_body(), X_WG, Box(*size), "ground", CoulombFriction(0.8, 0.8))
    plant.SetDefaultFloatingBaseBodyPose(plant.GetBodyByName("F0"), RigidTransform([0, 0, model.wheel_radius]))
    plant.Finalize()
    ApplyDriverConfig(SnakeDriver(), "snake", plant, {}, None, builder)
    driver = builder.GetSubsystemByName("snake.driver")
    body = snake_body(model)
    recovery = builder.AddNamedSystem("recovery", NullSpaceRecovery(NullSpaceConfig(), body=body))
    shift = builder.AddNamedSystem("shift", ShiftControl(ShiftControlConfig(), body=body))
    bend = np.linspace(0.0, 2.0, 100)
    path = BodyPath(np.column_stack([np.sin(bend), 1.0 - np.cos(bend), np.zeros(100)]), 1.0)
    sources = {
        (recovery, "command"): ConstantValueSource(Value(RecoveryCommand(1, True, 0, 4, (-0.3, 0.0, 0.2)))),
        (shift, "path"): ConstantValueSource(Value(path)),
        (shift, "speed_command"): ConstantVectorSource([0.1]),
    }
    for (system, port), source in sources.items():
        builder.Connect(builder.AddSystem(source).get_output_port(), system.GetInputPort(port))
    builder.Connect(driver.GetOutputPort("joint_angles"), recovery.GetInputPort("joint_angles"))
    builder.Connect(recovery.GetOutputPort("joint_command"), driver.GetInputPort("joint_command"))
    builder.Connect(shift.GetOutputPort("wheel_speed_command"), driver.GetInputPort("wheel_speed_command"))
    return builder.Build()
