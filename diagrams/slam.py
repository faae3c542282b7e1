"""SLAM as a part of missions: classes of points, scan matching, pose graph, and the maps that follow it."""

from dataclasses import dataclass, field

import numpy as np
from naraha.systems.point_classes import PointClasses, PointClassesConfig
from naraha.systems.pose_graph import PlaceRecognition, PoseGraphConfig, PoseGraphSlam
from naraha.systems.registration.coarse import describe_place, find_pose, place_distance
from naraha.systems.slam import KeyframePoses, ScanMatcher, ScanMatcherConfig, SurveyMap, SurveyMapConfig
from naraha.systems.voxel_map import OccupancyMap, OccupancyMapConfig, write_octomap
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder, System

from .mission import Mission
from .wiring import DiagramReader, connect


@dataclass(kw_only=True)
class SlamStages:
    """The stages from scans to maps; null leaves one out."""

    # Classes of the points of every scan, which registration and loops use.
    point_classes: PointClassesConfig | None = field(default_factory=PointClassesConfig)
    # Registration that steers the robot and makes the map.
    slam: ScanMatcherConfig = field(default_factory=ScanMatcherConfig)
    # Loops, and the poses that follow from them; null leaves every keyframe where it was registered.
    pose_graph: PoseGraphConfig | None = field(default_factory=PoseGraphConfig)
    # A second registration, for comparison only.
    baseline: ScanMatcherConfig | None = None
    survey_map: SurveyMapConfig = field(default_factory=SurveyMapConfig)
    # Free and occupied space.
    occupancy: OccupancyMapConfig | None = field(default_factory=OccupancyMapConfig)


def add_matching(
    builder: DiagramBuilder,
    stages: SlamStages,
    scans: System,
    *,
    odometry: System | None = None,
    X_BS: RigidTransform | None = None,
    X_MB0: RigidTransform | None = None,
) -> System:
    """Adds `point_classes`, `slam`, `pose_graph` and `baseline`, and returns `slam`.

    Args:
        scans: has the output port `scan_S`. odometry: has `X_OB`; scans are matched without it when not given.
        X_BS: pose of the sensor in the base. X_MB0: pose of the base in the map at the start.
    """
    with_odometry = odometry is not None
    matcher = ScanMatcher(
        stages.slam,
        X_BS=X_BS,
        X_MB0=X_MB0,
        with_odometry=with_odometry,
        with_corrections=stages.pose_graph is not None,
        with_classes=stages.point_classes is not None,
    )
    slam = builder.AddNamedSystem("slam", matcher)
    matchers = [slam]
    if stages.point_classes is not None:
        classes = builder.AddNamedSystem("point_classes", PointClasses(stages.point_classes))
        connect(builder, scans, "scan_S", classes)
        connect(builder, classes, "class_model", slam)
    if stages.pose_graph is not None:
        graph = PoseGraphSlam(stages.pose_graph, recognition=recognise_places())
        builder.AddNamedSystem("pose_graph", graph)
        connect(builder, slam, "keyframe", graph)
        connect(builder, graph, "keyframe_poses", slam)
    if stages.baseline is not None:
        baseline = ScanMatcher(stages.baseline, X_BS=X_BS, X_MB0=X_MB0, with_odometry=with_odometry)
        matchers.append(builder.AddNamedSystem("baseline", baseline))
    for system in matchers:
        connect(builder, scans, "scan_S", system)
    if odometry is not None:
        for system in matchers:
            connect(builder, odometry, "X_OB", system)
    return slam


def add_maps(
    builder: DiagramBuilder, stages: SlamStages, keyframes: System, *, p_BS: np.ndarray | None = None
) -> System:
    """Adds `survey_map` and `occupancy`, which follow `pose_graph` where there is one, and returns `survey_map`.

    Args:
        keyframes: has the output port `keyframe`. p_BS: position of the sensor in the base (3,) [m].
    """
    with_corrections = stages.pose_graph is not None
    maps = [builder.AddNamedSystem("survey_map", SurveyMap(stages.survey_map, with_corrections=with_corrections))]
    if stages.occupancy is not None:
        occupancy = OccupancyMap(stages.occupancy, p_BS=p_BS, with_corrections=with_corrections)
        maps.append(builder.AddNamedSystem("occupancy", occupancy))
    for system in maps:
        connect(builder, keyframes, "keyframe", system)
        if with_corrections:
            connect(builder, builder.GetSubsystemByName("pose_graph"), "keyframe_poses", system)
    return maps[0]


def slam_metrics(log: DiagramReader) -> dict[str, float]:
    """Counts of loops and voxels, and whether the pose graph agrees with itself."""
    metrics: dict[str, float] = {}
    if log.diagram.HasOutputPort("pose_graph.health"):
        health = log.read("pose_graph.health")
        metrics |= {
            "loops_accepted": health.loops_accepted,
            "loops_refused": health.loops_refused,
            "pose_graph_misfit": health.misfit,
        }
    if log.diagram.HasOutputPort("occupancy.voxel_map"):
        voxels = log.read("occupancy.voxel_map")
        metrics |= {"voxels_known": len(voxels.known()[1]), "voxels_occupied": len(voxels.occupied())}
    return metrics


def final_poses(log: DiagramReader) -> KeyframePoses:
    """Where the keyframes are after a last optimisation over all of them; without pose graph, nothing is known."""
    if not log.diagram.HasOutputPort("pose_graph.batch_poses"):
        return KeyframePoses()
    poses: KeyframePoses = log.read("pose_graph.batch_poses")
    return poses


def write_occupancy(mission: Mission, log: DiagramReader) -> None:
    """Writes `survey_map.bt` (free or occupied) and `survey_map.ot` (log-odds), which OctoMap reads."""
    if log.diagram.HasOutputPort("occupancy.voxel_map"):
        voxels = log.read("occupancy.voxel_map")
        for name in ("survey_map.bt", "survey_map.ot"):
            write_octomap(mission.path(name), voxels)


def recognise_places() -> PlaceRecognition:
    """How a pose graph knows places again when the poses do not say where the robot may be."""
    return PlaceRecognition(describe_place, place_distance, _align)


def _align(source: PointCloud, target: PointCloud) -> RigidTransform | None:
    found = find_pose(source, target)
    return None if not found or found[0].ambiguous else found[0].X_TS
