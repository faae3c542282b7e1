"""The tables that `naraha illuminate` leaves."""

import csv
from pathlib import Path

import numpy as np
from naraha.systems.files import replacing
from naraha.systems.placement import FloorPlan
from naraha.systems.sensing import IlluminanceField

from .illuminate_log import RunRecord
from .illuminate_station import MeasuringRoute


def write_points(path: Path, record: RunRecord) -> None:
    """Writes a line for every measuring point in the order of the route: asked, reached, measured, error, lux.

    What was not measured stays empty. `believed` is where the robot thought to be, `true` where the meter was.
    """
    columns = ["point", "asked_x_m", "asked_y_m", "reached", "believed_x_m", "believed_y_m", "true_x_m", "true_y_m"]
    columns += ["error_m", "illuminance_lux", "deviation_lux", "readings", "true_illuminance_lux", "time_s"]
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(columns)
        for p in record.points:
            row: list[object] = [p.point, *_metres(p.asked), p.measured is not None]
            if p.measured is not None:
                m = p.measured
                row += [*_metres((m.x, m.y)), *_metres(p.true), f"{p.error:.4f}", f"{m.illuminance:.2f}"]
                row += [f"{m.deviation:.2f}", m.readings, f"{p.true_illuminance:.2f}", f"{m.time:.1f}"]
            table.writerow(row + [""] * (len(columns) - len(row)))


def write_track(path: Path, record: RunRecord) -> None:
    """Writes a line a tenth of a second: true and believed pose, error, standard deviation and health."""
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        poses = [f"{kind}_{axis}" for kind in ("true", "believed") for axis in ("x_m", "y_m", "heading_rad")]
        table.writerow(["time_s", *poses, "error_m", "deviation_m", "health"])
        for row, error, deviation in zip(record.track, record.slam_errors, record.deviation, strict=True):
            table.writerow([f"{value:.4f}" for value in (*row[:7], error, deviation, row[7])])


def write_light(path: Path, places: np.ndarray, values: np.ndarray) -> None:
    """Writes what the map of the illuminance is made from, a line a value (n,) [lux], with its place (n, 2) [m]."""
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["x_m", "y_m", "illuminance_lux"])
        table.writerows([*_metres(place), f"{value:.2f}"] for place, value in zip(places, values, strict=True))


def write_route(path: Path, way: MeasuringRoute) -> None:
    """Writes the route, a line a point: x, y, and the measuring point that it is, if any."""
    point_at = dict(zip(way.stops.tolist(), way.points.tolist(), strict=True))
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["x_m", "y_m", "point"])
        for i, xy in enumerate(way.route.tolist()):
            table.writerow([*_metres(xy), point_at.get(i, "")])


def write_landmarks(path: Path, way: MeasuringRoute) -> None:
    """Writes where boxes are to be put up, a line a box."""
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["x_m", "y_m"])
        table.writerows(_metres(xy) for xy in way.sites.tolist())


def map_points(plan: FloorPlan, spacing: float) -> np.ndarray:
    """Points of a grid on the plan's free floor, (m, 2) [m]."""
    xs, ys = (plan.origin[i] + np.arange(spacing / 2, plan.size[i], spacing) for i in range(2))
    points: np.ndarray = np.stack(np.meshgrid(xs, ys, indexing="xy"), axis=-1).reshape(-1, 2)
    return points[~plan.is_occupied(points)]


def write_map(path: Path, plan: FloorPlan, field: IlluminanceField, spacing: float) -> None:
    """Writes expected illuminance and its standard deviation on a grid of `spacing` [m]."""
    points = map_points(plan, spacing)
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["x_m", "y_m", "illuminance_lux", "deviation_lux"])
        for (x, y), mean, deviation in zip(points.tolist(), *field.at(points), strict=True):
            table.writerow([f"{x:.2f}", f"{y:.2f}", f"{mean:.1f}", f"{deviation:.1f}"])


def _metres(xy: object) -> list[str]:
    return [f"{float(value):.4f}" for value in xy]  # type: ignore[attr-defined]
