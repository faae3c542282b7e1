"""Tracking a pose through a sequence of scans, as one function from state to state."""

import dataclasses
import math
from dataclasses import dataclass, field, replace

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform

from ..clouds import VoxelCloud
from ..config import quantity
from ..point_classes import ClassCounts, ClassModel, class_probabilities, fit_class_model
from ..registration import (
    Registration,
    RegistrationConfig,
    Target,
    covariance_at,
    placed,
    prepare_target,
    register,
)
from ..sensing import Scan, deskew
from ..sensing.deskew import rotation_vector
from .keyframe import NO_KEYFRAME, Keyframe, KeyframePoses, PoseHealth
from .motion import distance_and_angle, scale_motion
from .odometry_accuracy import OdometryAccuracy, odometry_covariance

REFERENCES = ("local_map", "previous_keyframe")
# Attribute of clouds that registration uses besides positions, see `point_classes`.
CLASSES = "class_probabilities"
GUESSES = ("constant_velocity", "none")
# Without odometry a gap in the scans is bridged with the last velocity for at most this many times the last step.
_MAX_EXTRAPOLATION = 3.0
# A robot that moves less than this during a scan stands still [m], [rad].
_REST_DISTANCE, _REST_ANGLE = 0.002, 0.002


@dataclass(kw_only=True)
class ScanMatcherConfig:
    """Scan matching with keyframes. The defaults serve a LiDAR of 16 lines or more, in and around buildings."""

    # [s] Interval at which a new scan is looked for; that of the LiDAR or shorter.
    period: float = quantity(0.1, unit="s", above=0)
    # What a scan is registered to: the last keyframes together, or the chain of S0-g.
    reference: str = quantity("local_map", choices=REFERENCES)
    # Where a scan is first looked for when there is no odometry: moved on at the last velocity, or where the last was.
    guess: str = quantity("constant_velocity", choices=GUESSES)
    # [keyframes] How many of the last make the local map.
    local_map_keyframes: int = quantity(10, unit="keyframes", low=1)
    # [keyframes] How many of the others are added to it, oldest first among those about as near: where the robot has
    # been before, scans are matched to what was mapped then, and drift ends.
    revisited_keyframes: int = quantity(5, unit="keyframes", low=0)
    # [m] Only those that were taken within this distance.
    revisit_distance: float = quantity(4.0, unit="m", low=0)
    # [m] Grid of the local map.
    local_map_voxel: float = quantity(0.15, unit="m", above=0)
    # [m], [deg] Motion since the last scan of the local map from which on another is added to it. With odometry, scans
    # below it are not registered, because registration is what costs; without odometry, all are, and all are keyframes.
    keyframe_distance: float = quantity(0.5, unit="m", low=0)
    keyframe_angle_deg: float = quantity(15.0, unit="deg", low=0)
    # [s] With odometry, a robot that has moved more than `rest_distance` or `rest_angle_deg` is registered at the
    # latest after this time: on slopes tracks slide in ways that odometry cannot tell. Null waits for the motion above.
    max_wait: float | None = quantity(None, unit="s", above=0)
    # [m], [deg] With odometry, a robot that has come to rest after a smaller motion than that, but larger than this, is
    # registered once more: tracks say little of a turn, and what cameras see at rest is laid on that keyframe.
    rest_distance: float = quantity(0.03, unit="m", low=0)
    rest_angle_deg: float = quantity(1.0, unit="deg", low=0)
    # [deg] With odometry, a scan during which roll and pitch change by more than this is passed over for a calm one,
    # for at most another `keyframe_distance` of way: while a robot tips over an edge, odometry that is a few
    # hundredths of a second late is off by degrees, and the map would follow it from then on.
    max_swing_deg: float = quantity(1.5, unit="deg", above=0)
    # [m] Keyframe clouds are thinned to this grid.
    keyframe_voxel: float = quantity(0.1, unit="m", above=0)
    # [m] Points nearer than `min_range` are the robot itself, points beyond `max_range` are not trusted.
    min_range: float = quantity(0.3, unit="m", low=0)
    max_range: float = quantity(150.0, unit="m", above=0)
    # [failures] The scan that fails as the n-th in a row is placed by dead reckoning, as a keyframe with health 0, and
    # a new local map starts there, so that the survey goes on behind a place that cannot be matched.
    max_failures: int = quantity(5, unit="failures", low=1)
    # How far odometry is trusted along motions that a registration leaves open.
    odometry: OdometryAccuracy = field(default_factory=OdometryAccuracy)
    # Turns of `retry_yaws_deg` are only tried without odometry.
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)


