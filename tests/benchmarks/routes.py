"""Different ways round water on 50 maps: how many are found, how long it takes, and the usual other method beside it.

Scenes `both`, `left`, `right`, `none`: where the water between start and goal can be passed. For each: on how many maps
all sides were found that exist and none that does not, pairs of routes that are the same way (no obstacle between
them), time of a search with smoothing and measures. `penalty_` is the usual way to alternatives without signatures:
the shortest way again and again, where cells within 0.5 m of the ways before cost three times as much, as many ways as
ours offers at most; neither smoothed nor measured.
"""

import argparse
import itertools
import statistics
import time
from collections.abc import Sequence

import numpy as np
from naraha.systems.routes import WATER, RouteGrid, RoutesConfig, find_routes
from naraha.systems.routes.ground import make_ground
from naraha.systems.routes.islands import find_islands
from naraha.systems.routes.search_kernels import tree
from scipy.ndimage import distance_transform_edt

from ..routes.maps import water_map
from .report import print_table, use_one_core, write_json

SCENES = ("both", "left", "right", "none")
MAPS = 50


def sides_passed(ways: Sequence[np.ndarray], grid: RouteGrid) -> set[str]:
    """Sides on which ways (K, 2) pass the middle of the water, seen along +x."""
    middle = grid.centre_of(np.argwhere(grid.kind == WATER)).mean(axis=0)
    heights = [way[np.argmin(np.abs(way[:, 0] - middle[0])), 1] for way in ways]
    return {"left" if y > middle[1] else "right" for y in heights}


def same_way(a: np.ndarray, b: np.ndarray, grid: RouteGrid) -> bool:
    """Whether the loop along one path and back along the other winds round no blocked cell, by summing angles."""
    loop = np.vstack([a, b[::-1], a[:1]])
    away = loop - grid.centre_of(np.argwhere(grid.blocked))[:, None]
    angles = np.unwrap(np.arctan2(away[..., 1], away[..., 0]), axis=1)
    return not bool((np.abs(angles[:, -1] - angles[:, 0]) > 1).any())


def by_penalty(grid: RouteGrid, start: np.ndarray, goal: np.ndarray, config: RoutesConfig) -> list[np.ndarray]:
    """Ways (K, 2) in M [m] by the penalty method, those that are equal left out."""
    ground, islands = make_ground(grid, config), find_islands(grid)
    ny, weight, ways = grid.shape[1], ground.weight.copy(), []
    first, last = (int(i * ny + j) for i, j in (grid.index_of(start[:2]), grid.index_of(goal)))
    for _ in range(config.most):
        cost, towards, _ = tree(last, weight, ground.moves, islands.table, True)
        if not np.isfinite(cost[first]):
            break
        cells = [first]
        while cells[-1] != last:
            cells.append(int(towards[cells[-1]]))
        ij = np.column_stack([np.array(cells) // ny, np.array(cells) % ny])
        on_way = np.ones(grid.shape, bool)
        on_way[tuple(ij.T)] = False
        weight = np.where(distance_transform_edt(on_way) * grid.cell < 0.5, 3 * ground.weight, weight)
        if not any(len(ij) == len(other) and (grid.centre_of(ij) == other).all() for other in ways):
            ways.append(grid.centre_of(ij))
    return ways


def run(scene: str) -> dict[str, object]:
    """Values of one scene, under the names of the JSON file."""
    config = RoutesConfig()
    exist = {"both": {"left", "right"}, "left": {"left"}, "right": {"right"}, "none": set()}[scene]
    methods = {
        "naraha": lambda *arguments: [route.xy for route in find_routes(*arguments, config)],
        "penalty": lambda *arguments: by_penalty(*arguments, config),
    }
    values: dict[str, object] = {"maps": MAPS}
    for name, find in methods.items():
        find(*_arguments(scene, 0))
        right, same, offered, times = 0, 0, [], []
        for seed in range(MAPS):
            arguments = _arguments(scene, seed)
            began = time.perf_counter()
            ways = find(*arguments)
            times.append(time.perf_counter() - began)
            offered.append(len(ways))
            right += sides_passed(ways, arguments[0]) == exist
            same += sum(same_way(a, b, arguments[0]) for a, b in itertools.combinations(ways, 2))
        values[f"{name}_maps_right"] = right
        values[f"{name}_same_way_pairs"] = same
        values[f"{name}_routes_mean"] = statistics.mean(offered)
        values[f"{name}_time_s"] = statistics.median(times)
        values[f"{name}_time_max_s"] = max(times)
    return values


def _arguments(scene: str, seed: int) -> tuple[RouteGrid, np.ndarray, np.ndarray]:
    grid, start, goal = water_map(seed, scene)
    return grid, start, np.array(goal)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=SCENES)
    parser.add_argument("--json")
    options = parser.parse_args()
    use_one_core()
    if options.scene:
        values = run(options.scene)
    else:
        values = {f"{scene}_{name}": value for scene in SCENES for name, value in run(scene).items()}
    print_table("different ways", ["value", ""], list(values.items()))
    write_json(options.json, values)


if __name__ == "__main__":
    main()
