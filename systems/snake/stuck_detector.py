"""Watches what a snake can measure and says when it is stuck, where, and how (row S1-g)."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method
from .posture import axle_positions, belly_loads, nearest_by_half
from .stuck_features import SnakeMeasures, StuckFeatures
from .stuck_rules import Diagnosis, StuckRules, diagnose, stuck_probability


@dataclass(kw_only=True)
class StuckDetectorConfig:
    """How measurements are gathered and when the answer changes."""

    # Time between two looks at the measurements.
    period: float = quantity(0.02, unit="s", above=0.0)
    # Time constant over which forces and speeds are averaged.
    window: float = quantity(0.4, unit="s", above=0.0)
    # Time after the wheels are told to go before anything is said.
    patience: float = quantity(0.8, unit="s", low=0.0)
    # The robot is stuck when the probability has stayed above this for a while, and free again when below half of it.
    probability: float = quantity(0.8, above=0.0, high=1.0)
    hold: float = quantity(0.4, unit="s", low=0.0)
    rules: StuckRules = field(default_factory=StuckRules)


# Layout of the discrete state, before the averages.
_DRIVING, _ABOVE, _STUCK, _PROBABILITY, _SCALARS = range(5)


class StuckDetector(LeafSystem):
    """
    .. pydrake_system::

        name: StuckDetector
        input_ports:
        - joint_angles
        - joint_torques
        - wheel_speeds
        - wheel_torques
        - wheel_speed_command
        - pad_forces
        - ranges
        - rpy
        - forward_speed
        output_ports:
        - diagnosis

    Tells from measurements alone whether a snake with n units is stuck, at which unit, and in which class of S1-d.

    - `joint_angles`, `joint_torques` (2n - 1): p0, y0, p1, ... [rad, N m].
    - `wheel_speeds`, `wheel_torques`, `wheel_speed_command` (2n): left and right of unit 0, of 1, ... [rad/s, N m].
    - `pad_forces` (4n) [N], see `ContactPads`; `ranges` [m], see `RangeSensors`.
    - `rpy` (3) [rad] of the IMU on the head; `forward_speed` (1) [m/s] of the head, see `InertialSpeed`.
    - `diagnosis`: a `Diagnosis`.

    Forces and torques are averaged over `window`. How they become a diagnosis is said at `stuck_probability` and
    `class_scores`. The class is judged anew as long as the robot is stuck and drives; while the wheels rest, the last
    answer stands.

    Raises `ConfigError` on values out of range and `PortError` when a port is not connected.
    """

    def __init__(self, config: StuckDetectorConfig, *, measures: SnakeMeasures, zones: int):
        super().__init__()
        check_config(config, key="stuck_detector")
        self._config, self._measures = config, measures
        n = measures.units
        self._sizes = {
            "joint_angles": 2 * n - 1,
            "joint_torques": 2 * n - 1,
            "wheel_speeds": 2 * n,
            "wheel_torques": 2 * n,
            "wheel_speed_command": 2 * n,
            "pad_forces": 4 * n,
            "ranges": 6 * n * zones,
            "rpy": 3,
            "forward_speed": 1,
        }
        for name, size in self._sizes.items():
            self.DeclareVectorInputPort(name, size)
        # Averages: rim speed, thrust, belly loads (2n), yaw torques (n - 1).
        self.DeclareDiscreteState(_SCALARS + 2 + 2 * n + n - 1)
        self._diagnosis = self.DeclareAbstractState(AbstractValue.Make(Diagnosis()))
        self.DeclareAbstractOutputPort(
            "diagnosis",
            lambda: AbstractValue.Make(Diagnosis()),
            weak_method(self._CalcDiagnosis),
            prerequisites_of_calc={self.abstract_state_ticket(self._diagnosis)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Update)

    def _CalcDiagnosis(self, context: Context, output: AbstractValue) -> None:
        held: Any = context.get_abstract_state(int(self._diagnosis))
        output.set_value(held.get_value())

    def _Update(self, context: Context, state: State) -> EventStatus:
        config, measures = self._config, self._measures
        read = {name: eval_typed(self, context, name, np.ndarray) for name in self._sizes}
        x = context.get_discrete_state_vector().value().copy()
        command = float(read["wheel_speed_command"].mean()) * measures.wheel_radius
        driving = abs(command) >= config.rules.driving_speed
        self._average(x, read)
        x[_DRIVING] = x[_DRIVING] + config.period if driving else 0.0
        held: Any = context.get_abstract_state(int(self._diagnosis))
        diagnosis = held.get_value()
        if driving:
            features = self._features(x, read, command)
            x[_PROBABILITY] = stuck_probability(features, measures, config.rules)
            self._decide(x)
            diagnosis = diagnose(features, float(x[_PROBABILITY]), bool(x[_STUCK]), measures, config.rules)
        state.get_mutable_discrete_state().set_value(x)
        state.get_mutable_abstract_state(int(self._diagnosis)).set_value(diagnosis)
        return EventStatus.Succeeded()

    def _average(self, x: np.ndarray, read: dict[str, np.ndarray]) -> None:
        radius = self._measures.wheel_radius
        now = np.r_[
            np.median(read["wheel_speeds"]) * radius,
            read["wheel_torques"].sum() / radius,
            belly_loads(read["pad_forces"]),
            read["joint_torques"][1::2],
        ]
        share = min(1.0, self._config.period / self._config.window)
        x[_SCALARS:] += share * (np.nan_to_num(now) - x[_SCALARS:])

    def _features(self, x: np.ndarray, read: dict[str, np.ndarray], command: float) -> StuckFeatures:
        n = self._measures.units
        averages = x[_SCALARS:]
        heights = axle_positions(np.nan_to_num(read["joint_angles"]), read["rpy"], self._measures.half_length)[:, 2]
        nearest = nearest_by_half(read["ranges"], n)
        return StuckFeatures(
            wheel_speed=float(averages[0]),
            command_speed=command,
            body_speed=float(read["forward_speed"][0]),
            thrust=float(averages[1]),
            belly_loads=averages[2 : 2 + 2 * n],
            yaw_torques=averages[2 + 2 * n :],
            axle_heights=heights,
            under=nearest[:, 0],
            beside=nearest[:, 1:].T,
        )

    def _decide(self, x: np.ndarray) -> None:
        config = self._config
        likely = x[_PROBABILITY] >= config.probability and x[_DRIVING] >= config.patience
        x[_ABOVE] = x[_ABOVE] + config.period if likely else 0.0
        if x[_ABOVE] >= config.hold:
            x[_STUCK] = 1.0
        elif x[_PROBABILITY] < 0.5 * config.probability:
            x[_STUCK] = 0.0
