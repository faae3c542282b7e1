"""Simulated spinning LiDAR on SceneGraph geometry."""

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from pydrake.common.value import AbstractValue
from pydrake.geometry import FrameId, QueryObject
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem, State

from ..config import check_config, quantity
from ..noise import generator_at
from ..ports import eval_typed, weak_method
from .deskew import interpolate_pose
from .mirror import mirror_share, mirrored_rays
from .own_body import OwnBody
from .ray_scene import RayHits, RayScene
from .scan import Scan
from .scan_pattern import ScanPattern, utm30lx, utm30lx_10hz, vlp16

# [m] Dust farther away returns too little.
_DUST = 10.0
_PATTERNS = {"vlp16": vlp16, "utm30lx": utm30lx, "utm30lx_10hz": utm30lx_10hz}


@dataclass(kw_only=True)
class LidarConfig:
    """Which LiDAR, and how its beams return. A value of None keeps that of the pattern."""

    # The sensor: rings, columns, and the defaults of the values below.
    pattern: str = quantity("vlp16", choices=tuple(_PATTERNS))
    # Time of a revolution.
    period: float | None = quantity(None, unit="s", above=0.0)
    # Nearest and farthest distance that is reported.
    min_range: float | None = quantity(None, unit="m", low=0.0)
    max_range: float | None = quantity(None, unit="m", above=0.0)
    # Standard deviation of a distance.
    range_noise: float | None = quantity(None, unit="m", low=0.0)
    # Distance at which half of the shots at a white wall, square on, come back.
    detection_range: float | None = quantity(None, unit="m", above=0.0)
    # How sharply detection sets in with power; 3 goes from 11 % to 89 % over a factor of 4. Assumed.
    detection_steepness: float = quantity(3.0, above=0.0)
    # Share of shots lost for no reason that is modelled. Assumed.
    dropout: float = quantity(0.005, low=0.0, high=1.0)
    # Share of shots that dust or rain sends back from anywhere on the way, up to 10 m.
    stray: float = quantity(0.0, low=0.0, high=1.0)
    # How much more power the mirrored share returns at normal incidence than if it were scattered. Assumed.
    specular_gain: float = quantity(10.0, low=0.0)
    # Incidence angle at which the mirrored return has fallen to exp(-1/2). Assumed; slightly rough, as rippled water.
    specular_width: float = quantity(0.05, unit="rad", above=0.0)
    # Standard deviation of the intensity; a real VLP-16 has 0.009 between neighbours on smooth patches.
    intensity_noise: float = quantity(0.01, low=0.0)
    # Whether surfaces show mirror images: a wall across a puddle then gives points below the floor.
    mirror: bool = True


@dataclass(frozen=True, eq=False)
class Returns:
    """Shots that came back.

    Attributes:
        ray: (M,) index of the ray, rising.
        distance: (M,) float32 [m], measured.
        intensity: (M,) float32 in [0, 1].
    """

    ray: np.ndarray
    distance: np.ndarray
    intensity: np.ndarray


def configured_pattern(config: LidarConfig) -> ScanPattern:
    """Pattern of `config`, with what `config` overrides.

    Raises:
        ConfigError: the ranges do not fit each other.
    """
    pattern = _PATTERNS[config.pattern]()
    names = ("period", "min_range", "max_range", "range_noise", "detection_range")
    changes = {name: getattr(config, name) for name in names if getattr(config, name) is not None}
    if config.period is not None:
        changes["times"] = pattern.times * (config.period / pattern.period)
    return dataclasses.replace(pattern, **changes)


