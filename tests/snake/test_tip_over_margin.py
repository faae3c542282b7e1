import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.diagrams.recover import RecoverScenario
from naraha.diagrams.snake_rehearsal import copy_of
from naraha.models.snake.snake_model import SnakeModel
from naraha.models.worlds import World, surfaces
from naraha.models.worlds.world import Solid
from naraha.systems.snake.snake_pilot import Move
from naraha.systems.snake.tip_over_margin import (
    TipOverMargin,
    TipOverMarginConfig,
    convex_hull,
    tip_over_margin,
)
from pydrake.geometry import Box, HalfSpace
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import ConvexHull

SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
coordinate = st.floats(-3, 3).map(lambda v: round(v, 3))


def test_the_margin_is_the_distance_to_the_nearest_edge():
    assert tip_over_margin(SQUARE, np.array([0.3, -0.2])) == pytest.approx(0.7)
    assert tip_over_margin(SQUARE, np.array([1.0, 0.5])) == pytest.approx(0.0, abs=1e-12)
    assert tip_over_margin(SQUARE, np.array([1.4, 0.0])) == pytest.approx(-0.4)


def test_nothing_stands_on_two_points():
    assert tip_over_margin(convex_hull(SQUARE[:2]), np.zeros(2)) == -np.inf
    assert tip_over_margin(convex_hull(np.array([[0, 0], [1, 1], [2, 2]])), np.ones(2)) == -np.inf


@given(points=st.lists(st.tuples(coordinate, coordinate), min_size=4, max_size=20, unique=True))
def test_the_hull_is_that_of_qhull(points):
    points = np.array(points)
    ours = convex_hull(points)
    if len(ours) < 3:
        return
    area = 0.5 * np.sum(ours[:, 0] * np.roll(ours[:, 1], -1) - ours[:, 1] * np.roll(ours[:, 0], -1))
    if area < 1e-3:
        return
    assert area == pytest.approx(ConvexHull(points).volume, rel=1e-9)
    margins = [tip_over_margin(ours, point) for point in points]
    assert min(margins) > -1e-9


@pytest.mark.parametrize("offset", [0.0, 0.1, 0.25])
def test_a_box_stands_with_half_its_width_less_how_far_its_mass_is_off(offset):
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.002)
    model = plant.AddModelInstance("box")
    inertia = SpatialInertia.SolidBoxWithMass(2.0, 0.6, 0.4, 0.2)
    box = plant.AddRigidBody("box", model, inertia.Shift([-offset, 0.0, 0.0]))
    # Corners as small boxes, so that contact is at four places.
    for x in (-0.3, 0.3):
        for y in (-0.2, 0.2):
            place = RigidTransform([x, y, -0.1])
            plant.RegisterCollisionGeometry(box, place, Box(1e-3, 1e-3, 1e-3), f"foot{x}{y}", CoulombFriction(1, 1))
    plant.RegisterCollisionGeometry(plant.world_body(), RigidTransform(), HalfSpace(), "ground", CoulombFriction(1, 1))
    plant.Finalize()
    plant.SetDefaultFloatingBaseBodyPose(box, RigidTransform([0.0, 0.0, 0.1]))
    margin = builder.AddSystem(TipOverMargin(TipOverMarginConfig(), plant=plant, model=model))
    for name in ("contact_results", "body_poses"):
        builder.Connect(plant.GetOutputPort(name), margin.GetInputPort(name))
    builder.ExportOutput(margin.GetOutputPort("tip_margin"), "tip_margin")
    builder.ExportOutput(margin.GetOutputPort("support"), "support")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.3)
    context = simulator.get_context()
    assert diagram.GetOutputPort("tip_margin").Eval(context)[0] == pytest.approx(min(0.2, 0.3 - offset), abs=2e-3)
    support = diagram.GetOutputPort("support").Eval(context)
    assert support.centre_of_mass[0] == pytest.approx(offset, abs=2e-3)
    assert len(support.polygon) == 4


ARCH = np.zeros(19)
ARCH[[4, 6, 8, 10, 12]] = [0.5, -0.25, -0.5, -0.25, 0.5]


def on_a_slope(angle, joint_angles, seconds=1.0):
    """A snake across a slope [rad] on which it does not slip: (margins, rolls against the slope, every 50 ms)."""
    scenario = RecoverScenario(recording=None, snake=SnakeModel(wheel_friction=6.0))
    X_WG = RigidTransform(RollPitchYaw(angle, 0, 0), [0, 0, 0])
    middle = [float(v) for v in X_WG.multiply(np.array([0, 0, -0.1]))]
    degrees = [float(np.rad2deg(angle)), 0.0, 0.0]
    floor = Solid(name="floor", box=[8, 8, 0.2], xyz=middle, rpy_deg=degrees, surface="floor", friction=6.0)
    world = World(solids=[floor], surfaces={"floor": surfaces.CONCRETE_FLOOR})
    run = copy_of(scenario, world, X_WG @ RigidTransform([0, 0, 0.05]), joint_angles)
    run.give(Move(joints=tuple(float(q) for q in joint_angles)))
    found = []
    while run.time < seconds:
        run.advance(0.05)
        roll = RollPitchYaw(run.read("station.cheat.X_WB").rotation()).roll_angle()
        found.append((float(run.read("station.tip_margin")[0]), roll - angle, run.read("station.support")))
    return found


@pytest.mark.parametrize("joint_angles", [np.zeros(19), ARCH], ids=["straight", "arch"])
def test_the_margin_is_zero_at_the_slope_on_which_the_snake_really_tips(joint_angles):
    flat = on_a_slope(0.0, joint_angles)[-1]
    height, half_track = flat[2].centre_of_mass[2], 0.08
    assert flat[0] == pytest.approx(half_track, abs=1e-3)
    tips_at = np.arctan2(half_track, height)
    for short in (np.deg2rad(8), np.deg2rad(1.5)):
        stands = on_a_slope(tips_at - short, joint_angles)
        wanted = half_track * np.cos(tips_at - short) - height * np.sin(tips_at - short)
        assert stands[-1][0] == pytest.approx(wanted, abs=2e-3)
        assert abs(stands[-1][1]) < np.deg2rad(1.5)
    falls = on_a_slope(tips_at + np.deg2rad(1.5), joint_angles)
    assert abs(falls[-1][1]) > np.deg2rad(10)
    assert falls[-1][0] < 0
