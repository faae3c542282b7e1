import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.tracking import (
    KanayamaConfig,
    KanayamaTracking,
    TourConfig,
    Waypoint,
    WaypointTour,
    leg_reference,
)
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem


class Unicycle(LeafSystem):
    """A robot that does what it is told, but turns with only `grip` of the commanded rate."""

    def __init__(self, grip: float):
        super().__init__()
        self._grip = grip
        self.DeclareVectorInputPort("twist", 2)
        self.DeclareContinuousState(3)
        self.DeclareAbstractOutputPort(
            "X_MB", lambda: Value(RigidTransform()), self._calc, prerequisites_of_calc={self.xc_ticket()}
        )

    def DoCalcTimeDerivatives(self, context, derivatives):
        v, omega = self.GetInputPort("twist").Eval(context)
        theta = context.get_continuous_state_vector().CopyToVector()[2]
        derivatives.get_mutable_vector().SetFromVector([v * np.cos(theta), v * np.sin(theta), self._grip * omega])

    def _calc(self, context, output):
        x, y, theta = context.get_continuous_state_vector().CopyToVector()
        output.set_value(RigidTransform(RollPitchYaw(0, 0, theta), [x, y, 0]))


def make_waypoint(where):
    return where if isinstance(where, Waypoint) else Waypoint(xy=list(where))


def drive(waypoints, duration, grip=1.0, **config):
    builder = DiagramBuilder()
    robot = builder.AddSystem(Unicycle(grip))
    tour = builder.AddSystem(WaypointTour(TourConfig(waypoints=[make_waypoint(w) for w in waypoints], **config)))
    law = builder.AddSystem(KanayamaTracking(KanayamaConfig()))
    builder.Connect(robot.GetOutputPort("X_MB"), tour.GetInputPort("X_MB"))
    builder.Connect(robot.GetOutputPort("X_MB"), law.GetInputPort("X_MB"))
    builder.Connect(tour.GetOutputPort("reference_pose"), law.GetInputPort("reference_pose"))
    builder.Connect(tour.GetOutputPort("reference_twist"), law.GetInputPort("reference_twist"))
    builder.Connect(law.GetOutputPort("twist_command"), robot.GetInputPort("twist"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    path = []

    def monitor(root):
        path.append(robot.GetMyContextFromRoot(root).get_continuous_state_vector().CopyToVector())

    simulator.set_monitor(monitor)
    simulator.AdvanceTo(duration)
    return np.array(path), tour, tour.GetMyContextFromRoot(simulator.get_context())


@pytest.mark.parametrize("grip", [1.0, 0.5])
def test_every_waypoint_is_reached_in_order_and_then_the_robot_stands_still(grip):
    waypoints = [(2, 0), (2, 2), (0, 2), (0, 0)]
    path, tour, context = drive(waypoints, 60, grip)
    rest = path
    for w in waypoints:
        near = np.flatnonzero(np.hypot(*(rest[:, :2] - w).T) < 0.12)
        assert len(near) > 0
        rest = rest[near[0] :]
    assert tour.GetOutputPort("done").Eval(context)[0] == 1
    assert tour.GetOutputPort("waypoints_reached").Eval(context)[0] == 4
    np.testing.assert_allclose(tour.GetOutputPort("reference_twist").Eval(context), 0)
    np.testing.assert_allclose(path[-1], path[-10], atol=1e-6)


def test_a_straight_leg_is_driven_straight():
    path, _, _ = drive([(3, 0)], 15)
    assert np.abs(path[:, 1]).max() < 1e-6


def test_a_waypoint_behind_the_robot_is_turned_to_on_the_spot():
    path, _, _ = drive([(-1, 0)], 12)
    turning = np.abs(path[:, 2]) < np.pi - 0.1
    assert np.hypot(*path[turning, :2].T).max() < 0.01
    assert path[-1, 0] == pytest.approx(-1, abs=0.11)


def test_the_robot_turns_to_each_heading_of_a_waypoint_and_stands_still_there():
    look = Waypoint(xy=[1.0, 0.0], look_deg=[90.0, -45.0])
    path, tour, context = drive([look, (2, 0)], 40, look_time=3.0)
    assert tour.GetOutputPort("done").Eval(context)[0] == 1
    headings = np.rad2deg(path[:, 2])
    at_waypoint = np.hypot(*(path[:, :2] - look.xy).T) < 0.12
    step = 40 / len(path)
    for heading in look.look_deg:
        still = at_waypoint & (np.abs(headings - heading) < 3)
        longest = max(np.diff(np.flatnonzero(np.diff([0, *still, 0])))[::2])
        assert 3.0 <= longest * step < 5.0
    first = np.flatnonzero(np.abs(headings - 90) < 3)[0]
    second = np.flatnonzero(np.abs(headings + 45) < 3)[0]
    assert first < second
    np.testing.assert_allclose(path[-1, :2], [2, 0], atol=0.12)


def test_a_waypoint_counts_as_reached_when_it_has_been_looked_at():
    _, tour, context = drive([Waypoint(xy=[0.5, 0.0], look_deg=[0.0])], 4, look_time=100.0)
    assert tour.GetOutputPort("waypoints_reached").Eval(context)[0] == 0
    np.testing.assert_allclose(tour.GetOutputPort("reference_twist").Eval(context), 0)


def test_leg_reference_is_the_foot_of_the_perpendicular_and_never_beyond_the_goal():
    reference, remaining = leg_reference(np.array([1.0, 0.7, 0.3]), np.zeros(2), np.array([4.0, 0.0]))
    np.testing.assert_allclose(reference, [1, 0, 0])
    assert remaining == pytest.approx(3)
    reference, remaining = leg_reference(np.array([5.0, 0.7, 0.3]), np.zeros(2), np.array([4.0, 0.0]))
    np.testing.assert_allclose(reference, [4, 0, 0])
    assert remaining == 0


def test_the_flipper_preset_is_that_of_the_current_waypoint():
    tour = WaypointTour(TourConfig(waypoints=[Waypoint(xy=[1, 0], flippers="climb")]))
    assert tour.GetOutputPort("flipper_preset").Eval(tour.CreateDefaultContext()) == "climb"


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (TourConfig(), r"tour\.waypoints: no waypoints"),
        (TourConfig(waypoints=[Waypoint(xy=[1.0])]), r"tour\.waypoints\[0\]\.xy: wrong length"),
        (TourConfig(waypoints=[Waypoint(xy=[1.0, float("nan")])]), r"tour\.waypoints\[0\]\.xy: out of range"),
        (TourConfig(waypoints=[Waypoint()], speed=-1), r"tour\.speed: out of range"),
    ],
)
def test_bad_tours_name_the_key(config, message):
    with pytest.raises(ConfigError, match=message):
        WaypointTour(config)
