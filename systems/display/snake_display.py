"""The snake in Meshcat as it feels itself (row S1-e): posture with true attitude, pads, ranges, segment and target."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import Box, Cylinder, Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config, quantity
from ..ports import eval_typed
from ..snake.actuator_faults import ActuatorReport
from ..snake.posture import belly_loads, half_poses, nearest_by_half
from ..snake.recovery_motion import RecoveryCommand
from ..snake.stuck_rules import Diagnosis
from .colours import set_colour
from .picture_board import lettering, picture_mesh

# Colour of every mode, so that it is never mistaken.
MODE_COLOURS = {
    "hold": Rgba(0.5, 0.5, 0.5, 1.0),
    "wheels": Rgba(0.1, 0.6, 0.1, 1.0),
    "shift": Rgba(0.1, 0.4, 0.9, 1.0),
    "relax": Rgba(0.9, 0.7, 0.1, 1.0),
    "recover": Rgba(0.85, 0.1, 0.1, 1.0),
}

_ALARM = Rgba(0.6, 0.0, 0.25, 1.0)
_BOARD_WIDTH = 0.6
"""[m] of what is written."""


@dataclass(kw_only=True)
class SnakeDisplayConfig:
    """How the snake is drawn."""

    # Time between two drawings.
    period: float = quantity(0.1, unit="s", above=0.0)
    # Half a unit, width and height of the body, radius, width and tread of the wheels.
    half_length: float = quantity(0.09, unit="m", above=0.0)
    width: float = quantity(0.11, unit="m", above=0.0)
    height: float = quantity(0.035, unit="m", above=0.0)
    wheel_radius: float = quantity(0.05, unit="m", above=0.0)
    wheel_width: float = quantity(0.024, unit="m", above=0.0)
    tread: float = quantity(0.16, unit="m", above=0.0)
    # Force that is drawn in the strongest colour.
    strong_force: float = quantity(30.0, unit="N", above=0.0)
    # Ranges beyond this are not drawn.
    near: float = quantity(0.12, unit="m", above=0.0)
    # Tip-over margin that is drawn in green; at zero it is red.
    safe_margin: float = quantity(0.06, unit="m", above=0.0)
    # Where the drawing stands beside the robot [m].
    offset: list[float] = quantity([0.0, 0.9, 0.0], unit="m")


def force_colour(force: float, strong: float) -> Rgba:
    """Blue-grey without force, through yellow to red at `strong`."""
    share = float(np.clip(force / strong, 0.0, 1.0))
    if share <= 0:
        return Rgba(0.45, 0.55, 0.7, 1.0)
    return Rgba(1.0, max(0.0, 1.0 - share), 0.1, 1.0)


def errors_in_words(report: ActuatorReport) -> str:
    """One line that names what is wrong with which joint, "" when nothing is."""
    return ", ".join(f"{joint}: {word}" for joint, word in report.errors.items())


def _above(X: RigidTransform, offset: list[float]) -> RigidTransform:
    """An upright frame at an offset from the origin of another, in W [m]."""
    return RigidTransform(X.translation() + np.array(offset))


@dataclass(frozen=True)
class _Shown:
    """What has been set up in Meshcat so far."""

    mode: str = ""
    errors: str = ""
    error_boards: int = 0
    built: bool = False
    # Of the drive that was last: in a recovery the wheels turn with the shape, and what is said then means nothing.
    diagnosis: Diagnosis = field(default_factory=Diagnosis)


class SnakeDisplay(LeafSystem):
    """
    .. pydrake_system::

        name: SnakeDisplay
        input_ports:
        - joint_angles
        - rpy
        - pad_forces
        - ranges
        - tip_margin
        - recovery_command
        - diagnosis
        - mode
        - actuator_report
        output_ports: []

    Draws a snake with n units in Meshcat below `snake/`, from what it measures (row S1-e), beside the simulated one.

    - `joint_angles` (2n - 1) [rad] and `rpy` (3) [rad] of the head: the posture with its true attitude.
    - `pad_forces` (4n) [N]: every half of the body in the colour of what presses on its belly.
    - `ranges` [m], see `RangeSensors`: a plane where something is near.
    - `tip_margin` (1) [m]: a ball over the head, green to red.
    - `recovery_command` (`RecoveryCommand`): ends of the segment and the target, while it runs.
    - `diagnosis` (`Diagnosis`): a ball at the unit that is stuck, as it was said when the wheels last drove.
    - `mode` (str): in large letters on a board of its own colour over the robot, and as a button in the panel.
    - `actuator_report` (`ActuatorReport`): what is wrong with the actuators, in words, on a board and as a button.

    Drawing is all that it does; a joint without an angle is drawn straight. Raises `ConfigError` on values out of
    range and `PortError` when a port is not connected or carries another type.
    """

    def __init__(self, config: SnakeDisplayConfig, meshcat: Meshcat, *, units: int, zones: int):
        super().__init__()
        check_config(config, key="display")
        self._config, self._meshcat, self._units = config, meshcat, units
        self.DeclareVectorInputPort("joint_angles", 2 * units - 1)
        self.DeclareVectorInputPort("rpy", 3)
        self.DeclareVectorInputPort("pad_forces", 4 * units)
        self.DeclareVectorInputPort("ranges", 6 * units * zones)
        self.DeclareVectorInputPort("tip_margin", 1)
        self.DeclareAbstractInputPort("recovery_command", AbstractValue.Make(RecoveryCommand()))
        self.DeclareAbstractInputPort("diagnosis", AbstractValue.Make(Diagnosis()))
        self.DeclareAbstractInputPort("mode", AbstractValue.Make(""))
        self.DeclareAbstractInputPort("actuator_report", AbstractValue.Make(ActuatorReport()))
        self.DeclareAbstractState(AbstractValue.Make(_Shown()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Draw)

    def _Draw(self, context: Context, state: State) -> EventStatus:
        held: Any = context.get_abstract_state(0)
        shown: _Shown = held.get_value()
        if not shown.built:
            self._build()
        angles = np.nan_to_num(eval_typed(self, context, "joint_angles", np.ndarray))
        poses = half_poses(angles, eval_typed(self, context, "rpy", np.ndarray), self._config.half_length)
        offset = np.array(self._config.offset)
        low = min(X.translation()[2] for X in poses) - self._config.wheel_radius
        X_WH = RigidTransform(offset - [0.0, 0.0, low])
        poses = [X_WH @ X for X in poses]
        time = context.get_time()
        self._draw_body(poses, time)
        self._draw_pads(eval_typed(self, context, "pad_forces", np.ndarray), time)
        self._draw_ranges(eval_typed(self, context, "ranges", np.ndarray), poses, time)
        self._draw_segment(eval_typed(self, context, "recovery_command", RecoveryCommand), poses, time)
        self._draw_margin(float(eval_typed(self, context, "tip_margin", np.ndarray)[0]), poses[0], time)
        mode = eval_typed(self, context, "mode", str)
        if mode == "wheels":
            shown = replace(shown, diagnosis=eval_typed(self, context, "diagnosis", Diagnosis))
        self._draw_stuck(shown.diagnosis, poses, time)
        shown = self._show_words(
            replace(shown, built=True),
            mode,
            errors_in_words(eval_typed(self, context, "actuator_report", ActuatorReport)),
            poses[0],
            time,
        )
        state.get_mutable_abstract_state(0).set_value(shown)
        return EventStatus.Succeeded()

    def _build(self) -> None:
        config, meshcat = self._config, self._meshcat
        half = Box(0.94 * config.half_length, config.width, config.height)
        middle = RigidTransform(np.array([-config.half_length / 2, 0.0, 0.0]))
        for i in range(2 * self._units):
            meshcat.SetObject(f"snake/half/{i}/body", half, Rgba(0.45, 0.55, 0.7, 1.0))
            meshcat.SetTransform(f"snake/half/{i}/body", middle)
            for side in range(3):
                plane = (
                    Box(config.half_length, config.width, 0.001) if side == 0 else Box(config.half_length, 0.001, 0.04)
                )
                meshcat.SetObject(f"snake/half/{i}/range/{side}", plane, Rgba(0.1, 0.7, 0.9, 0.5))
        wheel = Cylinder(config.wheel_radius, config.wheel_width)
        for i in range(self._units):
            for k, sign in enumerate((1, -1)):
                path = f"snake/half/{2 * i}/wheel/{k}"
                meshcat.SetObject(path, wheel, Rgba(0.1, 0.1, 0.1, 1.0))
                place = np.array([-config.half_length, sign * config.tread / 2, 0.0])
                meshcat.SetTransform(path, RigidTransform(RotationMatrix.MakeXRotation(np.pi / 2), place))
        meshcat.SetObject("snake/margin", Sphere(0.03), Rgba(0.1, 0.8, 0.1, 1.0))
        for mode, colour in MODE_COLOURS.items():
            meshcat.SetObject(f"snake/mode/{mode}", picture_mesh(lettering(mode.upper(), colour), _BOARD_WIDTH))
            meshcat.SetProperty(f"snake/mode/{mode}", "visible", False, 0.0)
        meshcat.SetObject("snake/target", Sphere(0.025), Rgba(0.85, 0.1, 0.1, 0.8))
        meshcat.SetObject("snake/stuck", Sphere(0.09), Rgba(1.0, 0.5, 0.0, 0.35))
        for k in range(2):
            meshcat.SetObject(f"snake/segment/{k}", Sphere(0.035), Rgba(0.85, 0.1, 0.1, 0.8))

    def _draw_body(self, poses: list[RigidTransform], time: float) -> None:
        for i, X in enumerate(poses):
            self._meshcat.SetTransform(f"snake/half/{i}", X, time)

    def _draw_pads(self, pad_forces: np.ndarray, time: float) -> None:
        for i, force in enumerate(belly_loads(pad_forces)):
            set_colour(
                self._meshcat, f"snake/half/{i}/body", force_colour(float(force), self._config.strong_force), time
            )

    def _draw_ranges(self, ranges: np.ndarray, poses: list[RigidTransform], time: float) -> None:
        config = self._config
        middle = -config.half_length / 2
        for i, nearest in enumerate(nearest_by_half(ranges, self._units)):
            places = (
                [middle, 0, -config.height / 2 - nearest[0]],
                [middle, config.width / 2 + nearest[1], 0],
                [middle, -config.width / 2 - nearest[2], 0],
            )
            for side, place in enumerate(places):
                path = f"snake/half/{i}/range/{side}"
                self._meshcat.SetTransform(path, RigidTransform(np.array(place)), time)
                self._meshcat.SetProperty(path, "visible", bool(nearest[side] < config.near), time)

    def _draw_segment(self, command: RecoveryCommand, poses: list[RigidTransform], time: float) -> None:
        self._meshcat.SetProperty("snake/segment", "visible", command.run, time)
        self._meshcat.SetProperty("snake/target", "visible", command.run, time)
        if not command.run:
            return
        for k, unit in enumerate((command.first_unit, command.last_unit)):
            axle = poses[2 * unit + 1]  # the origin of a rear half is its pitch joint
            self._meshcat.SetTransform(f"snake/segment/{k}", _above(axle, [0.0, 0.0, 0.08]), time)
        self._meshcat.SetTransform("snake/target", RigidTransform(poses[0] @ np.array(command.target)), time)

    def _draw_margin(self, margin: float, X_WB: RigidTransform, time: float) -> None:
        share = float(np.clip(margin / self._config.safe_margin, 0.0, 1.0))
        set_colour(self._meshcat, "snake/margin", Rgba(1.0 - share, 0.8 * share, 0.1, 1.0), time)
        self._meshcat.SetTransform("snake/margin", _above(X_WB, [0.0, 0.0, 0.25]), time)

    def _draw_stuck(self, diagnosis: Diagnosis, poses: list[RigidTransform], time: float) -> None:
        self._meshcat.SetProperty("snake/stuck", "visible", diagnosis.stuck, time)
        if diagnosis.stuck:
            place = poses[2 * diagnosis.unit + 1].translation()
            self._meshcat.SetTransform("snake/stuck", RigidTransform(place), time)

    def _show_words(self, shown: _Shown, mode: str, errors: str, X_WB: RigidTransform, time: float) -> _Shown:
        meshcat, boards = self._meshcat, shown.error_boards
        for path, height in (("snake/mode", 0.42), ("snake/errors", 0.56)):
            meshcat.SetTransform(path, _above(X_WB, [-0.3, 0.0, height]), time)
        if mode != shown.mode:
            for path, visible in ((shown.mode, False), (mode, True)):
                if path in MODE_COLOURS:
                    meshcat.SetProperty(f"snake/mode/{path}", "visible", visible, time)
            self._swap_button(f"MODE: {shown.mode.upper()}" if shown.mode else "", f"MODE: {mode.upper()}")
        if errors != shown.errors:
            self._swap_button(shown.errors, errors)
            if shown.errors:
                meshcat.SetProperty(f"snake/errors/{boards - 1}", "visible", False, time)
            if errors:
                path, boards = f"snake/errors/{boards}", boards + 1
                meshcat.SetObject(path, picture_mesh(lettering(errors, _ALARM), _BOARD_WIDTH))
                meshcat.SetProperty(path, "visible", False, 0.0)
                meshcat.SetProperty(path, "visible", True, time)
        return replace(shown, mode=mode, errors=errors, error_boards=boards)

    def _swap_button(self, before: str, after: str) -> None:
        if before:
            self._meshcat.DeleteButton(before, strict=False)
        if after:
            self._meshcat.AddButton(after)
