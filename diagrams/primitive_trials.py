"""One drive of one motion of route learning on one kind of ground, and what all of them come to."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from naraha.models.worlds import World
from naraha.models.worlds.stair_hall import RISE, RUN
from naraha.systems.config import quantity
from naraha.systems.drive import PRIMITIVES, MotionPrimitivesConfig
from naraha.systems.drive.motion_primitives import BACK, FORWARD
from naraha.systems.routes import Ground, outcome_of
from naraha.systems.tracking import planar_pose, pose_error
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from .ability_worlds import GROUNDS
from .motions import make_motions
from .station import StationConfig
from .wiring import subsystem

# [rad] A robot that is tilted more than this has tipped over. [s] Time to settle on the ground before the motion.
_TIPPED, _SETTLE = 1.2, 0.4
# [m] How far above the ground the station is built, and where on it the motion begins.
_ABOVE, _PLACE = 0.45, 2.4


@dataclass(kw_only=True)
class PrimitiveTrials:
    """How the motions are tried."""

    # Drives of every motion on every ground, each with its own start, heading, friction and bumps.
    trials: int = quantity(20, low=2)
    # [rad] Slope that is driven up, down and along. [m] Height of the ridges on rough ground.
    slope: float = quantity(0.3, unit="rad", low=0)
    ridges: float = quantity(0.06, unit="m", low=0)
    # [m] Height of the steps of a stair, as deep as in the stair hall, that is driven up and down.
    rise: float = quantity(RISE, unit="m", low=0)
    # [m], [deg] How far the start and the heading are off, at most.
    offset: float = quantity(0.1, unit="m", low=0)
    heading_deg: float = quantity(5.0, unit="deg", low=0, high=20)
    # [-] Lowest and highest friction between the robot and the ground.
    friction: list[float] = quantity([0.75, 0.95], unit="-", above=0, min_length=2)
    motions: MotionPrimitivesConfig = field(default_factory=MotionPrimitivesConfig)


@dataclass(frozen=True)
class _Site:
    """A ground: kind of terrain, world of `GROUNDS` at a level, and headings that the robot may have on it [45°].

    The robot stands on a plane that rises along x by `slope` [rad], `height` [m] high at x = 0.
    """

    terrain: str
    world: str
    level: float
    headings: tuple[int, ...]
    slope: float = 0.0
    height: float = 0.0


@dataclass(frozen=True)
class Trial:
    """How one motion ended.

    Attributes:
        moved: (3,) way ahead, to the left [m] and turn [rad], see `naraha.systems.routes.Outcome`.
        ended: whether the motion came to its end, upright. time: that it took [s].
        slip: share of what the belts drove that the robot did not [-], of turns by the gauge of the driver.
        tilt: steepest on the way [rad].
    """

    moved: np.ndarray
    ended: bool
    time: float
    slip: float
    tilt: float


def sites(config: PrimitiveTrials) -> dict[str, _Site]:
    """The grounds by their names."""
    every = tuple(range(8))
    # On a stair the robot lies on the edges of the treads.
    edges = {"slope": float(np.arctan2(config.rise, RUN)), "height": config.rise}
    return {
        "flat": _Site("flat", "pitch_slope", 0.0, every),
        "slope_up": _Site("slope", "pitch_slope", config.slope, (0,), config.slope),
        "slope_down": _Site("slope", "pitch_slope", config.slope, (4,), config.slope),
        "side_slope": _Site("slope", "pitch_slope", config.slope, (2, 6), config.slope),
        "rough": _Site("rough", "ridges", config.ridges, every, height=config.ridges),
        "stair_up": _Site("steps", "stair", config.rise, (0,), **edges),
        "stair_down": _Site("steps", "stair", config.rise, (4,), **edges),
    }


def try_motion(
    station: StationConfig, site: _Site, action: int, rng: np.random.Generator, config: PrimitiveTrials
) -> Trial:
    """Drives a motion (index into `PRIMITIVES`) once. Start, heading, friction and bumps are drawn from `rng`."""
    seed = int(rng.integers(2**31))
    world: World = GROUNDS[site.world](site.level, seed, float(rng.uniform(config.friction[0], config.friction[1])))
    nominal = int(rng.choice(site.headings)) * np.pi / 4
    yaw = nominal + np.deg2rad(config.heading_deg) * rng.uniform(-1, 1)
    slope, height = site.slope, station.robot.known_model().base_height
    place = [_PLACE + config.offset * rng.uniform(-1, 1), config.offset * rng.uniform(-1, 1), height]
    X_WG = RigidTransform(RollPitchYaw(0, -slope, 0), np.array([0, 0, site.height]))
    X_WB = X_WG @ RigidTransform(RollPitchYaw(0, 0, yaw), np.array(place))
    # The station is built with the robot in the air before the obstacle: it must not start inside a slope or ridge.
    robot = replace(station.robot, start_xyz=[-1.0, 0.0, height + _ABOVE], start_yaw_deg=float(np.rad2deg(yaw)))
    # Level: before its first sample the IMU says so, and the odometry then sees the slope as a change.
    X_OB0 = RigidTransform(RollPitchYaw(0, 0, yaw), X_WB.translation())
    diagram = make_motions(replace(station, robot=robot), config.motions, seed=seed, world=world, X_OB0=X_OB0)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    plant = subsystem(diagram, "station", "plant")
    base = plant.GetBodyByName("base", plant.GetModelInstanceByName("robot"))
    plant.SetFreeBodyPose(plant.GetMyMutableContextFromRoot(context), base, X_WB)
    diagram.GetInputPort("action").FixValue(context, [-1.0])
    simulator.AdvanceTo(_SETTLE)

    def read() -> tuple[Any, np.ndarray, Any]:
        ports = ("cheat.X_WB", "track_displacements", "status")
        pose, belts, status = (diagram.GetOutputPort(name).Eval(context) for name in ports)
        return pose, np.array(belts), status

    X_WB, belts, _ = read()
    start = np.array([*planar_pose(X_WB)[:2], nominal])
    turned = planar_pose(X_WB)[2] - nominal
    diagram.GetInputPort("action").FixValue(context, [float(action)])
    simulator.AdvanceTo(_SETTLE + 0.02)
    diagram.GetInputPort("action").FixValue(context, [-1.0])
    tilt, status = 0.0, "running"
    while status == "running" and tilt < _TIPPED:
        simulator.AdvanceTo(context.get_time() + 0.02)
        X_WB, now, status = read()
        tilt = max(tilt, float(np.arccos(np.clip(X_WB.rotation().matrix()[2, 2], -1, 1))))
    moved = pose_error(start, planar_pose(X_WB))
    driven = now - belts
    if action in (FORWARD, BACK):
        length = np.sqrt(2.0) if round(nominal / (np.pi / 4)) % 2 else 1.0
        moved[:2] /= length
        # The way is seen from above; up and down a slope the belts have more of it.
        seen = abs(driven.mean()) * (np.cos(slope) if abs(np.cos(nominal)) > 0.9 else 1.0)
        slip = 1 - abs(moved[0]) * length / max(seen, 1e-6)
    else:
        gauge = station.robot.known_driver().gauge
        angle = np.arctan2(np.sin(moved[2] - turned), np.cos(moved[2] - turned))
        slip = 1 - abs(angle) * gauge / max(abs(driven[1] - driven[0]), 1e-6)
    return Trial(moved, status == "done", context.get_time() - _SETTLE, float(slip), tilt)


def measure(
    station: StationConfig, config: PrimitiveTrials, seed: int, tell: Callable[[str], None] = lambda words: None
) -> Iterator[tuple[dict[str, Ground], list[list[object]]]]:
    """Tries every motion on every ground; yields each ground by its name, and a row for every drive on it.

    Args:
        tell: is told before every drive what comes; may raise `KeyboardInterrupt`.
    """
    for number, (name, site) in enumerate(sites(config).items()):
        ground = Ground(terrain=site.terrain, level=site.level)
        rows: list[list[object]] = []
        for action, motion in enumerate(PRIMITIVES):
            drives = []
            for k in range(config.trials):
                tell(f"{name} {motion}, drive {k + 1}")
                rng = np.random.default_rng([seed, number, action, k])
                drives.append(try_motion(station, site, action, rng, config))
            samples = np.array([drive.moved for drive in drives])
            ended, time, slip = ([getattr(drive, key) for drive in drives] for key in ("ended", "time", "slip"))
            outcome = outcome_of(samples, ended, time, slip)
            ground.motions[motion] = replace(outcome, tilt=round(max(drive.tilt for drive in drives), 4))
            rows += [
                [name, motion, k, *d.moved.tolist(), d.ended, d.time, d.slip, d.tilt] for k, d in enumerate(drives)
            ]
        yield {name: ground}, rows
