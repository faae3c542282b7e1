"""The dose mapper at its ports."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.dose import dose_mapper
from naraha.systems.dose.dose_estimate import DoseConfig
from naraha.systems.dose.dose_mapper import DoseMapper, DoseMapperConfig, position_at
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.sensing.gamma_counter import NO_READING, DoseReading
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

SOURCE = np.array([1.0, 0.5, 0.3])


def robot_pose(t):
    """Around a square of 4 m with 1 m/s, always looking ahead."""
    side, s = int(t // 4) % 4, t % 4
    yaw = side * np.pi / 2
    corner = np.array([[-2, -2], [2, -2], [2, 2], [-2, 2]])[side]
    return RigidTransform(RollPitchYaw(0, 0, yaw), [*(corner + s * np.array([np.cos(yaw), np.sin(yaw)])), 0.1])


class Script(LeafSystem):
    """Poses and readings as functions of time; readings are held from the instant after their end."""

    def __init__(self, pose=robot_pose, duration=0.5, live_time=None, p_BG=(0.3, 0, 0.4)):
        super().__init__()
        self.pose, self.duration, self.live_time, self.p_BG = pose, duration, live_time, np.array(p_BG)
        self.DeclareAbstractOutputPort("reading", lambda: AbstractValue.Make(object()), self._reading)
        self.DeclareAbstractOutputPort("X_MB", lambda: AbstractValue.Make(RigidTransform()), self._pose)

    def _reading(self, context, output):
        index = int((context.get_time() + 1e-9) / self.duration) - 1
        if index < 0:
            output.set_value(NO_READING)
            return
        end = (index + 1) * self.duration
        p_MG = robot_pose(end - self.duration / 2) @ self.p_BG
        rate = 0.1 + 3.0 / np.square(p_MG - SOURCE).sum()
        counts = int(np.random.default_rng(index).poisson(1000 * rate * self.duration))
        live = self.duration if self.live_time is None else self.live_time(index)
        output.set_value(DoseReading(counts, live, rate, 0.0, end, self.duration, index))

    def _pose(self, context, output):
        output.set_value(self.pose(context.get_time()))


def run(until=16.4, config=None, map_M=None, X_BG=None, **script):
    builder = DiagramBuilder()
    source = builder.AddSystem(Script(**script))
    mapper = builder.AddSystem(DoseMapper(config, X_BG=X_BG or RigidTransform([0.3, 0, 0.4])))
    for name in ("reading", "X_MB"):
        builder.Connect(source.GetOutputPort(name), mapper.GetInputPort(name))
    simulator = Simulator(builder.Build())
    context = mapper.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    if map_M is not None:
        mapper.GetInputPort("map_M").FixValue(context, AbstractValue.Make(map_M))
    simulator.AdvanceTo(until)
    return mapper, context, simulator


def output(mapper, context, name):
    return mapper.GetOutputPort(name).Eval(context)


def test_every_reading_is_noted_once_with_the_place_in_its_middle():
    mapper, context, _ = run(9.95)
    readings = output(mapper, context, "readings")
    assert len(readings.time) == 19
    np.testing.assert_allclose(readings.time, 0.25 + 0.5 * np.arange(19))
    expected = [robot_pose(t) @ np.array([0.3, 0, 0.4]) for t in readings.time]
    away = np.linalg.norm(readings.p_MG - expected, axis=1)
    # Positions are on the straight line between poses 0.1 s apart; at a corner the arm swings.
    assert np.median(away) < 1e-6
    assert away.max() < 0.05


def test_what_was_noted_does_not_change_afterwards():
    mapper, context, simulator = run(3.0)
    readings = output(mapper, context, "readings")
    before = readings.counts.tolist(), readings.p_MG.tolist()
    simulator.AdvanceTo(6.0)
    assert len(output(mapper, context, "readings").time) > len(before[0])
    assert (readings.counts.tolist(), readings.p_MG.tolist()) == before
    with pytest.raises(ValueError, match="read-only"):
        readings.counts[0] = 0


def test_source_is_found_at_the_ports():
    mapper, context, _ = run()
    (source,) = output(mapper, context, "sources")
    assert np.linalg.norm(source.p_M[:2] - SOURCE[:2]) < 0.3
    assert source.dose_rate_1m == pytest.approx(3.0, rel=0.15)
    health = output(mapper, context, "health")
    assert (health.state, health.skipped) == ("good", 0)
    assert output(mapper, context, "dose_field").sources[0] is source
    assert output(mapper, context, "dose_field").rate(np.array([[1.0, 2.5, 0.3]]))[0] == pytest.approx(0.85, rel=0.2)


def test_field_is_computed_once_for_all_ports_and_only_when_asked(monkeypatch):
    calls = []
    real = dose_mapper.estimate_dose
    monkeypatch.setattr(dose_mapper, "estimate_dose", lambda *args: calls.append(args) or real(*args))
    mapper, context, _ = run(6.0)
    assert calls == []
    for name in ("dose_field", "sources", "health", "dose_field"):
        output(mapper, context, name)
    assert len(calls) == 1


def test_map_is_handed_to_the_estimator(monkeypatch):
    seen = []
    real = dose_mapper.estimate_dose
    monkeypatch.setattr(dose_mapper, "estimate_dose", lambda *args: seen.append(args[2]) or real(*args))
    points = np.random.default_rng(0).uniform(-3, 3, (100, 3)).astype(np.float32)
    for cloud, expected in ((PointCloud(o3d.core.Tensor(points)), points), (PointCloud(), None)):
        mapper, context, _ = run(2.0, map_M=cloud)
        output(mapper, context, "dose_field")
        assert seen[-1] is expected if expected is None else np.array_equal(seen[-1], expected)


def test_before_there_are_readings_the_health_says_few():
    mapper, context, _ = run(0.3)
    assert len(output(mapper, context, "readings").time) == 0
    assert output(mapper, context, "health").state == "few readings"
    assert output(mapper, context, "sources") == ()


def test_poses_that_are_not_finite_cost_only_their_readings():
    def pose(t):
        return RigidTransform([np.nan, 0, 0]) if 3 < t < 8 else robot_pose(t)

    mapper, context, _ = run(pose=pose)
    readings = output(mapper, context, "readings")
    unknown = ~np.isfinite(readings.p_MG).all(axis=1)
    assert 6 <= unknown.sum() <= 10
    assert readings.time[unknown].min() > 3
    assert readings.time[unknown].max() < 8
    health = output(mapper, context, "health")
    assert health.skipped == unknown.sum()
    assert np.linalg.norm(output(mapper, context, "sources")[0].p_M[:2] - SOURCE[:2]) < 0.4


def test_readings_without_live_time_are_skipped():
    mapper, context, _ = run(live_time=lambda index: 0.0 if index % 4 == 0 else 0.5)
    assert output(mapper, context, "health").skipped == 8
    assert len(output(mapper, context, "sources")) == 1


def test_position_is_interpolated_and_unknown_across_gaps():
    poses = np.array([[0, 0, 0, 0], [1, 2, 0, 0], [5, 2, 8, 0]], float)
    np.testing.assert_allclose(position_at(poses, 0.25, 0.5), [0.5, 0, 0])
    np.testing.assert_allclose(position_at(poses, 1.0, 0.5), [2, 0, 0])
    assert np.isnan(position_at(poses, 3.0, 0.5)).all()
    assert np.isnan(position_at(poses, -1.0, 0.5)).all()
    assert np.isnan(position_at(np.zeros((0, 4)), 0.0, 0.5)).all()


def test_wrong_inputs_are_named():
    mapper = DoseMapper()
    context = mapper.CreateDefaultContext()
    with pytest.raises(PortError, match=r"DoseMapper\.reading: input port is not connected"):
        Simulator(mapper).AdvanceTo(0.2)
    mapper.GetInputPort("map_M").FixValue(context, AbstractValue.Make({"no": "cloud"}))
    with pytest.raises(PortError, match=r"DoseMapper\.map_M: wrong type"):
        output(mapper, context, "dose_field")


@pytest.mark.parametrize(
    ("config", "key"),
    [
        (DoseMapperConfig(period=0.0), "period"),
        (DoseMapperConfig(max_gap=-1.0), "max_gap"),
        (DoseMapperConfig(dose=DoseConfig(sensitivity=-5.0)), "dose.sensitivity"),
    ],
)
def test_bad_configurations_are_refused(config, key):
    with pytest.raises(ConfigError, match=f"dose_mapper: {key}: out of range"):
        DoseMapper(config)
