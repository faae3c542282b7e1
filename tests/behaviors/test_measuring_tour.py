import numpy as np
import pytest
from naraha.systems.behaviors import MeasuringTour, MeasuringTourConfig, TourState, tour_step
from naraha.systems.errors import ConfigError
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from tests.behaviors.behavior_examples import measuring_tour
from tests.routes.route_examples import with_inputs

ROUTE = np.array([[2.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
STOPS = np.array([1, 2])
CONFIG = MeasuringTourConfig(settle_time=0.5, dwell_time=1.0, patience=20.0)


def drive(track, *, reading=lambda time: 100.0, stand=True):
    """Steps the tour along `track`, a point a step, standing still while it measures; returns its states."""
    state, states, i, time = TourState(), [], 0, 0.0
    while i < len(track):
        state = tour_step(state, time, np.array(track[i], float), reading(time), ROUTE, STOPS, CONFIG)
        states.append(state)
        time += CONFIG.period
        i += not (stand and state.stopped)
    return states


def line(a, b, step=0.03):
    a, b = np.array(a, float), np.array(b, float)
    return [a + s * (b - a) for s in np.arange(0, 1 + 1e-9, step / np.linalg.norm(b - a))]


def test_points_on_the_way_are_passed_and_stops_are_measured_at():
    states = drive([*line([0, 0], [4, 0]), *line([4, 0], [4, 3])])
    last = states[-1]
    assert last.index == 3
    assert [m.stop for m in last.measurements] == [0, 1]
    for m, point in zip(last.measurements, ROUTE[1:], strict=True):
        assert np.hypot(m.x - point[0], m.y - point[1]) <= CONFIG.tolerance
        assert (m.illuminance, m.deviation) == (100.0, 0.0)
    assert last.given_up == ()


def test_readings_before_the_robot_has_settled_do_not_count():
    began = next(i for i, s in enumerate(drive([*line([0, 0], [4, 0])])) if s.stopped) * CONFIG.period

    def reading(time):
        return 500.0 if time < began + 0.5 - 1e-6 else 80.0 + 10.0 * (round(time / CONFIG.period) % 2)

    (measured,) = drive([*line([0, 0], [4, 0]), [4.0, 0.1]], reading=reading)[-1].measurements
    assert measured.illuminance == pytest.approx(85.0, abs=0.6)
    assert measured.deviation == pytest.approx(5.0, abs=0.1)
    assert measured.readings == 11


def test_a_point_on_the_way_is_passed_also_by_a_detour():
    states = drive([*line([0, 1.5], [4, 1.5]), *line([4, 1.5], [4, 0])])
    assert states[-1].measurements[0].stop == 0


def test_a_stop_that_is_not_reached_is_given_up():
    states = drive([np.array([3.5, 0.0])] * 900, stand=False)
    assert states[-1].given_up == (0, 1)
    assert states[-1].measurements == ()
    assert states[-1].index == 3


def test_the_system_says_goal_and_stop():
    root, tour = measuring_tour(0)
    simulator = Simulator(root)
    context = tour.GetMyContextFromRoot(simulator.get_context())
    simulator.AdvanceTo(0.15)
    np.testing.assert_array_equal(tour.GetOutputPort("goal").Eval(context), [2.0, 0.0])
    assert tour.GetOutputPort("status").Eval(context) == "driving"
    route = np.array([[0.0, 0.0]])
    root, tour = with_inputs(
        MeasuringTour(CONFIG, route, np.array([0])), X_MB=RigidTransform(), illuminance=np.array([7.0])
    )
    simulator = Simulator(root)
    simulator.AdvanceTo(0.35)
    context = tour.GetMyContextFromRoot(simulator.get_context())
    assert tour.GetOutputPort("stop").Eval(context)[0] == 1
    assert tour.GetOutputPort("status").Eval(context) == "measuring"
    simulator.AdvanceTo(2.0)
    assert tour.GetOutputPort("status").Eval(context) == "done"
    assert tour.GetOutputPort("stop").Eval(context)[0] == 1
    (measured,) = tour.GetOutputPort("tour").Eval(context).measurements
    assert measured.illuminance == 7.0


def test_a_robot_that_is_lost_stands():
    inputs = {"X_MB": RigidTransform(), "illuminance": np.zeros(1), "lost": np.ones(1)}
    root, tour = with_inputs(MeasuringTour(CONFIG, ROUTE, STOPS), **inputs)
    simulator = Simulator(root)
    simulator.AdvanceTo(0.5)
    context = tour.GetMyContextFromRoot(simulator.get_context())
    assert tour.GetOutputPort("stop").Eval(context)[0] == 1
    assert tour.GetOutputPort("status").Eval(context) == "lost"


@pytest.mark.parametrize(
    ("route", "stops", "words"),
    [
        (np.zeros((0, 2)), [], "route: no route"),
        ([[np.nan, 0.0]], [0], "route: no route"),
        ([[1.0, 0.0]], [1], "stops: stops"),
        ([[1.0, 0.0], [2.0, 0.0]], [1, 0], "stops: stops"),
    ],
)
def test_routes_that_are_none_are_refused(route, stops, words):
    with pytest.raises(ConfigError, match=words):
        MeasuringTour(CONFIG, np.array(route), np.array(stops))
