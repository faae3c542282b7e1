"""2D localisation: error, honesty of the covariance and time per scan; maps of real logs with their loops closed.

`rooms`: a drive in a room, along a bare corridor, and both while mapping, in closed form, by ours and by the evolution
strategy of the paper. Errors against truth; `nees`: eᵀ P⁻¹ e over its degrees of freedom, 1 where the covariance is
honest, more where it promises too much; `health`: fitness in [0, 1].

`fr079`, `intel`: logs of Radish. They come without truth, so three things are said of each trajectory (raw odometry,
localiser alone, graph): entropy of the map in bits (a blurred map has more); the errors at loops, relative poses found
by matching scans of one visit to submaps of another, those that were believed and are sure of their position to 10 cm;
and, for the graph, these errors at the loops of one half of the keyframes when only those of the other half are in it.
Time is that of one core, all included.
"""

import argparse
import itertools
import statistics
import time
from pathlib import Path

import numpy as np
from naraha.systems.localization import (
    GraphMapper,
    LocalizerConfig,
    OccupancyGrid,
    localize,
    read_carmen_log,
    start_localization,
)
from naraha.systems.localization.planar import between, difference, from_matrix
from naraha.systems.pose_graph import optimize

from ..localization.rooms import corridor, drive, noisy_odometry, rasterised, room, scan_in
from .report import print_table, use_one_core, write_json

LOGS = Path(__file__).parents[3] / "shared" / "data" / "radish"
DRIVES = {
    "room": (room(), [4, 1.2, 0], [[0.05, 0.0, 0.036]] * 180),
    "corridor": (corridor(), [0, 0.2, 0], [[0.1, 0.0, 0.0]] * 300),
}


