"""The drivers of the robots with wheels and of those with tracks alone, as diagrams beside a plant."""

import gc
import weakref

import numpy as np
import pytest
from naraha.models import MODELS_DIR
from naraha.systems.drive import (
    DifferentialDriver,
    TrackedDriver,
    WheelDriver,
    WheelDriverConfig,
    make_differential_driver,
    make_tracked_driver,
)
from naraha.systems.errors import ConfigError, PortError
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.manipulation import ApplyDriverConfigs
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

ROBOTS = {"pioneer": DifferentialDriver, "amphibious": TrackedDriver}
every_robot = pytest.mark.parametrize("model", list(ROBOTS))


def plant_in(builder, model, edit=lambda text: text):
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.004)
    text = (MODELS_DIR / model / f"{model}.urdf").read_text(encoding="utf-8")
    Parser(plant).AddModelsFromString(edit(text), "urdf")
    plant.Finalize()
    return plant


def apply(builder, plant, config, name):
    ApplyDriverConfigs(
        driver_configs={name: config}, sim_plant=plant, models_from_directives=[], lcm_buses=None, builder=builder
    )
    return builder.GetSubsystemByName(f"{name}.driver")


def names(system):
    inputs = {system.get_input_port(i).get_name() for i in range(system.num_input_ports())}
    return inputs, {system.get_output_port(i).get_name() for i in range(system.num_output_ports())}


@every_robot
@pytest.mark.parametrize(("command", "port"), [("twist", "twist_command"), ("track_speeds", "track_speed_command")])
def test_only_the_command_and_the_tilt_stay_open(model, command, port):
    builder = DiagramBuilder()
    plant = plant_in(builder, model)
    driver = apply(builder, plant, ROBOTS[model](command=command), model)
    inputs, outputs = names(driver)
    assert {name for name in inputs if not builder.IsConnectedOrExported(driver.GetInputPort(name))} == {
        port,
        "tilt_setpoint",
    }
    assert outputs >= {"track_speeds", "track_displacements", "commanded_track_speeds", "desired_state"}


@every_robot
def test_it_loads_from_yaml_and_back(model):
    config = yaml_load_typed(schema=ROBOTS[model], data="{command: track_speeds, max_speed: 0.1, encoders: {seed: 3}}")
    assert (config.command, config.max_speed, config.encoders.seed) == ("track_speeds", 0.1, 3)
    assert yaml_load_typed(schema=ROBOTS[model], data=yaml_dump_typed(config, schema=ROBOTS[model])) == config


@every_robot
@pytest.mark.parametrize(("key", "value"), [("command", "wish"), ("max_speed", -1.0), ("period", 0.0), ("gauge", 0.0)])
def test_bad_values_are_refused_by_key(model, key, value):
    builder = DiagramBuilder()
    plant = plant_in(builder, model)
    with pytest.raises(ConfigError, match=key):
        apply(builder, plant, ROBOTS[model](**{key: value}), model)


@every_robot
def test_the_driver_of_the_other_robot_does_not_fit(model):
    builder = DiagramBuilder()
    plant = plant_in(builder, model)
    other = next(driver for name, driver in ROBOTS.items() if name != model)
    with pytest.raises(ConfigError, match="the model has no"):
        apply(builder, plant, other(), model)


def test_wheels_without_controller_gains_are_refused():
    builder = DiagramBuilder()
    plant = plant_in(builder, "pioneer", lambda text: text.replace("<drake:controller_gains", "<drake:nothing"))
    with pytest.raises(ConfigError, match="no drake:controller_gains"):
        apply(builder, plant, DifferentialDriver(), "pioneer")


def test_one_tracked_robot_a_plant():
    builder = DiagramBuilder()
    plant = plant_in(builder, "amphibious")
    apply(builder, plant, TrackedDriver(), "amphibious")
    with pytest.raises(ConfigError, match="surface_speeds port is already connected"):
        apply(builder, plant, TrackedDriver(), "amphibious")


def wheel_driver(config=None):
    builder = DiagramBuilder()
    plant = plant_in(builder, "pioneer")
    driver = WheelDriver(config or WheelDriverConfig(), plant, plant.GetModelInstanceByName("pioneer"))
    simulator = Simulator(driver)
    context = simulator.get_mutable_context()
    state = plant.GetPositionsAndVelocities(plant.CreateDefaultContext(), plant.GetModelInstanceByName("pioneer"))
    driver.GetInputPort("state").FixValue(context, state)
    return driver, simulator, context


def test_a_wheel_that_is_held_is_pushed_with_its_whole_torque_and_no_further():
    """The setpoint leads the wheel, which stands still, by effort / p plus what one period adds."""
    driver, simulator, context = wheel_driver()
    driver.GetInputPort("twist_command").FixValue(context, [0.5, 0.0])
    simulator.AdvanceTo(5.0)
    angles, rates = driver.GetOutputPort("wheel_setpoint").Eval(context).reshape(2, 2)
    lead, rate = 1.5 / 60.0, 0.5 / 0.0975
    np.testing.assert_allclose(rates, rate)
    assert np.all(angles >= lead - 1e-9)
    assert np.all(angles <= lead + rate * 0.02 + 1e-9)


def test_wheels_start_with_the_acceleration_of_their_limit_and_keep_the_curvature():
    driver, simulator, context = wheel_driver(WheelDriverConfig(max_speed=0.6, max_acceleration=0.5))
    driver.GetInputPort("track_speed_command").FixValue(context, [0.8, 0.4])
    simulator.AdvanceTo(0.5)
    speeds = driver.GetOutputPort("commanded_track_speeds").Eval(context)
    assert speeds[0] == pytest.approx(0.5 * 0.5, abs=0.5 * 0.02 + 1e-9)
    assert speeds[1] == pytest.approx(speeds[0] / 2)
    simulator.AdvanceTo(3.0)
    np.testing.assert_allclose(driver.GetOutputPort("commanded_track_speeds").Eval(context), [0.6, 0.3])


def test_none_or_both_commands_are_refused():
    _, simulator, _ = wheel_driver()
    with pytest.raises(PortError, match="no input is connected"):
        simulator.AdvanceTo(0.1)
    driver, simulator, context = wheel_driver()
    for name in ("twist_command", "track_speed_command"):
        driver.GetInputPort(name).FixValue(context, [0.0, 0.0])
    with pytest.raises(PortError, match="both inputs are connected"):
        simulator.AdvanceTo(0.1)


@every_robot
def test_a_driver_is_freed_with_its_diagram(model):
    builder = DiagramBuilder()
    plant = plant_in(builder, model)
    make = {"pioneer": make_differential_driver, "amphibious": make_tracked_driver}[model]
    driver = make(ROBOTS[model](), plant, plant.GetModelInstanceByName(model))
    leaves = [weakref.ref(leaf) for leaf in driver.GetSystems() if type(leaf).__module__.startswith("naraha.")]
    assert leaves
    del builder, plant, driver
    gc.collect()
    assert [leaf() for leaf in leaves] == [None] * len(leaves)
