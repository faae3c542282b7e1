"""Pictures of planning and measuring: the hall with topology, landmarks, sites and route; evolution; illuminance."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from naraha.systems.files import replacing
from naraha.systems.placement import FloorPlan, Placement, PlacementProblem, Round
from naraha.systems.sensing import IlluminanceField, Window

WALL, LINKS, LANDMARK, SITE, BOX = "0.25", "0.82", "tab:purple", "0.55", "tab:red"
ROUTE, POINT, TRUTH, BELIEF, WINDOW = "tab:green", "tab:blue", "0.1", "tab:orange", "deepskyblue"


def save_figure(figure: Figure, path: Path, *, dpi: int = 110) -> None:
    """Writes a figure; its kind is that of the suffix."""
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=dpi)


def draw_hall(axes: Axes, plan: FloorPlan) -> None:
    """Draws the walls, from wall to wall at one scale."""
    for x0, y0, x1, y1 in plan.wall_boxes().tolist():
        axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, color=WALL, lw=0))
    low, high = plan.origin, plan.origin + plan.size
    margin = 0.02 * plan.size.max()
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal")
    axes.set(xlabel="x [m]", ylabel="y [m]")


def draw_placement(
    axes: Axes,
    problem: PlacementProblem,
    placement: Placement | None = None,
    *,
    track: np.ndarray | None = None,
    failed_at: np.ndarray | None = None,
    links: bool = True,
) -> None:
    """Draws topology, landmarks and sites of a plan, and the route and the boxes of a placement.

    Args:
        track: (t, 8) a run, as in `RunRecord`. failed_at: (2,) where it failed [m].
    """
    draw_hall(axes, problem.plan)
    nodes, side = problem.topology.nodes, problem.config.sites.side
    if links:
        axes.add_collection(LineCollection(list(nodes[problem.topology.links]), colors=LINKS, linewidths=0.6, zorder=0))
    axes.plot(*problem.landmarks.positions.T, "^", color=LANDMARK, ms=5, label="landmarks of the plan")
    axes.plot(*problem.sites.T, "s", mfc="none", mec=SITE, ms=4, label="sites")
    if placement is not None:
        for x, y in placement.sites.tolist():
            axes.add_patch(Rectangle((x - side / 2, y - side / 2), side, side, color=BOX, zorder=3))
        axes.plot(*placement.sites.T, "s", color=BOX, ms=5, label=f"{len(placement.sites)} added landmarks", zorder=3)
        axes.plot(*placement.route.T, "-", color=ROUTE, lw=1.2, label=f"route, {placement.length:.0f} m")
    if track is not None:
        axes.plot(*track[:, 1:3].T, "-", color=TRUTH, lw=1.0, label="driven")
        axes.plot(*track[:, 4:6].T, "-", color=BELIEF, lw=1.0, label="believed")
    axes.plot(*problem.points[1:].T, "o", color=POINT, ms=4, label="measuring points")
    axes.plot(*problem.points[0], ">", color=POINT, ms=7, label="start")
    if failed_at is not None:
        axes.plot(*failed_at, "x", color=BOX, ms=13, mew=3, label="failed here", zorder=4)


def draw_rounds(problem: PlacementProblem, rounds: Sequence[Round]) -> Figure:
    """A map of every round, as in the paper's Fig. 10 and 11: boxes, route, and where the run failed."""
    columns = min(3, max(1, len(rounds)))
    rows = max(1, -(-len(rounds) // columns))
    ratio = float(problem.plan.size[1] / problem.plan.size[0])
    figure = Figure(figsize=(5.2 * columns, (5.2 * ratio + 0.9) * rows + 0.4), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for i, axes in enumerate(grid):
        if i >= len(rounds):
            axes.set_axis_off()
            continue
        r = rounds[i]
        draw_placement(axes, problem, r.placement, failed_at=r.verification.where, links=False)
        seen = "succeeded" if r.verification.ok else "failed"
        head = f"round {i + 1} (at least {r.least}): {int(r.placement.chosen.sum())} landmarks, "
        axes.set_title(f"{head}{r.placement.length:.0f} m\n{seen}, error {r.verification.max_error:.2f} m", fontsize=9)
        axes.tick_params(labelsize=7)
        axes.set(xlabel="", ylabel="")
    handles, labels = grid[0].get_legend_handles_labels()
    named = {
        label: h for label, h in zip(labels, handles, strict=True) if "added" not in label and "route" not in label
    }
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=4, fontsize=8)
    return figure


def draw_evolution(rounds: Sequence[Round]) -> Figure:
    """Number of landmarks, length of the route and mean Eval by generation, as in the paper's Fig. 7 to 9.

    The generations of the rounds follow each other; a line stands where one ends, red where its run failed.
    """
    figure = Figure(figsize=(11, 3.2), layout="constrained")
    panels = figure.subplots(1, 3)
    names = ("added landmarks", "length of the route [m]", "mean Eval of the nodes")
    ends = np.cumsum([len(r.placement.curve) for r in rounds])
    curves = np.concatenate([r.placement.curve for r in rounds]) if rounds else np.zeros((0, 3))
    for axes, name, values in zip(panels, names, curves.T, strict=True):
        axes.plot(np.arange(1, len(values) + 1), values, color=ROUTE)
        for end, r in zip(ends, rounds, strict=True):
            axes.axvline(end, color=SITE if r.verification.ok else BOX, lw=0.8, ls="--")
        axes.set(xlabel="generation", title=name, ylim=(0, 1.08 * max(values.max(initial=0.0), 1e-6)))
    return figure


def draw_errors(problem: PlacementProblem, placement: Placement, track: np.ndarray | None = None) -> Figure:
    """The error that is expected along a route, what is allowed, and what a run (t, 8) has shown.

    A run is drawn over the length that it has driven, scaled to that of the route.
    """
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.subplots()
    poses, errors = problem.errors_along(placement.order, placement.chosen)
    steps = np.hypot(*np.diff(np.vstack([problem.points[:1], poses[:, :2]]), axis=0).T)
    along = np.cumsum(steps)
    axes.plot(along, errors, color=ROUTE, label="expected, largest")
    axes.axhline(problem.config.error_limit, color=BOX, ls="--", lw=1, label="allowed")
    if track is not None:
        driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track[:, 1:3], axis=0).T))])
        off = np.hypot(*(track[:, 4:6] - track[:, 1:3]).T)
        axes.plot(driven * min(1.0, along[-1] / max(driven[-1], 1e-9)), off, color=BELIEF, lw=1, label="of the run")
    axes.set(xlabel="along the route [m]", ylabel="error of the position [m]", ylim=(0, None))
    axes.legend(fontsize=8)
    return figure


