"""DistinctRoutes at its ports, and routes.csv."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, InputError, PortError
from naraha.systems.routes import DistinctRoutes, Route, RouteFileError, RoutesConfig, read_routes, write_routes
from pydrake.common.value import AbstractValue

from .maps import hall_map, water_map


def offer(grid, start, goal, config=None):
    system = DistinctRoutes(config)
    context = system.CreateDefaultContext()
    system.GetInputPort("route_grid").FixValue(context, AbstractValue.Make(grid))
    system.GetInputPort("start").FixValue(context, np.asarray(start, float))
    system.GetInputPort("goal").FixValue(context, np.asarray(goal, float))
    return system.GetOutputPort("routes").Eval(context), system.GetOutputPort("status").Eval(context)


def test_routes_come_without_complaint_and_at_most_as_many_as_wanted():
    grid, start, goal = water_map(3)
    routes, status = offer(grid, start, goal)
    assert len(routes) >= 2
    assert status == ""
    assert len(offer(grid, start, goal, RoutesConfig(most=1))[0]) == 1


def test_why_there_is_no_route_is_said():
    grid, start, goal = water_map(3, "none")
    assert offer(grid, start, goal) == ((), "no way leads from start to goal")
    routes, status = offer(grid, start, [99.0, 0.0])
    assert routes == ()
    assert status.startswith("goal: outside the grid")
    assert "nearest free cell at" in status
    assert offer(grid, start, start[:2]) == ((), "the robot is at the goal")


def test_a_grid_of_another_type_and_bad_config_are_refused():
    grid, start, goal = water_map(0)
    with pytest.raises(PortError, match=r"DistinctRoutes\.route_grid"):
        offer(grid.kind, start, goal)
    with pytest.raises(ConfigError, match=r"routes\.most"):
        DistinctRoutes(RoutesConfig(most=0))


def test_routes_come_back_from_their_file_as_they_were(tmp_path):
    grid, start, goal = water_map(5)
    routes, _ = offer(grid, start, goal)
    path = tmp_path / "routes.csv"
    write_routes(path, routes, grid)
    again = read_routes(path, grid)
    assert len(again) == len(routes)
    for a, b in zip(routes, again, strict=True):
        for name in Route.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert a.label == b.label
    write_routes(path, (), grid)
    assert read_routes(path) == ()


def test_routes_of_another_map_are_refused(tmp_path):
    grid, start, goal = water_map(5)
    write_routes(tmp_path / "routes.csv", offer(grid, start, goal)[0], grid)
    with pytest.raises(RouteFileError, match=rf"routes\.csv: .*another map.*{grid.fingerprint}"):
        read_routes(tmp_path / "routes.csv", hall_map(1)[0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "", "not a file of routes"),
        (lambda text: text.replace("x_m", "x", 1), "not a file of routes"),
        (lambda text: text + "0,1,2\n", r"line \d+: wrong number of columns"),
        (lambda text: text.replace("\n0,3,", "\n0,three,", 1), r"line 6: bad value"),
        (lambda text: "\n".join(text.splitlines()[:3]) + "\n", "route 0: .*at least two points"),
    ],
)
def test_a_damaged_file_names_file_and_line(tmp_path, change, message):
    grid, start, goal = water_map(5)
    path = tmp_path / "routes.csv"
    write_routes(path, offer(grid, start, goal)[0], grid)
    path.write_text(change(path.read_text()))
    with pytest.raises(RouteFileError, match=message) as caught:
        read_routes(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(RouteFileError, match=r"none\.csv: cannot be read"):
        read_routes(tmp_path / "none.csv")


def test_a_route_needs_a_height_for_every_point():
    with pytest.raises(InputError, match="z"):
        Route(xy=np.array([[0.0, 0], [1, 0]]), z=np.zeros(3))
