"""The paper's case (S2-d): a few frames, metres apart, of a hall full of things that hide each other, with puddles."""

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from naraha.models.worlds import load_world
from naraha.models.worlds.stair_hall import FREE_WAY
from naraha.systems.noise import generator_at
from naraha.systems.sensing import LidarConfig, RayScene
from naraha.systems.sensing.lidar import configured_pattern, make_cloud, simulate_returns, sweep_rays
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw

HEIGHT = 0.30  # [m] of the sensor over the ground
ABOVE = 1.5  # [m] over the landing of the stair, below whatever hangs
NIR_NOISE = 0.1  # relative standard deviation of a brightness
SLIP, YAW_NOISE_DEG = 0.2, 2.0  # of the odometry, between two frames


@dataclass(frozen=True, eq=False)
class Frame:
    """What was seen from one place.

    Attributes:
        cloud_S: points in the sensor frame with `intensity`, `nir`, `ring` and `column`.
        X_WS: where it was.
        X_OS: where the odometry says it was.
    """

    cloud_S: PointCloud
    X_WS: RigidTransform
    X_OS: RigidTransform


def hall_frames(seed: int, count: int = 14) -> list[Frame]:
    """`count` frames along the way around `stair_hall`, about 3.5 m apart, the last one near the first.

    Near-infrared brightness is what the surface reflects that the shot met first, times a noise: the sweep of a
    pan-tilt camera at every place. The odometry makes every step 20 % too short and has 2° of noise in every turn.
    """
    world = load_world("stair_hall", seed)
    scene, config = world.ray_scene(), LidarConfig()
    pattern = configured_pattern(config)
    frames: list[Frame] = []
    for i, X_WS in enumerate(_places(seed, count, scene)):
        rng, X = generator_at(seed, i), X_WS.GetAsMatrix4()
        rays = sweep_rays(pattern, X, X)
        returns = simulate_returns(*rays, scene, rng, config=config, pattern=pattern)
        cloud = make_cloud(pattern, returns)
        met = scene.cast(rays[0][returns.ray], rays[1][returns.ray])
        nir = met.lookup("nir_reflectance") * np.exp(NIR_NOISE * rng.standard_normal(len(returns.ray)))
        cloud.point["nir"] = o3d.core.Tensor(nir.astype(np.float32)[:, None])
        X_OS = X_WS
        if frames:
            step = frames[-1].X_WS.inverse() @ X_WS
            turn = RollPitchYaw(0, 0, np.deg2rad(YAW_NOISE_DEG) * rng.standard_normal())
            slipped = RigidTransform(step.rotation(), (1 - SLIP) * step.translation())
            X_OS = frames[-1].X_OS @ slipped @ RigidTransform(turn, np.zeros(3))
        frames.append(Frame(cloud, X_WS, X_OS))
    return frames


def _places(seed: int, count: int, scene: RayScene) -> list[RigidTransform]:
    """Poses along the free way and over the stair, evenly, looking on, with a little roll and pitch."""
    rng = np.random.default_rng([seed, 31])
    steps = np.linalg.norm(np.diff(FREE_WAY, axis=0), axis=1)
    s = np.concatenate([[0], np.cumsum(steps)])
    poses = []
    for at in np.linspace(0, s[-1] - 1.0, count):
        leg = min(int(np.searchsorted(s, at, side="right")) - 1, len(steps) - 1)
        along = (FREE_WAY[leg + 1] - FREE_WAY[leg]) / steps[leg]
        roll, pitch = np.deg2rad(1.0) * rng.standard_normal(2)
        yaw = np.arctan2(along[1], along[0]) + np.deg2rad(10) * rng.standard_normal()
        place = FREE_WAY[leg] + (at - s[leg]) * along
        fall = scene.cast(np.array([[*place, ABOVE]], np.float32), np.array([[0, 0, -1]], np.float32)).distance[0]
        poses.append(RigidTransform(RollPitchYaw(roll, pitch, yaw), [*place, ABOVE - fall + HEIGHT]))
    return poses