def in_rooms(name: str, method: str, mapping: bool, seeds: int) -> dict[str, float]:
    walls, start, steps = DRIVES[name]
    config = LocalizerConfig(method=method, mapping=mapping)
    occupied, origin = rasterised(walls)
    errors, values, health, times = [], [], [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        truth, odometry = drive(start, steps), noisy_odometry(steps, rng, config.odometry)
        grid = None if mapping else OccupancyGrid.from_plan(occupied, 0.05, origin)
        known = start_localization(config, grid, truth[0])
        for k, (X, X_OB) in enumerate(zip(truth, odometry, strict=True)):
            scan = scan_in(walls, X, rng, time=0.1 * k, index=k)
            began = time.process_time()
            known = localize(known, scan, X_OB, config, seed=seed)
            times.append(time.process_time() - began)
            e = difference(X, known.pose)
            errors.append(e)
            values.append(e @ np.linalg.solve(known.covariance, e) / 3)
            health.append(known.health)
    distance = np.linalg.norm(np.array(errors)[:, :2], axis=1)
    return {
        "position_rms_m": float(np.sqrt(np.mean(distance**2))),
        "position_max_m": float(distance.max()),
        "heading_rms_deg": float(np.degrees(np.sqrt(np.mean(np.square(errors)[:, 2])))),
        "nees": float(np.mean(values)),
        "health_median": float(np.median(health)),
        "ms_per_scan": 1e3 * statistics.median(times),
    }


def is_sure(information: np.ndarray) -> bool:
    """Whether a loop knows its position to 10 cm."""
    return bool(np.linalg.eigvalsh(np.linalg.inv(information)[:2, :2])[-1] < 0.1**2)


def loop_errors(poses: np.ndarray, loops: list) -> dict[str, float]:
    """Mean and deviation of position [m] and heading [deg] at loops (i, j, X_ij, …), for poses (K, 3)."""
    errors = np.array([between(X_ij, between(poses[i], poses[j])) for i, j, X_ij, _ in loops])
    distance, turn = np.linalg.norm(errors[:, :2], axis=1), np.degrees(np.abs(errors[:, 2]))
    return {
        "mean_m": float(distance.mean()), "std_m": float(distance.std()), "max_m": float(distance.max()),
        "mean_deg": float(turn.mean()), "std_deg": float(turn.std()),
    }  # fmt: skip


def held_out(mapper: GraphMapper, loops: list) -> dict[str, float]:
    """Errors at the loops of the second half of each 40 keyframes, with only those of the first half in the graph."""
    first = np.array([(loop[1] // 20) % 2 == 0 for loop in mapper.loops]) & mapper.accepted
    poses = from_matrix(optimize(mapper.graph(first)).poses)
    return loop_errors(poses, [loop for loop in loops if (loop[1] // 20) % 2 == 1])


def on_log(name: str, picture: Path | None, most: int | None = None) -> dict[str, float]:
    log = read_carmen_log(LOGS / f"{name}.clf.bz2", most=most)
    mapper, times = GraphMapper(X_BS=log.X_BS), []
    for scan, X_OB in zip(log.scans, log.odometry, strict=True):
        began = time.process_time()
        mapper.add_scan(scan, X_OB)
        times.append(time.process_time() - began)
    began = time.process_time()
    grid = mapper.finish()
    finishing = time.process_time() - began
    loops = [
        loop for loop, accepted in zip(mapper.loops, mapper.accepted, strict=True) if accepted and is_sure(loop[3])
    ]
    local = np.array([keyframe.local for keyframe in mapper.keyframes])
    raw = log.odometry[[keyframe.scan for keyframe in mapper.keyframes]]
    trajectories = {"odometry": raw, "localizer": local, "graph": mapper.poses}
    values: dict[str, float] = {
        "scans": len(log.scans), "keyframes": len(local), "loops": len(mapper.loops),
        "believed": int(mapper.accepted.sum()), "sure": len(loops),
        "ms_per_scan": 1e3 * (sum(times) + finishing) / len(times),
        "ms_per_scan_median": 1e3 * statistics.median(times), "ms_worst": 1e3 * max(times), "finish_s": finishing,
    }  # fmt: skip
    maps = {}
    for which, poses in trajectories.items():
        maps[which] = grid if which == "graph" else mapper.make_map(poses)
        values[f"{which}_entropy_kbit"] = maps[which].entropy() / 1e3
        values |= {f"{which}_loops_{key}": value for key, value in loop_errors(poses, loops).items()}
    values |= {f"held_out_{key}": value for key, value in held_out(mapper, loops).items()}
    if picture is not None:
        draw(picture / f"{name}.png", maps, trajectories)
    return values


def draw(path: Path, maps: dict[str, OccupancyGrid], trajectories: dict[str, np.ndarray]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(maps), figsize=(8 * len(maps), 8))
    for axis, (which, grid) in zip(axes, maps.items(), strict=True):
        axis.imshow(1 / (1 + np.exp(grid.log_odds.T)), origin="lower", extent=grid.extent, cmap="gray", vmin=0, vmax=1)
        axis.plot(*trajectories[which][:, :2].T, "r-", linewidth=0.4)
        seen = grid.origin + grid.resolution * np.argwhere(grid.occupied)
        low, high = np.quantile(seen, 0.002, axis=0) - 1, np.quantile(seen, 0.998, axis=0) + 1
        axis.set(title=which, xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
        axis.set_aspect("equal")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", choices=("rooms", "fr079", "intel"))
    parser.add_argument("--pictures", type=Path, help="folder for the maps of the logs")
    parser.add_argument("--json")
    arguments = parser.parse_args()
    use_one_core()
    values: dict[str, object] = {}
    if arguments.only in (None, "rooms"):
        rows = []
        for name in DRIVES:
            for method, mapping in itertools.product(("naraha", "paper"), (False, True)):
                found = in_rooms(name, method, mapping, arguments.seeds)
                label = f"{name}_{method}{'_mapping' if mapping else ''}"
                values |= {f"{label}_{key}": value for key, value in found.items()}
                rows.append((label, *found.values()))
        print_table("rooms", ("drive", *found), rows)
    for name in ("fr079", "intel"):
        if arguments.only not in (None, name):
            continue
        if not (LOGS / f"{name}.clf.bz2").is_file():
            print(f"{name}: the log is not there, left out")
            continue
        measured = on_log(name, arguments.pictures)
        values |= {f"{name}_{key}": value for key, value in measured.items()}
        print_table(name, ("measure", "value"), list(measured.items()))
    write_json(arguments.json, values)


if __name__ == "__main__":
    main()
