import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.snake.tip_over_margin import (
    TipOverMargin,
    TipOverMarginConfig,
    convex_hull,
    tip_over_margin,
)
from pydrake.geometry import Box, HalfSpace
from pydrake.math import RigidTransform
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
