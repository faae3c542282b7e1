"""A robot with its driver on given ground, for physics tests."""

import functools

import numpy as np
from naraha.models import MODELS_DIR
from naraha.models.amphibious.urdf import AmphibiousShape
from naraha.models.crawler.urdf import CRAWLERS
from naraha.models.lux_robot.urdf import LuxRobotShape
from naraha.models.pioneer.urdf import PioneerShape
from naraha.systems.drive import CrawlerDriver, DifferentialDriver, TrackedDriver
from pydrake.common.value import Value
from pydrake.geometry import Box
from pydrake.manipulation import ApplyDriverConfigs
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

TIME_STEP = 0.004
RIDE_HEIGHT = CRAWLERS["crawler"].track_radius
"""Height [m] of the crawler's axles over flat ground."""
RIDE_HEIGHTS = {
    "pioneer": PioneerShape().wheel_radius,
    "lux_robot": LuxRobotShape().wheel_radius,
    "amphibious": AmphibiousShape().track_radius,
}
DRIVERS = {"pioneer": DifferentialDriver, "lux_robot": DifferentialDriver, "amphibious": TrackedDriver}


@functools.cache
def robot_urdf(model: str) -> str:
    (path,) = MODELS_DIR.glob(f"*/{model}.urdf")
    return path.read_text(encoding="utf-8")


FLOOR = [((0.0, 0.0, -0.5), (30.0, 30.0, 1.0))]


class _TrueAttitude(LeafSystem):
    """Roll, pitch and yaw of a body of the plant, in place of the IMU."""

    def __init__(self, plant: MultibodyPlant):
        super().__init__()
        self._plant_state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self._plant, self._scratch = plant, plant.CreateDefaultContext()
        self.DeclareVectorOutputPort("rpy", 3, self._CalcRpy)

    def _CalcRpy(self, context, output):
        self._plant.SetPositionsAndVelocities(self._scratch, self._plant_state.Eval(context))
        X_WB = self._plant.EvalBodyPoseInWorld(self._scratch, self._plant.GetBodyByName("base"))
        output.SetFromVector(RollPitchYaw(X_WB.rotation()).vector())


