"""Setpoints of a model's actuated joints, gathered for the plant's `desired_state` port."""

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuator, ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import MatrixGain, Multiplexer

from ..errors import ConfigError


def find_actuators(
    plant: MultibodyPlant, model_instance: ModelInstanceIndex, joints: Sequence[str]
) -> list[JointActuator]:
    """The position-controlled actuators of the named joints.

    Raises:
        ConfigError: a joint has no actuator, or its actuator no `drake:controller_gains`.
    """
    model = plant.GetModelInstanceName(model_instance)
    actuators = [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices(model_instance)]
    by_joint = {actuator.joint().name(): actuator for actuator in actuators}
    for joint in joints:
        if joint not in by_joint:
            raise ConfigError(
                "the model has no actuated joint of this name", key=model, value=list(by_joint), valid=joint
            )
        if not by_joint[joint].has_controller():
            raise ConfigError("actuator has no drake:controller_gains", key=model, value=by_joint[joint].name())
    return [by_joint[joint] for joint in joints]


def state_indices(plant: MultibodyPlant, model_instance: ModelInstanceIndex, joints: Sequence[str]) -> np.ndarray:
    """Where the positions of the named joints of one degree of freedom are in the model's state, (len(joints),)."""
    positions = plant.GetPositionsFromArray(model_instance, np.arange(plant.num_positions(), dtype=float))
    starts = [plant.GetJointByName(name, model_instance).position_start() for name in joints]
    return np.array([np.flatnonzero(positions == start)[0] for start in starts])


def add_setpoints(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    model_instance: ModelInstanceIndex,
    groups: Mapping[str, Sequence[str]],
) -> System:
    """Adds what puts setpoints of groups of joints into the order of the plant, and exports it as `desired_state`.

    Args:
        groups: names of the joints of every group. Together they are all actuated joints of the model.

    Returns:
        A system with one input per group: positions and then velocities of its joints.

    Raises:
        ConfigError: the joints are not those that the model's actuators move.
    """
    joints = [joint for group in groups.values() for joint in group]
    find_actuators(plant, model_instance, joints)
    actuated = [plant.get_joint_actuator(i).joint().name() for i in plant.GetJointActuatorIndices(model_instance)]
    if sorted(actuated) != sorted(joints):
        model = plant.GetModelInstanceName(model_instance)
        raise ConfigError("the model has other actuated joints", key=model, value=actuated, valid=joints)
    # Where position and velocity of every joint are among the inputs, one behind the other.
    place: dict[str, tuple[int, int]] = {}
    start = 0
    for group in groups.values():
        for i, joint in enumerate(group):
            place[joint] = (start + i, start + len(group) + i)
        start += 2 * len(group)
    order = [place[joint][k] for k in (0, 1) for joint in actuated]
    gather = builder.AddNamedSystem("gather", Multiplexer([2 * len(group) for group in groups.values()]))
    reorder = builder.AddNamedSystem("reorder", MatrixGain(np.eye(len(order))[order]))
    builder.Connect(gather.get_output_port(), reorder.get_input_port())
    builder.ExportOutput(reorder.get_output_port(), "desired_state")
    return gather
