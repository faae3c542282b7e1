"""The survey map takes every keyframe once, in its last version."""

import dataclasses

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.slam import Keyframe, KeyframePoses, SurveyMap
from open3d.t.geometry import PointCloud
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator


def keyframe(index, points, nir=None, x=0.0):
    cloud = PointCloud(o3d.core.Tensor(np.array(points, np.float32)))
    if nir is not None:
        cloud.point["nir"] = o3d.core.Tensor(np.array(nir, np.float32)[:, None])
    return Keyframe(index, 0.1 * index, RigidTransform([x, 0, 0]), None, cloud, 1.0)


def mapped(keyframes):
    """The map and the keyframes after the given ones have arrived, one a period."""
    simulator = Simulator(system := SurveyMap())
    context = simulator.get_mutable_context()
    for i, one in enumerate(keyframes):
        system.GetInputPort("keyframe").FixValue(context, Value(one))
        simulator.AdvanceTo(0.1 * i + 0.05)
    return [system.GetOutputPort(name).Eval(context) for name in ("map_M", "keyframes")]


def test_a_later_version_of_the_newest_keyframe_takes_its_place():
    bare = keyframe(3, [[1.05, 0.05, 0.05]])
    seen = keyframe(3, [[1.05, 0.05, 0.05]], nir=[0.4])
    cloud, keyframes = mapped([bare, seen])
    assert keyframes == (seen,)
    assert cloud.point["count"].numpy().tolist() == [[1]]
    assert cloud.point["nir"].numpy() == pytest.approx(np.array([[0.4]]))


def test_the_last_version_is_what_stays_when_the_next_keyframe_comes():
    versions = [keyframe(0, [[0.05, 0.05, 0.05]], nir=[value]) for value in (np.nan, 0.2, 0.6)]
    cloud, keyframes = mapped([*versions, keyframe(1, [[0.05, 0.05, 0.05]], nir=[0.8], x=1.0)])
    assert [k.index for k in keyframes] == [0, 1]
    assert keyframes[0] is versions[-1]
    np.testing.assert_allclose(cloud.point.positions.numpy()[:, 0], [0.05, 1.05], atol=1e-6)
    np.testing.assert_allclose(cloud.point["nir"].numpy()[:, 0], [0.6, 0.8], atol=1e-6)


def test_a_keyframe_that_comes_again_after_the_next_is_left_out():
    first, second = keyframe(0, [[0.05, 0.05, 0.05]]), keyframe(1, [[2.05, 0.05, 0.05]])
    cloud, keyframes = mapped([first, second, dataclasses.replace(first)])
    assert keyframes == (first, second)
    assert cloud.point["count"].numpy().sum() == 2


def test_keyframes_move_when_the_pose_graph_has_found_them_elsewhere():
    simulator = Simulator(system := SurveyMap(with_corrections=True))
    context = simulator.get_mutable_context()
    poses = KeyframePoses()
    for i in range(3):
        system.GetInputPort("keyframe").FixValue(context, Value(keyframe(i, [[0.05, 0.05, 0.05]], x=float(i))))
        system.GetInputPort("keyframe_poses").FixValue(context, Value(poses))
        simulator.AdvanceTo(0.1 * i + 0.05)
    poses = KeyframePoses(1, {i: RigidTransform([i, 0.5, 0]) for i in range(1, 3)})
    system.GetInputPort("keyframe_poses").FixValue(context, Value(poses))
    simulator.AdvanceTo(0.35)
    cloud, keyframes = (system.GetOutputPort(name).Eval(context) for name in ("map_M", "keyframes"))
    expected = [[0.05, 0.05, 0.05], [1.05, 0.55, 0.05], [2.05, 0.55, 0.05]]
    np.testing.assert_allclose(cloud.point.positions.numpy(), expected, atol=1e-6)
    assert [k.X_MB.translation()[1] for k in keyframes] == [0, 0.5, 0.5]


def test_nothing_is_laid_out_anew_while_the_corrections_stay_the_same():
    simulator = Simulator(system := SurveyMap(with_corrections=True))
    context = simulator.get_mutable_context()
    system.GetInputPort("keyframe").FixValue(context, Value(keyframe(0, [[0.05, 0.05, 0.05]])))
    system.GetInputPort("keyframe_poses").FixValue(context, Value(KeyframePoses(1, {0: RigidTransform([0, 1, 0])})))
    simulator.AdvanceTo(0.05)
    first = system.GetOutputPort("map_M").Eval(context)
    simulator.AdvanceTo(1.05)
    assert system.GetOutputPort("map_M").Eval(context) is first
