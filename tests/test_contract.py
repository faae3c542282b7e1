"""What every system of the package promises, checked for all of them at once."""

import importlib
import inspect
import pkgutil
import re

import naraha.systems
import numpy as np
import pytest
import yaml
from open3d.t.geometry import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageGrey8U, ImageRgba8U

from tests.examples import EXAMPLES


def all_systems() -> list[type[LeafSystem]]:
    found = {}
    for module in pkgutil.walk_packages(naraha.systems.__path__, "naraha.systems."):
        for _, cls in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            public = cls.__module__ == module.name and not cls.__name__.startswith("_")  # others are bases of these
            if issubclass(cls, LeafSystem) and public:
                found[cls.__name__] = cls
    return list(found.values())


SYSTEMS = all_systems()
every_system = pytest.mark.parametrize("cls", SYSTEMS, ids=lambda cls: cls.__name__)


def input_names(system):
    return [system.get_input_port(i).get_name() for i in range(system.num_input_ports())]


def output_names(system):
    return [system.get_output_port(i).get_name() for i in range(system.num_output_ports())]


def fingerprint(value):
    """What an output port's value says, in a form that can be compared."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if hasattr(value, "GetAsMatrix4"):
        return value.GetAsMatrix4().tobytes()
    if isinstance(value, PointCloud):
        return {name: tensor.numpy().tobytes() for name, tensor in value.point.items()}
    if isinstance(value, (tuple, list)):
        return [fingerprint(item) for item in value]
    if isinstance(value, (ImageDepth32F, ImageGrey8U, ImageRgba8U)):
        return value.data.tobytes()
    if hasattr(value, "__dataclass_fields__"):
        return {name: fingerprint(getattr(value, name)) for name in value.__dataclass_fields__}
    if type(value).__name__ == "BusValue":
        return {name: fingerprint(value.Find(name)) for name in value}
    return repr(value)


def outputs(system, root_context):
    context = system.GetMyContextFromRoot(root_context)
    return {name: fingerprint(system.GetOutputPort(name).Eval(context)) for name in output_names(system)}


def run(cls, seed):
    """Runs the system's example for a moment; returns the system, its root and its root context."""
    root, system = EXAMPLES[cls.__name__](seed)
    simulator = Simulator(root)
    simulator.AdvanceTo(0.35)
    return root, system, simulator.get_context()


def test_there_is_an_example_of_every_system_and_no_stale_one():
    assert {cls.__name__ for cls in SYSTEMS} == set(EXAMPLES)


@every_system
def test_the_docstring_block_is_the_live_ports(cls):
    doc = inspect.cleandoc(cls.__doc__)
    block = re.match(r"\.\. pydrake_system::\n\n((?:    .*\n|\n)+)", doc)
    assert block, "the docstring does not open with a pydrake_system block"
    stated = yaml.safe_load(inspect.cleandoc(block.group(1)))
    _, system = EXAMPLES[cls.__name__](0)
    live_inputs, live_outputs = input_names(system), output_names(system)
    assert stated["name"] == cls.__name__
    optional = set(re.findall(r"`(\w+)`[^`]*optional", doc))
    assert set(live_inputs) <= set(stated.get("input_ports", []))
    assert set(stated.get("input_ports", [])) - set(live_inputs) <= optional
    assert stated.get("output_ports", []) == live_outputs
    description = doc[block.end() :]
    assert len(description) > 150
    for name in live_inputs + live_outputs:
        assert f"`{name}`" in description, f"port {name} is not described"


@every_system
def test_a_cloned_context_says_the_same_and_goes_its_own_way(cls):
    root, system, context = run(cls, 0)
    clone = context.Clone()
    before = outputs(system, context)
    assert outputs(system, clone) == before
    Simulator(root, clone).AdvanceTo(0.7)
    assert outputs(system, context) == before


@every_system
def test_two_runs_with_one_seed_are_equal(cls):
    _, system, context = run(cls, 5)
    _, again, context_again = run(cls, 5)
    assert outputs(system, context) == outputs(again, context_again)
