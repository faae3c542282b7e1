"""Which way the flippers should stand: a commanded preset, or one that follows the robot's pitch."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..errors import ConfigError, PortError
from ..ports import eval_typed, weak_method
from .flipper_driver import FLIPPERS

AUTO = "auto"
"""The value of `flipper_preset` that leaves the choice to the rule."""


def _default_presets() -> dict[str, list[float]]:
    # −0.15 rad brings a flipper's lower run almost in line with the track's, so that robot and flippers bridge two
    # stair edges as one flat belly; 0.5 rad puts the tip 0.19 m over the ground, above a step of 0.18 m.
    return {
        "flat": [0.0, 0.0, 0.0, 0.0],
        "climb": [0.5, 0.5, -0.15, -0.15],
        "descend": [-0.15, -0.15, -0.15, -0.15],
    }


@dataclass(kw_only=True)
class FlipperRuleConfig:
    """Flipper angles for kinds of ground, and when the pitch calls for which."""

    # [s] between two looks at the attitude.
    period: float = quantity(0.02, unit="s", above=0.0)
    # [rad] angles by name, each in the order front left, front right, rear left, rear right. `flat`, `climb` and
    # `descend` must be there, others may be added for command.
    flipper_presets: dict[str, list[float]] = field(default_factory=_default_presets)
    # [rad] pitch that starts climb (nose up) or descend (nose down): more than a ramp for wheelchairs (5 deg) or a
    # single plank gives, less than half of a stair (35 deg).
    slope_enter: float = quantity(0.21, unit="rad", above=0.0)
    # [rad] pitch below which they end, clearly less than slope_enter so that the edge does not switch to and fro.
    slope_exit: float = quantity(0.10, unit="rad", above=0.0)
    # [s] for which the pitch must call for another preset before it is taken, longer than it takes to cross a bump.
    confirm_time: float = quantity(0.3, unit="s", low=0.0)


def preset_for_pitch(active: str, pitch: float, slope_enter: float, slope_exit: float) -> str:
    """The preset that `pitch` [rad] (positive nose down, as a rotation about y) calls for, with hysteresis.

    `climb` starts above `slope_enter` [rad] nose up and ends below `slope_exit`; `descend` likewise nose down.
    """
    nose_up = -pitch
    if nose_up > (slope_exit if active == "climb" else slope_enter):
        return "climb"
    if -nose_up > (slope_exit if active == "descend" else slope_enter):
        return "descend"
    return "flat"


class FlipperRule(LeafSystem):
    """
    .. pydrake_system::

        name: FlipperRule
        input_ports:
        - rpy
        - flipper_preset
        output_ports:
        - flipper_command
        - active_preset

    Chooses among the presets of the configuration. `rpy` is roll, pitch, yaw [rad] of the base, from the IMU's
    estimate. `flipper_preset` (a string, optional) is "auto" or the name of a preset; a name is taken at the next
    sample, "auto" follows the pitch (`preset_for_pitch`): it changes only after the pitch has called for the same other
    preset for `confirm_time`, so that bumps do not flip it. When "auto" takes over from a command it starts from the
    preset that was commanded: a robot sent up a stair with `climb` keeps it until the pitch falls below `slope_exit`.
    Flat flippers mount a step by friction on its riser alone, so command `climb` before a stair: it lays the tips on
    the edge.

    `flipper_command` (4) [rad] is in the order of `FLIPPERS`; `active_preset` is a string. Both depend on state only.
    It starts with `flat`. A pitch that is not finite changes nothing.

    Raises `ConfigError` for a value out of range, `PortError` for an unknown preset, or when "auto" is asked for and
    `rpy` is not connected.
    """

    def __init__(self, config: FlipperRuleConfig):
        super().__init__()
        check_config(config)
        if config.slope_exit > config.slope_enter:
            raise ConfigError(
                "is above slope_enter",
                key="slope_exit",
                value=config.slope_exit,
                valid=f"<= {config.slope_enter:g} rad",
            )
        check_presets(config.flipper_presets)
        self._config = config
        self._names = list(config.flipper_presets)
        self._angles = np.array(list(config.flipper_presets.values()), dtype=float)
        self._rpy = self.DeclareVectorInputPort("rpy", 3)
        self._preset = self.DeclareAbstractInputPort("flipper_preset", Value(AUTO))
        flat = float(self._names.index("flat"))
        # Indices of the active preset and of the one that the pitch calls for, and how long it has done so [s].
        self.DeclareDiscreteState(np.array([flat, flat, 0.0]))
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Update)
        state = {self.xd_ticket()}
        self.DeclareVectorOutputPort("flipper_command", 4, self._CalcFlipperCommand, prerequisites_of_calc=state)
        self.DeclareAbstractOutputPort(
            "active_preset", lambda: Value("flat"), weak_method(self._CalcActivePreset), prerequisites_of_calc=state
        )

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        active, called, since = context.get_discrete_state_vector().value()
        name = eval_typed(self, context, "flipper_preset", str) if self._preset.HasValue(context) else AUTO
        if name != AUTO:
            if name not in self._names:
                where = f"{type(self).__name__}.flipper_preset"
                raise PortError("unknown preset", where=where, value=name, valid=[AUTO, *self._names])
            active = called = self._names.index(name)
            since = 0.0
        else:
            call = self._names.index(self._called_preset(context, self._names[int(active)]))
            since = since + self._config.period if call == called and call != active else 0.0
            called = call
            if call != active and since >= self._config.confirm_time - 1e-9:
                active, since = call, 0.0
        discrete_state.set_value(np.array([active, called, since]))

    def _called_preset(self, context: Context, active: str) -> str:
        if not self._rpy.HasValue(context):
            where = f"{type(self).__name__}.rpy"
            raise PortError("input port is not connected", where=where, valid="roll, pitch, yaw, or a commanded preset")
        pitch = float(eval_typed(self, context, "rpy", np.ndarray)[1])
        if not np.isfinite(pitch):
            return active
        return preset_for_pitch(active, pitch, self._config.slope_enter, self._config.slope_exit)

    def _active(self, context: Context) -> int:
        return int(context.get_discrete_state_vector().value()[0])

    def _CalcFlipperCommand(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._angles[self._active(context)])

    def _CalcActivePreset(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._names[self._active(context)])


def check_presets(presets: Mapping[str, list[float]], key: str = "flipper_presets") -> None:
    """Raises `ConfigError` unless there are `flat`, `climb` and `descend`, and every preset is four finite angles."""
    if missing := [name for name in ("flat", "climb", "descend") if name not in presets]:
        raise ConfigError("presets are missing", key=key, value=list(presets), valid=missing)
    if AUTO in presets:
        raise ConfigError("the name is taken by the rule", key=key, value=AUTO)
    for name, angles in presets.items():
        if np.shape(angles) != (len(FLIPPERS),) or not np.isfinite(angles).all():
            raise ConfigError("not four angles", key=f"{key}.{name}", value=angles, valid=FLIPPERS)
