"""Keyframes with the depth camera's points beside those of the LiDAR, their normals and tilts."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State
from pydrake.systems.sensors import ImageDepth32F

from ..clouds import estimate_normals, voxel_filter
from ..config import check_config, quantity
from ..errors import ConfigError, PortError
from ..ports import eval_typed, weak_method
from ..sensing.camera_model import CameraModel
from ..slam.keyframe import NO_KEYFRAME, Keyframe
from ..slam.scan_matcher import History, odometry_at
from .layers import with_layers
from .projection import check_extrinsics, move_rows


@dataclass(kw_only=True)
class KeyframeAssemblerConfig:
    """Which points of the depth image are used, and how normals are found."""

    # [s] Interval at which keyframes and images are looked for; that of the scan matcher or shorter.
    period: float = quantity(0.1, unit="s", above=0)
    # [s] Longest time between image and keyframe; what the robot moved in it is taken out by the odometry.
    max_gap: float = quantity(0.3, unit="s", above=0)
    # [s] How long images are kept to find the one nearest to the keyframe. With 0 an image is only looked at when a
    # keyframe comes, which is cheaper: simulated cameras make only the images that somebody reads.
    memory: float = quantity(0.0, unit="s", low=0)
    # [m] Depths that are used. Noise grows with the square: a D415 has 0.1 m at 6 m.
    min_depth: float = quantity(0.3, unit="m", low=0)
    max_depth: float = quantity(6.0, unit="m", above=0)
    # [m] Corners of a box in B that holds the robot: depth points in it are dropped.
    body_low: list[float] = quantity([-0.6, -0.35, -0.1], unit="m")
    body_high: list[float] = quantity([0.6, 0.35, 0.6], unit="m")
    # [m] Depth points are thinned to one a voxel; 0 keeps all. Beyond `far_depth` the voxels are larger, so that noise
    # does not scatter a surface over several of them.
    voxel_size: float = quantity(0.05, unit="m", low=0)
    far_depth: float = quantity(2.5, unit="m", above=0)
    far_voxel_size: float = quantity(0.1, unit="m", above=0)
    # [m] Normals are found from up to 20 neighbours within this radius.
    normal_radius: float = quantity(0.5, unit="m", above=0)


def depth_points(
    depth: np.ndarray, camera: CameraModel, X_BD: RigidTransform, config: KeyframeAssemblerConfig
) -> np.ndarray:
    """Points p_BP (N, 3) float32 [m] of a depth image (H, W): thinned, without those of the robot itself.

    Pixels that are not finite, or not between the smallest and largest depth, give none.

    Raises:
        CameraError: the image has another size than the camera.
    """
    camera.check_image(depth, "depth_image")
    z = np.asarray(depth, np.float32).ravel()
    good = np.flatnonzero((z >= config.min_depth) & (z <= config.max_depth))  # False for NaN
    p_DP = camera.unproject(depth)[good]
    p_BP = np.ascontiguousarray(move_rows(p_DP, X_BD.rotation().matrix(), X_BD.translation()).T)
    low, high = np.array([config.body_low, config.body_high], np.float32)
    own = np.ones(len(p_BP), bool)
    for axis in range(3):
        own &= (p_BP[:, axis] >= low[axis]) & (p_BP[:, axis] <= high[axis])
    if config.voxel_size == 0:
        return p_BP[~own]
    far = p_DP[:, 2] > config.far_depth
    parts = [(p_BP[~own & ~far], config.voxel_size), (p_BP[~own & far], config.far_voxel_size)]
    return np.vstack([_thinned(part, voxel) for part, voxel in parts])


def _thinned(points: np.ndarray, voxel: float) -> np.ndarray:
    thin: np.ndarray = voxel_filter(PointCloud(o3d.core.Tensor(points)), voxel).point.positions.numpy()
    return thin


def join_clouds(cloud: PointCloud, points: np.ndarray) -> PointCloud:
    """`cloud` with `points` (N, 3) behind its own. An attribute of the cloud is NaN there, `count` is 1.

    Attributes become float32, so that NaN fits in; each of the points counts as much as one measured by the LiDAR.
    """
    joined = PointCloud()
    if "positions" in cloud.point:
        for name, tensor in cloud.point.items():
            values = tensor.numpy()
            if name == "positions":
                more = np.asarray(points, np.float32)
            else:
                more = np.full((len(points), *values.shape[1:]), 1 if name == "count" else np.nan, np.float32)
            if name == "count":
                more = more.astype(values.dtype)
            joined.point[name] = o3d.core.Tensor(np.concatenate([values.astype(more.dtype), more]))
    else:
        joined.point["positions"] = o3d.core.Tensor(np.asarray(points, np.float32))
    return joined


def surface_layers(points: np.ndarray, p_BE: np.ndarray, up_B: np.ndarray, radius: float) -> dict[str, np.ndarray]:
    """`normals` (N, 3) towards the sensor at `p_BE`, zero where unknown, and `tilt` (N,) [rad], NaN where unknown.

    The tilt is the angle between normal and vertical `up_B`, from 0 for a floor to π for a ceiling. A surface that the
    sensor sees from below is one that faces down.
    """
    normals = estimate_normals(points, radius).astype(np.float32) if len(points) else np.zeros((0, 3), np.float32)
    facing = np.einsum("ij,ij->i", normals, np.asarray(p_BE, np.float32) - points)
    normals[facing < 0] *= -1
    tilt = np.arccos(np.clip(normals @ np.asarray(up_B, np.float32), -1, 1))
    tilt[~normals.any(axis=1)] = np.nan
    return {"normals": normals, "tilt": tilt}


@dataclass(frozen=True, eq=False)
class _Assembly:
    """Abstract state; read-only, so that Drake may share it instead of copying it at every update."""

    received: Keyframe = NO_KEYFRAME
    assembled: Keyframe = NO_KEYFRAME
    odometry: History = ()
    rpy: tuple[tuple[float, np.ndarray], ...] = ()
    images: tuple[tuple[float, np.ndarray], ...] = ()

    def __deepcopy__(self, memo: dict) -> "_Assembly":
        return self


class KeyframeAssembler(LeafSystem):
    """
    .. pydrake_system::

        name: KeyframeAssembler
        input_ports:
        - keyframe
        - depth_image
        - image_time
        - rpy
        - X_OB
        output_ports:
        - keyframe

    Joins the points of a depth camera to every new keyframe, and finds the normals of all of them.

    Every `period` it notes the odometry and the IMU's angles and looks for a new keyframe. The depth image that was
    taken nearest to the keyframe, `max_gap` apart at most, becomes points (`depth_points`), which the odometry moves
    from where the robot was at the exposure to where it was at the keyframe. They follow the points of the LiDAR
    (`join_clouds`). Without such an image, or when none of its pixels has a depth, the LiDAR's points stay alone.

    - `keyframe` (`Keyframe`), in: from the scan matcher.
    - `depth_image` (`ImageDepth32F`) [m]: depth along z, 0, infinite or NaN where there is none.
    - `image_time` (1) [s]: when it was exposed; negative or NaN before the first.
    - `rpy` (3) [rad]: roll, pitch and yaw of the base from the IMU; only the vertical is used.
    - `X_OB` (`RigidTransform`): odometry, pose of the base B in O.
    - `keyframe` (`Keyframe`), out: the newest, with `normals` (N, 3), towards the sensor and zero where unknown, and
      `tilt` (N, 1) [rad], NaN where unknown; see `surface_layers`. Index -1 before the first.

    Args:
        camera: intrinsics of the depth camera.
        X_BD: its pose in the base.

    Raises:
        ConfigError: a value of the configuration is out of range.
        CameraError: `X_BD` is no rigid motion, or (while running) the image has another size than the camera.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, config: KeyframeAssemblerConfig | None = None, *, camera: CameraModel, X_BD: RigidTransform):
        super().__init__()
        self._config = config = config or KeyframeAssemblerConfig()
        check_config(config, where="KeyframeAssembler")
        for name in ("body_low", "body_high"):
            if len(getattr(config, name)) != 3:
                raise ConfigError("not a point", where="KeyframeAssembler", key=name, valid="x, y, z [m]")
        self._camera = camera
        self._X_BD = check_extrinsics(X_BD.GetAsMatrix4(), "KeyframeAssembler.X_BD")
        self.DeclareAbstractInputPort("keyframe", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("depth_image", AbstractValue.Make(ImageDepth32F(1, 1)))
        self.DeclareVectorInputPort("image_time", 1)
        self.DeclareVectorInputPort("rpy", 3)
        self.DeclareAbstractInputPort("X_OB", AbstractValue.Make(RigidTransform()))
        ticket = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(_Assembly())))
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Assemble)
        self.DeclareAbstractOutputPort(
            "keyframe", lambda: AbstractValue.Make(NO_KEYFRAME), weak_method(self._CalcKeyframe), {ticket}
        )

    def _Assemble(self, context: Context, state: State) -> EventStatus:
        known, now = self._assembly(context), context.get_time()
        # Copies: what the ports give are references to their caches, which will hold the next values.
        X_OB = RigidTransform(eval_typed(self, context, "X_OB", RigidTransform))
        since = now - max(3.0, self._config.memory)
        known = replace(
            known,
            odometry=(*(note for note in known.odometry if since <= note[0] < now), (now, X_OB)),
            rpy=(*(note for note in known.rpy if since <= note[0] < now), (now, self._eval_vector(context, "rpy"))),
        )
        keyframe = eval_typed(self, context, "keyframe", Keyframe)
        new = keyframe.index >= 0 and keyframe is not known.received
        if new or self._config.memory > 0:
            known = replace(known, images=self._images(context, known))
        if new:
            known = replace(known, received=keyframe, assembled=self._assembled(known, keyframe))
        state.get_mutable_abstract_state(0).set_value(known)
        return EventStatus.Succeeded()

    def _images(self, context: Context, known: _Assembly) -> tuple[tuple[float, np.ndarray], ...]:
        """Remembered images and the one that is there now, if there is one."""
        time = float(self._eval_vector(context, "image_time")[0])
        kept = tuple(note for note in known.images if note[0] >= context.get_time() - self._config.memory)
        if not time >= 0 or any(note[0] == time for note in kept):  # NaN, too
            return kept
        image: Any = eval_typed(self, context, "depth_image", ImageDepth32F)
        depth = np.array(image.data[:, :, 0])
        self._camera.check_image(depth, "KeyframeAssembler.depth_image")
        return (*kept, (time, depth))

    def _assembled(self, known: _Assembly, keyframe: Keyframe) -> Keyframe:
        cloud = keyframe.cloud_B
        near = [note for note in known.images if abs(note[0] - keyframe.time) <= self._config.max_gap]
        if near:
            time, depth = min(near, key=lambda note: abs(note[0] - keyframe.time))
            X_OB = keyframe.X_OB or odometry_at(known.odometry, keyframe.time)
            X_BV = X_OB.inverse() @ odometry_at(known.odometry, time)
            p_VP = depth_points(depth, self._camera, self._X_BD, self._config)
            moved = move_rows(p_VP, X_BV.rotation().matrix(), X_BV.translation()).T
            cloud = join_clouds(cloud, np.ascontiguousarray(moved))
        if "positions" not in cloud.point:
            return keyframe
        times = [note[0] for note in known.rpy]
        roll, pitch = (np.interp(keyframe.time, times, [note[1][axis] for note in known.rpy]) for axis in (0, 1))
        up_B = RollPitchYaw(roll, pitch, 0.0).ToRotationMatrix().matrix()[2]
        points = cloud.point.positions.numpy()
        layers = surface_layers(points, self._X_BD.translation(), up_B, self._config.normal_radius)
        return replace(keyframe, cloud_B=with_layers(cloud, layers))

    def _eval_vector(self, context: Context, name: str) -> np.ndarray:
        port = self.GetInputPort(name)
        if not port.HasValue(context):
            raise PortError("input port is not connected", where=f"KeyframeAssembler.{name}", valid="a vector")
        value: Any = port.Eval(context)
        return np.array(value)

    @staticmethod
    def _assembly(context: Context) -> _Assembly:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _CalcKeyframe(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._assembly(context).assembled)
