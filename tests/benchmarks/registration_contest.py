"""How a contest of registrations is run and reported; ours behind the peers' signature."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from naraha.systems.registration import METHODS, RegistrationConfig, register
from naraha.systems.registration.coarse import find_pose
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RotationMatrix

from .registration_peers import Matrix, Peer
from .registration_scenes import Pair
from .report import print_table

# To whose time all others are compared.
YARDSTICK = "small_gicp_gicp"


@dataclass(frozen=True)
class Limits:
    """A registration succeeded if it is off by less than this [m], [deg]."""

    metres: float
    degrees: float


@dataclass(frozen=True, eq=False)
class Scores:
    """What one contestant reached: an entry a pair of errors [m], [deg] and times [s], arrays (N,)."""

    metres: np.ndarray
    degrees: np.ndarray
    seconds: np.ndarray

    def successes(self, limits: Limits) -> np.ndarray:
        return (self.metres < limits.metres) & (self.degrees < limits.degrees)


def as_pose(matrix: Matrix) -> RigidTransform:
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(matrix[:3, :3]), matrix[:3, 3])


def ours() -> dict[str, Peer]:
    """Our registrations that start at a guess, behind the peers' signature."""

    def method(name: str) -> Peer:
        config = RegistrationConfig(method=name)

        def align(source: PointCloud, target: PointCloud, guess: Matrix) -> Matrix:
            return register(source, target, as_pose(guess), config).X_TS.GetAsMatrix4()

        return align

    names = {"naraha": "surfaces", "naraha_attributes": "attributes"}
    return {name: method(kind) for name, kind in names.items() if kind in METHODS}


def our_global() -> dict[str, Peer]:
    """Our alignments that need no guess: the search, and the search with a registration at the end."""

    def search(source: PointCloud, target: PointCloud, guess: Matrix) -> Matrix:
        found = find_pose(source, target)
        return found[0].X_TS.GetAsMatrix4() if found else guess

    def search_and_register(source: PointCloud, target: PointCloud, guess: Matrix) -> Matrix:
        found = find_pose(source, target)
        return register(source, target, found[0].X_TS).X_TS.GetAsMatrix4() if found else guess

    return {"naraha": search_and_register, "naraha_search": search}


def errors(X: Matrix, X_true: RigidTransform) -> tuple[float, float]:
    """Distance [m] and angle [deg] between a found pose and the true one; infinite where X is no pose."""
    if not np.isfinite(X).all():
        return float("inf"), float("inf")
    difference = X_true.inverse().GetAsMatrix4() @ X
    turn = RotationMatrix.ProjectToRotationMatrix(difference[:3, :3]).ToAngleAxis().angle()
    return float(np.linalg.norm(difference[:3, 3])), float(np.rad2deg(abs(turn)))


def run_in_turns(contestants: Mapping[str, Peer], pairs: Sequence[Pair]) -> dict[str, Scores]:
    """Every contestant on every pair; pair by pair, so that what else the machine does falls on all of them.

    The first call of each, which may compile, does not count.
    """
    results: dict[str, list[tuple[float, float, float]]] = {name: [] for name in contestants}
    for align in contestants.values():
        align(pairs[0].source, pairs[0].target, pairs[0].X_TS_guess.GetAsMatrix4())
    for pair in pairs:
        for name, align in contestants.items():
            guess = pair.X_TS_guess.GetAsMatrix4()
            start = time.perf_counter()
            X = align(pair.source, pair.target, guess)
            seconds = time.perf_counter() - start
            results[name].append((*errors(np.asarray(X), pair.X_TS), seconds))
    return {name: Scores(*np.array(rows).T) for name, rows in results.items()}


def report(scene: str, title: str, scores: Mapping[str, Scores], pairs: Sequence[Pair], limits: Limits) -> dict:
    """Prints the table of one set of pairs and returns its numbers under flat keys."""
    counted = np.array([not pair.ill_posed for pair in pairs])
    yardstick = np.median(scores[YARDSTICK].seconds) if YARDSTICK in scores else float("nan")
    rows, values = [], {}
    for name, score in scores.items():
        good = score.successes(limits)[counted]
        metres, degrees = score.metres[counted], score.degrees[counted]
        milliseconds = 1e3 * float(np.median(score.seconds))
        found = {
            "success": int(good.sum()),
            "counted": int(counted.sum()),
            "median_mm": 1e3 * float(np.median(metres)),
            "median_deg": float(np.median(degrees)),
            "worst_mm": 1e3 * float(metres.max()),
            "worst_deg": float(degrees.max()),
            "ms": milliseconds,
            "times_as_fast": 1e3 * float(yardstick) / milliseconds,
        }
        values |= {f"{scene}_{name}_{key}": value for key, value in found.items()}
        successes = f"{found['success']}/{found['counted']}"
        rows.append((name, successes, *(found[key] for key in list(found)[2:])))
    columns = ("", "success", "median mm", "median deg", "worst mm", "worst deg", "median ms", f"× {YARDSTICK}")
    print_table(f"{title}; success: {limits.metres:g} m, {limits.degrees:g} deg", columns, rows)
    return values


def report_pairs(scores: Mapping[str, Scores], pairs: Sequence[Pair]) -> None:
    """Prints the error of everyone [mm] on every pair."""
    rows = [
        (f"{i}{' (ill-posed)' if pair.ill_posed else ''}", *(1e3 * float(s.metres[i]) for s in scores.values()))
        for i, pair in enumerate(pairs)
    ]
    print_table("error of every pair [mm]", ("pair", *scores), rows)
