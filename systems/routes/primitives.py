"""What the four motions come to on each kind of ground, measured, as a file beside the robot's model (row S0-h)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..config import check_config, quantity
from ..config_files import read_config, write_config
from ..errors import ConfigError
from .motion_model import ACTIONS, MotionModel, from_primitives
from .route_grid import TERRAINS

# Draws from each normal distribution, half of them mirrored so that its mean is exact.
_DRAWS = 1000


@dataclass(kw_only=True)
class Outcome:
    """What one motion came to on one kind of ground.

    Ahead and left are seen from the heading of the grid that is nearest to the robot's at the start, and for a robot
    that stands along a diagonal of the grid they are divided by √2, as the step there is √2 times as long.
    """

    # Drives that were made, and the share of them that did not come to an end.
    trials: int = quantity(1, low=1)
    failed: float = quantity(0.0, unit="-", low=0, high=1)
    # [m, m, rad] Mean and covariance (rows) of way ahead, way to the left, and turn, of those that came to an end.
    mean: list[float] = quantity([0.0, 0.0, 0.0], unit="m, m, rad", min_length=3)
    covariance: list[list[float]] = field(default_factory=lambda: [[0.0] * 3 for _ in range(3)])
    # [s] Mean time. [-] Mean share of what the belts drove that the robot did not, negative when it did more, as tracks
    # turn more easily on a crest. [rad] Steepest tilt of all drives.
    time: float = quantity(0.0, unit="s", low=0)
    slip: float = quantity(0.0, unit="-")
    tilt: float = quantity(0.0, unit="rad", low=0)


@dataclass(kw_only=True)
class Ground:
    """The motions on one kind of ground, by their name (`ACTIONS`)."""

    # Kind of terrain of the grid (`TERRAINS`) that it stands for; several grounds of one kind count equally.
    terrain: str = quantity("flat", choices=TERRAINS)
    # [rad] or [m]: how steep or high it was.
    level: float = quantity(0.0, low=0)
    motions: dict[str, Outcome] = field(default_factory=dict)


@dataclass(kw_only=True)
class Primitives:
    """The motions of one robot."""

    robot: str = ""
    # How these numbers came about.
    source: str = ""
    # [m] Way that forward and back were to make.
    step: float = quantity(0.5, unit="m", above=0)
    grounds: dict[str, Ground] = field(default_factory=dict)


def outcome_of(samples: np.ndarray, ended: Sequence[bool], time: Sequence[float], slip: Sequence[float]) -> Outcome:
    """Statistics of drives, without their tilt.

    Args:
        samples: (N, 3) way ahead [m], to the left [m], turn [rad]. ended: (N,) whether the motion came to its end.
        time: (N,) [s]. slip: (N,) [-].
    """
    samples, good = np.asarray(samples, float), np.asarray(ended, bool)
    made = samples[good]
    mean = made.mean(axis=0) if len(made) else np.zeros(3)
    covariance = np.cov(made.T) if len(made) > 1 else np.zeros((3, 3))
    return Outcome(
        trials=len(samples),
        failed=round(float(1 - good.mean()), 4),
        mean=[round(float(value), 5) for value in mean],
        covariance=[[float(f"{value:.4g}") for value in row] for row in covariance],
        time=round(float(np.mean(np.asarray(time)[good])) if len(made) else 0.0, 3),
        slip=round(float(np.mean(np.asarray(slip)[good])) if len(made) else 0.0, 4),
    )


def motion_model(primitives: Primitives, cell: float, *, least: float = 0.005) -> MotionModel:
    """The spread of outcomes on a grid with cells of edge `cell` [m] that follows from measured motions.

    A motion that did not come to its end is taken to have led nowhere. For a cell of another size than the measured
    step, steps and their errors are taken in proportion; how far a turn slides does not depend on the cell.

    Args:
        least: outcomes less likely than this are left out.
    """
    rng = np.random.default_rng(0)
    standard = rng.standard_normal((_DRAWS // 2, 3))
    standard = np.vstack([standard, -standard])
    samples: dict[str, dict[str, list[np.ndarray]]] = {}
    for ground in primitives.grounds.values():
        for action, outcome in ground.motions.items():
            values, vectors = np.linalg.eigh(np.array(outcome.covariance))
            root = vectors * np.sqrt(np.maximum(values, 0.0))
            share = cell / primitives.step if action in ("forward", "back") else 1.0
            drawn = (np.array(outcome.mean) + standard @ root.T) * np.array([share, share, 1.0])
            drawn[: round(outcome.failed * _DRAWS)] = 0.0
            samples.setdefault(ground.terrain, {}).setdefault(action, []).append(rng.permutation(drawn))
    joined = {terrain: {a: np.vstack(rows) for a, rows in motions.items()} for terrain, motions in samples.items()}
    return from_primitives(joined, cell, least=least)


def read_primitives(path: Path) -> Primitives:
    """Reads and checks measured motions.

    Raises:
        ConfigError: no such file, not YAML, an unknown key, a value out of range.
    """
    primitives = read_config(path, Primitives, "not measured motions")
    check_primitives(primitives, where=path)
    return primitives


def write_primitives(path: Path, primitives: Primitives) -> None:
    """Writes measured motions that `read_primitives` reads back to the same."""
    write_config(path, primitives)


def check_primitives(primitives: Primitives, *, where: object = "primitives") -> None:
    """Raises `ConfigError` for the first value that cannot be used."""
    check_config(primitives, where=where)
    for name, ground in primitives.grounds.items():
        for action, outcome in ground.motions.items():
            key = f"grounds.{name}.motions.{action}"
            if action not in ACTIONS:
                raise ConfigError("unknown motion", where=where, key=key, value=action, valid=ACTIONS)
            if len(outcome.mean) != 3:
                raise ConfigError("wrong length", where=where, key=f"{key}.mean", valid="ahead, left, turn")
            try:
                covariance = np.array(outcome.covariance, float)
            except ValueError:
                covariance = np.zeros(0)
            good = covariance.shape == (3, 3) and np.isfinite(covariance).all()
            if not (good and np.allclose(covariance, covariance.T) and np.linalg.eigvalsh(covariance)[0] > -1e-9):
                raise ConfigError("not a covariance", where=where, key=f"{key}.covariance", valid="symmetric 3 × 3")
