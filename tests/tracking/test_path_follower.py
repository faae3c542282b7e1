import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError, InputError, PortError
from naraha.systems.tracking import KanayamaConfig, KanayamaTracking, Path, PathFollower, PathFollowerConfig
from naraha.systems.tracking.path_follower import speed_at
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem


class Unicycle(LeafSystem):
    """A robot that does what it is told, but turns with only `grip` of the commanded rate."""

    def __init__(self, pose, grip):
        super().__init__()
        self._grip = grip
        self.DeclareVectorInputPort("twist", 2)
        self.DeclareContinuousState(3)
        self._start = pose
        self.DeclareAbstractOutputPort(
            "X_MB", lambda: Value(RigidTransform()), self._calc, prerequisites_of_calc={self.xc_ticket()}
        )

    def SetDefaultState(self, context, state):
        state.get_mutable_continuous_state().SetFromVector(self._start)

    def DoCalcTimeDerivatives(self, context, derivatives):
        v, omega = self.GetInputPort("twist").Eval(context)
        theta = context.get_continuous_state_vector().CopyToVector()[2]
        derivatives.get_mutable_vector().SetFromVector([v * np.cos(theta), v * np.sin(theta), self._grip * omega])

    def _calc(self, context, output):
        x, y, theta = context.get_continuous_state_vector().CopyToVector()
        output.set_value(RigidTransform(RollPitchYaw(0, 0, theta), [x, y, 0]))


class Ride:
    """A robot on a route, which can be given another route or be carried elsewhere."""

    def __init__(self, route, pose=(0, 0, 0), grip=1.0, **config):
        builder = DiagramBuilder()
        self.robot = builder.AddSystem(Unicycle(np.array(pose, float), grip))
        self.follower = builder.AddSystem(PathFollower(PathFollowerConfig(**config)))
        law = builder.AddSystem(KanayamaTracking(KanayamaConfig()))
        for system in (self.follower, law):
            builder.Connect(self.robot.GetOutputPort("X_MB"), system.GetInputPort("X_MB"))
        for name in ("reference_pose", "reference_twist"):
            builder.Connect(self.follower.GetOutputPort(name), law.GetInputPort(name))
        builder.Connect(law.GetOutputPort("twist_command"), self.robot.GetInputPort("twist"))
        self.simulator = Simulator(builder.Build())
        self.root = self.simulator.get_mutable_context()
        self.context = self.follower.GetMyMutableContextFromRoot(self.root)
        self.poses, self.twists = [], []
        self.give(route)
        self.simulator.set_monitor(self._monitor)
        self.simulator.Initialize()

    def _monitor(self, root):
        self.poses.append(self.pose())
        self.twists.append(self.robot.GetInputPort("twist").Eval(self.robot.GetMyContextFromRoot(root)))

    def pose(self):
        return self.robot.GetMyContextFromRoot(self.root).get_continuous_state_vector().CopyToVector()

    def give(self, route):
        path = route if isinstance(route, Path) else Path(xy=np.array(route, float).reshape(-1, 2))
        self.follower.GetInputPort("route").FixValue(self.context, AbstractValue.Make(path))

    def carry(self, pose):
        self.robot.GetMyMutableContextFromRoot(self.root).SetContinuousState(np.array(pose, float))

    def run(self, duration):
        self.simulator.AdvanceTo(self.root.get_time() + duration)
        return self

    def read(self, name):
        return self.follower.GetOutputPort(name).Eval(self.context)


def arc(radius, angle, step=0.1):
    t = np.linspace(0, angle, max(int(radius * angle / step), 2))
    return radius * np.column_stack([np.sin(t), 1 - np.cos(t)])


@pytest.mark.parametrize("grip", [1.0, 0.6])
def test_a_curve_is_followed_to_its_end_and_the_robot_stands_still_there(grip):
    route = arc(1.5, np.pi)
    ride = Ride(route, grip=grip).run(30)
    away = [Path(xy=route).nearest(pose[:2])[1] for pose in ride.poses]
    assert max(away) < (0.02 if grip == 1 else 0.15)
    assert ride.read("status") == "arrived"
    assert ride.read("progress")[0] == 1
    np.testing.assert_allclose(ride.poses[-1][:2], route[-1], atol=0.15)
    np.testing.assert_allclose(ride.read("reference_twist"), 0)


def test_the_robot_turns_on_the_spot_at_the_start_when_the_route_leads_back():
    ride = Ride([[0, 0], [-2, 0]]).run(2)
    assert ride.read("status") == "turning"
    assert np.hypot(*ride.pose()[:2]) < 1e-6
    ride.run(13)
    assert ride.read("status") == "arrived"
    assert max(abs(pose[1]) for pose in ride.poses) < 0.05


def test_a_sharp_corner_is_rounded_by_little():
    ride = Ride([[0, 0], [1.5, 0], [1.5, 1.5]]).run(25)
    assert ride.read("status") == "arrived"
    away = [Path(xy=np.array([[0, 0], [1.5, 0], [1.5, 1.5]])).nearest(pose[:2])[1] for pose in ride.poses]
    assert max(away) < 0.15


