"""Faults of the snake's actuators: overload, heat and lost links, as they are on the robot and as it reports them."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..errors import ConfigError
from ..ports import eval_typed, weak_method
from .recovery_motion import joint_name

FAULTS = ("dead", "lost_link")


@dataclass(kw_only=True)
class Fault:
    """A fault that happens."""

    # Joint, such as p4 or y3.
    joint: str = "p0"
    # dead: no torque any more. lost_link: nothing comes from the actuator or gets to it, so no angle and no torque.
    kind: str = quantity("dead", choices=FAULTS)
    # When it begins.
    time: float = quantity(0.0, unit="s", low=0.0)


@dataclass(kw_only=True)
class ActuatorFaultsConfig:
    """Limits and heat of the actuators. Values are assumed."""

    # Time between two looks.
    period: float = quantity(0.02, unit="s", above=0.0)
    # Torque of a joint at which it is overloaded, and the time that it may be.
    overload_torque: float = quantity(14.0, unit="N m", above=0.0)
    overload_time: float = quantity(1.0, unit="s", low=0.0)
    # Temperature around, and at which the torque begins to be taken back and is gone.
    ambient: float = quantity(20.0, unit="degC")
    warm: float = quantity(70.0, unit="degC")
    hot: float = quantity(85.0, unit="degC")
    # Temperature over the ambient that a steady torque of 1 N m leads to, times its square, and how fast.
    heating: float = quantity(0.8, unit="K/(N m)²", low=0.0)
    time_constant: float = quantity(120.0, unit="s", above=0.0)
    # Largest torque of a joint that is well.
    torque: float = quantity(15.0, unit="N m", above=0.0)
    faults: list[Fault] = field(default_factory=list)


@dataclass(frozen=True)
class ActuatorReport:
    """What the actuators report.

    Attributes:
        words: (2n - 1) "", "overload", "warm", "hot", "dead" or "no link" of every joint from the head.
        temperatures: (2n - 1) [degC].
    """

    words: tuple[str, ...] = ()
    temperatures: tuple[float, ...] = ()

    @property
    def errors(self) -> dict[str, str]:
        """What is wrong, by the name of the joint."""
        return {joint_name(i): word for i, word in enumerate(self.words) if word}


def heated(temperature: np.ndarray, torque: np.ndarray, dt: float, config: ActuatorFaultsConfig) -> np.ndarray:
    """Temperatures [degC] after `dt` [s] under `torque` [N m]: first order, towards ambient + heating × torque²."""
    steady = config.ambient + config.heating * torque**2
    return steady + (temperature - steady) * np.exp(-dt / config.time_constant)


def torque_share(temperature: np.ndarray, config: ActuatorFaultsConfig) -> np.ndarray:
    """Share of its torque that an actuator gives: 1 up to `warm`, 0 from `hot` on, linear between."""
    return np.clip((config.hot - temperature) / (config.hot - config.warm), 0.0, 1.0)


class ActuatorFaults(LeafSystem):
    """
    .. pydrake_system::

        name: ActuatorFaults
        input_ports:
        - joint_angles
        - joint_torques
        output_ports:
        - reported_joint_angles
        - joint_torque_limit
        - actuator_report

    Sits between the joints' actuators and everything that reads them, for a snake with n units.

    - `joint_angles` [rad], `joint_torques` [N m]: (2n - 1), measured at the joints.
    - `reported_joint_angles` (2n - 1) [rad]: NaN where the link is lost.
    - `joint_torque_limit` (2n - 1) [N m]: less where an actuator is warm, zero where it is hot, dead or without link.
    - `actuator_report`: an `ActuatorReport`, in words for the display.

    Faults happen at the times of the configuration. Raises `ConfigError` on values out of range or a joint that the
    robot does not have, and `PortError` when a port is not connected.
    """

    def __init__(self, config: ActuatorFaultsConfig, *, units: int):
        super().__init__()
        check_config(config, key="actuator_faults")
        if not config.hot > config.warm > config.ambient:
            raise ConfigError("not ambient < warm < hot", key="actuator_faults.hot", value=config.hot)
        self._config, self._joints = config, 2 * units - 1
        names = [joint_name(i) for i in range(self._joints)]
        for i, fault in enumerate(config.faults):
            if fault.joint not in names:
                key = f"actuator_faults.faults[{i}].joint"
                raise ConfigError("no such joint", key=key, value=fault.joint, valid=f"{names[0]} to {names[-1]}")
        self._when = np.full((len(FAULTS), self._joints), np.inf)
        for fault in config.faults:
            row, joint = FAULTS.index(fault.kind), names.index(fault.joint)
            self._when[row, joint] = min(self._when[row, joint], fault.time)
        self.DeclareVectorInputPort("joint_angles", self._joints)
        self.DeclareVectorInputPort("joint_torques", self._joints)
        # Temperatures, then how long each has been overloaded.
        self.DeclareDiscreteState(np.r_[np.full(self._joints, config.ambient), np.zeros(self._joints)])
        state = {self.xd_ticket(), self.time_ticket()}
        self.DeclareVectorOutputPort(
            "reported_joint_angles",
            self._joints,
            self._CalcReportedAngles,
            {self.time_ticket(), self.input_port_ticket(self.GetInputPort("joint_angles").get_index())},
        )
        self.DeclareVectorOutputPort("joint_torque_limit", self._joints, self._CalcTorqueLimit, state)
        self.DeclareAbstractOutputPort(
            "actuator_report", lambda: AbstractValue.Make(ActuatorReport()), weak_method(self._CalcReport), state
        )
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Update)

    def _faulty(self, context: Context) -> np.ndarray:
        """(2, 2n - 1) bool: which of `FAULTS` every joint has."""
        faulty: np.ndarray = context.get_time() >= self._when
        return faulty

    def _CalcReportedAngles(self, context: Context, output: BasicVector) -> None:
        angles = np.array(eval_typed(self, context, "joint_angles", np.ndarray))
        angles[self._faulty(context)[1]] = np.nan
        output.SetFromVector(angles)

    def _CalcTorqueLimit(self, context: Context, output: BasicVector) -> None:
        temperature = context.get_discrete_state_vector().value()[: self._joints]
        limit = self._config.torque * torque_share(temperature, self._config)
        output.SetFromVector(np.where(self._faulty(context).any(axis=0), 0.0, limit))

    def _CalcReport(self, context: Context, output: AbstractValue) -> None:
        config = self._config
        temperature, overloaded = context.get_discrete_state_vector().value().reshape(2, -1)
        dead, lost = self._faulty(context)
        words = np.full(self._joints, "", dtype=object)
        for word, where in (
            ("overload", overloaded >= config.overload_time),
            ("warm", temperature >= config.warm),
            ("hot", temperature >= config.hot),
            ("dead", dead),
            ("no link", lost),
        ):
            words[where] = word
        output.set_value(ActuatorReport(tuple(words), tuple(float(t) for t in temperature)))

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        config = self._config
        torque = np.abs(np.nan_to_num(eval_typed(self, context, "joint_torques", np.ndarray)))
        temperature, overloaded = context.get_discrete_state_vector().value().reshape(2, -1)
        over = np.where(torque >= config.overload_torque, overloaded + config.period, 0.0)
        discrete_state.set_value(np.r_[heated(temperature, torque, config.period, config), over])