@dataclass(frozen=True, eq=False)
class Track:
    """Abstract state of the tracker; read-only, so that Drake may share it instead of copying it at every update.

    Attributes:
        X_MB, X_OB, time: pose last measured, the odometry then (None without odometry), and when.
        step, step_time: motion and time between the last two measured poses, for tracking without odometry.
        tried_at: pose at the last attempt to make a keyframe, in O with odometry, else in M.
        last_index: `Scan.index` last seen.
        keyframe: the latest one.
        mapped: keyframes that the local map is taken from.
        target: the local map in M, prepared for registration.
        failures: attempts that failed in a row.
        poses_version: of the corrections that are applied, see `correct_track`.
    """

    X_MB: RigidTransform
    X_OB: RigidTransform | None = None
    time: float = 0.0
    step: RigidTransform = field(default_factory=RigidTransform)
    step_time: float = math.inf
    tried_at: RigidTransform = field(default_factory=RigidTransform)
    last_index: int = -1
    keyframe: Keyframe = NO_KEYFRAME
    mapped: tuple[Keyframe, ...] = ()
    target: Target | None = None
    failures: int = 0
    poses_version: int = 0
    health: PoseHealth = PoseHealth(False, 0.0, "no scan yet", 0.0, 0, 0)

    def __deepcopy__(self, memo: dict) -> "Track":
        return self

    @property
    def X_MO(self) -> RigidTransform:
        """Pose of the odometry frame in the map, as of the last measured pose; identity without odometry."""
        return RigidTransform() if self.X_OB is None else self.X_MB @ self.X_OB.inverse()


def track_scan(
    track: Track,
    scan: Scan,
    X_BS: RigidTransform,
    config: ScanMatcherConfig,
    X_OB_start_end: tuple[RigidTransform, RigidTransform] | None = None,
    class_model: ClassModel | None = None,
) -> Track:
    """Takes in one scan: skips it, lets it pass, or registers it and perhaps makes it a keyframe.

    Args:
        X_OB_start_end: odometry at the start and end of the scan; None without odometry.
        class_model: gives the points of a scan that is registered their `class_probabilities`; None does without.
    """
    if scan.index == track.last_index or scan.index < 0:
        return track
    track = replace(track, last_index=scan.index)
    X_OB: RigidTransform | None = None
    if X_OB_start_end is not None:
        X_OB0, X_OB = X_OB_start_end
        X_BB0 = X_OB.inverse() @ X_OB0
        guess = track.X_MO @ X_OB
    else:
        moving = config.guess == "constant_velocity"
        guess = track.X_MB @ _predicted_step(track, scan.end_time) if moving else track.X_MB
        X_BB0 = _predicted_step(track, track.time + scan.end_time - scan.start_time).inverse()
    if (usable := int(_usable(scan.p_SP, config).sum())) < config.registration.min_points:
        return _skip(track, f"scan {scan.index} has {usable} usable points, needs {config.registration.min_points}")
    if track.target is None:
        first = placed(guess, usable)
        cloud_S = prepare_cloud(scan, X_BS, X_BB0, config, class_model)
        return _accept(track, scan, cloud_S, X_BS, first, X_OB, config)
    sweep = scan.end_time > scan.start_time
    if X_OB is not None and (
        _swings(track, X_OB, X_BB0, config)
        or not (
            _moved(track.tried_at, X_OB, config)
            or _waited(track, scan.end_time, X_OB, config)
            or (sweep and _came_to_rest(track, X_OB, X_BB0, config))
        )
    ):
        return replace(track, health=replace(track.health, scans_used=track.health.scans_used + 1))
    cloud_S = prepare_cloud(scan, X_BS, X_BB0, config, class_model)
    result = _register(track, cloud_S, X_BS, guess, X_OB, config)
    if result.valid:
        return _accept(track, scan, cloud_S, X_BS, result, X_OB, config)
    track = _skip(track, f"scan {scan.index}: {result.reason}")
    track = replace(track, failures=track.failures + 1, tried_at=guess if X_OB is None else X_OB)
    if track.failures < config.max_failures:
        return track
    # Lost: go on from where dead reckoning says, on a map of its own.
    lost = _accept(replace(track, mapped=()), scan, cloud_S, X_BS, result, X_OB, config)
    reason = f"{track.health.reason}; new local map by dead reckoning after {track.failures} failures"
    return replace(lost, health=replace(track.health, reason=reason))


