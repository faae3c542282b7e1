import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import InputError
from naraha.systems.routes import add_boxes, merge_voxels
from pydrake.geometry import Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder


def voxels_of(boxes):
    found = []
    for box in boxes:
        found += [tuple(np.array(v) + box[:3]) for v in np.ndindex(*(box[3:] - box[:3]))]
    return found


@given(st.sets(st.tuples(*[st.integers(-3, 3)] * 3), max_size=60))
def test_boxes_fill_exactly_the_voxels_and_none_twice(voxels):
    boxes = merge_voxels(np.array(sorted(voxels)).reshape(-1, 3))
    filled = [tuple(int(i) for i in v) for v in voxels_of(boxes)]
    assert len(filled) == len(set(filled))
    assert set(filled) == voxels


def test_a_solid_block_is_one_box_and_a_room_six():
    block = np.stack(np.meshgrid(range(5), range(7), range(3), indexing="ij"), -1).reshape(-1, 3) - 2
    np.testing.assert_array_equal(merge_voxels(block), [[-2, -2, -2, 3, 5, 1]])
    room = np.ones((20, 15, 8), bool)
    room[1:-1, 1:-1, 1:-1] = False
    assert len(merge_voxels(np.argwhere(room))) == 6


def test_no_voxels_make_no_boxes_and_repeated_ones_count_once():
    assert merge_voxels(np.zeros((0, 3))).shape == (0, 6)
    assert len(merge_voxels(np.zeros((4, 3)))) == 1


def test_a_ball_comes_to_rest_on_the_boxes():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.002)
    ball = plant.AddRigidBody("ball", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    plant.RegisterCollisionGeometry(ball, RigidTransform(), Sphere(0.1), "ball", CoulombFriction(0.5, 0.5))
    plant.SetDefaultFloatingBaseBodyPose(ball, RigidTransform([0.25, 0.25, 0.5]))
    slab = np.stack(np.meshgrid(range(5), range(5), range(2), indexing="ij"), -1).reshape(-1, 3)
    names = add_boxes(plant, merge_voxels(slab), 0.1)
    assert names == ["voxels_0"]
    plant.Finalize()
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.5)
    X_WB = plant.EvalBodyPoseInWorld(plant.GetMyContextFromRoot(simulator.get_context()), ball)
    assert X_WB.translation()[2] == pytest.approx(0.2 + 0.1, abs=2e-3)


def test_what_cannot_be_used_is_refused():
    with pytest.raises(InputError, match="too far"):
        merge_voxels(np.array([[0, 0, 0], [10_000, 10_000, 10_000]]))
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.01)
    boxes = merge_voxels(np.zeros((1, 3)))
    with pytest.raises(InputError, match="voxel"):
        add_boxes(plant, boxes, 0.0)
    with pytest.raises(InputError, match="friction"):
        add_boxes(plant, boxes, 0.1, friction=-1.0)
    plant.Finalize()
    with pytest.raises(InputError, match="finalized"):
        add_boxes(plant, boxes, 0.1)
