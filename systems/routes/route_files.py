"""routes.csv: routes for other programs, and read back on the map that they were made on (S0-i)."""

import csv
import os
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import replacing
from .route import Route
from .route_grid import RouteGrid

_HEAD = "# naraha routes, grid "
_POINT = ("x_m", "y_m", "z_m")
_VALUES = ("time_s", "clearance_m", "dose", "steepest_rad", "tilt_rad", "confidence", "cost")
_COLUMNS = ("route", "point", *_POINT, "length_m", *_VALUES, "signature", "sides")


class RouteFileError(InputError):
    """A file of routes cannot be read, or its routes were made on another map."""


def write_routes(path: str | os.PathLike[str], routes: tuple[Route, ...], grid: RouteGrid) -> None:
    """Writes a line for every point of every route, numbered from 0, with the route's values repeated on each.

    The first line holds the fingerprint of the grid.
    """
    with replacing(Path(path)) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        file.write(f"{_HEAD}{grid.fingerprint}\n")
        table = csv.writer(file, lineterminator="\n")
        table.writerow(_COLUMNS)
        for number, route in enumerate(routes):
            words = [" ".join(map(str, route.signature)), "; ".join(route.sides)]
            values = [repr(float(getattr(route, name))) for name in ("length_m", *_VALUES)]
            for point, place in enumerate(np.column_stack([route.xy, route.z])):
                table.writerow([number, point, *(repr(float(v)) for v in place), *values, *words])


def read_routes(path: str | os.PathLike[str], grid: RouteGrid | None = None) -> tuple[Route, ...]:
    """Reads routes as `write_routes` wrote them.

    Args:
        grid: that the routes are to be driven on; not compared when not given.

    Raises:
        RouteFileError: no such file, not a file of routes, a bad line, or made on another map than `grid`.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise RouteFileError(f"cannot be read ({error.strerror})", where=path) from None
    except UnicodeDecodeError:
        raise RouteFileError("not a text file", where=path) from None
    if len(lines) < 2 or not lines[0].startswith(_HEAD) or lines[1] != ",".join(_COLUMNS):
        raise RouteFileError("not a file of routes", where=path, valid=f"{_HEAD.strip()} ..., {', '.join(_COLUMNS)}")
    fingerprint = lines[0].removeprefix(_HEAD).strip()
    if grid is not None and fingerprint != grid.fingerprint:
        valid = f"grid {grid.fingerprint}"
        raise RouteFileError("the routes were made on another map", where=path, value=fingerprint, valid=valid)
    rows: dict[int, list[dict[str, str]]] = {}
    for number, words in enumerate(csv.reader(lines[2:]), start=3):
        if len(words) != len(_COLUMNS):
            key = f"line {number}"
            raise RouteFileError("wrong number of columns", where=path, key=key, value=len(words), valid=len(_COLUMNS))
        row = dict(zip(_COLUMNS, words, strict=True))
        try:
            for name in ("route", "point"):
                int(row[name])
            for name in (*_POINT, *_VALUES):
                float(row[name])
            [int(word) for word in row["signature"].split()]
        except ValueError as error:
            raise RouteFileError(f"bad value: {error}", where=path, key=f"line {number}") from None
        rows.setdefault(int(row["route"]), []).append(row)
    return tuple(_route(path, rows[number]) for number in sorted(rows))


def _route(path: Path, rows: list[dict[str, str]]) -> Route:
    rows = sorted(rows, key=lambda row: int(row["point"]))
    first = rows[0]
    places = np.array([[float(row[name]) for name in _POINT] for row in rows])
    try:
        return Route(
            xy=places[:, :2],
            z=places[:, 2],
            **{name: float(first[name]) for name in _VALUES},
            signature=tuple(int(word) for word in first["signature"].split()),
            sides=tuple(word for word in first["sides"].split("; ") if word),
        )
    except InputError as error:
        raise RouteFileError(f"route {first['route']}: {error}", where=path) from None
