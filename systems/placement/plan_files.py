"""Floor plans in YAML: walls as polylines, or an image with its scale."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydrake.common.yaml import yaml_load_data, yaml_load_typed

from ..config import check_config, quantity
from ..errors import InputError, PlanError
from .floor_plan import FloorPlan, plan_from_image, plan_from_walls


@dataclass(kw_only=True)
class PlanFile:
    """A floor plan as it stands in a YAML file: either `size` and `walls`, or `image` and `resolution`."""

    # [m] Polylines x, y of the walls' middle lines; one whose last point is its first is closed.
    walls: list[list[list[float]]] = field(default_factory=list)
    # [m] Closed polygons x, y of what is solid, such as pillars; filled, and walled along their sides.
    solids: list[list[list[float]]] = field(default_factory=list)
    # [m] Extent along x and y, from the origin of W.
    size: list[float] = quantity([], unit="m", above=0)
    # [m] Half of it on either side of a wall's middle line.
    wall_thickness: float = quantity(0.2, unit="m", above=0)
    # An image beside the file: dark is wall, the lower edge is at the smallest y.
    image: str = ""
    # [m] Side of a cell, or of a pixel: of an image the scale, which must be given.
    resolution: float | None = quantity(None, unit="m", above=0)
    # [m] Lower left corner of an image in W.
    origin: list[float] = quantity([0.0, 0.0], unit="m")
    # [m, m, rad] Pose that the robot starts from.
    start: list[float] = quantity([], unit="m, m, rad")
    # [m] Places x, y to measure at.
    measuring_points: list[list[float]] = field(default_factory=list)


def read_floor_plan(path: Path) -> FloorPlan:
    """Reads a plan from a YAML file and checks it.

    Raises:
        PlanError, ConfigError: one line that names file, key and valid values: no such file, an unknown key, an image
            without scale, a point in a wall or without a way to it.
    """
    if path.suffix.lower() not in (".yaml", ".yml"):
        keys = "a YAML file with image, resolution, start and measuring_points"
        raise PlanError("a plan without scale", where=path, valid=keys)
    file = _read(path)
    check_config(file, where=path)
    start = _array(path, "start", file.start, (3,))
    points = _array(path, "measuring_points", file.measuring_points, (-1, 2))
    if file.image:
        corner = _array(path, "origin", file.origin, (2,))
        plan = plan_from_image(path.parent / file.image, file.resolution, start, points, origin=corner)
    else:
        size = _array(path, "size", file.size, (2,))
        walls = [_array(path, f"walls[{i}]", wall, (-1, 2)) for i, wall in enumerate(file.walls)]
        solids = [_array(path, f"solids[{i}]", solid, (-1, 2)) for i, solid in enumerate(file.solids)]
        if not walls and not solids:
            raise PlanError("no wall and no image", where=path, key="walls", valid="polylines x, y [m]")
        closed = [np.vstack([solid, solid[:1]]) for solid in solids]
        segments = [np.stack([line[:-1], line[1:]], axis=1) for line in (*walls, *closed)]
        try:
            plan = plan_from_walls(
                np.concatenate(segments),
                size,
                start,
                points,
                thickness=file.wall_thickness,
                resolution=file.resolution or 0.05,
                outlines=solids,
            )
        except PlanError as error:
            raise PlanError("no plan of that size", where=path, key=error.key, value=error.value) from None
    plan.check(where=path)
    return plan


def _read(path: Path) -> PlanFile:
    try:
        text = path.read_text()
        data: Any = yaml_load_data(text)
        if not isinstance(data, dict):
            raise ValueError("not a mapping")
        unknown = [key for key in data if key not in PlanFile.__dataclass_fields__]
        if unknown:
            raise PlanError("unknown key", where=path, key=str(unknown[0]), valid=sorted(PlanFile.__dataclass_fields__))
        file: PlanFile = yaml_load_typed(schema=PlanFile, data=text)
    except InputError:
        raise
    except OSError as error:
        raise PlanError(error.strerror or "cannot be read", where=path) from None
    except (yaml.YAMLError, ValueError, RuntimeError, TypeError, KeyError) as error:
        raise PlanError(f"not a floor plan: {' '.join(str(error).split())}", where=path) from None
    return file


def _array(path: Path, key: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """`value` as an array of `shape`, in which -1 is any number that is not 0. Raises `PlanError`."""
    words = {(3,): "x, y, heading [m, m, rad]", (2,): "x, y [m]", (-1, 2): "a list of x, y [m]"}[shape]
    try:
        array = np.array(value, float)
    except (TypeError, ValueError):
        raise PlanError("not numbers", where=path, key=key, valid=words) from None
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or not array.size or not np.isfinite(array).all():
        raise PlanError("missing or of the wrong shape", where=path, key=key, value=value or None, valid=words)
    return array
