"""Several viewpoints joined without odometry, and what must stay out."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.clouds import voxel_filter
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.sensing import Scan
from naraha.systems.slam import Keyframe
from naraha.systems.viewpoints.viewpoint_merger import (
    MergeConfig,
    ViewpointMerger,
    ViewpointMergerConfig,
    merge_viewpoints,
)
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from tests.viewpoints.viewpoints import box_room, cloud_of, errors, take_views


@pytest.fixture(scope="module")
def hall():
    return take_views(1, revolutions=3)


@pytest.fixture(scope="module")
def merged(hall):
    return merge_viewpoints(hall[0])


def worst(result, X_WS):
    first = min(result.poses)
    M = X_WS[first] @ result.poses[first].inverse()
    return np.max([errors(X, M.inverse() @ X_WS[k]) for k, X in result.poses.items()], axis=0)


def test_five_viewpoints_are_joined_to_2_cm_and_a_fifth_of_a_degree(hall, merged):
    assert sorted(merged.poses) == [0, 1, 2, 3, 4]
    assert merged.left_out == {}
    distance, angle = worst(merged, hall[1])
    assert distance < 0.02
    assert angle < 0.2
    assert merged.rmse < 0.02
    np.testing.assert_allclose(merged.poses[0].GetAsMatrix4(), np.eye(4), atol=1e-9)


def test_the_pair_table_says_what_was_found(merged):
    assert len(merged.pairs) == 10
    assert sum(pair.used for pair in merged.pairs) >= 8
    for pair in merged.pairs:
        if pair.used:
            assert pair.score > pair.runner_up + 0.1
            assert 0 < pair.fitness <= 1
            assert 0 < pair.rmse < 0.05


def test_a_view_from_another_place_stays_out_with_a_reason(hall):
    stranger = take_views(0, world="rough", places=[(0.0, 0.0)], revolutions=3)[0]
    result = merge_viewpoints([hall[0][0], stranger[0], hall[0][3], hall[0][4]])
    assert sorted(result.poses) == [0, 2, 3]
    assert "fits nowhere" in result.left_out[1]
    assert worst(result, {0: hall[1][0], 2: hall[1][3], 3: hall[1][4]})[0] < 0.03


def test_views_of_two_places_are_not_joined(hall):
    stranger = take_views(0, world="rough", places=[(0.0, 0.0)], revolutions=3)[0]
    result = merge_viewpoints([hall[0][0], stranger[0]])
    assert list(result.poses) == [0]
    assert "fits no other view" in result.left_out[1]


def test_an_empty_rectangular_room_is_ambiguous_and_not_joined():
    rng = np.random.default_rng(0)
    clouds = [cloud_of(box_room(rng, p=p, yaw=yaw)[0]) for p, yaw in (((-2.0, 0.5), 0.3), ((1.5, -1.0), 2.0))]
    result = merge_viewpoints(clouds)
    assert list(result.poses) == [0]
    assert "fits in two ways" in result.left_out[1]


def test_one_view_is_its_own_map():
    result = merge_viewpoints([cloud_of(box_room(np.random.default_rng(0))[0])])
    assert list(result.poses) == [0]
    assert result.pairs == ()
    assert result.left_out == {}
    assert merge_viewpoints([]).poses == {}


def test_identical_views_lie_on_each_other(hall):
    result = merge_viewpoints([hall[0][0], hall[0][0]])
    distance, angle = errors(result.poses[1], RigidTransform())
    assert distance < 1e-3
    assert angle < 1e-2


def test_empty_and_tilted_views_stay_out_and_the_rest_is_joined(hall):
    leaning = cloud_of(
        hall[0][1].point.positions.numpy() @ RollPitchYaw(np.deg2rad(8), 0, 0).ToRotationMatrix().matrix().T
    )
    result = merge_viewpoints([cloud_of(np.zeros((0, 3))), leaning, hall[0][3], hall[0][4]])
    assert sorted(result.poses) == [2, 3]
    assert "0 usable voxels" in result.left_out[0]
    assert "not level" in result.left_out[1]
    assert "give its roll and pitch" in result.left_out[1]


def test_roll_and_pitch_level_views_that_lean():
    clouds, X_WS, rpy = take_views(2, places=[(-8, -5), (-1, -3), (-8, 2)], revolutions=3, lean_deg=8.0)
    result = merge_viewpoints(clouds, rpy=rpy)
    assert sorted(result.poses) == [0, 1, 2]
    distance, angle = worst(result, X_WS)
    assert distance < 0.03
    assert angle < 0.2
    # M is level to the IMU's error, although S is not.
    np.testing.assert_allclose(RollPitchYaw(result.poses[0].rotation()).vector()[:2], rpy[0][:2], atol=1e-9)


@pytest.mark.parametrize(
    "change",
    [
        lambda c: setattr(c, "min_score", -1.0),
        lambda c: setattr(c.search.view, "heights", [2.0, 0.2]),
        lambda c: setattr(c.refinement, "max_distances", []),
        lambda c: setattr(c.search, "pixel", float("nan")),
    ],
)
def test_bad_configuration_is_refused(change):
    config = MergeConfig()
    change(config)
    with pytest.raises(ConfigError):
        merge_viewpoints([], config)
    with pytest.raises(ConfigError):
        ViewpointMerger(ViewpointMergerConfig(merge=config))


def fix(system, context, view, rpy=None):
    system.GetInputPort("view").FixValue(context, AbstractValue.Make(view))
    if rpy is not None:
        system.GetInputPort("rpy").FixValue(context, rpy)


def start(system, view, rpy=None):
    simulator = Simulator(system)
    fix(system, simulator.get_mutable_context(), view, rpy)
    return simulator, simulator.get_mutable_context()


def output(system, context, name):
    return system.GetOutputPort(name).Eval(context)


@pytest.fixture(scope="module")
def rooms():
    rng = np.random.default_rng(3)
    made = [box_room(rng, p=p, yaw=yaw, crate=True) for p, yaw in (((-2.0, 0.5), 0.3), ((1.5, -1.0), 2.0))]
    clouds = [cloud_of(points) for points, _ in made]
    for index, cloud in enumerate(clouds):
        cloud.point["nir"] = o3d.core.Tensor(np.full((len(cloud.point.positions), 1), 0.2 + 0.4 * index, np.float32))
    return clouds, [X for _, X in made]


def test_the_system_joins_views_as_they_come_and_keeps_their_attributes(rooms):
    clouds, X_WS = rooms
    system = ViewpointMerger()
    simulator, context = start(system, Scan(clouds[0], 0.0, 0.0, 0))
    simulator.AdvanceTo(0.05)
    assert list(output(system, context, "poses")) == [0]
    first = output(system, context, "merge")
    fix(system, context, Scan(clouds[1], 0.1, 0.1, 4))
    simulator.AdvanceTo(0.15)
    poses = output(system, context, "poses")
    assert sorted(poses) == [0, 4]
    assert errors(poses[4], X_WS[0].inverse() @ X_WS[1])[0] < 0.02
    assert first.poses.keys() == {0}
    again = output(system, context, "merge")
    simulator.AdvanceTo(0.25)
    assert output(system, context, "merge") is again
    cloud = output(system, context, "merged_M")
    nir = cloud.point["nir"].numpy()
    assert nir.min() == pytest.approx(0.2)
    assert nir.max() == pytest.approx(0.6)
    alone = max(len(voxel_filter(c, 0.1).point.positions) for c in clouds)
    assert alone <= len(cloud.point.positions) < 1.6 * alone


def test_keyframes_are_levelled_by_rpy_and_seen_from_the_sensor(rooms):
    clouds, X_WS = rooms
    X_BS = RigidTransform([0.1, 0.0, 0.2])
    system = ViewpointMerger(X_BS=X_BS, with_rpy=True)
    rpy = [np.array([0.15, -0.1, 0.0]), np.array([-0.1, 0.12, 1.0])]
    simulator, X_WB = None, []
    for index, (cloud, X) in enumerate(zip(clouds, X_WS, strict=True)):
        X_SB = RigidTransform(RollPitchYaw(rpy[index][0], rpy[index][1], 0), np.zeros(3)) @ X_BS.inverse()
        X_WB.append(X @ X_SB)
        points = X_SB.inverse().multiply(cloud.point.positions.numpy().astype(float).T).T
        keyframe = Keyframe(index, 0.1 * index, RigidTransform(), None, cloud_of(points), 1.0)
        if simulator is None:
            simulator, context = start(system, keyframe, rpy[index])
        fix(system, context, keyframe, rpy[index])
        simulator.AdvanceTo(0.1 * index + 0.05)
    result = output(system, context, "merge")
    assert sorted(result.poses) == [0, 1], result.left_out
    assert errors(result.poses[0].inverse() @ result.poses[1], X_WB[0].inverse() @ X_WB[1])[0] < 0.02


def test_no_view_yet_is_no_view_and_a_wrong_type_is_named(rooms):
    system = ViewpointMerger()
    simulator, context = start(system, Scan(rooms[0][0], 0.0, 0.0, -1))
    simulator.AdvanceTo(0.05)
    assert output(system, context, "poses") == {}
    assert len(output(system, context, "merged_M").point.positions) == 0
    with pytest.raises(PortError, match=r"ViewpointMerger\.view: wrong type, got 'dict'"):
        start(system, {})[0].AdvanceTo(0.05)
    with pytest.raises(PortError, match=r"ViewpointMerger\.view: input port is not connected"):
        Simulator(system).AdvanceTo(0.05)
    levelled = ViewpointMerger(with_rpy=True)
    with pytest.raises(PortError, match=r"ViewpointMerger\.rpy: input port is not connected"):
        start(levelled, Scan(rooms[0][0], 0.0, 0.0, 0))[0].AdvanceTo(0.05)


@pytest.mark.slow
def test_20_halls_are_joined():
    joined, found = 0, []
    for seed in range(20):
        clouds, X_WS, _ = take_views(seed)
        result = merge_viewpoints(clouds)
        joined += len(result.poses)
        found.append(worst(result, X_WS))
    distances, angles = np.array(found).T
    print(f"\njoined {joined} of 100; worst view: median {np.median(distances):.4f} m, max {distances.max():.4f} m,")
    print(f"median {np.median(angles):.3f} deg, max {angles.max():.3f} deg")
    assert joined == 100
    assert distances.max() < 0.03
    assert np.mean(distances < 0.02) >= 0.9
    assert angles.max() < 0.2
