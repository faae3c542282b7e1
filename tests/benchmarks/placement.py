"""Planning of routes and landmarks beside what others would use for its parts, in the shipped construction hall.

Scenes:
- `evolution`: pairs of a route and a set of landmarks that are evaluated a second, with the paper's fitness and with
  the expected error, in DEAP (the same tables, a few lines of numpy a pair) and compiled.
- `paths`: shortest ways over the topology beside networkx's A* on the same graph, and over the plan's plain grid.
- `order`: the order of 15, 50 and 100 points: multi-start local search beside OR-Tools' guided local search, and the
  proof where there is one.
- `cover`: added landmarks and length for several error limits and topologies, on the shortest route: the usual greedy
  set cover (every pose must be fixed by its own scan), a greedy one that knows our expected error, and the fewest,
  proved by integer programming; beside co-evolution with routes no longer than that, and without that limit.
Peers are in the extra `bench`.
"""

import argparse
import statistics
import time
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from naraha.models.plans import load_floor_plan
from naraha.systems.errors import PlanError
from naraha.systems.placement import (
    EvolutionConfig,
    PlacementProblem,
    ProblemConfig,
    TopologyConfig,
    evolve,
    fewest_sites,
    make_problem,
    shortest_order,
)
from naraha.systems.placement.follow_kernels import route_length
from naraha.systems.placement.grid_links import grid_path
from naraha.systems.placement.memetic_kernels import cost_table, shorten
from naraha.systems.placement.problem import word_of
from naraha.systems.placement.topology import drivable_cells

from .placement_peers import (
    deap_rate,
    error_in_numpy,
    eval_in_numpy,
    greedy_cover,
    greedy_visibility_cover,
    ortools_order,
)
from .report import print_table, use_one_core, write_json

LIMITS = (0.12, 0.15, 0.2, 0.3)
TOPOLOGIES = 5


def hall(limit: float = 0.4, seed: int = 0) -> PlacementProblem:
    plan = load_floor_plan("construction_hall")
    return make_problem(plan, ProblemConfig(error_limit=limit, topology=TopologyConfig(seed=seed)))


def fastest(contestants: Mapping[str, Callable[[], object]], repeats: int = 20) -> dict[str, float]:
    """Shortest time of a call [s] of every contestant, in turns: calls of a few milliseconds are disturbed by whatever
    else the machine does, and the median with them."""
    times = dict.fromkeys(contestants, np.inf)
    for _ in range(repeats):
        for name, call in contestants.items():
            began = time.perf_counter()
            call()
            times[name] = min(times[name], time.perf_counter() - began)
    return times


def evolution() -> dict[str, object]:
    problem = hall()
    rng = np.random.default_rng(0)
    routes = np.array([rng.permutation(15) + 1 for _ in range(60)])
    sets = [rng.random(len(problem.sites)) < 0.5 for _ in range(60)]
    words = np.array([word_of(chosen) for chosen in sets])
    weights = np.array([40.0, 1e4, 5.0, np.inf, 1e3])
    times = fastest({"table": lambda: cost_table(routes, words, problem.tables(), weights)}, repeats=6)
    table_rate = len(routes) * len(words) / times["table"]
    by_sides = partial(eval_in_numpy, problem.sides(), len(problem.points))
    values: dict[str, object] = {
        "deap_error_evaluations_per_s": deap_rate(problem, partial(error_in_numpy, problem), seconds=10)
    }
    values["naraha_error_evaluations_per_s"] = table_rate
    values["deap_paper_evaluations_per_s"] = deap_rate(problem, by_sides, seconds=5)
    for preset, name in (("paper", "naraha_paper_evaluations_per_s"), ("ours", "naraha_ours_evaluations_per_s")):
        config = EvolutionConfig(preset=preset, patience=200)
        evolve(problem, config)
        began = time.perf_counter()
        found = evolve(problem, config)
        values[name] = found.evaluations / (time.perf_counter() - began)
    for kind, deap in (("paper", "paper"), ("error", "error"), ("ours", "error")):
        ours, theirs = values[f"naraha_{kind}_evaluations_per_s"], values[f"deap_{deap}_evaluations_per_s"]
        values[f"{kind}_times_deap"] = float(ours) / float(theirs)  # type: ignore[arg-type]
    return values


