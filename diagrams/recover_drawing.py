"""A recovery as the source draws it (Fig. 3.2-2 and 3.2-3, b and c): w_e against w_ref, d, and what keeps it safe."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .recover_metrics import COLUMNS

_AXES = (("x", "#c0392b"), ("y", "#1e8449"), ("z", "#2860a8"))


def draw_recovery(rows: np.ndarray) -> Figure:
    """Draws the rows of a `RecoverScript`, (N, len(COLUMNS)).

    Above: position and attitude of the control point in the frame of the segment's reference point, solid as measured
    and dashed as wanted. Below: distance d of the segment's middle from its target, then the margins of joints and
    against tipping over, and the motion of the head.
    """
    table = dict(zip(COLUMNS, rows.T, strict=True))
    time = table["time_s"] - table["time_s"][0]
    # Several attempts may follow each other; lines must not cross the time between them.
    gaps = np.flatnonzero(np.diff(time) > 0.5) + 1
    time = np.insert(time, gaps, np.nan)

    def line(axis: Axes, name: str, scale: float, **style: object) -> None:
        axis.plot(time, scale * np.insert(table[name], gaps, np.nan), **style)  # type: ignore[arg-type]

    figure = Figure(figsize=(10.5, 6.4), layout="constrained")
    (position, attitude), (distance, safety) = figure.subplots(2, 2, sharex=True)
    for axis, unit, scale, prefix in ((position, "m", 1.0, ""), (attitude, "rad", 180 / np.pi, "r")):
        for name, colour in _AXES:
            line(axis, f"control_{prefix}{name}_{unit}", scale, color=colour, lw=1.6, label=f"$w_e$ {name}")
            line(axis, f"reference_{prefix}{name}_{unit}", scale, color="k", lw=1.1, ls=(0, (4, 3)))
        axis.plot([], [], color="k", lw=1.1, ls=(0, (4, 3)), label="$w_{ref}$")
        axis.legend(fontsize=8, ncols=4)
    line(distance, "target_distance_m", 1e3, color="#7d3c98", lw=1.8)
    line(safety, "tip_margin_m", 1e3, color="#2860a8", label="tip-over margin [mm]")
    line(safety, "limit_margin_rad", 180 / np.pi, color="#c0392b", label="margin of the joints [deg]")
    line(safety, "head_motion_m", 1e3, color="k", label="motion of the head [mm]")
    safety.legend(fontsize=8)
    position.set(title="control point: position in the segment's frame", ylabel="[m]")
    attitude.set(title="control point: rotation vector", ylabel="[deg]")
    distance.set(title="distance d of the middle from its target", ylabel="[mm]", xlabel="time [s]")
    safety.set(title="margins and head", xlabel="time [s]")
    distance.set_ylim(bottom=0.0)
    for axis in figure.axes:
        axis.grid(alpha=0.3)
    return figure
