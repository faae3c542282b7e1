"""Other people's registrations behind one signature: source cloud, target cloud, guess (4, 4) → pose (4, 4) of the
source in the target.

Each gets the raw clouds and does all of its own work: thinning, normals, search trees. Each runs on one thread if
OMP_NUM_THREADS is 1 (Open3D has no other switch). What is not installed is left out with a line that says so.
"""

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud

_o3d: Any = o3d.pipelines.registration
Matrix = np.ndarray
Peer = Callable[[PointCloud, PointCloud, Matrix], Matrix]
ITERATIONS = 50
# Share of geometry against colour of ColoredICP; its default of 0.968 makes next to no use of the colour.
GEOMETRY_SHARE = 0.5


def local_peers(voxel: float = 0.25, max_distance: float = 1.0) -> dict[str, Peer]:
    """Registrations that start at a guess.

    Args:
        voxel: [m] to which clouds are thinned. With 0.25 m small_gicp is as it is shipped; the other peers have no
            default. Finer is slower and on few rings not more exact: their 20 neighbours then lie on one ring.
        max_distance: [m] between partners at most.
    """
    peers: dict[str, Peer] = {
        "open3d_point_to_point": _open3d("point_to_point", voxel, max_distance),
        "open3d_point_to_plane": _open3d("point_to_plane", voxel, max_distance),
        "open3d_point_to_plane_tukey": _open3d("point_to_plane_tukey", voxel, max_distance),
        "open3d_gicp": _open3d("gicp", voxel, max_distance),
        "open3d_colored": _open3d("colored", voxel, max_distance),
    }
    small_gicp = _imported("small_gicp")
    if small_gicp is not None:
        for kind in ("ICP", "PLANE_ICP", "GICP", "VGICP"):
            peers[f"small_gicp_{kind.lower()}"] = _small_gicp(small_gicp, kind, voxel, max_distance)
        if voxel <= 0.1:
            peers["small_gicp_gicp_80_neighbours"] = _small_gicp_wide(small_gicp, voxel, max_distance)
    if _imported("kiss_icp") is not None:
        peers["kiss_icp"] = _kiss_icp(2 * voxel, max_distance)
    return peers


def global_peers(voxel: float = 0.25) -> dict[str, Peer]:
    """Registrations that need no guess; they are given one and do not look at it."""
    peers: dict[str, Peer] = {"open3d_fpfh_ransac": _fpfh_ransac(voxel), "open3d_fgr": _fast_global(voxel)}
    kiss_matcher = _imported("kiss_matcher")
    if kiss_matcher is not None:
        peers["kiss_matcher_20"] = _kiss_matcher(kiss_matcher, 0.2)
        peers["kiss_matcher_30"] = _kiss_matcher(kiss_matcher, 0.3)
    return peers


def _imported(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        print(f"{name} is not installed: left out")
        return None


def _points(cloud: PointCloud) -> np.ndarray:
    return cloud.point.positions.numpy().astype(float)


def _legacy(cloud: PointCloud) -> Any:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(_points(cloud)))


def _grey(cloud: PointCloud) -> np.ndarray:
    """(N, 3): the likeliest class as a shade of grey; intensity where there are no classes."""
    if "class_probabilities" in cloud.point:
        probabilities = cloud.point["class_probabilities"].numpy()
        shade = probabilities.argmax(axis=1) / max(probabilities.shape[1] - 1, 1)
    elif "intensity" in cloud.point:
        intensity = cloud.point["intensity"].numpy()[:, 0].astype(float)
        shade = np.clip(intensity / max(np.quantile(intensity, 0.98), 1e-9), 0, 1)
    else:
        shade = np.full(len(cloud.point.positions), 0.5)
    return np.repeat(shade[:, None], 3, axis=1)


def _open3d(kind: str, voxel: float, max_distance: float) -> Peer:
    around = o3d.geometry.KDTreeSearchParamHybrid(5 * voxel, 20)
    criteria = _o3d.ICPConvergenceCriteria(1e-6, 1e-6, ITERATIONS)

    def align(source: PointCloud, target: PointCloud, guess: Matrix) -> Matrix:
        clouds = [_legacy(source), _legacy(target)]
        if kind == "colored":
            for cloud, original in zip(clouds, (source, target), strict=True):
                cloud.colors = o3d.utility.Vector3dVector(_grey(original))
        p_S, p_T = (cloud.voxel_down_sample(voxel) for cloud in clouds)
        if kind != "point_to_point":
            p_T.estimate_normals(around)
        if kind in ("gicp", "colored"):
            p_S.estimate_normals(around)
        if kind == "gicp":
            method = _o3d.TransformationEstimationForGeneralizedICP()
            return _o3d.registration_generalized_icp(p_S, p_T, max_distance, guess, method, criteria).transformation
        if kind == "colored":
            method = _o3d.TransformationEstimationForColoredICP(lambda_geometric=GEOMETRY_SHARE)
            return _o3d.registration_colored_icp(p_S, p_T, max_distance, guess, method, criteria).transformation
        method = {
            "point_to_point": _o3d.TransformationEstimationPointToPoint,
            "point_to_plane": _o3d.TransformationEstimationPointToPlane,
            "point_to_plane_tukey": lambda: _o3d.TransformationEstimationPointToPlane(_o3d.TukeyLoss(3 * voxel)),
        }[kind]()
        return _o3d.registration_icp(p_S, p_T, max_distance, guess, method, criteria).transformation

    return align


