"""The snake's control tick beside other solvers, and how fast the snake is simulated, on one core in one run.

Scene `tick`: one tick for a segment of five units (nine joints, six components of the control point's pose). Ours is
the whole of rows S1-a and S1-b: kinematics, Jacobian, gradients of target distance, manipulability and joint term,
projection, ranges and rates of the joints. `numpy` is the published law in plain numpy, without bounds. Drake's
differential inverse kinematics, pink and mink (those of them that are installed) solve a quadratic programme for the
same twist of the same chain with ranges and rates of the joints and a resting pose in the null space; none of them has
the manipulability term. Each of theirs includes bringing the joint angles into its model, as ours does.

Scene `simulation`: the snake drives straight on flat ground at 5 ms with its driver; simulated seconds per second of
processor time with 10, 20 and 40 units, beside the same snake standing without its driver, and driving without it with
wheels that are driven surfaces of the links in place of two joints a unit. Then ten units with all that a mission has:
sensors, cameras, detector and controllers.

Scene `recovery`: see `snake_cases`. Without `--scene` the first two run.
"""

import argparse
import importlib
import time
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import numpy as np
from naraha.diagrams.recover import RecoverScenario, make_recover
from naraha.models.snake.snake_model import SnakeModel
from naraha.models.snake.urdf import snake_urdf
from naraha.systems.drive.snake_driver import ApplyDriverConfig, SnakeDriver
from naraha.systems.snake import ChainKinematics, NullSpaceConfig
from naraha.systems.snake import null_space_kernels as kernel
from naraha.systems.snake.null_space_kernels import recovery_tick
from naraha.systems.snake.snake_pilot import Move
from pydrake.common.value import Value
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsParameters,
    DoDifferentialInverseKinematics,
)
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BusValue, DiagramBuilder

from .report import print_table, time_in_turns, use_one_core, write_json

JOINTS, HALF_LENGTH = 9, 0.09
LIMIT, MAX_RATE, PERIOD = 1.3, 1.2, 0.01
TWIST = np.array([0.03, 0.0, 0.01, 0.0, 0.05, 0.02])
TARGET = np.array([-0.3, 0.05, 0.15])
CALLS = 200
"""Calls in a measurement, with angles that change from one to the next."""


def angle_sets() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.clip(0.4 * rng.standard_normal(JOINTS) + 0.01 * rng.standard_normal((CALLS, JOINTS)), -1.2, 1.2)


def chain_urdf() -> str:
    """The segment as a robot of its own: L0 is its reference link, L9 its control link."""
    inertia = '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'
    parts = ['<robot name="segment"><link name="L0"/>']
    for j in range(JOINTS):
        x, axis = (0.0 if j == 0 else -HALF_LENGTH), ("0 1 0" if j % 2 == 0 else "0 0 1")
        parts.append(
            f'<link name="L{j + 1}"><inertial><mass value="0.4"/>{inertia}</inertial></link>'
            f'<joint name="j{j}" type="revolute"><parent link="L{j}"/><child link="L{j + 1}"/>'
            f'<origin xyz="{x} 0 0"/><axis xyz="{axis}"/>'
            f'<limit lower="{-LIMIT}" upper="{LIMIT}" effort="15" velocity="{MAX_RATE}"/></joint>'
        )
    return "".join([*parts, "</robot>"])


def ours(config: NullSpaceConfig) -> Callable[[np.ndarray], np.ndarray]:
    chain = ChainKinematics(JOINTS, HALF_LENGTH)
    R, p = chain.control_pose(angle_sets()[0])
    reference = np.concatenate([p, R.ravel(), TWIST])
    limits, report = np.full(JOINTS, LIMIT), np.zeros(kernel.REPORT)
    settings = config.settings(JOINTS, HALF_LENGTH)
    return lambda theta: recovery_tick(theta, reference, TARGET, limits, settings, report)


