"""The snake's station with what moves it: pilot, shift control and null-space recovery, as one diagram."""

from dataclasses import dataclass, field

import numpy as np
from naraha.models.worlds import World
from naraha.systems.display.picture_board import PictureBoard, PictureBoardConfig
from naraha.systems.display.snake_display import SnakeDisplay, SnakeDisplayConfig
from naraha.systems.snake import NullSpaceConfig, NullSpaceRecovery, ShiftControl, ShiftControlConfig, SnakeBody
from naraha.systems.snake.actuator_faults import ActuatorFaults, ActuatorFaultsConfig
from naraha.systems.snake.inertial_speed import InertialSpeed, InertialSpeedConfig
from naraha.systems.snake.recovery_planner import RecoveryPlanner, RecoveryPlannerConfig
from naraha.systems.snake.snake_pilot import Move, SnakePilot, SnakePilotConfig
from naraha.systems.snake.stuck_detector import StuckDetector, StuckDetectorConfig
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System

from .snake_station import SnakeStationConfig, make_snake_station, snake_measures
from .wiring import DiagramReader, connect, export_outputs


@dataclass(kw_only=True)
class SnakeMovesConfig(SnakeStationConfig):
    """The station and its controllers."""

    pilot: SnakePilotConfig = field(default_factory=SnakePilotConfig)
    shift: ShiftControlConfig = field(default_factory=ShiftControlConfig)
    recovery: NullSpaceConfig = field(default_factory=NullSpaceConfig)
    speed: InertialSpeedConfig = field(default_factory=InertialSpeedConfig)
    detector: StuckDetectorConfig = field(default_factory=StuckDetectorConfig)
    planner: RecoveryPlannerConfig = field(default_factory=RecoveryPlannerConfig)
    # Heat and faults of the actuators; the faults happen on the robot, not in its rehearsals.
    actuators: ActuatorFaultsConfig = field(default_factory=ActuatorFaultsConfig)


def snake_body(config: SnakeStationConfig) -> SnakeBody:
    """What the controllers know of the robot."""
    snake = config.snake
    return SnakeBody(snake.half_length, snake.wheel_radius, snake.tread, np.array(snake.joint_limits()))


def make_snake_moves(
    config: SnakeMovesConfig,
    world: World,
    *,
    X_WB: RigidTransform,
    joint_angles: np.ndarray,
    seed: int,
    meshcat: Meshcat | None = None,
) -> Diagram:
    """Builds the diagram; see `make_snake_station` for the arguments.

    Input: `move` (`Move`). Outputs: every output of every part as "<part>.<port>". Parts: `station`, `actuators`,
    `pilot`, `shift`, `recovery`, and, when the station has all its sensors, `speed`, `detector` and `planner`, and with
    a Meshcat `display`; with a Meshcat and cameras `head_board` and `tail_board`. What is not the station reads the
    joint angles that the actuators report.
    """
    builder = DiagramBuilder()
    body = snake_body(config)
    station = make_snake_station(config, world, X_WB=X_WB, joint_angles=joint_angles, seed=seed, meshcat=meshcat)
    builder.AddSystem(station)
    pilot = builder.AddNamedSystem("pilot", SnakePilot(config.pilot, body=body))
    shift = builder.AddNamedSystem("shift", ShiftControl(config.shift, body=body))
    recovery = builder.AddNamedSystem("recovery", NullSpaceRecovery(config.recovery, body=body))

    builder.ExportInput(pilot.GetInputPort("move"), "move")
    actuators = builder.AddNamedSystem("actuators", ActuatorFaults(config.actuators, units=body.units))
    for port in ("joint_angles", "joint_torques"):
        connect(builder, station, port, actuators)
    connect(builder, actuators, "joint_torque_limit", station)
    for target in (pilot, recovery):
        connect(builder, actuators, "reported_joint_angles", target, "joint_angles")
    connect(builder, station, "tip_margin", recovery)
    connect(builder, station, "wheel_speeds", shift)
    connect(builder, pilot, "path", shift)
    connect(builder, pilot, "speed_command", shift)
    connect(builder, pilot, "recovery_command", recovery, "command")
    connect(builder, pilot, "joint_command", recovery, "held_joint_command")
    for source, name in ((shift, "shift"), (recovery, "recovery")):
        for port in ("joint_command", "wheel_speed_command"):
            connect(builder, source, port, pilot, f"{name}_{port}")
    for port in ("joint_command", "wheel_speed_command", "wheel_torque_limit"):
        connect(builder, pilot, port, station)
    if config.imu is not None and config.pads is not None and config.ranges is not None:
        _add_detection(config, builder, station, body)
        if meshcat is not None:
            _add_display(config, builder, station, meshcat)
    if config.cameras is not None and meshcat is not None:
        for end, x in (("head", 0.2), ("tail", -1.2)):
            board = PictureBoard(PictureBoardConfig(xyz=[x, 1.3, 0.75]), meshcat, path=f"images/{end}")
            builder.AddNamedSystem(f"{end}_board", board)
            connect(builder, station, f"{end}_image", board, "image")
    export_outputs(builder)
    diagram = builder.Build()
    diagram.set_name("snake_moves")
    return diagram


