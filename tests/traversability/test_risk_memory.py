from dataclasses import replace

import numpy as np
import pytest
from naraha.systems.errors import PortError
from naraha.systems.traversability import IMPASSABLE, RiskMap, RiskMemory, RiskMemoryConfig
from naraha.systems.traversability.risk_memory import empty_grid, remember
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from tests.traversability.unicycle_world import pioneer, scan

CONFIG = RiskMemoryConfig()


def seen(origin, risk, coverage=1.0):
    """A map of cells of 0.1 m from cell `origin` on."""
    risk = np.array(risk, np.float32)
    rest = np.zeros_like(risk)
    cover = np.full_like(risk, coverage)
    return RiskMap(risk, rest, rest, rest, rest, cover, np.array(origin) * 0.1, 0.1)


def at(grid, i, j):
    """Risk at cell (i, j) of the map frame, NaN outside."""
    p = np.array([i, j]) - np.rint(grid.origin / grid.cell).astype(int)
    inside = (p >= 0).all() and (p < grid.risk.shape).all()
    return float(grid.risk[tuple(p)]) if inside else np.nan


def test_what_was_seen_stays_where_it_was_when_something_else_is_seen():
    grid = remember(empty_grid(0.1), seen((3, -2), [[17, 20]]), 0.0, CONFIG)
    grid = remember(grid, seen((-5, 4), [[30]]), 1.0, CONFIG)
    assert [at(grid, 3, -2), at(grid, 3, -1), at(grid, -5, 4)] == [17, 20, 30]
    assert np.isfinite(grid.risk).sum() == 3
    assert grid.index == 2


def test_what_is_not_seen_now_is_not_forgotten():
    grid = remember(empty_grid(0.1), seen((0, 0), [[17, 40]]), 0.0, CONFIG)
    grid = remember(grid, seen((0, 0), [[18, np.nan]]), 100.0, CONFIG)
    assert [at(grid, 0, 0), at(grid, 0, 1)] == [18, 40]


def test_a_worse_view_replaces_a_better_one_only_with_time():
    grid = remember(empty_grid(0.1), seen((0, 0), [[17]], 1.0), 0.0, CONFIG)
    worse = seen((0, 0), [[50]], 0.6)
    assert at(remember(grid, worse, 1.0, CONFIG), 0, 0) == 17
    assert at(remember(grid, worse, CONFIG.half_life, CONFIG), 0, 0) == 50


def test_danger_is_learnt_at_once_and_forgotten_after_three_measurements_in_a_row():
    grid = remember(empty_grid(0.1), seen((0, 0), [[17]]), 0.0, CONFIG)
    grid = remember(grid, seen((0, 0), [[IMPASSABLE]]), 0.5, CONFIG)
    values = [at(grid, 0, 0)]
    for i, risk in enumerate([17, 17, IMPASSABLE, 17, 17, 17]):
        grid = remember(grid, seen((0, 0), [[risk]]), 1 + i, CONFIG)
        values.append(at(grid, 0, 0))
    assert values == [IMPASSABLE] * 6 + [17]


def test_memory_does_not_change_what_was_given_out():
    first = remember(empty_grid(0.1), seen((0, 0), [[17]]), 0.0, CONFIG)
    remember(first, seen((0, 0), [[99]]), 1.0, CONFIG)
    assert at(first, 0, 0) == 17


@pytest.mark.parametrize("direction", [1, -1])
def test_the_far_side_is_forgotten_when_it_gets_too_long(direction):
    config, grid = replace(CONFIG, longest=3.0), empty_grid(0.1)
    for i in range(50):
        grid = remember(grid, seen((direction * i, 0), [[17 + i]]), float(i), config)
        assert max(grid.risk.shape) <= 30
    assert at(grid, direction * 49, 0) == 66
    assert at(grid, direction * 25, 0) == 42
    assert np.isnan(at(grid, direction * 10, 0))


def test_nothing_seen_is_an_update_too():
    grid = remember(empty_grid(0.1), seen((0, 0), [[np.nan]]), 0.0, CONFIG)
    assert grid.index == 1
    assert grid.risk.size == 0


def run_memory(pose, boxes, duration=0.1):
    system = RiskMemory(pioneer(), RiskMemoryConfig(reach=3.0))
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    x, y, theta = pose
    cloud = PointCloud(scan(boxes, np.array(pose)))
    system.GetInputPort("cloud_H").FixValue(context, AbstractValue.Make(cloud))
    system.GetInputPort("X_MB").FixValue(context, RigidTransform(RollPitchYaw(0, 0, theta), [x, y, 0.3]))
    simulator.AdvanceTo(duration)
    return system.GetOutputPort("risk_memory").Eval(context)


@pytest.mark.parametrize("theta", [0.0, 0.7, -2.5])
def test_a_wall_is_remembered_where_it_is_in_the_map_whatever_the_heading(theta):
    grid = run_memory((5.03, -2.02, theta), [(6.0, -4.0, 6.2, 0.0)])
    assert max(at(grid, i, -20) for i in (59, 60, 61)) == IMPASSABLE
    assert at(grid, 53, -20) == pytest.approx(17, abs=1)
    assert np.isnan(at(grid, 66, -20))


def test_an_empty_cloud_leaves_an_empty_memory_and_a_missing_one_is_named():
    system = RiskMemory(pioneer())
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    system.GetInputPort("X_MB").FixValue(context, RigidTransform())
    with pytest.raises(PortError, match=r"RiskMemory\.cloud_H: input port is not connected"):
        simulator.AdvanceTo(0.1)
    system.GetInputPort("cloud_H").FixValue(context, AbstractValue.Make(PointCloud()))
    simulator.AdvanceTo(0.6)
    assert not np.isfinite(system.GetOutputPort("risk_memory").Eval(context).risk).any()
