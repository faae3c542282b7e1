"""Two views of one place, laid on each other without a guess."""

from itertools import combinations

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.viewpoints.joint_registration import register_jointly
from naraha.systems.viewpoints.place_search import PlaceSearchConfig, find_pose, search_place
from naraha.systems.viewpoints.viewpoint import Viewpoint
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from tests.viewpoints.viewpoints import box_room, cloud_of, errors, take_views

icp = o3d.pipelines.registration


@pytest.fixture(scope="module")
def hall():
    clouds, poses, _ = take_views(0, revolutions=3)
    return [Viewpoint(cloud) for cloud in clouds], poses


@pytest.mark.parametrize("pair", [(0, 1), (0, 3), (1, 2), (3, 4)])
def test_views_metres_apart_are_found_from_nothing(hall, pair):
    views, X_WV = hall
    i, j = pair
    best, *others = search_place(views[j], views[i])
    distance, angle = errors(best.X_TS, X_WV[i].inverse() @ X_WV[j])
    assert distance < 0.2
    assert angle < 0.5
    assert best.score > 0.2
    assert best.denied < 0.02
    assert all(best.score - other.score > 0.15 for other in others)


def test_the_hall_turned_by_180_degrees_is_denied_by_what_stands_inside(hall):
    views, X_WV = hall
    half_turn = RigidTransform(RollPitchYaw(0, 0, np.pi), np.zeros(3))
    for i, j in combinations(range(5), 2):
        right = views[i].agreement(views[j], X_WV[i].inverse() @ X_WV[j])
        wrong = views[i].agreement(views[j], X_WV[i].inverse() @ half_turn @ X_WV[j])
        assert right.agreed > 0.2
        assert right.denied < 0.01 < wrong.denied


def test_an_empty_rectangle_fits_in_two_ways_and_a_crate_decides():
    rng = np.random.default_rng(0)
    for crate in (False, True):
        a, X_WA = box_room(rng, p=(-2.0, 0.5), yaw=0.3, crate=crate)
        b, X_WB = box_room(rng, p=(1.5, -1.0), yaw=2.0, crate=crate)
        found = find_pose(cloud_of(b), cloud_of(a))
        lead = found[0].score - found[1].score
        if crate:
            assert errors(found[0].X_TS, X_WA.inverse() @ X_WB)[0] < 0.02
            assert lead > 0.1
        else:
            assert found[1].score > 0.5
            assert lead < 0.05


def test_opposite_faces_of_a_wall_do_not_agree():
    rng = np.random.default_rng(1)
    points, _ = box_room(rng)
    view = Viewpoint(cloud_of(points))
    assert view.agreement(view, RigidTransform()).agreed == 1.0
    # The room next door shares the wall at y = 3 m, seen from its other side.
    next_door = view.agreement(view, RigidTransform([0.0, 6.0, 0.0]))
    assert next_door.agreed < 0.05


def test_floor_and_tilt_are_found():
    clouds, X_WV, _ = take_views(0, places=[(-8.0, -5.0)], revolutions=1, tilt_deg=2.0)
    view = Viewpoint(clouds[0])
    truth = float(np.arccos(X_WV[0].rotation().matrix()[2, 2]))
    assert view.floor == pytest.approx(-0.30, abs=0.02)
    assert view.tilt == pytest.approx(truth, abs=np.deg2rad(0.1))


@pytest.mark.parametrize(
    ("points", "problem"),
    [
        (np.zeros((0, 3)), "0 usable voxels"),
        (np.full((5000, 3), np.nan), "0 usable voxels"),
        (np.random.default_rng(0).uniform(-3, 3, (5000, 3)) * [1, 1, 0], "voxels of walls and objects"),
    ],
)
def test_a_view_that_cannot_be_used_says_why_and_is_not_searched(points, problem):
    rng = np.random.default_rng(0)
    room, _ = box_room(rng)
    assert problem in Viewpoint(cloud_of(points)).problem
    assert find_pose(cloud_of(points), cloud_of(room)) == ()
    assert find_pose(cloud_of(room), cloud_of(points)) == ()


def test_joint_registration_holds_the_first_view_and_finds_the_rest(hall):
    views, X_WV = hall
    true = {k: X_WV[0].inverse() @ X_WV[k] for k in range(5)}
    rng = np.random.default_rng(2)
    start = {
        k: X if k == 0 else X @ RigidTransform(RollPitchYaw(rng.normal(0, 0.003, 3)), rng.normal(0, 0.05, 3))
        for k, X in true.items()
    }
    result = register_jointly(dict(enumerate(views)), start, list(combinations(range(5), 2)))
    assert result.poses[0].IsNearlyIdentity(1e-12)
    for k in range(1, 5):
        distance, angle = errors(result.poses[k], true[k])
        assert distance < 0.03
        assert angle < 0.1
        deviations = np.sqrt(np.diag(result.covariances[k]))
        assert (deviations > 1e-5).all()
        assert (deviations < 0.02).all()


def fpfh_pose(source, target, method):
    """The usual way: FPFH features, RANSAC or FGR over their matches, point-to-plane ICP. X_TS (4, 4)."""
    clouds, features = [], []
    for cloud in (source, target):
        legacy = cloud.to_legacy().voxel_down_sample(0.3)
        legacy.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(0.9, 30))
        legacy.orient_normals_towards_camera_location(np.zeros(3))
        clouds.append(legacy)
        features.append(icp.compute_fpfh_feature(legacy, o3d.geometry.KDTreeSearchParamHybrid(1.5, 100)))
    o3d.utility.random.seed(0)
    if method == "ransac":
        checks = [
            icp.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            icp.CorrespondenceCheckerBasedOnDistance(0.45),
        ]
        rough = icp.registration_ransac_based_on_feature_matching(
            *clouds,
            *features,
            True,
            0.45,
            icp.TransformationEstimationPointToPoint(False),
            3,
            checks,
            icp.RANSACConvergenceCriteria(100000, 0.999),
        )
    else:
        option = icp.FastGlobalRegistrationOption(maximum_correspondence_distance=0.3)
        rough = icp.registration_fgr_based_on_feature_matching(*clouds, *features, option)
    fine = icp.registration_icp(
        *clouds, 0.5, rough.transformation, icp.TransformationEstimationPointToPlane(icp.TukeyLoss(0.2))
    )
    return fine.transformation


@pytest.mark.slow
def test_more_pairs_are_found_than_with_fpfh_and_ransac_or_fgr():
    right = {"ours": 0, "ransac": 0, "fgr": 0}
    pairs = 0
    for seed in range(5):
        clouds, X_WV, _ = take_views(seed)
        views = [Viewpoint(cloud) for cloud in clouds]
        for i, j in combinations(range(5), 2):
            truth = X_WV[i].inverse() @ X_WV[j]
            found = search_place(views[j], views[i], PlaceSearchConfig())
            guesses = {"ours": found[0].X_TS if found else RigidTransform()}
            for method in ("ransac", "fgr"):
                X = fpfh_pose(clouds[j], clouds[i], method)
                guesses[method] = RigidTransform(X[:3, 3]) if not np.isfinite(X).all() else _rigid(X)
            pairs += 1
            for name, X in guesses.items():
                distance, angle = errors(X, truth)
                right[name] += distance < 0.5 and angle < 5
    print(f"\nright of {pairs} pairs: {right}")
    assert right["ours"] >= 0.9 * pairs
    assert right["ours"] > max(right["ransac"], right["fgr"])


def _rigid(X):
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(X[:3, :3]), X[:3, 3])