def _small_gicp(small_gicp: Any, kind: str, voxel: float, max_distance: float) -> Peer:
    def align(source: PointCloud, target: PointCloud, guess: Matrix) -> Matrix:
        return small_gicp.align(
            _points(target),
            _points(source),
            init_T_target_source=guess,
            registration_type=kind,
            voxel_resolution=1.0,
            downsampling_resolution=voxel,
            max_correspondence_distance=max_distance,
            num_threads=1,
            max_iterations=ITERATIONS,
        ).T_target_source

    return align


def _small_gicp_wide(small_gicp: Any, voxel: float, max_distance: float) -> Peer:
    """GICP on a fine cloud whose covariances reach over more than one ring all the same: slow, and exact indoors."""

    def align(source: PointCloud, target: PointCloud, guess: Matrix) -> Matrix:
        prepare = {"downsampling_resolution": voxel, "num_neighbors": 80, "num_threads": 1}
        p_T, tree = small_gicp.preprocess_points(_points(target), **prepare)
        p_S, _ = small_gicp.preprocess_points(_points(source), **prepare)
        return small_gicp.align(
            p_T,
            p_S,
            tree,
            guess,
            registration_type="GICP",
            max_correspondence_distance=max_distance,
            num_threads=1,
            max_iterations=ITERATIONS,
        ).T_target_source

    return align


def _kiss_icp(voxel: float, max_distance: float) -> Peer:
    """The registration inside KISS-ICP, with the thinning of its pipeline; at home it meets a map of many scans."""
    from kiss_icp.config.parser import load_config
    from kiss_icp.mapping import get_voxel_hash_map
    from kiss_icp.registration import get_registration
    from kiss_icp.voxelization import voxel_down_sample

    config = load_config(None)
    config.mapping.voxel_size = voxel
    config.registration.max_num_threads = 1
    registration = get_registration(config)

    def align(source: PointCloud, target: PointCloud, guess: Matrix) -> Matrix:
        voxel_map = get_voxel_hash_map(config)
        voxel_map.update(voxel_down_sample(_points(target), 0.5 * voxel), np.eye(4))
        thinned = voxel_down_sample(_points(source), 1.5 * voxel)
        return registration.align_points_to_map(
            points=thinned,
            voxel_map=voxel_map,
            initial_guess=guess,
            max_correspondance_distance=max_distance,
            kernel=max_distance / 3,
        )

    return align


def _features(cloud: PointCloud, voxel: float) -> tuple[Any, Any]:
    thinned = _legacy(cloud).voxel_down_sample(voxel)
    thinned.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2 * voxel, 30))
    return thinned, _o3d.compute_fpfh_feature(thinned, o3d.geometry.KDTreeSearchParamHybrid(5 * voxel, 100))


def _fpfh_ransac(voxel: float) -> Peer:
    def align(source: PointCloud, target: PointCloud, guess: Matrix) -> Matrix:
        o3d.utility.random.seed(0)
        (p_S, features_S), (p_T, features_T) = _features(source, voxel), _features(target, voxel)
        return _o3d.registration_ransac_based_on_feature_matching(
            p_S,
            p_T,
            features_S,
            features_T,
            True,
            1.5 * voxel,
            _o3d.TransformationEstimationPointToPoint(False),
            3,
            [
                _o3d.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                _o3d.CorrespondenceCheckerBasedOnDistance(1.5 * voxel),
            ],
            _o3d.RANSACConvergenceCriteria(100_000, 0.999),
        ).transformation

    return align


def _fast_global(voxel: float) -> Peer:
    option = _o3d.FastGlobalRegistrationOption(maximum_correspondence_distance=0.5 * voxel)

    def align(source: PointCloud, target: PointCloud, guess: Matrix) -> Matrix:
        o3d.utility.random.seed(0)
        (p_S, features_S), (p_T, features_T) = _features(source, voxel), _features(target, voxel)
        return _o3d.registration_fgr_based_on_feature_matching(p_S, p_T, features_S, features_T, option).transformation

    return align


def _kiss_matcher(kiss_matcher: Any, voxel: float) -> Peer:
    def align(source: PointCloud, target: PointCloud, guess: Matrix) -> Matrix:
        matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(voxel_size=voxel))
        found = matcher.estimate(_points(source).astype(np.float32), _points(target).astype(np.float32))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.asarray(found.rotation), np.ravel(found.translation)
        return pose

    return align
