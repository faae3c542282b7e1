"""Position drives of the snake's joints and speed drives of its wheels, with limited torque."""

import weakref
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, LeafSystem

from ..config import check_config, quantity
from ..errors import ConfigError
from ..ports import eval_typed
from .snake_drive_kernels import drive_step


@dataclass(kw_only=True)
class SnakeDrivesConfig:
    """Limits of the drives of a snake. Values are assumed."""

    # [s] between two samples. That of the plant: within a longer one the stiff drives pull to and fro.
    period: float = quantity(0.005, unit="s", above=0.0)
    # [rad/s] largest speed of a pitch or yaw joint.
    joint_max_rate: float = quantity(1.5, unit="rad/s", above=0.0)
    # [N m] largest torque of a pitch or yaw joint; never more than the model's own.
    joint_torque: float = quantity(15.0, unit="N m", low=0.0)
    # [rad/s], [rad/s^2] largest speed and acceleration of a wheel.
    wheel_max_speed: float = quantity(10.0, unit="rad/s", above=0.0)
    wheel_max_acceleration: float = quantity(40.0, unit="rad/s^2", above=0.0)
    # [N m] largest torque of a wheel that it gives for ever: 6 N of thrust at the rim, ten pairs give 1.3 times the
    # robot's weight.
    wheel_torque: float = quantity(0.3, unit="N m", low=0.0)


