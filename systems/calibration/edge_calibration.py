"""Extrinsic calibration of a camera without targets: edges of depth images against edges of the camera's images."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform
from scipy import ndimage

from ..config import check_config, quantity
from ..errors import CameraError
from ..sensing.camera_model import CameraModel
from .edge_matching import EdgeMatcher, EdgeProblem, information_of, piece_weight
from .edge_points import SpaceEdges, image_edges, space_edges
from .pose_fit import (
    Calibration,
    HoldConfig,
    change_between,
    changed,
    covariance_of,
    head_rotations,
    held_directions,
    unfitted,
    unheld_in_words,
)

_BINS = 6  # directions of edges that the first search tells apart


@dataclass(kw_only=True)
class EdgeCalibrationConfig:
    """How edges are found and matched. The defaults serve a depth camera like the D415."""

    # [m], [1/m] Depths of neighbouring pixels that differ by more than min_jump + jump_per_z2 z² make an edge; the
    # second is six times 0.0032, the noise of a D415.
    min_jump: float = quantity(0.1, unit="m", above=0)
    jump_per_z2: float = quantity(0.02, unit="1/m", low=0)
    # [px] Width of the Gaussian that smooths images.
    blur_px: float = quantity(1.0, unit="px", low=0.5)
    # [-] Multiple of the noise that the gradient of an edge exceeds.
    noise_factor: float = quantity(6.0, unit="-", above=0)
    # [deg] The camera is first turned this far either way about both axes across its view, to look for a start.
    search_deg: float = quantity(4.0, unit="deg", low=0)
    # [starts] Number of best turns from which the fit is made.
    starts: int = quantity(3, unit="starts", low=1)
    # [deg] Farthest distance of matched edges in every stage of the fit; never less than two pixels.
    stages_deg: list[float] = quantity([1.5, 0.8, 0.4, 0.2], unit="deg", above=0)
    # [iterations] In every stage.
    iterations: int = quantity(12, unit="iterations", low=1)
    # [points] Edge points of the depth images are thinned to this number, in all views together.
    max_points: int = quantity(20000, unit="points", low=100)
    # [points], [pieces] At least this many are matched in the end, on this many straight pieces of edge.
    min_points: int = quantity(100, unit="points", low=6)
    min_pieces: int = quantity(8, unit="pieces", low=3)
    # [-] A second, different pose whose score is this part of the best one makes the result doubtful.
    max_ambiguity: float = quantity(0.9, unit="-", above=0, high=1)
    # [-] A result that differs from the guess by more than this many of its standard deviations, which `hold` states,
    # is taken for a wrong match.
    max_change: float = quantity(3.0, unit="-", above=0)
    # How well the guess is known; also the limit for a direction to count as measured.
    hold: HoldConfig = field(default_factory=HoldConfig)


@dataclass(frozen=True, eq=False)
class CalibrationView:
    """What both cameras saw while the robot stood still. Read-only.

    Attributes:
        depth: (H, W) [m], of the depth camera D; views with the same array share the search for its edges.
        image: (h, w), of the camera that is calibrated: brightness, temperature, or whatever has edges.
        pan_tilt: angles of the pan-tilt, pan left + and tilt down + [rad]; zero for a fixed camera.
        brightness: what D saw besides depth, such as reflectance, (H, W); its edges are used as well.
    """

    depth: np.ndarray
    image: np.ndarray
    pan_tilt: tuple[float, float] = (0.0, 0.0)
    brightness: np.ndarray | None = None

    def __deepcopy__(self, memo: dict) -> "CalibrationView":
        return self


def calibrate_from_views(
    views: Sequence[CalibrationView],
    depth_camera: CameraModel,
    camera: CameraModel,
    X_HC_guess: RigidTransform,
    *,
    X_DN: RigidTransform | None = None,
    config: EdgeCalibrationConfig | None = None,
) -> Calibration:
    """Pose of a camera in the head of its pan-tilt, or in the depth camera when it is fixed, without targets.

    Where a foreground ends in the depth image, the other camera's image has an edge too, most often. Straight pieces of
    such edges become points in space (`space_edges`); their distances from edges of similar direction in the images
    (`image_edges`), across those edges, are made small over X_HC for all views at once. First the camera is turned to
    and fro, and turns with many points near edges are starts. From each, the closest edge points are matched again and
    again (Gauss and Newton on SE(3), Cauchy's kernel), within a distance that shrinks stage by stage. The guess counts
    as a measurement with the standard deviations of `config.hold`, so what the edges do not say stays as it was
    guessed; `reason` names such directions, and says so when another pose fits almost as well.

    The covariance takes the errors along one straight piece of edge as alike, in all the views that show it. Errors of
    the intrinsics, of X_DN and of the pan-tilt are not in it.

    Raises:
        CameraError: an image does not fit its intrinsics.
        ConfigError: a value of the configuration is out of range.
    """
    config = config or EdgeCalibrationConfig()
    check_config(config)
    X_DN = X_DN or RigidTransform()

    def failed(reason: str) -> Calibration:
        return unfitted(X_HC_guess, X_DN, 6, config.hold, reason)

    if not views:
        return failed("no views")
    problem = _prepare(views, depth_camera, camera, X_HC_guess, X_DN, config)
    if len(problem.p_HP) < config.min_points:
        return failed(f"only {len(problem.p_HP)} points on depth edges in the views, needs {config.min_points}")
    if sum(len(edges.uv) for edges in problem.images) < config.min_points:
        return failed("hardly any edges in the images")
    matcher, scale = EdgeMatcher(problem), config.hold.scale(6)
    fits = []
    for start in _starts(problem, X_HC_guess, config):
        X_HC = _fit(matcher, start, X_HC_guess, config)
        unlikely = float(((change_between(X_HC_guess, X_HC) / scale) ** 2).sum()) / 2
        fits.append((matcher.score(X_HC) - unlikely, X_HC))
    fits.sort(key=lambda fit: -fit[0])
    best, X_HC = fits[0]
    match = matcher.match(X_HC, _stage_px(config, camera)[-1])
    pieces = len(np.unique(problem.group[match.point]))
    if len(match.point) < config.min_points or pieces < config.min_pieces:
        return failed(
            f"only {len(match.point)} points on {pieces} pieces of edge match, "
            f"needs {config.min_points} on {config.min_pieces}"
        )
    change = float((np.abs(change_between(X_HC_guess, X_HC)) / scale).max())
    if change > config.max_change:
        return failed(f"the best match is {change:.1f} standard deviations of the guess away from it")
    information = information_of(problem, match, scale)
    reasons = [unheld_in_words(*held_directions(information, scale))]
    for score, X_other in fits[1:]:
        change = np.abs(change_between(X_HC, X_other)) / scale
        if score > config.max_ambiguity * best and change.max() > 0.5:
            reasons.append(f"ambiguous: another pose fits {100 * score / best:.0f} % as well")
            break
    covariance = covariance_of(information + np.diag(scale**-2.0), scale)
    rms = float(np.sqrt(np.average(match.error**2, weights=match.weight)))
    return Calibration(X_HC, X_DN, covariance, rms, len(match.point), True, "; ".join(filter(None, reasons)))


def _prepare(
    views: Sequence[CalibrationView],
    depth_camera: CameraModel,
    camera: CameraModel,
    X_HC_guess: RigidTransform,
    X_DN: RigidTransform,
    config: EdgeCalibrationConfig,
) -> EdgeProblem:
    """Finds the edges, and chooses for every view the points that it may see."""
    known: dict[tuple[int, int], SpaceEdges] = {}
    images, parts = [], []
    R_NH = head_rotations(np.array([view.pan_tilt for view in views]))
    corners = camera.undistort(np.array([[0, 0], [camera.width - 1, 0], [0, camera.height - 1], camera.shape[::-1]]))
    reach = np.arctan(np.linalg.norm(corners, axis=1).max()) + np.deg2rad(config.search_deg + 2)
    groups = 0
    for i, view in enumerate(views):
        camera.check_image(view.image, "image")
        if not np.isfinite(view.image).all():
            raise CameraError("not finite", where="image", valid="numbers")
        images.append(image_edges(view.image, config.blur_px, config.noise_factor))
        key = (id(view.depth), id(view.brightness))
        if key not in known:
            edges = space_edges(
                view.depth,
                depth_camera,
                min_jump=config.min_jump,
                jump_per_z2=config.jump_per_z2,
                brightness=view.brightness,
            )
            known[key] = SpaceEdges(edges.p_DP, edges.t_DP, edges.group + groups)
            groups += edges.group.max(initial=-1) + 1
        edges = known[key]
        R_DH = X_DN.rotation().matrix() @ R_NH[i]
        p_HP = (edges.p_DP - X_DN.translation()) @ R_DH
        p_CP = (p_HP - X_HC_guess.translation()) @ X_HC_guess.rotation().matrix()
        seen = np.arctan2(np.linalg.norm(p_CP[:, :2], axis=1), p_CP[:, 2]) < reach
        parts.append((np.full(int(seen.sum()), i), p_HP[seen], (edges.t_DP @ R_DH)[seen], edges.group[seen]))
    nothing = (np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, int))
    view_index, p_HP, t_HP, group = (np.concatenate(column) for column in zip(nothing, *parts, strict=True))
    total = len(p_HP)
    if total > config.max_points:
        chosen = np.sort(np.random.default_rng(0).choice(total, config.max_points, replace=False))
        view_index, p_HP, t_HP, group = view_index[chosen], p_HP[chosen], t_HP[chosen], group[chosen]
    return EdgeProblem(camera, view_index, p_HP, t_HP, group, images)


def _starts(problem: EdgeProblem, X_HC_guess: RigidTransform, config: EdgeCalibrationConfig) -> list[RigidTransform]:
    """The guess, turned about x and y to where most edge points are near edges of their direction in the images."""
    camera = problem.camera
    width = max(np.deg2rad(0.5), 1.5 / camera.fx)
    steps = int(np.ceil(np.deg2rad(config.search_deg) / (0.7 * width)))
    away = np.full((len(problem.images), _BINS, *camera.shape), np.inf, np.float32)
    for i, edges in enumerate(problem.images):
        at = np.rint(edges.uv).astype(int)
        turn = np.arctan2(edges.normal[:, 1], edges.normal[:, 0]) / np.pi * _BINS
        for b in range(_BINS):
            near = np.abs((turn - b + _BINS / 2) % _BINS - _BINS / 2) <= 1
            if near.any():
                free = np.ones(camera.shape, bool)
                free[at[near, 1], at[near, 0]] = False
                away[i, b] = ndimage.distance_transform_edt(free)
    score = np.exp(-0.5 * (away / (0.5 * width * camera.fx)) ** 2)
    candidates = []
    for i in range(-steps, steps + 1):
        for j in range(-steps, steps + 1):
            X_HC = changed(X_HC_guess, 0.7 * width * np.array([i, j, 0, 0, 0, 0]))
            _, uv, along, inside = problem.project(X_HC)
            at = np.rint(uv[inside]).astype(int)
            normal = np.arctan2(along[inside, 0], -along[inside, 1]) / np.pi * _BINS
            b = np.rint(normal).astype(int) % _BINS
            candidates.append((float(score[problem.view[inside], b, at[:, 1], at[:, 0]].sum()), i, j, X_HC))
    candidates.sort(key=lambda candidate: -candidate[0])
    chosen: list[tuple[float, int, int, RigidTransform]] = []
    for candidate in candidates:
        if all(max(abs(candidate[1] - c[1]), abs(candidate[2] - c[2])) > 1 for c in chosen):
            chosen.append(candidate)
        if len(chosen) == config.starts:
            break
    return [candidate[3] for candidate in chosen]


def _stage_px(config: EdgeCalibrationConfig, camera: CameraModel) -> list[float]:
    return [max(2.0, camera.fx * float(np.deg2rad(stage))) for stage in config.stages_deg]


def _fit(
    matcher: EdgeMatcher,
    X_HC: RigidTransform,
    X_HC_guess: RigidTransform,
    config: EdgeCalibrationConfig,
) -> RigidTransform:
    """Gauss-Newton steps with matches that are renewed at every step."""
    scale = config.hold.scale(6)
    for reach in _stage_px(config, matcher.problem.camera):
        for _ in range(config.iterations):
            match = matcher.match(X_HC, reach)
            if len(match.point) < 6:
                return X_HC
            # Points on one piece of edge say the same thing: together they count as one.
            weight = piece_weight(matcher.problem, match)
            spread = max(float(np.sqrt(np.average(match.error**2, weights=match.weight))), 0.2)
            slopes = match.J * scale
            information = (slopes.T * weight) @ slopes / spread**2 + np.eye(6)
            gradient = slopes.T @ (weight * match.error) / spread**2
            gradient += change_between(X_HC_guess, X_HC) / scale
            step = -np.linalg.solve(information, gradient)
            X_HC = changed(X_HC, scale * step)
            if np.abs(step).max() < 1e-4:
                break
    return X_HC
