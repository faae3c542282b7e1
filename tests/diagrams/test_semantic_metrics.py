"""What the metrics of a semantic map say about maps whose errors are known."""

import numpy as np
import open3d as o3d
import pytest
from naraha.diagrams.change_metrics import View, box_distance, change_metrics, changed_solids
from naraha.diagrams.semantic_metrics import in_plan, intersection_over_union, match_puddles, true_classes
from naraha.models.worlds import Solid, World, load_world
from naraha.systems.changes import ChangedObject, UpdateSummary, make_seen_space
from naraha.systems.changes.sight import Rays
from naraha.systems.hazards import Region
from naraha.systems.sensing import RayScene, Surface, SurfaceTable
from naraha.systems.slam import Keyframe
from open3d.t.geometry import PointCloud
from pydrake.geometry import Box, Cylinder
from pydrake.math import RigidTransform, RollPitchYaw

from tests.sensing.conftest import ShapeWorld


def puddle(x, y):
    corner = np.array([x, y, 0.0])
    return Region("water", corner, 0.5, np.zeros((3, 2)), 0.9, 50, corner, corner)


def test_intersection_over_union_of_masks():
    found, true = np.array([1, 1, 0, 0], bool), np.array([0, 1, 1, 0], bool)
    assert intersection_over_union(found, true) == pytest.approx(1 / 3)
    assert intersection_over_union(~found & found, ~true & true) == 1


def test_solids_hold_points_over_and_under_them():
    pool = Solid(name="pool", cylinder=[0.4, 0.01], xyz=[1, 2, 0])
    box = Solid(name="box", box=[2, 1, 1], xyz=[0, 0, 0.5], rpy_deg=[0, 0, 90])
    points = np.array([[1.3, 2, 7.0], [1.3, 2.3, 0], [0.4, 0.9, 0], [0.9, 0.4, 0]])
    np.testing.assert_array_equal(in_plan(pool, points), [True, False, False, False])
    np.testing.assert_array_equal(in_plan(box, points), [False, False, True, False])


def test_puddles_are_matched_to_pools_once():
    pools = [Solid(name=f"pool_{i}", cylinder=[0.4, 0.01], xyz=[3.0 * i, 0, 0]) for i in range(3)]
    assert match_puddles([puddle(0.1, 0), puddle(0.2, 0.1), puddle(3, 0.2), puddle(1.5, 0)], pools) == (2, 1)
    assert match_puddles([], pools) == (0, 0)
    assert match_puddles([puddle(0, 0)], []) == (0, 1)


def test_the_true_class_of_a_point_is_what_its_ray_met_and_not_where_the_map_puts_it():
    """Water on the floor, seen along a grazing ray with an error of distance, and from a wrong pose in the map."""
    table = SurfaceTable(by_pattern={"pool": Surface(label="water")}, default=Surface(label="floor"))
    world = ShapeWorld().add(Box(20, 20, 1), [0, 0, -0.5], "floor").add(Cylinder(0.4, 0.02), [2, 0, 0], "pool")
    scene: RayScene = world.rays(table)
    p_BS = np.array([0.0, 0.0, 0.3])
    on_water, short_of_it = np.array([2.0, 0.0, 0.01]), np.array([1.3, 0.0, 0.0])
    ghost = p_BS + 2.0 * (on_water - p_BS)  # far behind what its ray meets: a mirror image
    measured = [p_BS + 1.03 * (on_water - p_BS), p_BS + 0.97 * (short_of_it - p_BS), ghost]
    cloud = PointCloud(o3d.core.Tensor(np.array(measured, np.float32)))
    cloud.point["intensity"] = o3d.core.Tensor(np.ones((3, 1), np.float32))
    wrong = RigidTransform(RollPitchYaw(0, 0, 1.0), [5.0, 1.0, 0.0])
    keyframe = Keyframe(0, 0.0, wrong, None, cloud, 1.0)
    points = wrong.multiply(np.array(measured).T).T
    true = true_classes(points, [keyframe], [RigidTransform()], scene, p_BS=p_BS, p_BD=p_BS, voxel=0.1)
    np.testing.assert_array_equal(true["water"], [True, False, False])
    assert not true["heat"].any()


def changed(kind, solid):
    inside = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 3)) * solid.box
    points = inside + solid.xyz
    return ChangedObject(kind, points.mean(axis=0), np.ptp(points, axis=0), points.astype(np.float32), 0.9)


def test_changes_are_counted_by_object_with_what_no_survey_could_tell_left_out():
    box = {"box": [0.6, 0.6, 0.6], "surface": "crate"}
    old = [Solid(name="a", xyz=[0, 0, 0.3], **box), Solid(name="b", xyz=[3, 0, 0.3], **box)]
    new = [Solid(name="b", xyz=[6, 0, 0.3], **box), Solid(name="c", xyz=[9, 0, 0.3], **box)]
    before, after = (World(solids=solids, surfaces={"crate": Surface()}) for solids in (old, new))
    assert sorted((kind, s.name) for kind, s in changed_solids(before, after)) == [
        ("appeared", "b"),
        ("appeared", "c"),
        ("vanished", "a"),
        ("vanished", "b"),
    ]
    everything = [changed("vanished", s) for s in old] + [changed("appeared", s) for s in new]
    points = [
        np.vstack([thing.points for thing in everything if thing.kind == kind]) for kind in ("vanished", "appeared")
    ]
    # Rays along x from the left and the right pass all places but that of "c", which nobody has seen free.
    ends = np.stack(np.meshgrid([7.5], np.arange(-0.5, 0.6, 0.1), np.arange(0.0, 0.7, 0.1)), -1).reshape(-1, 3)
    rays = [Rays(end - [9.0, 0, 0], end[None].astype(np.float32), 0.0) for end in ends]
    views = tuple(View(p, make_seen_space(rays)) for p in points)
    summary = UpdateSummary(True, "", 1, 1, None, {"not seen again": 3}, {}, {}, 0.0, 0.0)

    metrics = change_metrics((before, after), views, summary, everything[:3])
    assert (metrics["changes_visible"], metrics["changes_found"], metrics["changes_right"]) == (3, 3, 3)
    assert metrics["points_not_seen_again"] == 3
    # The same reported as the other kind is wrong, and one that is not reported is missed.
    swapped = [ChangedObject("appeared", t.centre, t.extent, t.points, 0.9) for t in everything[:1]]
    metrics = change_metrics((before, after), views, summary, [*swapped, everything[1]])
    assert metrics["changes_precision"] == pytest.approx(1 / 2)
    assert metrics["changes_recall"] == pytest.approx(1 / 3)


def test_the_hall_and_the_hall_later_differ_by_ten_moves_five_arrivals_and_five_departures():
    solids = changed_solids(load_world("stair_hall", 0), load_world("stair_hall_later", 0))
    assert sum(kind == "appeared" for kind, _ in solids) == sum(kind == "vanished" for kind, _ in solids) == 15
    distance = box_distance(solids[0][1], np.array([solids[0][1].xyz, [100.0, 0, 0]]))
    assert distance[0] == 0
    assert distance[1] > 80