class SnakeDrives(LeafSystem):
    """
    .. pydrake_system::

        name: SnakeDrives
        input_ports:
        - joint_command
        - wheel_speed_command
        - joint_torque_limit
        - wheel_torque_limit
        - state
        - net_actuation
        output_ports:
        - desired_state
        - joint_angles
        - joint_rates
        - joint_torques
        - wheel_angles
        - wheel_speeds
        - wheel_torques

    Drives a snake with n units. Joint quantities have 2n - 1 entries, p0, y0, p1, ... from the head on; wheel
    quantities 2n, left and right of unit 0, of unit 1, ....

    Commands, each optional:
    - `joint_command` [rad]: followed with at most `joint_max_rate` within the ranges of the joints. Where it is not
      connected or not finite, a joint holds its place.
    - `wheel_speed_command` [rad/s], positive ahead: not connected or not finite counts as zero. A wheel that is to
      stand is held at its angle, so that it does not creep under load.
    - `joint_torque_limit`, `wheel_torque_limit` [N m]: smaller limits than those of the model; zero is an actuator
      without current, which only its gear damps. Without them, those of the configuration hold.

    From the plant: `state` and `net_actuation` of the model instance. To the plant: `desired_state`, angles and then
    rates in the order of the model's actuators, for Drake's implicit PD control.

    Measurements: `joint_angles` [rad], `joint_rates` [rad/s], `joint_torques` [N m], `wheel_angles` [rad],
    `wheel_speeds` [rad/s], `wheel_torques` [N m].

    A wheel is driven by the integral of its speed command. It leads the measured angle by no more than the torque
    limit allows, so that a wheel that was blocked does not catch up. Torque limits act at the samples: between two of
    them the plant's own limits hold.

    Raises `ConfigError` when a value is out of range or the model is not such a snake, and `PortError` when the plant
    is not connected.
    """

    def __init__(self, config: SnakeDrivesConfig, plant: MultibodyPlant, model_instance: ModelInstanceIndex):
        super().__init__()
        check_config(config)
        self._config = config
        joints, wheels = find_snake_joints(plant, model_instance)
        self._m, self._w = len(joints), len(wheels)
        self._find_actuators(plant, model_instance, [*joints, *wheels])
        m, w = self._m, self._w
        self._torque = np.concatenate([np.full(m, config.joint_torque), np.full(w, config.wheel_torque)])
        self._no_speed = np.zeros(w)
        self.DeclareVectorInputPort("joint_command", m)
        self.DeclareVectorInputPort("wheel_speed_command", w)
        self.DeclareVectorInputPort("joint_torque_limit", m)
        self.DeclareVectorInputPort("wheel_torque_limit", w)
        state = self.DeclareVectorInputPort("state", plant.num_multibody_states(model_instance))
        actuation = self.DeclareVectorInputPort("net_actuation", m + w)
        # References (angles, rates) and what of them the control gets (angles, rates), each joints and then wheels.
        self.DeclareDiscreteState(4 * (m + w))
        self.DeclareInitializationDiscreteUpdateEvent(self._Initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Update)
        self.DeclareVectorOutputPort("desired_state", 2 * (m + w), self._CalcDesiredState, {self.xd_ticket()})
        for name, port, indices in (
            ("joint_angles", state, self._angles[:m]),
            ("joint_rates", state, self._rates[:m]),
            ("joint_torques", actuation, self._actuators[:m]),
            ("wheel_angles", state, self._angles[m:]),
            ("wheel_speeds", state, self._rates[m:]),
            ("wheel_torques", actuation, self._actuators[m:]),
        ):
            self._DeclareMeasurement(name, port.get_name(), indices)

    def _find_actuators(self, plant: MultibodyPlant, model: ModelInstanceIndex, names: list[str]) -> None:
        """Where joints and wheels are in state, actuation and gains; their ranges."""
        positions = plant.GetPositionsFromArray(model, np.arange(plant.num_positions(), dtype=float)).astype(int)
        velocities = plant.GetVelocitiesFromArray(model, np.arange(plant.num_velocities(), dtype=float)).astype(int)
        joints = [plant.GetJointByName(name, model) for name in names]
        self._angles = np.array([np.flatnonzero(positions == j.position_start())[0] for j in joints])
        self._rates = len(positions) + np.array([np.flatnonzero(velocities == j.velocity_start())[0] for j in joints])
        actuators = [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices(model)]
        if without := [actuator.name() for actuator in actuators if not actuator.has_controller()]:
            problem = "actuators have no drake:controller_gains"
            raise ConfigError(problem, key=plant.GetModelInstanceName(model), value=without)
        place = {actuator.joint().name(): k for k, actuator in enumerate(actuators)}
        self._actuators = np.array([place[name] for name in names])
        gains = [actuators[k].get_controller_gains() for k in self._actuators]
        self._gains = np.array([[g.p for g in gains], [g.d for g in gains]])
        self._effort = np.array([actuators[k].effort_limit() for k in self._actuators])
        self._lower = np.array([j.position_lower_limits()[0] for j in joints[: self._m]])
        self._upper = np.array([j.position_upper_limits()[0] for j in joints[: self._m]])

    def _DeclareMeasurement(self, name: str, port: str, indices: np.ndarray) -> None:
        reference = weakref.ref(self)  # a callback that holds its system keeps it alive for ever

        def calc(context: Context, output: BasicVector) -> None:
            system = reference()
            assert system is not None  # Drake calls it through the system
            output.SetFromVector(eval_typed(system, context, port, np.ndarray)[indices])

        self.DeclareVectorOutputPort(name, len(indices), calc, {self.GetInputPort(port).ticket()})

    def _Initialize(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        angles = eval_typed(self, context, "state", np.ndarray)[self._angles]
        at_rest = np.zeros(len(angles))
        discrete_state.set_value(np.concatenate([angles, at_rest, angles, at_rest]))
        return EventStatus.Succeeded()

    def _limits(self, context: Context) -> np.ndarray:
        """Torque limits [N m] of joints and wheels; what is not a number counts as zero."""
        joints = self._optional(context, "joint_torque_limit", self._torque[: self._m])
        wheels = self._optional(context, "wheel_torque_limit", self._torque[self._m :])
        limits = np.concatenate([joints, wheels])
        limits[~(limits > 0.0)] = 0.0
        return np.minimum(limits, self._effort)

    def _optional(self, context: Context, port: str, otherwise: np.ndarray) -> np.ndarray:
        """What arrives at an input port, or `otherwise` when it is not connected."""
        return eval_typed(self, context, port, np.ndarray) if self.GetInputPort(port).HasValue(context) else otherwise

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        config = self._config
        references = context.get_discrete_state_vector().value().reshape(4, -1)
        state = eval_typed(self, context, "state", np.ndarray)
        new = drive_step(
            references,
            state[self._angles],
            state[self._rates],
            self._optional(context, "joint_command", references[0, : self._m]),
            self._optional(context, "wheel_speed_command", self._no_speed),
            self._limits(context),
            self._gains,
            self._lower,
            self._upper,
            config.period,
            config.joint_max_rate,
            config.wheel_max_speed,
            config.wheel_max_acceleration,
        )
        discrete_state.set_value(new.ravel())

    def _CalcDesiredState(self, context: Context, output: BasicVector) -> None:
        wanted = context.get_discrete_state_vector().value().reshape(4, -1)[2:]
        ordered = np.empty_like(wanted)
        ordered[:, self._actuators] = wanted
        output.SetFromVector(ordered.ravel())


def find_snake_joints(plant: MultibodyPlant, model: ModelInstanceIndex) -> tuple[list[str], list[str]]:
    """Names of the joints p0, y0, p1, ... and of the wheels w0L, w0R, ... of the snake `model`.

    Raises:
        ConfigError: its actuated joints are not those of a snake.
    """
    names = [plant.get_joint_actuator(i).joint().name() for i in plant.GetJointActuatorIndices(model)]
    units = sum(name.startswith("p") for name in names)
    joints = [f"{kind}{i}" for i in range(units) for kind in "py"][:-1]
    wheels = [f"w{i}{side}" for i in range(units) for side in "LR"]
    if units < 2 or sorted(names) != sorted(joints + wheels):
        raise ConfigError(
            "the model's actuated joints are not those of a snake",
            key=plant.GetModelInstanceName(model),
            value=names,
            valid="p0, y0, p1, ..., w0L, w0R, ...",
        )
    return joints, wheels