def correct_track(track: Track, poses: KeyframePoses, config: ScanMatcherConfig) -> Track:
    """Moves the keyframes, and with the last one the robot, to where a pose graph has found them to be."""
    if poses.version == track.poses_version:
        return track
    mapped = poses.moved(track.mapped)
    (keyframe,) = poses.moved((track.keyframe,))
    X_MM = keyframe.X_MB @ track.keyframe.X_MB.inverse()
    target = _target(choose_keyframes(mapped, config), config) if mapped else track.target
    corrected = replace(track, mapped=mapped, keyframe=keyframe, target=target, X_MB=X_MM @ track.X_MB)
    # Without odometry the last attempt is noted in M.
    tried_at = X_MM @ track.tried_at if track.X_OB is None else track.tried_at
    return replace(corrected, tried_at=tried_at, poses_version=poses.version)


def prepare_cloud(
    scan: Scan,
    X_BS: RigidTransform,
    X_BB0: RigidTransform,
    config: ScanMatcherConfig,
    class_model: ClassModel | None = None,
) -> PointCloud:
    """De-skews a scan to its end, in the sensor frame, and gives its points their classes.

    Args:
        X_BB0: pose of the base at the start of the scan in the base at its end.
        class_model: None gives no classes. A model that has not learnt yet is replaced by one of this scan.
    """
    usable = _usable(scan.p_SP, config)
    points = scan.p_SP[usable]
    times, duration = scan.attribute("time"), scan.end_time - scan.start_time
    if times is not None and duration > 0:
        fraction = np.clip(times[usable] / duration, 0, 1)
        X_S0S1 = X_BS.inverse() @ X_BB0.inverse() @ X_BS
        points = deskew(points, fraction, X_S0S1.GetAsMatrix4())
    cloud = scan.cloud_S.select_by_mask(o3d.core.Tensor(usable))
    if class_model is not None:
        model = class_model if class_model.scans else fit_class_model(ClassCounts().add(cloud))
        cloud.point[CLASSES] = o3d.core.Tensor(class_probabilities(cloud, model))
    cloud.point.positions = o3d.core.Tensor(np.ascontiguousarray(points, np.float32))
    return cloud