def _add_detection(config: SnakeMovesConfig, builder: DiagramBuilder, station: System, body: SnakeBody) -> None:
    assert config.ranges is not None
    pilot, actuators = builder.GetSubsystemByName("pilot"), builder.GetSubsystemByName("actuators")
    speed = builder.AddNamedSystem("speed", InertialSpeed(config.speed, units=body.units))
    detector = builder.AddNamedSystem(
        "detector", StuckDetector(config.detector, measures=snake_measures(config.snake), zones=config.ranges.zones)
    )
    planner = builder.AddNamedSystem("planner", RecoveryPlanner(config.planner, body=body))
    for port in ("gyro", "accelerometer", "wheel_speeds"):
        connect(builder, station, port, speed)
    for port in ("joint_torques", "wheel_speeds", "wheel_torques", "pad_forces", "ranges", "rpy"):
        connect(builder, station, port, detector)
    for target in (detector, planner):
        connect(builder, actuators, "reported_joint_angles", target, "joint_angles")
    for target in (speed, detector):
        connect(builder, pilot, "wheel_speed_command", target)
    connect(builder, speed, "forward_speed", detector)
    connect(builder, detector, "diagnosis", planner)
    connect(builder, station, "rpy", planner)


def _add_display(config: SnakeMovesConfig, builder: DiagramBuilder, station: System, meshcat: Meshcat) -> None:
    assert config.ranges is not None
    snake = config.snake
    look = SnakeDisplayConfig(
        half_length=snake.half_length,
        width=2 * snake.half_width,
        wheel_radius=snake.wheel_radius,
        wheel_width=snake.wheel_width,
        tread=snake.tread,
    )
    display = SnakeDisplay(look, meshcat, units=snake.units, zones=config.ranges.zones)
    builder.AddNamedSystem("display", display)
    for port in ("rpy", "pad_forces", "ranges", "tip_margin"):
        connect(builder, station, port, display)
    pilot, actuators = builder.GetSubsystemByName("pilot"), builder.GetSubsystemByName("actuators")
    connect(builder, actuators, "reported_joint_angles", display, "joint_angles")
    connect(builder, actuators, "actuator_report", display)
    connect(builder, builder.GetSubsystemByName("detector"), "diagnosis", display)
    for port in ("recovery_command", "mode"):
        connect(builder, pilot, port, display)


class SnakeRun(DiagramReader):
    """A `make_snake_moves` diagram while it is simulated: one gives it moves and reads its ports."""

    def __init__(self, diagram: Diagram):
        super().__init__(diagram)
        self.simulator = Simulator(diagram)
        self.context: Context = self.simulator.get_mutable_context()
        self._number = -1
        self.give(Move())

    @property
    def time(self) -> float:
        """[s]"""
        return float(self.context.get_time())

    def give(self, move: Move) -> Move:
        """Begins `move`, under the next number, which is returned with it."""
        self._number += 1
        move = _with_number(move, self._number)
        self.diagram.GetInputPort("move").FixValue(self.context, move)
        return move

    def advance(self, seconds: float) -> None:
        """Simulates `seconds` on."""
        self.simulator.AdvanceTo(self.time + seconds)

    def head(self) -> np.ndarray:
        """True position (3,) of the nose in W [m]; for metrics only."""
        position: np.ndarray = self.read("station.cheat.X_WB").translation().copy()
        return position


def _with_number(move: Move, number: int) -> Move:
    return Move(**{**move.__dict__, "number": number})


__all__ = ["SnakeMovesConfig", "SnakeRun", "make_snake_moves", "snake_body"]
