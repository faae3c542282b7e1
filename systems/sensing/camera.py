"""What all simulated cameras share: configuration, rays, exposure and delivery."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import FrameId, QueryObject
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State

from ..config import check_config, quantity
from ..ports import eval_typed
from .camera_model import CameraModel
from .own_body import OwnBody
from .ray_scene import RayHits, RayScene


@dataclass(kw_only=True)
class CameraConfig:
    """Image, lens and timing that every camera has."""

    # Size of the image.
    width: int = quantity(640, unit="px", low=1)
    height: int = quantity(480, unit="px", low=1)
    # Field of view from edge to edge, lens distortion left aside.
    fov_x_deg: float = quantity(60.0, unit="deg", above=0.0, high=170.0)
    fov_y_deg: float = quantity(45.0, unit="deg", above=0.0, high=170.0)
    # Lens distortion: k1, k2, p1, p2, k3 of Brown's model.
    distortion: list[float] = quantity([0.0, 0.0, 0.0, 0.0, 0.0])
    # Time between exposures.
    period: float = quantity(0.1, unit="s", above=0.0)
    # Time from an exposure to the delivery of its image; it may be longer than the period.
    latency: float = quantity(0.03, unit="s", low=0.0)

    def model(self) -> CameraModel:
        """Intrinsics and distortion. Raises `CameraError` when the distortion folds the image or lacks a number."""
        fov_x, fov_y = np.deg2rad([self.fov_x_deg, self.fov_y_deg])
        model = CameraModel.from_fov(self.width, self.height, float(fov_x), float(fov_y), tuple(self.distortion))
        model.undistort(np.array([[-0.5, -0.5], [self.width - 0.5, self.height - 0.5]]))
        return model


def cast_pixels(
    model: CameraModel, X_WC: RigidTransform, scene: RayScene, X_WF: Mapping[FrameId, RigidTransform] | None = None
) -> tuple[np.ndarray, RayHits]:
    """Casts the ray of every pixel, row by row.

    Args:
        X_WC: pose of the camera.
        X_WF: poses of the moving frames, see `RayScene.cast`.

    Returns:
        Unit directions d_W (H·W, 3) float32, and what the rays met first.
    """
    d_W = model.d_C @ X_WC.rotation().matrix().T.astype(np.float32)
    return d_W, scene.cast(X_WC.translation(), d_W, X_WF)


@dataclass(frozen=True, eq=False)
class Exposure:
    """Everything that an image depends on, noted at the instant of its exposure. The image is made when it is read.

    Attributes:
        time: [s].
        index: number of the exposure since the start.
        X_WP: pose of the frame that carries the camera.
        X_WF: poses of the frames that move against it.
        pan_tilt: pan and tilt [rad].
    """

    time: float
    index: int
    X_WP: RigidTransform
    X_WF: Mapping[FrameId, RigidTransform]
    pan_tilt: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class ExposureQueue:
    """Exposures between shutter and delivery; read-only.

    Attributes:
        count: number of exposures so far.
        pending: exposures that are not delivered yet, oldest first.
        shown: the last that was delivered, None before the first.
    """

    count: int = 0
    pending: tuple[Exposure, ...] = ()
    shown: Exposure | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> "ExposureQueue":
        return self

    def exposed(self, exposure: Exposure) -> "ExposureQueue":
        """The queue after an exposure; what is later than it is from before a jump back in time, and is dropped."""
        earlier = (other for other in self.pending if other.time < exposure.time)
        return replace(self, count=self.count + 1, pending=(*earlier, exposure))

    def delivered(self, until: float) -> "ExposureQueue":
        """The queue after delivery of all that was exposed up to time `until` [s]."""
        due = [exposure for exposure in self.pending if exposure.time <= until]
        if not due:
            return self
        return replace(self, pending=self.pending[len(due) :], shown=due[-1])


class _Camera(LeafSystem):
    """Base of the simulated cameras: exposes at 0, period, 2 period, ... and shows each image `latency` later.

    At its exposure an image is only noted (`Exposure`), so that images nobody reads cost nothing. Subclasses declare
    their image ports with `state_ticket` as the prerequisite, then call `declare_image_time`, and make the image of
    `shown(context)`.
    """

    def __init__(
        self,
        config: CameraConfig,
        *,
        scene: RayScene,
        parent_frame: FrameId,
        rigid_frames: Mapping[FrameId, RigidTransform] | None,
        own_frames: Collection[FrameId],
        seed: int,
    ):
        super().__init__()
        check_config(config, where=type(self).__name__)
        self.model = config.model()
        self._latency, self._tolerance = config.latency, 1e-6 * config.period
        self._scene = scene
        self._seed = seed
        self._body = OwnBody(scene, parent_frame, rigid_frames, own_frames)
        self.DeclareAbstractInputPort("geometry_query", AbstractValue.Make(QueryObject()))
        self._queue = self.DeclareAbstractState(AbstractValue.Make(ExposureQueue()))
        self.state_ticket = self.abstract_state_ticket(self._queue)
        # Two events at one time, as with no latency, happen in the order of their declaration.
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Expose)
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, config.latency, self._Deliver)

    def declare_image_time(self) -> None:
        self.DeclareVectorOutputPort("image_time", 1, self._CalcImageTime, {self.state_ticket})

    def shown(self, context: Context) -> Exposure | None:
        """The exposure whose image is shown, None before the first."""
        held: Any = context.get_abstract_state(int(self._queue))
        return held.get_value().shown

    def pan_tilt(self, context: Context) -> tuple[float, float]:
        """Pan and tilt [rad] of the camera at its exposure; zero unless a subclass knows them."""
        return 0.0, 0.0

    def _CalcImageTime(self, context: Context, output: BasicVector) -> None:
        exposure = self.shown(context)
        output.SetFromVector(np.array([np.nan if exposure is None else exposure.time]))

    def _Expose(self, context: Context, state: State) -> None:
        query = eval_typed(self, context, "geometry_query", QueryObject)
        held: Any = state.get_mutable_abstract_state(int(self._queue))
        queue: ExposureQueue = held.get_value()
        X_WP = self._body.parent_pose(query)
        poses, pan_tilt = self._body.other_poses(query), self.pan_tilt(context)
        held.set_value(queue.exposed(Exposure(context.get_time(), queue.count, X_WP, poses, pan_tilt)))

    def _Deliver(self, context: Context, state: State) -> None:
        held: Any = state.get_mutable_abstract_state(int(self._queue))
        held.set_value(held.get_value().delivered(context.get_time() - self._latency + self._tolerance))
