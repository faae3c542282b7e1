"""Policies as CSV, as the paper keeps them (row S0-i): written, and read back only onto the map that they are for."""

import json
import os
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..errors import InputError
from .motion_model import ACTIONS, HEADINGS
from .policy import RoutePolicy
from .route_grid import RouteGrid
from .route_task import RewardConfig

_TITLE = "# naraha route policy 1 "
_COLUMNS = ["ix", "iy", "heading", "x_m", "y_m", "theta_rad", *(f"q_{name}" for name in ACTIONS)]


class PolicyFileError(InputError):
    """A file of a policy cannot be read, or belongs to another map."""


def write_policy(path: str | os.PathLike[str], policy: RoutePolicy) -> None:
    """Writes a policy: a line that says what it is for, a header, a row for every free cell and heading.

    Columns: cell ix, iy and heading (of 45°), the same as x, y in M [m] and angle [rad], values of the four motions.
    """
    about = {
        "grid": policy.fingerprint,
        "shape": list(policy.free.shape),
        "origin_m": policy.origin.tolist(),
        "cell_m": policy.cell,
        "goal_m": list(policy.goal),
        "goal_radius_m": policy.goal_radius,
        "rewards": asdict(policy.rewards),
    }
    cells = np.argwhere(policy.free)
    ij = np.repeat(cells, HEADINGS, axis=0)
    heading = np.tile(np.arange(HEADINGS), len(cells))
    xy = policy.origin + (ij + 0.5) * policy.cell
    rows = np.column_stack([ij, heading, xy, heading * np.pi / 4, policy.q[policy.free].reshape(-1, 4)])
    form = ["%d", "%d", "%d", "%.4f", "%.4f", "%.5f", *["%.17g"] * 4]
    with Path(path).open("w", encoding="utf-8") as file:
        file.write(_TITLE + json.dumps(about) + "\n" + ",".join(_COLUMNS) + "\n")
        np.savetxt(file, rows, fmt=form, delimiter=",")


def read_policy(path: str | os.PathLike[str], grid: RouteGrid | None = None) -> RoutePolicy:
    """Reads what `write_policy` wrote, exactly.

    Args:
        grid: that the policy is to be used on; without it the map is not compared.

    Raises:
        PolicyFileError: no such file, not a policy, damaged, or made for another map than `grid`.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise PolicyFileError(f"cannot be read ({type(error).__name__})", where=path) from None
    first, _, rest = text.partition("\n")
    header, _, body = rest.partition("\n")
    if not first.startswith(_TITLE) or header.strip().split(",") != _COLUMNS:
        raise PolicyFileError(
            "is not a policy", where=path, valid=f"first line {_TITLE!r}, second {','.join(_COLUMNS)}"
        )
    try:
        policy = _parse(json.loads(first[len(_TITLE) :]), body)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise PolicyFileError(f"is damaged ({error})", where=path) from None
    if grid is not None and not policy.fits(grid):
        size = f"{policy.free.shape[0]}×{policy.free.shape[1]} cells from {policy.origin.tolist()} m"
        here = f"{grid.shape[0]}×{grid.shape[1]} cells from {grid.origin.tolist()} m, grid {grid.fingerprint}"
        raise PolicyFileError("is for another map", where=path, value=f"{size}, grid {policy.fingerprint}", valid=here)
    return policy


def _parse(about: dict, body: str) -> RoutePolicy:
    nx, ny = (int(n) for n in about["shape"])
    rows = np.loadtxt(body.splitlines(), delimiter=",", ndmin=2) if body.strip() else np.zeros((0, len(_COLUMNS)))
    if rows.shape[1] != len(_COLUMNS) or not np.isfinite(rows[:, :6]).all():
        raise ValueError(f"rows of {rows.shape[1]} numbers")
    i, j, heading = rows[:, :3].astype(int).T
    if (rows[:, :3] < 0).any() or (i >= nx).any() or (j >= ny).any() or (heading >= HEADINGS).any():
        raise ValueError("a cell outside the grid")
    q = np.zeros((nx, ny, HEADINGS, 4))
    counts = np.zeros((nx, ny), int)
    q[i, j, heading] = rows[:, 6:]
    np.add.at(counts, (i, j), 1)
    if not np.isin(counts, (0, HEADINGS)).all():
        raise ValueError("a cell without all its headings")
    q.flags.writeable = False
    x, y = (float(v) for v in about["goal_m"])
    return RoutePolicy(
        q,
        counts > 0,
        np.array(about["origin_m"], float),
        float(about["cell_m"]),
        (x, y),
        float(about["goal_radius_m"]),
        RewardConfig(**about["rewards"]),
        str(about["grid"]),
    )