class Rig:
    """The plant, the driver diagram, the true attitude for it, and the commands as fixed inputs.

    Args:
        model: a shipped robot. urdf: text of another one instead.
        boxes: (pose of the centre or its position, size) of every box of ground.
        ground_friction: of all boxes. X_WB: where the base starts.
    """

    def __init__(
        self,
        *,
        model="crawler",
        urdf=None,
        boxes=FLOOR,
        ground_friction=1.0,
        X_WB=None,
        driver=None,
        time_step=TIME_STEP,
        preset="auto",
    ):
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=time_step, discrete_contact_approximation="lagged")
        self.plant, self.scene_graph = AddMultibodyPlant(config, builder)
        (self.model,) = Parser(self.plant).AddModelsFromString(urdf or robot_urdf(model), "urdf")
        name = self.plant.GetModelInstanceName(self.model)
        friction = CoulombFriction(ground_friction, ground_friction)
        for i, (pose, size) in enumerate(boxes):
            X_WG = pose if isinstance(pose, RigidTransform) else RigidTransform(pose)
            self.plant.RegisterCollisionGeometry(self.plant.world_body(), X_WG, Box(*size), f"ground{i}", friction)
        self.base = self.plant.GetBodyByName("base")
        height = RIDE_HEIGHTS.get(name, RIDE_HEIGHT)
        self.plant.SetDefaultFloatingBaseBodyPose(self.base, RigidTransform([0, 0, height]) if X_WB is None else X_WB)
        self.plant.Finalize()
        ApplyDriverConfigs(
            driver_configs={name: driver or DRIVERS.get(name, CrawlerDriver)(command="track_speeds")},
            sim_plant=self.plant,
            models_from_directives=[],
            lcm_buses=None,
            builder=builder,
        )
        self.driver = builder.GetSubsystemByName(f"{name}.driver")
        attitude = builder.AddSystem(_TrueAttitude(self.plant))
        builder.Connect(self.plant.get_state_output_port(), attitude.get_input_port())
        if self.driver.HasInputPort("rpy"):
            builder.Connect(attitude.get_output_port(), self.driver.GetInputPort("rpy"))
        if self.driver.HasInputPort("tilt_setpoint"):
            level = builder.AddSystem(ConstantVectorSource(np.zeros(2)))
            builder.Connect(level.get_output_port(), self.driver.GetInputPort("tilt_setpoint"))
        self._command = "twist_command" if self.driver.HasInputPort("twist_command") else "track_speed_command"
        for port in (self._command, "flipper_preset"):
            if self.driver.HasInputPort(port):
                builder.ExportInput(self.driver.GetInputPort(port), port)
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        self.plant_context = self.plant.GetMyContextFromRoot(self.context)
        self.command(0.0, 0.0)
        if self.diagram.HasInputPort("flipper_preset"):
            self.preset(preset)

    def command(self, *values):
        """Sets the twist (v, ω) or the track speeds (left, right), whichever the driver takes."""
        self.diagram.GetInputPort(self._command).FixValue(self.context, np.array(values, dtype=float))

    def preset(self, name):
        self.diagram.GetInputPort("flipper_preset").FixValue(self.context, Value(name))

    def run(self, seconds):
        self.simulator.AdvanceTo(self.context.get_time() + seconds)

    def output(self, name):
        return self.driver.GetOutputPort(name).Eval(self.driver.GetMyContextFromRoot(self.context))

    @property
    def X_WB(self):
        return self.plant.EvalBodyPoseInWorld(self.plant_context, self.base)

    @property
    def V_WB(self):
        return self.plant.EvalBodySpatialVelocityInWorld(self.plant_context, self.base)

    @property
    def p_WB(self):
        return self.X_WB.translation()

    @property
    def rpy(self):
        return RollPitchYaw(self.X_WB.rotation()).vector()

    def contacts(self):
        """Contact points in the base frame (N, 3), normal forces on the robot (N,), and the robot's link of each."""
        results = self.plant.get_contact_results_output_port().Eval(self.plant_context)
        points, loads, links = [], [], []
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            points.append(self.X_WB.inverse() @ info.contact_point())
            loads.append(abs(info.contact_force() @ info.point_pair().nhat_BA_W))
            names = [self.plant.get_body(index).name() for index in (info.bodyA_index(), info.bodyB_index())]
            links.append(next(name for name in names if name != self.plant.world_body().name()))
        return np.array(points).reshape(-1, 3), np.array(loads), links


def slope(angle, *, height=RIDE_HEIGHT, heading=0.0):
    """A plane that rises along +x with `angle` [rad] through the origin, and the pose of a robot that stands on it.

    height: of its base's origin [m]. heading: of the robot in the plane, 0 uphill [rad].
    """
    R_WG = RollPitchYaw(0, -angle, 0).ToRotationMatrix()
    box = (RigidTransform(R_WG, R_WG @ [0, 0, -0.5]), (30, 30, 1))
    R_GB = RollPitchYaw(0, 0, heading).ToRotationMatrix()
    return [box], RigidTransform(R_WG @ R_GB, R_WG @ [0, 0, height])


def stairs(*, first_edge, rise, run, steps, landing):
    """Floor, a flight up along +x, a landing and the same flight down again; returns boxes and the two ends [m].

    The first riser stands at x = `first_edge`; `landing` is the length of the top [m].
    """
    boxes = [(RigidTransform([0, 0, -0.5]), (40, 6, 1))]
    far = first_edge + 2 * run * (steps - 1) + landing
    for i in range(steps):
        low, high = first_edge + run * i, far - run * i
        boxes.append((RigidTransform([(low + high) / 2, 0, rise * (i + 0.5)]), (high - low, 3, rise)))
    return boxes, far
