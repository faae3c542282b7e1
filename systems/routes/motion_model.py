"""What the four motions of the crawler lead to on the grid: where it ends, how likely, by kind of terrain.

State (x, y, θ) in cells and headings of 45°; motions forward, back, turn +45°, turn −45° (row S0-h, section 3.3.1).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .route_grid import TERRAINS

FORWARD, BACK, LEFT, RIGHT = range(4)
ACTIONS = ("forward", "back", "left", "right")
HEADINGS = 8
# Cell offsets (8, 2) of one step along each heading, counter-clockwise from +x.
STEPS = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]])
STEPS.flags.writeable = False


@dataclass(frozen=True, eq=False)
class MotionModel:
    """Outcomes of the four motions: with `probability`, the robot goes `cells` steps along heading + 45° `veer`
    and then has turned by 45° `turn`. A step along a diagonal heading is a diagonal step.

    Attributes:
        probability: (T, 4, O) float64 for T terrains (`TERRAINS`), 4 motions (`ACTIONS`), at most O outcomes;
            sums to 1 over the outcomes, 0 where there are fewer.
        cells: (T, 4, O) int64, not negative. veer, turn: (T, 4, O) int64 in steps of 45°, left positive.
    """

    probability: np.ndarray
    cells: np.ndarray
    veer: np.ndarray
    turn: np.ndarray

    def __post_init__(self) -> None:
        shape = self.probability.shape
        if len(shape) != 3 or shape[:2] != (len(TERRAINS), 4) or shape[2] == 0:
            raise InputError("wrong shape of outcomes", where="MotionModel", value=shape, valid="(4, 4, O)")
        for name in ("cells", "veer", "turn"):
            if getattr(self, name).shape != shape:
                raise InputError("does not fit probability", where="MotionModel", key=name, valid=str(shape))
        good = (self.probability >= 0).all() and np.allclose(self.probability.sum(axis=2), 1, atol=1e-9)
        if not good or (self.cells < 0).any():
            raise InputError("probabilities must add up to 1, and cells not be negative", where="MotionModel")
        for array in (self.probability, self.cells, self.veer, self.turn):
            array.flags.writeable = False

    @property
    def is_deterministic(self) -> bool:
        return bool((self.probability.max(axis=2) == 1).all())

    def outcomes(self, terrain: str, action: str) -> list[tuple[float, int, int, int]]:
        """(probability, cells, veer, turn) of every outcome that can happen, likeliest first."""
        t, a = TERRAINS.index(terrain), ACTIONS.index(action)
        rows = zip(*(getattr(self, name)[t, a].tolist() for name in ("probability", "cells", "veer", "turn")))  # noqa: B905
        return sorted((row for row in rows if row[0] > 0), reverse=True)


def deterministic() -> MotionModel:
    """Every motion does what it says: one step ahead or back, or 45° of turn."""
    return from_outcomes({"flat": {}})


def slipping(slip: float = 0.05, veer: float = 0.05) -> MotionModel:
    """An assumed spread for tests and first tries: a motion fails with `slip`, a step goes off to each side with
    `veer` / 2. Figures of a robot come from `from_primitives`."""
    straight = [(1 - slip - veer, 1, 0, 0), (slip, 0, 0, 0), (veer / 2, 1, 1, 0), (veer / 2, 1, -1, 0)]
    back = [(p, cells, 4 - side, turn) for p, cells, side, turn in straight]
    turns = {"left": [(1 - slip, 0, 0, 1), (slip, 0, 0, 0)], "right": [(1 - slip, 0, 0, -1), (slip, 0, 0, 0)]}
    return from_outcomes({"flat": {"forward": straight, "back": back, **turns}})


def from_outcomes(table: Mapping[str, Mapping[str, list[tuple[float, int, int, int]]]]) -> MotionModel:
    """Makes a model of lists of (probability, cells, veer, turn) by terrain and motion.

    A motion that is not listed does what it says; a terrain that is not listed is like "flat".

    Raises:
        InputError: a terrain or motion of another name, probabilities that do not add up to 1.
    """
    ideal = {"forward": (1.0, 1, 0, 0), "back": (1.0, 1, 4, 0), "left": (1.0, 0, 0, 1), "right": (1.0, 0, 0, -1)}
    for terrain, motions in table.items():
        if terrain not in TERRAINS:
            raise InputError("unknown terrain", where="MotionModel", value=terrain, valid=TERRAINS)
        for action in motions:
            if action not in ACTIONS:
                raise InputError("unknown motion", where="MotionModel", value=action, valid=ACTIONS)
    flat = table.get("flat", {})
    rows = [[list(table.get(t, flat).get(a, [ideal[a]])) for a in ACTIONS] for t in TERRAINS]
    width = max(len(outcomes) for motions in rows for outcomes in motions)
    full = np.array([[o + [(0.0, 0, 0, 0)] * (width - len(o)) for o in motions] for motions in rows])
    probability, cells, veer, turn = np.moveaxis(full, -1, 0)
    whole = (cells.astype(np.int64), veer.astype(np.int64), turn.astype(np.int64))
    return MotionModel(probability.copy(), *whole)


def from_primitives(
    measured: Mapping[str, Mapping[str, np.ndarray]], step: float, *, least: float = 0.005
) -> MotionModel:
    """Makes a model of motions measured in physics or on the robot.

    A sample between two cells or headings is shared between them in proportion, so that the mean displacement and
    turn are kept: a drift of a tenth of a cell a motion becomes a whole cell in one of ten.

    Args:
        measured: by terrain and motion, (N, 3) displacement ahead [m], to the left [m] and turn [rad], all seen from
            the pose at the start of the motion. A terrain that is not listed is like "flat".
        step: length that forward and back command along a straight heading, the edge of a cell [m].
        least: outcomes less likely than this are left out and the rest scaled up.

    Raises:
        InputError: no or not finite samples, unknown names, step not positive.
    """
    if not step > 0:
        raise InputError("step must be positive", where="from_primitives", value=step, valid="> 0 m")
    table: dict[str, dict[str, list[tuple[float, int, int, int]]]] = {}
    for terrain, motions in measured.items():
        table[terrain] = {}
        for action, values in motions.items():
            samples = np.asarray(values, float)
            if samples.ndim != 2 or samples.shape[1] != 3 or not len(samples) or not np.isfinite(samples).all():
                place = f"{terrain}.{action}"
                raise InputError("no usable samples", where="from_primitives", key=place, valid="(N, 3) finite")
            table[terrain][action] = _share(samples / np.array([step, step, np.pi / 4]), least)
    return from_outcomes(table)


def _share(samples: np.ndarray, least: float) -> list[tuple[float, int, int, int]]:
    """Outcomes of samples (N, 3) ahead [steps], left [steps], turn [45°], each shared between its 8 neighbours."""
    low = np.floor(samples + 1e-9)
    part = np.clip(samples - low, 0, 1)
    corners = np.array(list(np.ndindex(2, 2, 2)))
    shares = np.where(corners[:, None] == 1, part, 1 - part).prod(axis=2) / len(samples)
    places, which = np.unique((low + corners[:, None]).reshape(-1, 3).astype(int), axis=0, return_inverse=True)
    totals = np.bincount(which.ravel(), shares.ravel())
    weights: dict[tuple[int, int, int], float] = {}
    for (ahead, left, turn), weight in zip(places.tolist(), totals.tolist(), strict=True):
        cells = max(abs(ahead), abs(left))
        veer = round(float(np.arctan2(left, ahead) / (np.pi / 4))) if cells else 0
        weights[cells, veer, turn] = weights.get((cells, veer, turn), 0.0) + weight
    kept = {outcome: weight for outcome, weight in weights.items() if weight >= least}
    total = sum(kept.values())
    return [(weight / total, *outcome) for outcome, weight in sorted(kept.items(), key=lambda item: -item[1])]
