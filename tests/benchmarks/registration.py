"""Ours against everybody else's registration, one thread each, in turns.

    python -m tests.benchmarks.registration --scene room|partial|global|corridor|real|all [--pairs N] [--json FILE]

`room`: 24 pairs 0.5 m and 10° apart, no guess. `partial`: 24 pairs 3 to 6 m and 40° apart, the guess off by 0.5 m and
10°. `global`: these without a guess, and pairs at one place turned by any angle. `corridor`: nothing but colours on
plain walls tells how far the robot went, single steps and a run of 40 m. `real`: recorded pairs with an accepted pose.

Every time is that from the raw clouds to the pose. Medians are over all counted pairs, also those that failed.
"""

import argparse
import dataclasses
import os
import sys
import time
from collections.abc import Mapping, Sequence

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform

from .registration_contest import YARDSTICK, Limits, as_pose, our_global, ours, report, report_pairs, run_in_turns
from .registration_peers import Matrix, Peer, global_peers, local_peers
from .registration_recordings import consecutive_scans, recorded_pairs, small_gicp_suite
from .registration_scenes import Pair, flat_pairs
from .report import print_table, use_one_core, write_json
from .slam_scenes import Chain, corridor, corridor_chain, corridor_pairs

SCENES = ("room", "partial", "global", "corridor", "real")


def indoor_peers() -> dict[str, Peer]:
    """The peers as shipped, and on clouds thinned to 0.1 m."""
    return local_peers() | {f"{name}_10cm": align for name, align in local_peers(voxel=0.1).items()}


def measure_flat(scene: str, count: int, seed: int, per_pair: bool) -> dict[str, float]:
    """Scenes `room` and `partial`."""
    sets = flat_pairs(seed)
    pairs = (sets.near if scene == "room" else sets.partial)[:count]
    scores = run_in_turns(ours() | indoor_peers(), pairs)
    if per_pair:
        report_pairs(scores, pairs)
    apart = "0.5 m and 10 deg apart" if scene == "room" else "3 to 6 m and 40 deg apart"
    return report(scene, f"{scene}: {len(pairs)} pairs {apart}", scores, pairs, Limits(0.1, 1.0))


def measure_global(count: int, seed: int, per_pair: bool) -> dict[str, float]:
    """Scene `global`: alignment without a guess; all of it is written down, the ill-posed pairs count."""
    sets, values = flat_pairs(seed), {}
    for name, pairs in (("apart", sets.apart[:count]), ("same_place", sets.same_place[:count])):
        counted = [dataclasses.replace(pair, ill_posed=False) for pair in pairs]
        scores = run_in_turns(our_global() | global_peers(), counted)
        if per_pair:
            report_pairs(scores, pairs)
        values |= report(f"global_{name}", f"no guess, {name}", scores, counted, Limits(0.3, 5.0))
    return values


def classified(cloud: PointCloud) -> PointCloud:
    """`cloud` with the plainest classes there are: a threshold for each channel, and every label right in 9 of 10."""
    reflective = cloud.point["intensity"].numpy()[:, 0] > 0.6
    water = cloud.point["nir"].numpy()[:, 0] < 0.15
    probabilities = np.full((len(water), 4), 0.1 / 3, np.float32)
    probabilities[np.arange(len(water)), reflective + 2 * water] = 0.9
    cloud = cloud.clone()
    cloud.point["class_probabilities"] = o3d.core.Tensor(probabilities)
    return cloud


def measure_corridor(count: int) -> dict[str, float]:
    """Scene `corridor`: single steps from the identity, and runs of 40 m from odometry that slips by 20 %."""
    world, values = corridor(), {}
    peers = local_peers()
    for step in (0.25, 0.5, 1.0):
        pairs = [
            Pair(classified(source), classified(target), X_TS, RigidTransform())
            for source, target, X_TS in corridor_pairs(world, step, min(count, 15), seed=int(100 * step))
        ]
        scores = run_in_turns(ours() | peers, pairs)
        title = f"corridor: {len(pairs)} steps of {step:g} m, no guess"
        values |= report(f"corridor_step_{round(100 * step)}cm", title, scores, pairs, Limits(0.05, 0.5))
    runs = {
        "chain": (0.02, False, True),
        "chain_20_percent_wrong": (0.2, False, True),
        "chain_20_percent_wrong_in_spots": (0.2, True, True),
        "chain_without_classes": (0.02, False, False),
    }
    for name, (wrong, spots, with_classes) in runs.items():
        chain = corridor_chain(world, flip=wrong, spots=spots)
        clouds = [classified(cloud) if with_classes else cloud for cloud in chain.clouds]
        # What the geometric ones make of it does not depend on the classes.
        others = peers if name == "chain" else {"open3d_colored": peers["open3d_colored"]}
        contestants = ours() | others
        for align in contestants.values():
            align(clouds[1], clouds[0], chain.guesses[0].GetAsMatrix4())
        values |= _measure_chain(f"corridor_{name}", contestants, clouds[: count + 1], chain)
    return values


