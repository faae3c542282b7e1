import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.localization import EvolutionLocalizer, LocalizerConfig, OccupancyGrid, no_scan
from naraha.systems.localization.planar import compose, to_matrix
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from .rooms import drive, rasterised, room, scan_in

START = np.array([4.0, 1.2, 0.0])
TRUTH = drive(START, [[0.05, 0.0, 0.036]] * 40)


class Drive(LeafSystem):
    """A robot on a circle, with its laser at X_BS, scans from the number `first` on, and exact odometry from another
    origin."""

    def __init__(self, X_BS, first=0):
        super().__init__()
        self._X_BS, self._first = X_BS, first
        self.DeclareAbstractOutputPort("laser_scan", lambda: AbstractValue.Make(no_scan()), self._CalcScan)
        self.DeclareAbstractOutputPort("X_OB", lambda: AbstractValue.Make(RigidTransform()), self._CalcOdometry)

    def _CalcScan(self, context, output):
        k = round(context.get_time() / 0.1)
        if k < self._first:
            output.set_value(no_scan())
            return
        scan = scan_in(room(), compose(TRUTH[k], self._X_BS), np.random.default_rng(k), time=0.1 * k, index=k)
        output.set_value(scan)

    def _CalcOdometry(self, context, output):
        X_WB = to_matrix(TRUTH[round(context.get_time() / 0.1)])
        output.set_value(
            RigidTransform(to_matrix(np.array([9.0, -3.0, 2.0])) @ np.linalg.solve(to_matrix(START), X_WB))
        )


def plan():
    occupied, origin = rasterised(room())
    return OccupancyGrid.from_plan(occupied, 0.05, origin)


def driven(source, time, **options):
    """The localiser and its context after some time [s] of a drive; without a grid it maps."""
    config = LocalizerConfig(mapping=options.get("grid") is None)
    builder = DiagramBuilder()
    builder.AddSystem(source)
    system = builder.AddSystem(EvolutionLocalizer(config, start=START, **options))
    for name in ("laser_scan", "X_OB"):
        builder.Connect(source.GetOutputPort(name), system.GetInputPort(name))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(time)
    # A context of its own, which outlives the simulator.
    return system, system.GetMyContextFromRoot(simulator.get_context().Clone())


@pytest.mark.parametrize("mapping", [False, True])
def test_it_follows_a_robot_with_its_laser_off_centre(mapping):
    X_BS = np.array([0.2, -0.1, 0.3])
    system, context = driven(Drive(X_BS), 3.9, grid=None if mapping else plan(), X_BS=X_BS)
    value = {
        name: system.GetOutputPort(name).Eval(context) for name in ("pose", "X_MB", "covariance", "health", "lost")
    }
    np.testing.assert_allclose(value["pose"], TRUTH[39], atol=0.03)
    np.testing.assert_allclose(value["X_MB"].GetAsMatrix4(), to_matrix(value["pose"]), atol=1e-12)
    covariance = value["covariance"].reshape(3, 3)
    np.testing.assert_array_equal(covariance, covariance.T)
    assert 0 < np.sqrt(np.linalg.eigvalsh(covariance)[-1]) < 0.05
    assert value["health"][0] > 0.9
    assert value["lost"][0] == 0
    assert system.GetOutputPort("grid").Eval(context).occupied.sum() > 100
    assert system.GetOutputPort("localization").Eval(context).scans in (39, 40)


def test_the_start_is_where_it_was_at_the_first_look_not_at_the_first_scan():
    system, context = driven(Drive(np.zeros(3), first=6), 0.65)
    known = system.GetOutputPort("localization").Eval(context)
    assert known.scans == 1
    np.testing.assert_allclose(known.keyframes, [TRUTH[6]], atol=1e-3)  # odometry is looked at 1 ms later


def evaluated(system, scan, X_OB):
    context = system.CreateDefaultContext()
    system.GetInputPort("laser_scan").FixValue(context, AbstractValue.Make(scan))
    system.GetInputPort("X_OB").FixValue(context, AbstractValue.Make(X_OB))
    Simulator(system, context).AdvanceTo(0.01)
    return context


def test_between_scans_the_pose_goes_on_with_odometry():
    system = EvolutionLocalizer(grid=plan(), start=START)
    context = evaluated(system, scan_in(room(), START), RigidTransform([1, 0, 0]))
    before = system.GetOutputPort("pose").Eval(context).copy()
    system.GetInputPort("X_OB").FixValue(context, AbstractValue.Make(RigidTransform([1.3, 0, 0])))
    after = system.GetOutputPort("pose").Eval(context)
    np.testing.assert_allclose(after - before, [0.3 * np.cos(before[2]), 0.3 * np.sin(before[2]), 0], atol=1e-9)


def test_a_scan_belongs_to_odometry_of_its_own_time():
    """A scan that is half a period old is not taken for one of now: the robot drives 1 m/s."""
    system = EvolutionLocalizer(LocalizerConfig(), grid=plan(), start=START, period=0.2)
    context = evaluated(system, scan_in(room(), START, time=0.0, index=0), RigidTransform())
    half = drive(START, [[0.1, 0.0, 0.0]])[1]
    scan = scan_in(room(), half, time=0.1, index=1)
    system.GetInputPort("laser_scan").FixValue(context, AbstractValue.Make(scan))
    system.GetInputPort("X_OB").FixValue(context, AbstractValue.Make(RigidTransform([0.2, 0, 0])))
    Simulator(system, context).AdvanceTo(0.21)
    np.testing.assert_allclose(system.GetOutputPort("localization").Eval(context).X_OB, [0.1, 0, 0], atol=0.002)
    np.testing.assert_allclose(system.GetOutputPort("pose").Eval(context), np.add(START, [0.2, 0, 0]), atol=0.02)


def test_before_the_first_scan_the_pose_is_the_start():
    system = EvolutionLocalizer(grid=plan(), start=START)
    context = evaluated(system, no_scan(), RigidTransform([1, 0, 0]))
    np.testing.assert_array_equal(system.GetOutputPort("pose").Eval(context), START)
    assert system.GetOutputPort("localization").Eval(context).scans == 0


def test_what_it_cannot_work_with_is_refused():
    with pytest.raises(ConfigError, match="nothing to localise in"):
        EvolutionLocalizer()
    with pytest.raises(ConfigError, match=r"localizer: period"):
        EvolutionLocalizer(grid=plan(), period=0.0)
    with pytest.raises(ConfigError, match=r"localizer.method"):
        EvolutionLocalizer(LocalizerConfig(method="magic"), grid=plan())
    system = EvolutionLocalizer(grid=plan())
    context = system.CreateDefaultContext()
    system.GetInputPort("laser_scan").FixValue(context, AbstractValue.Make(object()))
    system.GetInputPort("X_OB").FixValue(context, AbstractValue.Make(RigidTransform()))
    with pytest.raises(PortError, match="laser_scan"):
        Simulator(system, context).AdvanceTo(0.01)
