"""A gamma counter near sources, against inverse squares and slabs on paper."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.sensing import Surface, SurfaceTable
from naraha.systems.sensing.gamma_counter import (
    GAMMA_CS137,
    NO_READING,
    GammaCounter,
    GammaCounterConfig,
    counts_from_uniform,
    make_reading,
    source_dose_rate,
)
from pydrake.common.value import AbstractValue
from pydrake.geometry import Box, FramePoseVector, SceneGraph, Sphere
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

TABLE = SurfaceTable(
    by_pattern={
        "source*": Surface(activity=50, attenuation=0),
        "wall": Surface(attenuation=17.8),
        "robot": Surface(attenuation=1000),
    }
)


class Poses(LeafSystem):
    """Frames that move at constant velocities from where they start."""

    def __init__(self, motions):
        super().__init__()
        self.motions = motions
        self.DeclareAbstractOutputPort("poses", lambda: AbstractValue.Make(FramePoseVector()), self._calc)

    def _calc(self, context, output):
        poses = FramePoseVector()
        for frame, (start, velocity) in self.motions.items():
            poses.set_value(frame, RigidTransform(np.add(start, context.get_time() * np.asarray(velocity))))
        output.set_value(poses)


def make_rig(make_world, *, config=None, robot=((0, 0, 0), (0, 0, 0)), source=None, wall=False, seed=0, p_PG=(0, 0, 1)):
    """A counter on a robot that moves as told, with a source that is fixed at (3, 0, 1) or moves as told."""
    builder = DiagramBuilder()
    scene_graph = builder.AddSystem(SceneGraph())
    world = make_world(scene_graph)
    parent = world.frame("robot")
    world.add(Box(0.5, 0.5, 3), name="robot", frame=parent)
    motions = {parent: robot}
    if source == "none":
        pass
    elif source is None:
        world.add(Sphere(0.1), [3, 0, 1], "source")
    else:
        frame = world.frame("source")
        world.add(Sphere(0.1), name="source", frame=frame)
        motions[frame] = source
    world.add(Box(0.2, 4, 4), [1.5, 0, 1] if wall else [-5, 0, 1], "wall")
    counter = builder.AddSystem(
        GammaCounter(
            config or GammaCounterConfig(),
            scene=world.rays(TABLE),
            parent_frame=parent,
            X_PG=RigidTransform(list(p_PG)),
            seed=seed,
        )
    )
    poses = builder.AddSystem(Poses(motions))
    builder.Connect(poses.get_output_port(), scene_graph.get_source_pose_port(world.source))
    builder.Connect(scene_graph.get_query_output_port(), counter.GetInputPort("geometry_query"))
    return Simulator(builder.Build()), counter


def output(simulator, counter, name):
    return counter.GetOutputPort(name).Eval(counter.GetMyContextFromRoot(simulator.get_context()))


def dose_rate(make_world, **options):
    simulator, counter = make_rig(make_world, **options)
    return output(simulator, counter, "cheat.dose_rate")[0]


def test_dose_rate_is_background_and_inverse_square(make_world):
    assert dose_rate(make_world) == pytest.approx(0.1 + GAMMA_CS137 * 50 / 9)
    assert dose_rate(make_world, robot=((-3, 0, 0), (0, 0, 0))) == pytest.approx(0.1 + GAMMA_CS137 * 50 / 36)
    assert dose_rate(make_world, source="none") == pytest.approx(0.1)


def test_wall_between_attenuates_and_the_robot_itself_does_not(make_world):
    open_air = dose_rate(make_world) - 0.1
    assert dose_rate(make_world, wall=True) - 0.1 == pytest.approx(open_air * np.exp(-17.8 * 0.2), rel=1e-5)


def test_source_that_moves_is_followed(make_world):
    simulator, counter = make_rig(make_world, source=((2, 0, 1), (1, 0, 0)))
    simulator.AdvanceTo(1.0)
    assert output(simulator, counter, "cheat.dose_rate")[0] == pytest.approx(0.1 + GAMMA_CS137 * 50 / 9)


def test_dose_rate_at_the_source_is_finite():
    assert np.isfinite(source_dose_rate(np.array([50.0]), np.array([0.0]), np.array([0.0]))).all()


def test_there_is_no_reading_before_the_first_period_is_over(make_world):
    simulator, counter = make_rig(make_world)
    simulator.AdvanceTo(0.45)
    assert output(simulator, counter, "reading") == NO_READING
    simulator.AdvanceTo(0.55)
    reading = output(simulator, counter, "reading")
    assert (reading.index, reading.duration) == (0, 0.5)
    assert reading.time == pytest.approx(0.5)
    assert reading.live_time == pytest.approx(0.5 - 5e-6 * reading.counts)
    assert reading.dose_rate == pytest.approx(reading.counts / reading.live_time / 1000)


def test_readings_of_a_moving_robot_are_the_mean_over_their_interval(make_world):
    config = GammaCounterConfig(sensitivity=1e5, period=0.5)
    simulator, counter = make_rig(make_world, config=config, robot=((0, 0, 0), (2, 0, 0)))
    simulator.AdvanceTo(0.6)
    ends = 0.1 + GAMMA_CS137 * 50 / np.array([3.0, 2.0]) ** 2
    reading = output(simulator, counter, "reading")
    assert reading.dose_rate == pytest.approx(ends.mean(), abs=4 * reading.sigma)
    assert reading.sigma < 0.03 * ends.mean()


def test_mean_and_spread_of_readings_are_those_of_the_dose_rate(make_world):
    simulator, counter = make_rig(make_world)
    readings = []

    def note(root_context):
        reading = counter.GetOutputPort("reading").Eval(counter.GetMyContextFromRoot(root_context))
        if reading.index >= 0 and (not readings or readings[-1].index < reading.index):
            readings.append(reading)

    simulator.set_monitor(note)
    simulator.AdvanceTo(300)
    rates = np.array([reading.dose_rate for reading in readings])
    assert [reading.index for reading in readings] == list(range(len(readings)))
    truth = 0.1 + GAMMA_CS137 * 50 / 9
    deviation = np.sqrt(truth / (1000 * 0.5))
    assert abs(rates.mean() - truth) < 4 * deviation / np.sqrt(len(rates))
    assert rates.std() == pytest.approx(deviation, rel=0.12)
    assert np.mean([reading.sigma for reading in readings]) == pytest.approx(deviation, rel=0.05)


@pytest.mark.parametrize(("rate", "dead_time"), [(40.0, 0.0), (40.0, 5e-3), (1000.0, 1e-3), (1e5, 1e-4)])
def test_counts_with_dead_time_are_those_of_a_renewal_process(rate, dead_time):
    """Mean n T / (1 + n τ) and variance n T / (1 + n τ)³ (long times), also when it saturates."""
    duration = 2.0
    uniform = np.random.default_rng(4).random(3000)
    counts = np.array([counts_from_uniform(u, rate, duration, dead_time) for u in uniform])
    mean = rate * duration / (1 + rate * dead_time)
    variance = rate * duration / (1 + rate * dead_time) ** 3
    assert counts.mean() == pytest.approx(mean, abs=4 * np.sqrt(variance / 3000) + 0.6 * (dead_time > 0))
    assert counts.var() == pytest.approx(variance, rel=0.12, abs=0.3)
    live = duration - counts * dead_time
    if rate * dead_time < 2:  # else there is next to no live time left
        assert np.mean(counts / live) == pytest.approx(rate, rel=0.05)


def test_no_radiation_gives_no_counts():
    assert counts_from_uniform(0.999999, 0.0, 1.0, 1e-6) == 0
    assert counts_from_uniform(0.0, 50.0, 1.0, 1e-6) >= 0


def test_saturated_counter_says_infinite_and_not_an_error():
    config = GammaCounterConfig(period=1.0, dead_time=0.1)
    assert counts_from_uniform(0.5, 1e9, 1.0, 0.1) == 10
    reading = make_reading(10, 1.0, 0, config)
    assert reading.live_time == 0
    assert reading.dose_rate == reading.sigma == np.inf


def test_reading_without_counts_is_uncertain_by_one_count():
    reading = make_reading(0, 1.0, 0, GammaCounterConfig())
    assert reading.dose_rate == 0
    assert reading.sigma == pytest.approx(1 / (0.5 * 1000))


def test_two_seeds_differ_and_one_seed_repeats(make_world):
    def readings(seed):
        simulator, counter = make_rig(make_world, seed=seed, robot=((-1, 0, 0), (0.2, 0, 0)))
        counts = []
        for i in range(1, 7):
            simulator.AdvanceTo(0.5 * i + 0.1)
            counts.append(output(simulator, counter, "reading").counts)
        return counts

    assert readings(1) == readings(1)
    assert readings(1) != readings(2)


@pytest.mark.parametrize(
    "change",
    [{"period": 0.0}, {"sensitivity": 0.0}, {"background": -0.1}, {"dead_time": -1e-6}, {"period": float("nan")}],
)
def test_bad_configurations_are_refused(make_world, change):
    with pytest.raises(ConfigError, match=f"gamma_counter: {next(iter(change))}: out of range"):
        make_rig(make_world, config=GammaCounterConfig(**change))


def test_missing_query_is_named(make_world):
    world = make_world().add(Sphere(0.1), name="source")
    counter = GammaCounter(
        GammaCounterConfig(), scene=world.rays(TABLE), parent_frame=world.frame("robot"), X_PG=RigidTransform()
    )
    with pytest.raises(PortError, match=r"GammaCounter\.geometry_query: input port is not connected"):
        counter.GetOutputPort("cheat.dose_rate").Eval(counter.CreateDefaultContext())
