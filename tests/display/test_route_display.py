import numpy as np
import pytest
from naraha.systems.display import ROUTE_COLOURS, RouteDisplay, RouteDisplayConfig, draw_routes
from naraha.systems.display.stroke_text import stroke_text
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.routes import Route
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator


def route(y, z=0.5):
    xy = np.column_stack([np.linspace(0, 3, 31), np.full(31, y)])
    return Route(xy=xy, z=np.full(31, z), time_s=10.0)


def test_a_ribbon_lies_over_the_route_at_its_width_and_height(read_scene):
    meshcat = Meshcat()
    draw_routes(meshcat, (route(1.0),), config=RouteDisplayConfig(width=0.1, lift=0.05))
    points = read_scene(meshcat).points["routes/1/way"]
    np.testing.assert_allclose(points.min(axis=0), [0, 0.95, 0.55], atol=1e-6)
    np.testing.assert_allclose(points.max(axis=0), [3, 1.05, 0.55], atol=1e-6)


def test_each_route_has_its_colour_and_a_label_beside_it(read_scene):
    meshcat = Meshcat()
    draw_routes(meshcat, (route(0.0), route(2.0)))
    scene = read_scene(meshcat)
    for number in (1, 2):
        red, green, blue = ROUTE_COLOURS[number - 1]
        assert scene.materials[f"routes/{number}/way"]["color"] == red * 65536 + green * 256 + blue
        label = scene.points[f"routes/{number}/label"]
        assert label[:, 1].min() > 2 * (number - 1)
        assert len(label) > 50


def test_the_chosen_route_is_wide_and_the_others_pale(read_scene):
    meshcat = Meshcat()
    draw_routes(meshcat, (route(0.0), route(2.0)), chosen=1, config=RouteDisplayConfig(width=0.1))
    scene = read_scene(meshcat)
    assert np.ptp(scene.points["routes/1/way"][:, 1]) == pytest.approx(0.1)
    assert np.ptp(scene.points["routes/2/way"][:, 1]) == pytest.approx(0.2)
    assert scene.materials["routes/1/way"]["opacity"] < 1
    assert scene.materials["routes/2/way"].get("opacity", 1) == 1


def test_new_routes_take_the_place_of_old_ones():
    meshcat = Meshcat()
    system = RouteDisplay(RouteDisplayConfig(period=0.5), meshcat=meshcat)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()

    def give(routes, chosen=-1):
        system.GetInputPort("routes").FixValue(context, AbstractValue.Make(routes))
        system.GetInputPort("chosen").FixValue(context, [chosen])
        simulator.AdvanceTo(context.get_time() + 0.5)

    give((route(0.0), route(2.0)))
    assert meshcat.HasPath("/drake/routes/2/way")
    meshcat.Delete("routes/2")
    give((route(0.0), route(2.0)))
    assert not meshcat.HasPath("/drake/routes/2/way")  # nothing new, nothing drawn
    give((route(0.0), route(2.0)), chosen=0)
    assert meshcat.HasPath("/drake/routes/2/way")
    give(())
    assert not meshcat.HasPath("/drake/routes")


def test_a_route_over_unknown_ground_is_drawn_between_what_is_known(read_scene):
    meshcat, z = Meshcat(), np.full(31, np.nan)
    z[0], z[30] = 0.0, 3.0
    draw_routes(meshcat, (Route(xy=route(0.0).xy, z=z),), config=RouteDisplayConfig(lift=0))
    points = read_scene(meshcat).points["routes/1/way"]
    np.testing.assert_allclose(points[:, 2], points[:, 0], atol=1e-6)
    draw_routes(meshcat, (Route(xy=route(0.0).xy, z=np.full(31, np.nan)),), config=RouteDisplayConfig(lift=0))
    np.testing.assert_allclose(read_scene(meshcat).points["routes/1/way"][:, 2], 0)


def test_text_is_as_high_as_wanted_and_grows_by_character():
    one, _ = stroke_text("8", 0.4)
    assert np.ptp(one[:, 1]) == pytest.approx(0.4 * (1 + 0.45 / 4))
    two, faces = stroke_text("88", 0.4)
    assert len(two) == 2 * len(one)
    assert faces.max() == len(two) - 1
    assert two[:, 0].min() == pytest.approx(one[:, 0].min())
    vertices, faces = stroke_text("?", 0.4)
    assert vertices.shape == (0, 2)
    assert faces.shape == (0, 3)


def test_digits_look_different():
    shapes = {stroke_text(digit, 1.0)[0].tobytes() for digit in "0123456789"}
    assert len(shapes) == 10


def test_bad_config_and_routes_of_another_type_are_refused():
    with pytest.raises(ConfigError, match=r"route_display\.width"):
        RouteDisplay(RouteDisplayConfig(width=0), meshcat=Meshcat())
    system = RouteDisplay(meshcat=Meshcat())
    simulator = Simulator(system)
    system.GetInputPort("routes").FixValue(simulator.get_mutable_context(), AbstractValue.Make([1]))
    system.GetInputPort("chosen").FixValue(simulator.get_mutable_context(), [0])
    with pytest.raises(PortError, match=r"RouteDisplay\.routes"):
        simulator.AdvanceTo(0.1)
