"""A LiDAR on a tilt unit: the sweep of its axis, and where the encoder says that the LiDAR was at the end of a scan."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State

from ..config import check_config, quantity
from ..errors import ConfigError
from ..noise import generator_at
from ..ports import eval_typed, weak_method
from .setpoints import state_indices

TILT_JOINT = "tilt_joint"
"""Joint of a robot's tilt unit; its axis is the y axis of frame `tilt_mount`, and it carries the link `lidar`."""


@dataclass(kw_only=True)
class TiltConfig:
    """How a tilt unit sweeps. Angles look down; 0 is level. With equal angles it stands still."""

    # The two ends of the sweep. From 0.6 m over ground, 5 to 50 degrees see the floor between 7 m and 0.5 m ahead.
    lowest_deg: float = quantity(5.0, unit="deg", low=-45.0, high=68.0)
    highest_deg: float = quantity(50.0, unit="deg", low=-45.0, high=68.0)
    # Time of a sweep down and up again.
    period: float = quantity(1.5, unit="s", above=0.0)
    # `triangle` turns at constant rate, so that scans are equally far apart; `sine` turns back softly.
    profile: str = quantity("triangle", choices=("triangle", "sine"))
    # Step of the encoder: 14 bits a turn. Assumed, as is its noise.
    resolution: float = quantity(2 * np.pi / 2**14, unit="rad", above=0.0)
    # Standard deviation of an encoder reading.
    noise: float = quantity(2e-4, unit="rad", low=0.0)

    def limits(self) -> np.ndarray:
        """Both ends of the sweep [rad], (2,). Raises `ConfigError` when they are the wrong way round."""
        if self.lowest_deg > self.highest_deg:
            raise ConfigError(
                "is above highest_deg", key="lowest_deg", value=self.lowest_deg, valid=f"<= {self.highest_deg:g} deg"
            )
        return np.deg2rad([self.lowest_deg, self.highest_deg])


def tilt_joints(plant: MultibodyPlant, model_instance: ModelInstanceIndex) -> list[str]:
    """The name of the model's tilt joint in a list, which is empty for a model without one."""
    return [TILT_JOINT] if plant.HasJointNamed(TILT_JOINT, model_instance) else []


def sweep(time: float, config: TiltConfig) -> tuple[float, float]:
    """Angle [rad] and rate [rad/s] at `time` [s]. The sweep starts at its lowest angle."""
    low, high = config.limits()
    phase = (time / config.period) % 1.0
    if config.profile == "sine":
        turn = 2 * math.pi * phase
        share, rate = (1 - math.cos(turn)) / 2, math.pi / config.period * math.sin(turn)
    else:
        share, rate = 1 - abs(2 * phase - 1), math.copysign(2 / config.period, 0.5 - phase)
    return low + share * (high - low), rate * (high - low)


class TiltSweep(LeafSystem):
    """
    .. pydrake_system::

        name: TiltSweep
        output_ports:
        - tilt_setpoint

    Sends a tilt unit up and down for ever: `tilt_setpoint` (2) is the angle [rad], down is positive, and the rate
    [rad/s] that `sweep` gives for the time, for the position control of the joint.

    Raises `ConfigError` for a value out of range or a sweep whose lowest angle is above its highest.
    """

    def __init__(self, config: TiltConfig):
        super().__init__()
        check_config(config, where="tilt")
        config.limits()
        self._config = config
        self.DeclareVectorOutputPort("tilt_setpoint", 2, self._CalcSetpoint, prerequisites_of_calc={self.time_ticket()})

    def _CalcSetpoint(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(sweep(context.get_time(), self._config)))


@dataclass
class _Reading:
    """What the encoder read last, and how often it has."""

    angle: float = 0.0
    X_BS: RigidTransform | None = None
    count: int = 0


class TiltEncoder(LeafSystem):
    """
    .. pydrake_system::

        name: TiltEncoder
        input_ports:
        - state
        output_ports:
        - tilt_angle
        - X_BS

    Reads the angle of a tilt unit once a scan and says where the LiDAR is on the robot:
    X_BS = X_BN Ry(angle) X_TS, with N the mount of the unit on the base B and T its turning part.

    - `state`: the plant's state of the robot.
    - `tilt_angle` (1) [rad]: down is positive; with noise, in steps of the encoder's resolution.
    - `X_BS` (RigidTransform): pose of the sensor S in the base.

    It samples with the period of the LiDAR, by the same kind of event, and holds: whoever reads `X_BS` and a LiDAR's
    `scan_S` together gets the pose at the `end_time` of that scan. At the start it reads at once.

    Raises:
        ConfigError: a value of the configuration is out of range, or the robot has no tilt unit.
        PortError: `state` is not connected.
    """

    def __init__(
        self,
        config: TiltConfig,
        plant: MultibodyPlant,
        model_instance: ModelInstanceIndex,
        *,
        period: float,
        seed: int = 0,
    ):
        """
        Args:
            period: of the LiDAR [s].
            seed: of the noise; two runs with one seed are equal.
        """
        super().__init__()
        check_config(config, where="tilt")
        if not tilt_joints(plant, model_instance):
            raise ConfigError(
                "the robot has no tilt unit", key="tilt", value=plant.GetModelInstanceName(model_instance)
            )
        self._config, self._seed = config, seed
        self._index = int(state_indices(plant, model_instance, [TILT_JOINT])[0])
        context = plant.CreateDefaultContext()
        base, mount, part, lidar = (
            plant.GetFrameByName(name, model_instance) for name in ("base", "tilt_mount", "tilt", "lidar")
        )
        self._X_BN = plant.CalcRelativeTransform(context, base, mount)
        self._X_TS = plant.CalcRelativeTransform(context, part, lidar)
        self.DeclareVectorInputPort("state", plant.num_multibody_states(model_instance))
        self._reading = self.DeclareAbstractState(AbstractValue.Make(_Reading(X_BS=self._pose(0.0))))
        self.DeclareInitializationUnrestrictedUpdateEvent(self._Read)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._Read)
        ticket = {self.abstract_state_ticket(self._reading)}
        self.DeclareVectorOutputPort("tilt_angle", 1, self._CalcAngle, prerequisites_of_calc=ticket)
        self.DeclareAbstractOutputPort(
            "X_BS", lambda: AbstractValue.Make(RigidTransform()), weak_method(self._CalcPose), ticket
        )

    def _pose(self, angle: float) -> RigidTransform:
        return self._X_BN @ RigidTransform(RotationMatrix.MakeYRotation(angle)) @ self._X_TS

    def _Read(self, context: Context, state: State) -> None:
        held: Any = state.get_mutable_abstract_state(int(self._reading))
        before: _Reading = held.get_value()
        noise = self._config.noise * generator_at(self._seed, before.count).standard_normal()
        true = eval_typed(self, context, "state", np.ndarray)[self._index]
        angle = float(np.rint((true + noise) / self._config.resolution) * self._config.resolution)
        held.set_value(_Reading(angle, self._pose(angle), before.count + 1))

    def _last(self, context: Context) -> _Reading:
        held: Any = context.get_abstract_state(int(self._reading))
        reading: _Reading = held.get_value()
        return reading

    def _CalcAngle(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([self._last(context).angle]))

    def _CalcPose(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._last(context).X_BS)