def draw_illuminance(
    plan: FloorPlan, field: IlluminanceField, *, spacing: float = 0.5, windows: Sequence[Window] = ()
) -> Figure:
    """Maps of the illuminance between the places where it was measured and of its standard deviation [lux]."""
    ratio = float(plan.size[1] / plan.size[0])
    figure = Figure(figsize=(11, 5.0 * ratio + 1.0), layout="constrained")
    xs, ys = (plan.origin[i] + np.arange(spacing / 2, plan.size[i], spacing) for i in range(2))
    points = np.stack(np.meshgrid(xs, ys), axis=-1)
    free = ~plan.is_occupied(points)
    for axes, values, name in zip(
        figure.subplots(1, 2), field.at(points.reshape(-1, 2)), ("illuminance [lux]", "standard deviation [lux]"),
        strict=True,
    ):  # fmt: skip
        shown = np.where(free, values.reshape(free.shape), np.nan)
        picture = axes.pcolormesh(xs, ys, shown, cmap="inferno", shading="nearest", rasterized=True)
        draw_hall(axes, plan)
        for window in windows:
            yaw, half = np.deg2rad(window.yaw_deg), window.size[0] / 2
            along = half * np.array([-np.sin(yaw), np.cos(yaw)])
            ends = np.array(window.xyz[:2]) + np.outer([-1, 1], along)
            axes.plot(*ends.T, color=WINDOW, lw=4, solid_capstyle="butt")
        axes.plot(*field.points.T, "o", mfc="none", mec="w", ms=4)
        axes.set_title(name, fontsize=10)
        figure.colorbar(picture, ax=axes, shrink=0.8)
    return figure