def in_numpy(config: NullSpaceConfig) -> Callable[[np.ndarray], np.ndarray]:
    """The law of row S1-a as it is written, on our kinematics and gradients."""
    chain = ChainKinematics(JOINTS, HALF_LENGTH)
    R_ref, p_ref = chain.control_pose(angle_sets()[0])

    def tick(theta: np.ndarray) -> np.ndarray:
        R, p = chain.control_pose(theta)
        spin = R @ R_ref.T
        turned = 0.5 * np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]])
        error = np.concatenate([p - p_ref, turned])
        J = chain.jacobian(theta)
        pinv = np.linalg.pinv(J)
        gradient = chain.distance_gradient(theta, JOINTS // 2, TARGET)
        dJ = chain.jacobian_derivative(theta)
        gradient -= 2 * config.singular_weight * np.einsum("ir,rij->j", pinv, dJ)
        wanted = config.alpha * gradient
        return pinv @ (TWIST - config.k_position * error) + wanted - pinv @ (J @ wanted)

    return tick


def drake_differential_ik() -> Callable[[np.ndarray], np.ndarray]:
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(chain_urdf(), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("L0"))
    plant.Finalize()
    context, control = plant.CreateDefaultContext(), plant.GetFrameByName(f"L{JOINTS}")
    parameters = DifferentialInverseKinematicsParameters(JOINTS, JOINTS)
    parameters.set_time_step(PERIOD)
    parameters.set_nominal_joint_position(np.zeros(JOINTS))
    parameters.set_joint_position_limits((np.full(JOINTS, -LIMIT), np.full(JOINTS, LIMIT)))
    parameters.set_joint_velocity_limits((np.full(JOINTS, -MAX_RATE), np.full(JOINTS, MAX_RATE)))
    velocity = np.concatenate([TWIST[3:], TWIST[:3]])

    def tick(theta: np.ndarray) -> np.ndarray:
        plant.SetPositions(context, theta)
        return DoDifferentialInverseKinematics(plant, context, velocity, control, parameters).joint_velocities

    return tick


def pink_ik() -> Callable[[np.ndarray], np.ndarray]:
    pinocchio, pink = importlib.import_module("pinocchio"), importlib.import_module("pink")
    model = pinocchio.buildModelFromXML(chain_urdf())
    configuration = pink.Configuration(model, model.createData(), angle_sets()[0])
    control = pink.FrameTask(f"L{JOINTS}", position_cost=1.0, orientation_cost=1.0)
    rest = pink.PostureTask(cost=1e-3)
    rest.set_target(np.zeros(JOINTS))
    start = configuration.get_transform_frame_to_world(f"L{JOINTS}")
    control.set_target(pinocchio.SE3(start.rotation, start.translation + PERIOD * TWIST[:3]))

    def tick(theta: np.ndarray) -> np.ndarray:
        configuration.update(theta)
        return pink.solve_ik(configuration, [control, rest], PERIOD, solver="daqp")

    return tick


def mink_ik() -> Callable[[np.ndarray], np.ndarray]:
    mujoco, mink = importlib.import_module("mujoco"), importlib.import_module("mink")
    model = mujoco.MjModel.from_xml_string(chain_urdf())
    configuration = mink.Configuration(model, q=angle_sets()[0])
    control = mink.FrameTask(f"L{JOINTS}", "body", position_cost=1.0, orientation_cost=1.0)
    rest = mink.PostureTask(model, cost=1e-3)
    rest.set_target(np.zeros(JOINTS))
    control.set_target(configuration.get_transform_frame_to_world(f"L{JOINTS}", "body"))
    limits = [
        mink.ConfigurationLimit(model),
        mink.VelocityLimit(model, {f"j{j}": MAX_RATE for j in range(JOINTS)}),
    ]

    def tick(theta: np.ndarray) -> np.ndarray:
        configuration.update(theta)
        return mink.solve_ik(configuration, [control, rest], PERIOD, solver="daqp", limits=limits)

    return tick


def tick_scene(repeats: int = 30) -> dict[str, object]:
    config = NullSpaceConfig()
    ticks: dict[str, Callable[[np.ndarray], Any]] = {"naraha": ours(config), "numpy": in_numpy(config)}
    for name, make in (("drake_diff_ik", drake_differential_ik), ("pink", pink_ik), ("mink", mink_ik)):
        try:
            ticks[name] = make()
        except ImportError as error:
            print(f"{name} is left out: {error}")
    angles = angle_sets()

    def run(tick: Callable[[np.ndarray], Any]) -> Callable[[], None]:
        def calls() -> None:
            for theta in angles:
                tick(theta)

        return calls

    times = time_in_turns({name: run(tick) for name, tick in ticks.items()}, repeats=repeats)
    # Where no bound is active ours is the published law.
    free = NullSpaceConfig(max_joint_rate=1e3, max_null_rate=1e3, joint_weight=0.0, damping=0.0, limit_gain=1e3)
    apart = max(float(np.abs(ours(free)(theta) - in_numpy(free)(theta)).max()) for theta in angles[:1])
    result: dict[str, object] = {f"{name}_tick_us": 1e6 * value / CALLS for name, value in times.items()}
    print_table("one tick, nine joints", ["", "µs"], [[name, 1e6 * value / CALLS] for name, value in times.items()])
    return result | {"naraha_against_numpy_rad_s": apart}


def with_driven_surfaces(urdf: str) -> str:
    """The same snake with wheels that do not turn but whose surfaces run."""
    ElementTree.register_namespace("drake", "http://drake.mit.edu")
    robot = ElementTree.fromstring(urdf)
    for joint in robot.findall("joint"):
        if joint.get("name", "").startswith("w"):
            joint.set("type", "fixed")
    for transmission in robot.findall("transmission"):
        moved = transmission.find("joint")
        if moved is not None and moved.get("name", "").startswith("w"):
            robot.remove(transmission)
    for link in robot.findall("link"):
        if link.get("name", "").startswith("W"):
            ElementTree.SubElement(link, "{http://drake.mit.edu}surface_velocity_axis", axis="0 1 0")
    return ElementTree.tostring(robot, encoding="unicode")


def realtime_factor(
    units: int, *, driver: bool = True, surfaces: bool = False, seconds: float = 3.0
) -> tuple[float, float]:
    """Simulated seconds per second of processor time, at 0.1 m/s or standing, and how far the snake got [m]."""
    model = SnakeModel(units=units)
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(time_step=0.005, discrete_contact_approximation="lagged")
    plant, _ = AddMultibodyPlant(config, builder)
    urdf = snake_urdf(model)
    (snake,) = Parser(plant).AddModelsFromString(with_driven_surfaces(urdf) if surfaces else urdf, "urdf")
    friction = CoulombFriction(0.8, 0.8)
    ground = RigidTransform([0, 0, -0.5])
    plant.RegisterCollisionGeometry(plant.world_body(), ground, Box(40, 4, 1), "ground", friction)
    head = plant.GetBodyByName("F0")
    plant.SetDefaultFloatingBaseBodyPose(head, RigidTransform([0, 0, model.wheel_radius]))
    plant.Finalize()
    driven = driver and not surfaces
    if driven:
        ApplyDriverConfig(SnakeDriver(), "snake", plant, {}, None, builder)
        drives: Any = builder.GetSubsystemByName("snake.driver")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    plant_context = plant.GetMyContextFromRoot(context)
    if driven:
        speeds = np.full(2 * units, 0.1 / model.wheel_radius)
        drives.GetInputPort("wheel_speed_command").FixValue(drives.GetMyContextFromRoot(context), speeds)
    else:
        desired = np.zeros(2 * len(plant.GetJointActuatorIndices(snake)))
        plant.get_desired_state_input_port(snake).FixValue(plant_context, desired)
    if surfaces:
        bus = BusValue()
        for i in range(units):
            for side in "LR":
                bus.Set(f"snake::W{i}{side}", Value(0.1))
        plant.get_surface_speeds_input_port().FixValue(plant_context, Value(bus))
    simulator.AdvanceTo(0.5)
    x = plant.EvalBodyPoseInWorld(plant_context, head).translation()[0]
    start = time.process_time()
    simulator.AdvanceTo(0.5 + seconds)
    factor = seconds / (time.process_time() - start)
    return factor, plant.EvalBodyPoseInWorld(plant_context, head).translation()[0] - x


def realtime_factor_of_mission(seconds: float = 3.0) -> float:
    """The same of the whole robot that drives on: all sensors, detector, controllers, and both cameras' images read."""
    _, run = make_recover(RecoverScenario(stuck=1, really=False, recording=None))
    run.give(Move(kind="shift", speed=0.1))
    run.advance(0.5)
    start = time.process_time()
    for _ in range(round(seconds / 0.5)):
        run.advance(0.5)
        for end in ("head", "tail"):
            run.read(f"station.{end}_image")
    return seconds / (time.process_time() - start)


def simulation_scene(repeats: int = 3) -> dict[str, object]:
    result: dict[str, object] = {}
    rows = []
    for units in (10, 20, 40):
        row: list[object] = [f"{units} units"]
        for name, options in (
            ("", {}),
            ("_standing_without_driver", {"driver": False}),
            ("_driven_surfaces", {"surfaces": True}),
        ):
            runs = [realtime_factor(units, **options) for _ in range(repeats)]  # type: ignore[arg-type]
            factor = float(np.median([factor for factor, _ in runs]))
            result[f"naraha_realtime_factor_{units}{name}"] = factor
            result[f"naraha_advance_m_{units}{name}"] = float(runs[0][1])
            row.append(factor)
        rows.append(row)
    print_table("real-time factor", ["", "driving", "standing, no driver", "driven surfaces"], rows)
    everything = float(np.median([realtime_factor_of_mission() for _ in range(repeats)]))
    print(f"10 units with all sensors, controllers and camera images: {everything:.2f}")
    result["naraha_realtime_factor_10_all_sensors"] = everything
    factors = [float(result[f"naraha_realtime_factor_{units}"]) for units in (10, 40)]  # type: ignore[arg-type]
    # Cost of a simulated second over the number of units, as a power.
    return result | {"naraha_growth_exponent": float(np.log(factors[0] / factors[1]) / np.log(4.0))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=("tick", "simulation", "recovery"))
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    arguments = parser.parse_args()
    use_one_core()
    result: dict[str, object] = {}
    if arguments.scene in (None, "tick"):
        result |= tick_scene()
    if arguments.scene in (None, "simulation"):
        result |= simulation_scene()
    if arguments.scene == "recovery":
        result |= importlib.import_module("tests.benchmarks.snake_cases").recovery_scene()
    write_json(arguments.json, result)


if __name__ == "__main__":
    main()