def test_speed_in_curves_is_what_the_yaw_rate_allows_and_reached_by_braking_before_them():
    config = PathFollowerConfig(speed=0.3, curve_yaw_rate=0.4, deceleration=0.3)
    t = np.linspace(0, np.pi, 60)[1:]
    bend = np.column_stack([2 + 0.5 * np.sin(t), 0.5 - 0.5 * np.cos(t)])
    path = Path(xy=np.vstack([[[x, 0] for x in np.arange(0, 2.01, 0.1)], bend]))
    assert speed_at(path, 0.0, config) == pytest.approx(0.3)
    assert speed_at(path, 2.7, config) == pytest.approx(0.4 * 0.5, rel=0.03)
    speeds = np.array([speed_at(path, s, config) for s in np.arange(0, path.length_m, 0.01)])
    before = speeds[:200]
    assert (np.diff(before**2) > -2 * 0.3 * 0.01 - 1e-9).all()
    assert speeds[198] < 0.29


def test_progress_grows_from_nothing_to_all_of_it():
    ride = Ride([[0, 0], [3, 0]])
    shares = [ride.run(0.5).read("progress")[0] for _ in range(24)]
    assert shares[0] < 0.05
    assert (np.diff(shares) >= 0).all()
    assert shares[-1] == 1


def test_no_route_means_stand_still():
    ride = Ride([]).run(1)
    assert ride.read("status") == "idle"
    np.testing.assert_array_equal(ride.poses[-1], 0)
    ride.give([[0, 0], [1, 0]])
    assert ride.run(8).read("status") == "arrived"


def test_a_route_that_is_taken_away_in_mid_leg_stops_the_robot():
    ride = Ride([[0, 0], [3, 0]]).run(3)
    where = ride.pose()
    ride.give([])
    np.testing.assert_allclose(ride.run(2).pose(), where, atol=1e-3)
    assert ride.read("status") == "idle"


def test_a_new_route_is_entered_where_the_robot_is():
    ride = Ride([[0, 0], [4, 0]]).run(6)
    x = ride.pose()[0]
    ride.give([[0, 0.1], [2, 0.1], [2, 2]])
    ride.run(25)
    assert ride.read("status") == "arrived"
    np.testing.assert_allclose(ride.pose()[:2], [2, 2], atol=0.08)
    assert min(pose[0] for pose in ride.poses[-300:]) > x - 0.05


def test_a_robot_that_is_carried_off_waits_and_goes_on_where_it_comes_back():
    ride = Ride([[0, 0], [4, 0]]).run(3)
    ride.carry([1.0, 1.0, 0.3])
    ride.run(2)
    assert ride.read("status") == "off the route"
    np.testing.assert_allclose(ride.pose(), [1.0, 1.0, 0.3], atol=0.02)
    ride.carry([3.0, 0.1, 2.0])
    ride.run(0.5)
    assert ride.read("status") == "turning"
    assert ride.read("progress")[0] == pytest.approx(0.75, abs=0.01)
    assert ride.run(10).read("status") == "arrived"


def test_a_route_that_crosses_itself_is_driven_all_the_way_round():
    t = np.linspace(0, 2 * np.pi, 120)
    loop = np.column_stack([np.sin(t), 1 - np.cos(t)])
    route = np.vstack(
        [[[x, 0] for x in np.arange(-1, -0.01, 0.1)], loop[:-1], [[x, 0] for x in np.arange(0.0, 1, 0.1)]]
    )
    ride = Ride(route, pose=(-1, 0, 0)).run(50)
    assert ride.read("status") == "arrived"
    assert max(pose[1] for pose in ride.poses) > 1.9


def test_the_robot_does_not_jerk_on_a_smooth_curve():
    ride = Ride(arc(1.5, np.pi)).run(10)
    v = np.array(ride.twists)[50:, 0]
    assert np.abs(np.diff(v)).max() < 0.02


@given(st.lists(st.tuples(st.integers(-20, 20), st.integers(-20, 20)), min_size=2, max_size=8), st.floats(-3, 3))
def test_the_nearest_point_is_nearer_than_any_sample_and_within_the_window(points, x):
    xy = np.array([p for i, p in enumerate(points) if i == 0 or p != points[i - 1]], float)
    if len(xy) < 2:
        return
    path, query = Path(xy=xy), np.array([x, 1.0])
    low, high = 0.3 * path.length_m, 0.7 * path.length_m
    s, distance = path.nearest(query, low, high)
    assert low - 1e-9 <= s <= high + 1e-9
    np.testing.assert_allclose(np.hypot(*(path.at(s)[:2] - query)), distance, atol=1e-9)
    samples = [np.hypot(*(path.at(u)[:2] - query)) for u in np.linspace(low, high, 50)]
    assert distance <= min(samples) + 1e-9


def test_heading_and_curvature_of_a_circle():
    path = Path(xy=arc(2.0, 2.0))
    for s in np.linspace(0.2, 3.7, 9):
        _, _, heading, curvature = path.at(s)
        assert heading == pytest.approx(s / 2, abs=1e-3)
        assert curvature == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize(
    ("xy", "message"),
    [([[0, 0, 0]], "xy"), ([[0, np.nan], [1, 1]], "finite"), ([[0, 0]], "two"), ([[0, 0], [0, 0], [1, 1]], r"xy\[1\]")],
)
def test_what_is_no_path_is_refused(xy, message):
    with pytest.raises(InputError, match=message):
        Path(xy=np.array(xy, float))


def test_bad_config_and_a_route_of_another_type_are_refused():
    with pytest.raises(ConfigError, match=r"path_follower\.speed"):
        PathFollower(PathFollowerConfig(speed=0))
    system = PathFollower()
    context = system.CreateDefaultContext()
    system.GetInputPort("X_MB").FixValue(context, AbstractValue.Make(RigidTransform()))
    system.GetInputPort("route").FixValue(context, AbstractValue.Make([[0, 0], [1, 0]]))
    with pytest.raises(PortError, match=r"PathFollower\.route"):
        system.GetOutputPort("status").Eval(context)
