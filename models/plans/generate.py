"""Generates the floor plans that come out of a seed: `python -m naraha.models.plans.generate` writes them anew."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import yaml

FOLDER = Path(__file__).parent


def gallery(seed: int = 0) -> dict[str, Any]:
    """Three bare rooms in a row, 56 × 18 m, with a door of 3 m between two of them somewhere, and 12 points."""
    rng = np.random.default_rng(seed)
    length, width = 56.0, 18.0
    walls = [_outline(length, width)]
    borders = [0.0, *(round(float(x), 1) for x in np.array([19.0, 37.0]) + rng.uniform(-2, 2, 2)), length]
    for x in borders[1:-1]:
        low = round(float(rng.uniform(3, width - 6)), 1)
        walls += [[[x, 0.1], [x, low]], [[x, low + 3.0], [x, width - 0.1]]]
    points = []
    for left, right in itertools.pairwise(borders):
        for x in (left + 4.5, right - 4.5):
            points += [[round(x, 2), 4.5], [round(x, 2), width - 4.5]]
    return _plan("Three bare rooms in a row", length, width, walls, [], [2.0, 9.0, 0.0], points)


def workshop(seed: int = 0) -> dict[str, Any]:
    """A hall of 44 × 28 m whose left half is full of machines and whose right half is bare, with 12 points."""
    rng = np.random.default_rng(seed)
    length, width = 44.0, 28.0
    points = [[x, y] for y in (4.5, 14.0, 23.5) for x in (5.0, 16.0, 28.0, 38.5)]
    start = [2.0, 2.0, 0.0]
    machines: list[tuple[float, float, float, float]] = []
    while len(machines) < 7:
        wide, deep = np.round(rng.uniform([1.5, 1.2], [4.5, 3.0]), 1)
        x, y = np.round(rng.uniform([3, 3], [length / 2 - wide, width - 3 - deep]), 1)
        box = (float(x), float(y), float(x + wide), float(y + deep))
        if all(_gap(box, (*p, *p)) > 2.0 for p in [start[:2], *points]) and all(_gap(box, m) > 2.5 for m in machines):
            machines.append(box)
    solids = [[[a, b], [c, b], [c, d], [a, d]] for a, b, c, d in np.round(machines, 1).tolist()]
    return _plan("A hall, half full of machines", length, width, [_outline(length, width)], solids, start, points)


GENERATED = {"gallery": gallery, "workshop": workshop}


def _outline(length: float, width: float) -> list[list[float]]:
    x, y = length - 0.1, width - 0.1
    return [[0.1, 0.1], [x, 0.1], [x, y], [0.1, y], [0.1, 0.1]]


def _gap(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """Distance of two boxes x0, y0, x1, y1."""
    return float(np.hypot(max(a[0] - b[2], b[0] - a[2], 0.0), max(a[1] - b[3], b[1] - a[3], 0.0)))


def _plan(
    title: str, length: float, width: float, walls: list[Any], solids: list[Any], start: list[float], points: list[Any]
) -> dict[str, Any]:
    keys = {"size": [length, width], "wall_thickness": 0.2, "resolution": 0.05, "walls": walls, "solids": solids}
    return {"title": title, **keys, "start": start, "measuring_points": points}


def as_yaml(plan: dict[str, Any], builder: str) -> str:
    """The text of a plan's file."""
    values = {key: value for key, value in plan.items() if key != "title"}
    head = f"# {plan['title']}; written by `python -m naraha.models.plans.generate` ({builder}, seed 0).\n"
    return head + yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=100)


if __name__ == "__main__":
    for name, build in GENERATED.items():
        (FOLDER / f"{name}.yaml").write_text(as_yaml(build(), name))
