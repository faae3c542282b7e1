import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.snake.actuator_faults import (
    ActuatorFaults,
    ActuatorFaultsConfig,
    Fault,
    heated,
    torque_share,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

N = 3


def simulate(config, seconds, torque):
    builder = DiagramBuilder()
    system = builder.AddSystem(ActuatorFaults(config, units=N))
    for name, value in (("joint_angles", np.arange(5.0) / 10), ("joint_torques", torque)):
        source = builder.AddSystem(ConstantVectorSource(np.array(value, float)))
        builder.Connect(source.get_output_port(), system.GetInputPort(name))
    for name in ("reported_joint_angles", "joint_torque_limit", "actuator_report"):
        builder.ExportOutput(system.GetOutputPort(name), name)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(seconds)
    return {
        name: diagram.GetOutputPort(name).Eval(simulator.get_context())
        for name in ("reported_joint_angles", "joint_torque_limit", "actuator_report")
    }


def test_heat_follows_the_closed_form_of_a_first_order_lag():
    config = ActuatorFaultsConfig()
    after = heated(np.array([20.0]), np.array([8.0]), 60.0, config)
    assert after[0] == pytest.approx(20 + 0.8 * 64 * (1 - np.exp(-0.5)))
    step = np.array([20.0])
    for _ in range(600):
        step = heated(step, np.array([8.0]), 0.1, config)
    np.testing.assert_allclose(step, after)


def test_a_warm_actuator_gives_less_and_a_hot_one_nothing():
    share = torque_share(np.array([20.0, 70.0, 77.5, 85.0, 120.0]), ActuatorFaultsConfig())
    np.testing.assert_allclose(share, [1, 1, 0.5, 0, 0])


def test_actuators_that_are_well_report_nothing_and_keep_their_torque():
    out = simulate(ActuatorFaultsConfig(), 1.0, np.full(5, 2.0))
    np.testing.assert_allclose(out["reported_joint_angles"], np.arange(5) / 10)
    np.testing.assert_allclose(out["joint_torque_limit"], 15.0)
    assert out["actuator_report"].errors == {}


def test_a_lost_link_has_no_angle_and_no_torque_and_a_dead_actuator_no_torque():
    faults = [Fault(joint="y0", kind="lost_link", time=0.5), Fault(joint="p2", kind="dead")]
    config = ActuatorFaultsConfig(faults=faults)
    before, after = (simulate(config, seconds, np.zeros(5)) for seconds in (0.4, 0.6))
    assert before["actuator_report"].errors == {"p2": "dead"}
    assert after["actuator_report"].errors == {"y0": "no link", "p2": "dead"}
    assert np.isnan(after["reported_joint_angles"][1])
    np.testing.assert_allclose(after["joint_torque_limit"], [15, 0, 15, 15, 0])


def test_overload_is_reported_after_it_has_lasted():
    config = ActuatorFaultsConfig(overload_time=0.3)
    torque = [0.0, -14.5, 0.0, 0.0, 0.0]
    assert simulate(config, 0.2, torque)["actuator_report"].errors == {}
    assert simulate(config, 0.5, torque)["actuator_report"].errors == {"y0": "overload"}


def test_faults_of_joints_that_are_not_there_are_refused():
    with pytest.raises(ConfigError, match=r"faults\[0\]\.joint.*valid: p0 to p2"):
        ActuatorFaults(ActuatorFaultsConfig(faults=[Fault(joint="p3")]), units=N)
    with pytest.raises(ConfigError, match="ambient < warm < hot"):
        ActuatorFaults(ActuatorFaultsConfig(hot=60.0), units=N)