def choose_keyframes(mapped: tuple[Keyframe, ...], config: ScanMatcherConfig) -> tuple[Keyframe, ...]:
    """The last keyframes, and before them the nearest of the others to the last one, see `ScanMatcherConfig`."""
    recent, others = mapped[-config.local_map_keyframes :], mapped[: -config.local_map_keyframes]
    here = mapped[-1].X_MB.translation()
    distances = [float(np.linalg.norm(keyframe.X_MB.translation() - here)) for keyframe in others]
    near = [i for i, distance in enumerate(distances) if distance <= config.revisit_distance]
    near.sort(key=lambda i: (distances[i] // (0.25 * config.revisit_distance or 1.0), i))
    return (*(others[i] for i in sorted(near[: config.revisited_keyframes])), *recent)


def local_map(keyframes: tuple[Keyframe, ...], config: ScanMatcherConfig) -> PointCloud:
    """The clouds of `keyframes` in one, in M, thinned, with their classes."""
    voxels = VoxelCloud(config.local_map_voxel)
    for keyframe in keyframes:
        bare = PointCloud(keyframe.cloud_B.point.positions)
        if CLASSES in keyframe.cloud_B.point:
            bare.point[CLASSES] = keyframe.cloud_B.point[CLASSES]
        voxels = voxels.insert(bare, keyframe.X_MB.GetAsMatrix4())
    return voxels.to_cloud()


def _target(keyframes: tuple[Keyframe, ...], config: ScanMatcherConfig) -> Target:
    return prepare_target(local_map(keyframes, config), config.registration)


def _usable(points: np.ndarray, config: ScanMatcherConfig) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.einsum("ij,ij->i", points, points)
        return (squares >= config.min_range**2) & (squares <= config.max_range**2)  # False for NaN


def _predicted_step(track: Track, time: float) -> RigidTransform:
    """Motion from the last measured pose to `time` at the velocity of the last step."""
    ratio = (time - track.time) / track.step_time
    return scale_motion(track.step, float(np.clip(ratio, 0, _MAX_EXTRAPOLATION)))


def _moved(X_AB: RigidTransform, X_AC: RigidTransform, config: ScanMatcherConfig) -> bool:
    distance, angle = distance_and_angle(X_AB.inverse() @ X_AC)
    return distance >= config.keyframe_distance or angle >= np.deg2rad(config.keyframe_angle_deg)


def _swings(track: Track, X_OB: RigidTransform, X_BB0: RigidTransform, config: ScanMatcherConfig) -> bool:
    """Whether the robot tips so fast that it is better to wait for the next scan, and there is still time to wait."""
    swing = float(np.hypot(*rotation_vector(X_BB0.rotation().matrix())[:2]))
    distance, _ = distance_and_angle(track.tried_at.inverse() @ X_OB)
    return swing > np.deg2rad(config.max_swing_deg) and distance < 2 * config.keyframe_distance


def _came_to_rest(track: Track, X_OB: RigidTransform, X_BB0: RigidTransform, config: ScanMatcherConfig) -> bool:
    """Whether the robot stood still during the scan, but has moved since the last attempt."""
    distance, angle = distance_and_angle(X_BB0)
    if distance > _REST_DISTANCE or angle > _REST_ANGLE:
        return False
    return _stirred(track, X_OB, config)


def _waited(track: Track, time: float, X_OB: RigidTransform, config: ScanMatcherConfig) -> bool:
    """Whether the last measured pose is old, and the robot has moved since the last attempt."""
    if config.max_wait is None or time - track.time < config.max_wait - 1e-9:
        return False
    return _stirred(track, X_OB, config)


def _stirred(track: Track, X_OB: RigidTransform, config: ScanMatcherConfig) -> bool:
    distance, angle = distance_and_angle(track.tried_at.inverse() @ X_OB)
    return distance >= config.rest_distance or angle >= np.deg2rad(config.rest_angle_deg)


def _register(
    track: Track,
    cloud_S: PointCloud,
    X_BS: RigidTransform,
    guess: RigidTransform,
    X_OB: RigidTransform | None,
    config: ScanMatcherConfig,
) -> Registration:
    """The pose X_MB. The cloud stays in the sensor's frame: a range image is seen from its origin."""
    assert track.target is not None
    target, X_SB = track.target, X_BS.inverse()
    if X_OB is not None:
        assert track.X_OB is not None
        R = np.kron(np.eye(2), guess.rotation().matrix())
        at_base = R @ odometry_covariance(track.X_OB.inverse() @ X_OB, config.odometry) @ R.T
        covariance = covariance_at(at_base, guess.rotation().matrix() @ X_BS.translation())
        without_turns = dataclasses.replace(config.registration, retry_yaws_deg=[])
        return register(cloud_S, target, guess @ X_BS, without_turns, covariance).at(X_SB)
    result = register(cloud_S, target, guess @ X_BS, config.registration)
    if config.guess != "none" and not (result.valid and result.fitness >= config.registration.retry_fitness):
        again = register(cloud_S, target, track.X_MB @ X_BS, config.registration)
        result = max(result, again, key=lambda one: (one.valid, one.fitness))
    return result.at(X_SB)


def _accept(
    track: Track,
    scan: Scan,
    cloud_S: PointCloud,
    X_BS: RigidTransform,
    result: Registration,
    X_OB: RigidTransform | None,
    config: ScanMatcherConfig,
) -> Track:
    used = track.health.scans_used + 1
    health = PoseHealth(True, result.health, result.reason, scan.end_time, used, track.health.scans_skipped)
    cloud_B = VoxelCloud(config.keyframe_voxel).insert(cloud_S, X_BS.GetAsMatrix4()).to_cloud()
    X_PB = track.keyframe.X_MB.inverse() @ result.X_TS if track.keyframe.index >= 0 else None
    keyframe = Keyframe(scan.index, scan.end_time, result.X_TS, X_OB, cloud_B, result.health, X_PB, result.covariance)
    elapsed = scan.end_time - track.time
    measured_before = track.target is not None and track.failures == 0 and elapsed > 0
    accepted = replace(
        track,
        X_MB=result.X_TS,
        X_OB=X_OB,
        time=scan.end_time,
        step=track.X_MB.inverse() @ result.X_TS if measured_before else RigidTransform(),
        step_time=elapsed if measured_before else math.inf,
        tried_at=result.X_TS if X_OB is None else X_OB,
        failures=0,
        keyframe=keyframe,
        health=health,
    )
    if config.reference == "previous_keyframe":
        return replace(accepted, mapped=(keyframe,), target=_target((keyframe,), config))
    if track.mapped and not _moved(track.mapped[-1].X_MB, keyframe.X_MB, config):
        return accepted
    mapped = (*track.mapped, keyframe)
    return replace(accepted, mapped=mapped, target=_target(choose_keyframes(mapped, config), config))


def _skip(track: Track, reason: str) -> Track:
    skipped = track.health.scans_skipped + 1
    return replace(track, health=replace(track.health, valid=False, health=0.0, reason=reason, scans_skipped=skipped))