def paths() -> dict[str, object]:
    import networkx as nx

    problem = hall()
    topology, plan = problem.topology, problem.plan
    graph = nx.Graph()
    lengths = np.hypot(*(topology.nodes[topology.links[:, 0]] - topology.nodes[topology.links[:, 1]]).T)
    graph.add_weighted_edges_from((int(a), int(b), float(d)) for (a, b), d in zip(topology.links, lengths, strict=True))
    places = topology.nodes.tolist()

    def straight(a: int, b: int) -> float:
        return ((places[a][0] - places[b][0]) ** 2 + (places[a][1] - places[b][1]) ** 2) ** 0.5

    pairs = [(a, b) for a in range(topology.fixed) for b in range(topology.fixed) if a != b]
    drivable = drivable_cells(plan, problem.config.topology.clearance)
    cells = plan.cell_of(problem.points)

    def on_grid() -> float:
        steps = np.diff(grid_path(drivable, cells[1], cells[15]), axis=0)
        return float(np.hypot(*steps.T).sum()) * plan.resolution

    times = fastest(
        {
            "naraha": lambda: [topology.path(a, b) for a, b in pairs],
            "networkx": lambda: [nx.astar_path(graph, a, b, straight) for a, b in pairs],
            "grid": on_grid,
        }
    )
    ours = [topology.path(a, b)[1] for a, b in pairs]
    theirs = [nx.path_weight(graph, nx.astar_path(graph, a, b, straight), "weight") for a, b in pairs]
    apart = np.hypot(*(problem.points[1] - problem.points[15]))
    return {
        "nodes": len(topology.nodes),
        "links": len(topology.links),
        "naraha_path_us": times["naraha"] / len(pairs) * 1e6,
        "networkx_path_us": times["networkx"] / len(pairs) * 1e6,
        "times_networkx": times["networkx"] / times["naraha"],
        "largest_difference_m": float(np.abs(np.subtract(ours, theirs)).max()),
        "grid_nodes": int(drivable.sum()),
        "grid_path_us": times["grid"] * 1e6,
        "straight_m": float(apart),
        "cells_m": topology.path(1, 15)[1],
        "cells_straightened_m": float(problem.lengths[1, 15]),
        "grid_m": on_grid(),
    }


def order() -> dict[str, object]:
    values: dict[str, object] = {}
    rng = np.random.default_rng(0)
    for n in (15, 50, 100):
        points = rng.uniform(0, 60, (n + 1, 2))
        lengths = hall().lengths if n == 15 else np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
        shorten(np.arange(1, n + 1), lengths)
        began = time.perf_counter()
        found = []
        for _ in range(200):
            route = rng.permutation(n) + 1
            shorten(route, lengths)
            found.append(route_length(route, lengths))
        values[f"naraha_{n}_points_m"] = min(found)
        values[f"naraha_{n}_points_s"] = time.perf_counter() - began
        peer = np.array(ortools_order(lengths, 5))
        values[f"ortools_{n}_points_m"] = route_length(peer, lengths)
        values[f"ortools_{n}_points_s"] = 5.0
        values[f"{n}_points_over_ortools"] = min(found) / route_length(peer, lengths) - 1
        if n == 15:
            shortest_order(lengths)
            began = time.perf_counter()
            values["proved_15_points_m"] = route_length(shortest_order(lengths), lengths)
            values["proof_15_points_s"] = time.perf_counter() - began
    return values


def cover() -> dict[str, object]:
    rows: dict[str, list[float]] = {}

    def note(name: str, landmarks: int, length: float) -> None:
        rows.setdefault(f"{name}_landmarks", []).append(landmarks)
        rows.setdefault(f"{name}_length_m", []).append(length)

    fewer, fewer_than_cover, not_fewer, longer, cases, seconds, proofs = 0, 0, 0, 0, 0, [], []
    for limit in LIMITS:
        for seed in range(TOPOLOGIES):
            problem = hall(limit, seed)
            route = shortest_order(problem.lengths)
            length = route_length(route, problem.lengths)
            began = time.perf_counter()
            try:
                fewest = fewest_sites(problem, route)
            except PlanError:
                continue  # not even all sites are enough on this route
            proofs.append(time.perf_counter() - began)
            cases += 1
            note("proved", int(fewest.chosen.sum()), length)
            cover = int(greedy_visibility_cover(problem, route).sum())
            note("greedy_visibility", cover, length)
            greedy = int(greedy_cover(problem, route).sum())
            note("greedy", greedy, length)
            capped = evolve(problem, EvolutionConfig(seed=seed, longest=length + 1e-6))
            note("naraha_no_longer", int(capped.chosen.sum()), capped.length)
            began = time.perf_counter()
            free = evolve(problem, EvolutionConfig(seed=seed))
            seconds.append(time.perf_counter() - began)
            note("naraha", int(free.chosen.sum()), free.length)
            assert capped.within_limit
            assert free.within_limit
            fewer += capped.chosen.sum() < greedy
            fewer_than_cover += capped.chosen.sum() < cover
            not_fewer += capped.chosen.sum() > greedy
            longer += capped.length > length + 1e-3
    values: dict[str, object] = {name: statistics.mean(numbers) for name, numbers in rows.items()}
    values |= {
        "cases": cases,
        "fewer_than_greedy": int(fewer),
        "fewer_than_greedy_visibility": int(fewer_than_cover),
        "more_than_greedy": int(not_fewer),
        "longer": int(longer),
    }
    values |= {"naraha_s": statistics.median(seconds), "proof_s": statistics.median(proofs)}
    return values


SCENES = {"evolution": evolution, "paths": paths, "order": order, "cover": cover}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=SCENES)
    parser.add_argument("--json")
    options = parser.parse_args()
    use_one_core()
    if options.scene:
        values = SCENES[options.scene]()
    else:
        values = {f"{scene}_{name}": value for scene, run in SCENES.items() for name, value in run().items()}
    print_table("routes and landmarks", ["value", ""], list(values.items()))
    write_json(options.json, values)


if __name__ == "__main__":
    main()
