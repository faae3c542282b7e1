"""Surface properties by geometry name."""

import math

import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.sensing import Surface, SurfaceTable
from naraha.systems.sensing.surfaces import surface_arrays
from pydrake.common.yaml import yaml_load_typed

WATER = Surface(label="water", lidar_reflectivity=0.02, specular=0.98)
WALL = Surface(label="wall", lidar_reflectivity=0.8)


def test_first_matching_pattern_wins():
    table = SurfaceTable(by_pattern={"puddle_wall": WALL, "puddle*": WATER, "*": WALL})
    assert table.lookup("puddle_wall") is WALL
    assert table.lookup("puddle_2") is WATER
    assert table.lookup("door") is WALL


@pytest.mark.parametrize("pattern", ["basement::puddle_1", "puddle_?", "*puddle*", "basement::*"])
def test_pattern_matches_the_full_name_or_its_last_part(pattern):
    assert SurfaceTable(by_pattern={pattern: WATER}).lookup("basement::puddle_1") is WATER


@pytest.mark.parametrize("pattern", ["basement", "Puddle_1", "puddle", "pud"])
def test_pattern_must_match_all_of_it_and_the_case(pattern):
    table = SurfaceTable(by_pattern={pattern: WATER}, default=WALL)
    assert table.lookup("basement::puddle_1") is WALL


def test_unknown_name_has_the_default_surface():
    assert SurfaceTable().lookup("anything") == Surface()


def test_table_loads_from_yaml():
    text = """
    by_pattern:
      "*puddle*": {label: water, specular: 0.9, temperature: 12}
    default: {label: concrete}
    """
    table = yaml_load_typed(schema=SurfaceTable, data=text)
    assert table.lookup("a::puddle") == Surface(label="water", specular=0.9, temperature=12)
    assert table.lookup("a::b").label == "concrete"


@pytest.mark.parametrize(
    ("field", "value", "valid"),
    [
        ("lidar_reflectivity", 1.2, ">= 0 and <= 1"),
        ("nir_reflectance", -0.1, ">= 0 and <= 1"),
        ("specular", math.nan, ">= 0 and <= 1"),
        ("emissivity", 2.0, ">= 0 and <= 1"),
        ("temperature", -300.0, ">= -273.15 °C"),
        ("activity", -1.0, ">= 0 MBq"),
    ],
)
def test_property_out_of_range_is_named(field, value, valid):
    with pytest.raises(ConfigError) as error:
        SurfaceTable(by_pattern={"door": Surface(**{field: value})})
    assert f"by_pattern.door.{field}" in str(error.value)
    assert valid in str(error.value)


def test_empty_pattern_and_wrong_entries_are_refused():
    with pytest.raises(ConfigError, match="empty pattern"):
        SurfaceTable(by_pattern={"": WALL})
    with pytest.raises(ConfigError, match=r"by_pattern\.door: not a Surface"):
        SurfaceTable(by_pattern={"door": {"label": "wall"}})


def test_arrays_give_each_geometry_its_properties_and_a_miss_nothing():
    arrays = surface_arrays([WALL, WATER, WALL])
    geometry = np.array([1, -1, 0, 2])
    np.testing.assert_array_equal(arrays.lidar_reflectivity[geometry], np.float32([0.02, 0, 0.8, 0.8]))
    np.testing.assert_array_equal(arrays.specular[geometry], np.float32([0.98, 0, 0, 0]))
    np.testing.assert_array_equal(arrays.emissivity[geometry], np.float32([0.95, 0, 0.95, 0.95]))
    assert arrays.labels == ("wall", "water")
    np.testing.assert_array_equal(arrays.label_id[geometry], [1, -1, 0, 0])
    np.testing.assert_array_equal(np.isnan(arrays.temperature[geometry]), [False, True, False, False])