def sweep_rays(pattern: ScanPattern, X_WS0: np.ndarray, X_WS1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rays of one revolution of a sensor that moves at constant twist.

    Args:
        X_WS0, X_WS1: poses of the sensor at the start and at the end of the revolution, (4, 4).

    Returns:
        p_WR, where the rays start, (N, 3) float32 [m], and d_W, their unit directions, (N, 3) float32.
    """
    R_S0S, p_S0S = interpolate_pose(np.linalg.solve(X_WS0, X_WS1), pattern.times / pattern.period)
    across = np.cos(pattern.azimuths)[:, None] * R_S0S[:, :, 0] + np.sin(pattern.azimuths)[:, None] * R_S0S[:, :, 1]
    R_WS0, p_WS0 = X_WS0[:3, :3], X_WS0[:3, 3]
    # One row a ring and 3 C numbers in it: long inner loops are what makes this fast.
    parts = (across @ R_WS0.T, R_S0S[:, :, 2] @ R_WS0.T, p_S0S @ R_WS0.T + p_WS0)
    level, up, start = (part.astype(np.float32).ravel() for part in parts)
    cosine, sine = (f(pattern.elevations).astype(np.float32)[:, None] for f in (np.cos, np.sin))
    d_W = cosine * level + sine * up
    p_WR = pattern.heights.astype(np.float32)[:, None] * up + start
    return p_WR.reshape(-1, 3), d_W.reshape(-1, 3)


def simulate_returns(
    p_WR: np.ndarray,
    d_W: np.ndarray,
    scene: RayScene,
    rng: np.random.Generator,
    *,
    config: LidarConfig,
    pattern: ScanPattern,
    X_WF: Mapping[FrameId, RigidTransform] | None = None,
    own_geometry: np.ndarray | None = None,
    own_distance: np.ndarray | None = None,
) -> Returns:
    """Fires every ray and decides what comes back.

    With reflectivity ρ, mirrored share s, incidence angle θ and distance r, the share of the light that comes back is
    b = ρ ((1 − s) cos θ + s g exp((cos θ − 1)/w²)): Lambert's law, and a lobe of gain g and width w for the mirrored
    share. The received power b/r² over that of a white wall, square on, at the detection range R is q = b R²/r². A
    shot is detected with probability q^k / (1 + q^k), k the steepness; so returns thin out with distance, incidence
    angle, dark and mirroring surfaces. Intensity is b, as after range correction, with noise, cut to [0, 1].

    With `mirror`, a shot that was not detected at a mirroring surface (s > 0) goes on along the mirrored ray and is
    mirrored once more on its way back: b is then m² times that of what the mirrored ray meets, m = `mirror_share`, and
    r is the length of the whole way. What the sensor reports is a point straight on at this distance, the mirror image.
    A mirror in a mirror shows nothing, nor does what rides with the sensor.

    A share `stray` of the shots comes back from dust, at any distance before what they would have met.

    Args:
        p_WR, d_W: rays, as from `sweep_rays`, N = those of `pattern`.
        rng: three numbers are drawn for every ray, whatever it hits, and three more after these for those that mirrors
            send on; at the end three for dust, if there is any.
        X_WF: poses of the moving frames, see `RayScene.cast`.
        own_geometry: geometries of the robot itself, as from `RayScene.geometries_of`: a ray that meets one of them
            first is lost.
        own_distance: distance of every ray to the parts of the robot that ride with the sensor, (N,), infinite where
            they are not in the way: a ray that meets nothing nearer is lost.
    """
    hits = scene.cast(p_WR, d_W, X_WF)
    back = _share_back(hits, config)
    clear = np.ones(len(back), bool)
    if own_geometry is not None:
        clear &= ~own_geometry[hits.geometry]
    if own_distance is not None:
        clear &= hits.distance < own_distance
    detected, measured, noise = _detect(hits.distance, back, rng, config, pattern)
    detected &= clear
    if config.mirror and scene.surface.specular.any():
        specular = hits.lookup("specular")
        ray = np.flatnonzero(clear & ~detected & (specular > 0))
        share = mirror_share(hits.lookup("lidar_reflectivity")[ray], specular[ray], hits.incidence_cos[ray])
        start, direction, way = mirrored_rays(p_WR, d_W, hits, ray)
        seen = scene.cast(start, direction, X_WF)
        weight = np.square(share) * _share_back(seen, config)
        if own_geometry is not None:
            weight[own_geometry[seen.geometry]] = 0
        in_mirror, far, other_noise = _detect(way + seen.distance, weight, rng, config, pattern)
        back[ray], measured[ray], noise[ray] = weight, far, other_noise
        detected[ray] |= in_mirror
    if config.stray > 0:
        uniform, share, weight = rng.random((3, len(back)), np.float32)
        dust = clear & (uniform < config.stray)
        least = np.float32(pattern.min_range)
        farthest = np.minimum(hits.distance, np.float32(min(_DUST, pattern.max_range)))
        measured = np.where(dust, least + share * np.maximum(farthest - least, 0), measured)
        back, detected = np.where(dust, weight, back), detected | dust
    ray = np.flatnonzero(detected)
    intensity = back[ray] + np.float32(config.intensity_noise) * noise[ray]
    return Returns(ray, measured[ray], np.clip(intensity, 0, 1, out=intensity))


def _share_back(hits: RayHits, config: LidarConfig) -> np.ndarray:
    """Share b of the light that comes back from every hit, (N,) float32; 0 where a ray met nothing."""
    cosine = hits.incidence_cos
    lobe = np.float32(config.specular_gain) * np.exp((cosine - 1) * np.float32(config.specular_width**-2))
    return hits.lookup("lidar_reflectivity") * (cosine + hits.lookup("specular") * (lobe - cosine))


def _detect(
    distance: np.ndarray, back: np.ndarray, rng: np.random.Generator, config: LidarConfig, pattern: ScanPattern
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which shots are detected and within the range, their measured distances, and unit noise for their intensity."""
    # Detected when u < (1 − dropout) / (1 + q^-k), u uniform. A miss has b = 0 at an infinite distance: never.
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        inverse_power = np.square(distance / np.float32(pattern.detection_range)) / back
        against = np.power(inverse_power, np.float32(config.detection_steepness))
        uniform = rng.random(len(back), np.float32)
        detected = uniform * (1 + against) < np.float32(1 - config.dropout)
    measured = distance + np.float32(pattern.range_noise) * rng.standard_normal(len(back), np.float32)
    noise = rng.standard_normal(len(back), np.float32)
    detected &= (measured >= np.float32(pattern.min_range)) & (measured <= np.float32(pattern.max_range))
    return detected, measured, noise


def make_cloud(pattern: ScanPattern, returns: Returns) -> o3d.t.geometry.PointCloud:
    """Points of `returns` in the sensor frame, each at its own instant, with the attributes of `Scan`."""
    ray = returns.ray
    positions = np.take(pattern.d_S, ray, axis=0)
    for axis in range(3):
        positions[:, axis] *= returns.distance
    positions[:, 2] += np.take(pattern.p_SR[:, 2], ray)
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(positions))
    attributes = {
        "intensity": returns.intensity,
        "time": np.take(pattern.time, ray),
        "ring": np.take(pattern.ring, ray),
        "column": np.take(pattern.column, ray),
    }
    for name, values in attributes.items():
        cloud.point[name] = o3d.core.Tensor.from_numpy(values[:, None])
    return cloud


