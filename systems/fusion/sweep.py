"""Where a narrow camera on a pan-tilt unit has to look to cover a wide view, and who makes it look there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..clouds import transform_points
from ..config import check_config, quantity
from ..errors import ConfigError, PortError
from ..sensing.camera_model import CameraModel


@dataclass(kw_only=True)
class SweepConfig:
    """The view to be covered, the camera that covers it, and how long it stays."""

    # [deg] Field of view of the depth camera (D415), which looks along the mount's x axis.
    fov_x_deg: float = quantity(69.4, unit="deg", above=0, high=170)
    fov_y_deg: float = quantity(42.5, unit="deg", above=0, high=170)
    # [deg] Field of view of the camera on the pan-tilt unit, square.
    camera_fov_deg: float = quantity(8.0, unit="deg", above=0, high=90)
    # [deg] From one position to the next; what is missing to the field of view is how much neighbours overlap.
    step_deg: float = quantity(7.0, unit="deg", above=0, high=90)
    # [deg] How much more than the view is covered on every side: cameras side by side see near things elsewhere.
    margin_deg: float = quantity(0.0, unit="deg", low=0, high=45)
    # [deg] Only rows whose tilt, downwards positive, is in this range: those that see the floor, for example.
    tilt_range_deg: list[float] = quantity([-90.0, 90.0], unit="deg", low=-90, high=90)
    # [s] How long it stays after it has arrived: more than the period of the camera, so that one exposure is surely at
    # rest, and than that of whoever looks for images.
    dwell: float = quantity(0.25, unit="s", above=0)
    # [deg] It has arrived when both encoders are this near.
    tolerance_deg: float = quantity(0.2, unit="deg", above=0)
    # [s] Interval at which the encoders are read.
    period: float = quantity(0.05, unit="s", above=0)


def plan_sweep(fov_x: float, fov_y: float, camera_fov: float, step: float, margin: float = 0.0) -> np.ndarray:
    """Pan and tilt of the positions from which a square camera covers a view, in the order of the shortest way.

    A view of `fov` is covered by a row of n images of `camera_fov` a `step` apart, (n − 1) step + camera_fov ≥ fov, so
    n = ceil((fov − camera_fov) / step) + 1 is the fewest, in each direction. The rows are as many on either side of
    the middle; what they reach too far is margin.

    An image at tilt t spans more pan, camera_fov / cos t, and its upper edge is the plane through the camera's x axis,
    whose elevation falls beside its middle: tan e = tan(t + camera_fov/2) cos Δpan. So does that of the view's edge,
    and with the numbers of the source (S0-a: 69.4° × 42.5°, 8°, 7°) 10 × 6 images cover every pixel.

    The way goes along one row and back along the next (boustrophedon): every move but the last is one step, and no way
    through all K positions has moves shorter than that.

    Args:
        fov_x, fov_y: the view, along the x axis of the mount [rad].
        camera_fov, step: [rad]; `step` may not be larger than `camera_fov`.
        margin: covered beyond the view on every side [rad].

    Returns:
        (K, 2) pan, left positive, and tilt, down positive [rad], from the upper left.

    Raises:
        ConfigError: images a step apart do not meet.
    """
    if not 0 < step <= camera_fov:
        raise ConfigError(
            "images do not meet", where="sweep", key="step", value=step, valid=f"0 < step <= {camera_fov}"
        )
    axes = []
    for fov in (fov_x, fov_y):
        count = 1 + max(0, int(np.ceil((fov + 2 * margin - camera_fov) / step - 1e-9)))
        axes.append((np.arange(count) - (count - 1) / 2) * step)
    pans, tilts = axes[0][::-1], axes[1]
    rows = [np.column_stack([pans[:: (-1) ** i], np.full(len(pans), tilt)]) for i, tilt in enumerate(tilts)]
    return np.vstack(rows)


def seam_error(
    camera: CameraModel,
    p_BP: np.ndarray,
    measured_p_BP: np.ndarray,
    X_BC: Sequence[RigidTransform],
    measured_X_BC: Sequence[RigidTransform],
) -> np.ndarray:
    """How far the images of two neighbouring tiles are from fitting together on the cloud [px], one value for each
    point and pair of tiles that both see it.

    A point at p is painted from the pixel at which its measured position falls with the measured pose of the camera;
    the error of a tile is the way from the true pixel to that one. The seam error is the length of the difference of
    the two tiles' errors: by so much one image is shifted against the other where they overlap.

    Args:
        p_BP, measured_p_BP: points, true and as the depth camera measured them, (N, 3) [m].
        X_BC, measured_X_BC: pose of the camera at every tile, true and as the encoders say.
    """
    errors, inside = [], []
    for X, measured_X in zip(X_BC, measured_X_BC, strict=True):
        uv, seen = camera.project(transform_points(X.inverse().GetAsMatrix4(), np.asarray(p_BP, float)))
        measured_uv, measured_seen = camera.project(
            transform_points(measured_X.inverse().GetAsMatrix4(), np.asarray(measured_p_BP, float))
        )
        errors.append(measured_uv - uv)
        inside.append(seen & measured_seen)
    found = [np.zeros(0)]
    for i in range(len(errors)):
        for j in range(i):
            both = inside[i] & inside[j]
            found.append(np.linalg.norm(errors[i][both] - errors[j][both], axis=1))
    return np.concatenate(found)


# Layout of the discrete state.
_POSITION, _DIRECTION, _ARRIVED, _SWEEPS = range(4)


class PanTiltSweep(LeafSystem):
    """
    .. pydrake_system::

        name: PanTiltSweep
        input_ports:
        - pan_tilt_angles
        output_ports:
        - pan_tilt_command
        - sweeps

    Makes a pan-tilt unit look at one position of `plan_sweep` after the other. It goes on when both encoders have been
    within the tolerance of the position for `dwell`, however long the unit takes; if it cannot get there, it waits. At
    the end it goes the same way back, so that no long way without images leads to the start.

    - `pan_tilt_angles` (2) [rad]: encoders, pan to the left and tilt downwards.
    - `pan_tilt_command` (2) [rad]: the position to look at.
    - `sweeps` (1): how often all positions have been looked at.

    Raises:
        ConfigError: a value of the configuration is out of range, or no position is left of the sweep.
        PortError: the input is not connected.
    """

    def __init__(self, config: SweepConfig | None = None):
        super().__init__()
        self._config = config = config or SweepConfig()
        check_config(config, where="PanTiltSweep")
        fields = (config.fov_x_deg, config.fov_y_deg, config.camera_fov_deg, config.step_deg, config.margin_deg)
        plan = plan_sweep(*np.deg2rad(fields))
        low, high = np.deg2rad(config.tilt_range_deg)
        self.positions = plan[(plan[:, 1] >= low - 1e-9) & (plan[:, 1] <= high + 1e-9)]
        if len(self.positions) == 0:
            tilts = np.rad2deg(np.unique(plan[:, 1])).round(1).tolist()
            raise ConfigError(
                "no row of the sweep is left",
                where="PanTiltSweep",
                key="tilt_range_deg",
                value=config.tilt_range_deg,
                valid=f"a range with one of {tilts} deg",
            )
        self.DeclareVectorInputPort("pan_tilt_angles", 2)
        self.DeclareDiscreteState(np.array([0.0, 1.0, -1.0, 0.0]))
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Step)
        self.DeclareVectorOutputPort("pan_tilt_command", 2, self._CalcCommand, {self.xd_ticket()})
        self.DeclareVectorOutputPort("sweeps", 1, self._CalcSweeps, {self.xd_ticket()})

    def _Step(self, context: Context, state: DiscreteValues) -> None:
        port = self.GetInputPort("pan_tilt_angles")
        if not port.HasValue(context):
            raise PortError("input port is not connected", where="PanTiltSweep.pan_tilt_angles", valid="2 angles")
        x = np.array(context.get_discrete_state_vector().value())
        off = np.abs(port.Eval(context) - self.positions[int(x[_POSITION])])
        now = context.get_time()
        if not (off <= np.deg2rad(self._config.tolerance_deg)).all():  # NaN, too
            x[_ARRIVED] = -1
        elif x[_ARRIVED] < 0:
            x[_ARRIVED] = now
        elif now - x[_ARRIVED] >= self._config.dwell - 1e-9:
            x[_ARRIVED] = -1
            onward = x[_POSITION] + x[_DIRECTION]
            if not 0 <= onward < len(self.positions):
                x[_SWEEPS] += 1
                x[_DIRECTION] *= -1
                onward = np.clip(x[_POSITION] + x[_DIRECTION], 0, len(self.positions) - 1)
            x[_POSITION] = onward
        state.get_mutable_vector(0).SetFromVector(x)

    def _CalcCommand(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.positions[int(context.get_discrete_state_vector()[_POSITION])])

    def _CalcSweeps(self, context: Context, output: BasicVector) -> None:
        output[0] = context.get_discrete_state_vector()[_SWEEPS]