def _measure_chain(
    scene: str, contestants: Mapping[str, Peer], clouds: Sequence[PointCloud], chain: Chain
) -> dict[str, float]:
    """Steps laid end to end: how far off they are at the end and on the way."""
    steps: dict[str, list[Matrix]] = {name: [] for name in contestants}
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for target, source, guess in zip(clouds[:-1], clouds[1:], chain.guesses, strict=False):
        for name, align in contestants.items():
            start = time.perf_counter()
            steps[name].append(np.asarray(align(source, target, guess.GetAsMatrix4())))
            seconds[name].append(time.perf_counter() - start)
    steps = {"odometry": [guess.GetAsMatrix4() for guess in chain.guesses[: len(clouds) - 1]]} | steps
    rows, values = [], {}
    for name, matrices in steps.items():
        off = chain.errors([as_pose(matrix) for matrix in matrices])
        distances = np.linalg.norm(off, axis=1)
        found = {
            "end_m": float(distances[-1]),
            "end_along_m": float(off[-1, 0]),
            "rmse_m": float(np.sqrt((distances**2).mean())),
            "ms": 1e3 * float(np.median(seconds[name])) if name in seconds else 0.0,
        }
        values |= {f"{scene}_{name}_{key}": value for key, value in found.items()}
        rows.append((name, *found.values()))
    columns = ("", "end error m", "of it along x", "RMSE m", "median ms")
    print_table(f"{scene}: {len(clouds) - 1} steps of 0.5 m", columns, rows)
    return values


def measure_real(count: int, per_pair: bool) -> dict[str, float]:
    """Scene `real`: the recorded pairs, small_gicp's own cases, and a sequence of neighbours."""
    values, rows = {}, []
    # These clouds have no classes, for which the paper's form is there.
    our_own = {"naraha": ours()["naraha"]}
    for recording in recorded_pairs()[:count]:
        scores = run_in_turns(our_own | local_peers(recording.voxel), [recording.pair])
        found = {name: (1e3 * float(s.metres[0]), float(s.degrees[0])) for name, s in scores.items()}
        for name, score in scores.items():
            head = f"real_{recording.name}_{name}"
            values |= {f"{head}_mm": found[name][0], f"{head}_deg": found[name][1]}
            values[f"{head}_ms"] = 1e3 * float(score.seconds[0])
        best = min((name for name in scores if "naraha" not in name), key=lambda name: found[name][0])
        milliseconds = [values[f"real_{recording.name}_{name}_ms"] for name in ("naraha", YARDSTICK)]
        tolerance = f"{1e3 * recording.metres:g} mm, {recording.degrees:g} deg"
        rows.append((recording.name, tolerance, *found["naraha"], best, *found[best], *found[YARDSTICK], *milliseconds))
    columns = ("", "tolerance", "naraha mm", "deg", "best peer", "mm", "deg", f"{YARDSTICK} mm", "deg")
    print_table("recorded pairs", (*columns, "naraha ms", f"{YARDSTICK} ms"), rows)
    for name, pairs, limits, peers in (
        ("small_gicp_suite", small_gicp_suite(), Limits(0.2, 2.5), local_peers(0.3)),
        ("hand_held", consecutive_scans(), Limits(0.1, 1.0), _better(local_peers(0.15))),
    ):
        if pairs:
            scores = run_in_turns(our_own | peers, pairs[:count])
            if per_pair:
                report_pairs(scores, pairs[:count])
            values |= report(f"real_{name}", name, scores, pairs[:count], limits)
    return values


def _better(peers: Mapping[str, Peer]) -> dict[str, Peer]:
    """Those of the peers that a long sequence is worth the time for."""
    wanted = ("small_gicp_gicp", "small_gicp_vgicp", "open3d_gicp", "open3d_point_to_plane_tukey", "kiss_icp")
    return {name: peers[name] for name in wanted if name in peers}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=(*SCENES, "all"), default="all")
    parser.add_argument("--pairs", type=int, default=1000, help="of every set at most, to be quick")
    parser.add_argument("--seed", type=int, default=0, help="layout of the flat")
    parser.add_argument("--per-pair", action="store_true", help="print the error of every pair, too")
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    arguments = parser.parse_args()
    if os.environ.get("OMP_NUM_THREADS") != "1":
        # Open3D reads it when it is loaded, which has happened.
        os.environ["OMP_NUM_THREADS"] = "1"
        os.execv(sys.executable, [sys.executable, "-m", "tests.benchmarks.registration", *sys.argv[1:]])
    use_one_core()
    values: dict[str, object] = {}
    for scene in SCENES if arguments.scene == "all" else (arguments.scene,):
        if scene in ("room", "partial"):
            values |= measure_flat(scene, arguments.pairs, arguments.seed, arguments.per_pair)
        elif scene == "global":
            values |= measure_global(arguments.pairs, arguments.seed, arguments.per_pair)
        elif scene == "corridor":
            values |= measure_corridor(arguments.pairs)
        else:
            values |= measure_real(arguments.pairs, arguments.per_pair)
    write_json(arguments.json, values)


if __name__ == "__main__":
    main()
