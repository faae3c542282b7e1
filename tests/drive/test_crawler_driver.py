import gc
import weakref

import numpy as np
import pytest
from naraha.systems.drive import CrawlerDriver, make_crawler_driver
from naraha.systems.drive.crawler_driver import ApplyDriverConfig
from naraha.systems.drive.tracks import find_track_surfaces
from naraha.systems.errors import ConfigError
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from tests.drive.rig import Rig, robot_urdf


def input_names(system):
    return {system.get_input_port(i).get_name() for i in range(system.num_input_ports())}


def output_names(system):
    return {system.get_output_port(i).get_name() for i in range(system.num_output_ports())}


def plant_in(builder, urdf=None, prefix=None):
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.004)
    parser = Parser(plant, prefix) if prefix else Parser(plant)
    parser.AddModelsFromString(urdf or robot_urdf("crawler"), "urdf")
    plant.Finalize()
    return plant


def apply(builder, plant, config=None, name="crawler"):
    ApplyDriverConfig(config or CrawlerDriver(), name, plant, {}, None, builder)


@pytest.mark.parametrize(("command", "port"), [("twist", "twist_command"), ("track_speeds", "track_speed_command")])
def test_the_driver_diagram_has_the_ports_that_the_command_asks_for(command, port):
    builder = DiagramBuilder()
    plant = plant_in(builder)
    driver = make_crawler_driver(CrawlerDriver(command=command), plant, plant.GetModelInstanceByName("crawler"))
    assert input_names(driver) == {port, "rpy", "flipper_preset", "state", "surface_displacements"}
    assert output_names(driver) >= {"track_speeds", "track_displacements", "flipper_angles", "active_preset"}


def test_it_is_one_named_system_and_only_commands_and_attitude_stay_open():
    builder = DiagramBuilder()
    plant = plant_in(builder)
    before = len(builder.GetSystems())
    apply(builder, plant)
    assert len(builder.GetSystems()) == before + 1
    driver = builder.GetSubsystemByName("crawler.driver")
    open_ports = {name for name in input_names(driver) if not builder.IsConnectedOrExported(driver.GetInputPort(name))}
    assert open_ports == {"twist_command", "rpy", "flipper_preset"}


def test_a_crawler_under_another_name_is_driven_too():
    builder = DiagramBuilder()
    plant = plant_in(builder, prefix="robot")
    apply(builder, plant, name="robot::crawler")
    left, right = find_track_surfaces(plant, plant.GetModelInstanceByName("robot::crawler"))
    assert left == [
        "robot::crawler::left_track",
        "robot::crawler::front_left_flipper",
        "robot::crawler::rear_left_flipper",
    ]
    assert right == [name.replace("left", "right") for name in left]


def test_an_unknown_model_is_named():
    builder = DiagramBuilder()
    with pytest.raises(ConfigError, match="'tank'"):
        apply(builder, plant_in(builder), name="tank")


def test_a_second_driver_on_the_same_plant_is_refused():
    builder = DiagramBuilder()
    plant = plant_in(builder)
    apply(builder, plant)
    with pytest.raises(ConfigError, match="surface_speeds port is already connected"):
        apply(builder, plant)


def test_a_model_without_tracks_is_refused():
    builder = DiagramBuilder()
    urdf = robot_urdf("crawler").replace("left_track", "left_belt")
    with pytest.raises(ConfigError, match="left_track"):
        apply(builder, plant_in(builder, urdf))


def test_a_surface_on_neither_side_is_refused():
    builder = DiagramBuilder()
    urdf = robot_urdf("crawler").replace("front_left_flipper", "front_flipper")
    with pytest.raises(ConfigError, match="neither left nor right"):
        apply(builder, plant_in(builder, urdf))


@pytest.mark.parametrize(("key", "value"), [("command", "wish"), ("max_speed", -1.0), ("period", 0.0)])
def test_bad_values_are_refused_by_key(key, value):
    builder = DiagramBuilder()
    with pytest.raises(ConfigError, match=key):
        apply(builder, plant_in(builder), CrawlerDriver(**{key: value}))


def test_bad_encoder_values_are_refused_by_their_path():
    config = CrawlerDriver()
    config.encoders.resolution = 0.0
    builder = DiagramBuilder()
    with pytest.raises(ConfigError, match=r"encoders\.resolution"):
        apply(builder, plant_in(builder), config)


def test_it_loads_from_yaml_and_back():
    text = "{command: track_speeds, max_speed: 0.1, flipper_max_speed: 0.5, slope_enter: 0.3, encoders: {seed: 3}}"
    config = yaml_load_typed(schema=CrawlerDriver, data=text)
    assert (config.command, config.max_speed, config.flipper_max_speed) == ("track_speeds", 0.1, 0.5)
    assert (config.slope_enter, config.encoders.seed) == (0.3, 3)
    assert config.flipper_presets == CrawlerDriver().flipper_presets
    assert yaml_load_typed(schema=CrawlerDriver, data=yaml_dump_typed(config, schema=CrawlerDriver)) == config


def test_presets_reach_the_flippers_of_the_plant():
    rig = Rig(preset="climb")
    rig.run(2.0)
    np.testing.assert_allclose(rig.output("flipper_angles"), CrawlerDriver().flipper_presets["climb"], atol=0.02)
    assert rig.output("active_preset") == "climb"


def test_two_runs_are_equal():
    ends = []
    for _ in range(2):
        rig = Rig(driver=CrawlerDriver())
        rig.command(0.2, 0.3)
        rig.run(1.0)
        ends.append(rig.X_WB.GetAsMatrix4())
    np.testing.assert_array_equal(*ends)


def test_a_driver_is_freed_with_its_diagram():
    builder = DiagramBuilder()
    plant = plant_in(builder)
    driver = make_crawler_driver(CrawlerDriver(), plant, plant.GetModelInstanceByName("crawler"))
    tracks = weakref.ref(driver.GetSubsystemByName("track_driver"))
    rule = weakref.ref(driver.GetSubsystemByName("flipper_rule"))
    del driver, builder, plant
    gc.collect()
    assert tracks() is None
    assert rule() is None