def scan_at(
    scene: RayScene, X_WS: RigidTransform, rng: np.random.Generator, config: LidarConfig | None = None
) -> o3d.t.geometry.PointCloud:
    """What a sensor that rests at X_WS sees of `scene`: points in S, with the attributes of `Scan`."""
    config = config or LidarConfig()
    pattern, X = configured_pattern(config), X_WS.GetAsMatrix4()
    return make_cloud(pattern, simulate_returns(*sweep_rays(pattern, X, X), scene, rng, config=config, pattern=pattern))


@dataclass
class _SweepState:
    """What the LiDAR remembers between scans."""

    scan: Scan
    time: float | None = None
    X_WS: np.ndarray | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> "_SweepState":
        return dataclasses.replace(self)  # the scan is read-only and so shared


class Lidar(LeafSystem):
    """
    .. pydrake_system::

        name: Lidar
        input_ports:
        - geometry_query
        output_ports:
        - scan_S

    Simulated spinning LiDAR. Every period `scan_S` becomes the `Scan` of the revolution that ends at that moment: rays
    are fired column by column from poses of the sensor between those at the start and at the end of the revolution, at
    constant twist, so that a moving robot gets the distorted scan that a real LiDAR gives. Points are in the sensor
    frame S at their own instant, with the attributes that `Scan` names; `deskew` brings them to `end_time`. Other
    bodies are where they are at `end_time`. Which shots come back and with what intensity: see `simulate_returns`.

    - `geometry_query` (QueryObject): the SceneGraph's `query` port, for the poses of the frames.
    - `scan_S` (Scan): the last whole revolution, held until the next; `start_time` and `end_time` are those of the
      revolution.

    The first event notes the pose and the next one, at t = period in a run from 0, is the first scan. Until then the
    output is a `Scan` without points whose index is -1. The same happens when time has jumped.

    Geometry of the robot itself hides what is behind it and gives no points. What rides with the sensor is found once,
    at construction.

    Args:
        config: which LiDAR, noise, dropout.
        scene: geometry with surface properties; build it once, sensors can share it.
        parent_frame: SceneGraph frame P that the sensor is fixed to.
        X_PS: pose of the sensor in P.
        rigid_frames: poses X_PF of the robot's frames that are welded to P, from `welded_frames(plant, body)`; P alone
            when not given.
        own_frames: further frames of the robot, which move against P, such as flippers.
        seed: of noise and dropout; two runs with one seed are equal.

    Raises:
        ConfigError: a value of `config` is out of its range.
        PortError: `geometry_query` is not connected.
    """

    def __init__(
        self,
        config: LidarConfig,
        *,
        scene: RayScene,
        parent_frame: FrameId,
        X_PS: RigidTransform,
        rigid_frames: Mapping[FrameId, RigidTransform] | None = None,
        own_frames: Collection[FrameId] = (),
        seed: int = 0,
    ):
        super().__init__()
        check_config(config, where="lidar")
        self.config = config
        self.pattern = configured_pattern(config)
        self._scene = scene
        self._seed = seed
        self._X_PS = X_PS
        self._body = OwnBody(scene, parent_frame, rigid_frames, own_frames)
        self._own_distance = self._body.distance(*sweep_rays(self.pattern, X_PS.GetAsMatrix4(), X_PS.GetAsMatrix4()))

        self.DeclareAbstractInputPort("geometry_query", AbstractValue.Make(QueryObject()))
        nothing = Scan(make_cloud(self.pattern, Returns(np.zeros(0, int), *np.zeros((2, 0), np.float32))), 0.0, 0.0, -1)
        self._state = self.DeclareAbstractState(AbstractValue.Make(_SweepState(scan=nothing)))
        self.DeclareAbstractOutputPort(
            "scan_S",
            lambda: AbstractValue.Make(nothing),
            weak_method(self._CalcScan),
            prerequisites_of_calc={self.abstract_state_ticket(self._state)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(self.pattern.period, 0.0, self._FinishScan)

    def _CalcScan(self, context: Context, output: AbstractValue) -> None:
        held: Any = context.get_abstract_state(int(self._state))
        output.set_value(held.get_value().scan)

    def _FinishScan(self, context: Context, state: State) -> None:
        query = eval_typed(self, context, "geometry_query", QueryObject)
        now = context.get_time()
        X_WS = (self._body.parent_pose(query) @ self._X_PS).GetAsMatrix4()
        held: Any = state.get_mutable_abstract_state(int(self._state))
        sweep: _SweepState = held.get_mutable_value()
        period = self.pattern.period
        if sweep.X_WS is not None and sweep.time is not None and abs(now - sweep.time - period) < 1e-6 * period:
            returns = simulate_returns(
                *sweep_rays(self.pattern, sweep.X_WS, X_WS),
                self._scene,
                generator_at(self._seed, sweep.scan.index + 1),
                config=self.config,
                pattern=self.pattern,
                X_WF=self._body.other_poses(query),
                own_geometry=self._body.moving,
                own_distance=self._own_distance,
            )
            sweep.scan = Scan(make_cloud(self.pattern, returns), sweep.time, now, sweep.scan.index + 1)
        sweep.time, sweep.X_WS = now, X_WS
