"""What others would use for the parts of placement: DEAP, OR-Tools, networkx, and a greedy set cover."""

import itertools
import random
import time

import numpy as np
from naraha.systems.placement import PlacementProblem
from naraha.systems.placement.follow_kernels import Sides, follow
from naraha.systems.placement.problem import word_of


def eval_in_numpy(sides: Sides, n: int, order: np.ndarray, chosen: np.ndarray) -> float:
    """The paper's mean Eval, a line of numpy a leg. n: points, the start among them."""
    word = word_of(chosen)
    total, count = 0, 0
    for a, b in itertools.pairwise([0, *order]):
        leg = slice(sides.first_node[a * n + b], sides.first_node[a * n + b + 1])
        total += np.count_nonzero(sides.left[leg] | ((sides.left_sites[leg] & word) != 0))
        total += np.count_nonzero(sides.right[leg] | ((sides.right_sites[leg] & word) != 0))
        count += leg.stop - leg.start
    return total / count


def error_in_numpy(problem: PlacementProblem, order: np.ndarray, chosen: np.ndarray) -> float:
    """Excess of the expected error along a route, as `follow` has it, by numpy's matrices."""
    of, n = problem.config.information, len(problem.points)
    P = np.diag([of.start_position**2] * 2 + [of.start_heading**2])
    heading, excess = problem.plan.start[2], 0.0
    F, Q = np.eye(3), np.diag([of.odometry_position**2] * 2 + [of.odometry_heading**2])
    for a, b in itertools.pairwise([0, *order]):
        leg = slice(problem.first[a * n + b], problem.first[a * n + b + 1])
        info = problem.base[leg] + problem.added[leg][:, chosen].sum(axis=1)
        matrices = info[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        for (_, _, theta, step), J, limit in zip(problem.poses[leg], matrices, problem.limit[leg], strict=True):
            P[2, 2] += of.odometry_turn**2 * abs((theta - heading + np.pi) % (2 * np.pi) - np.pi)
            heading = theta
            F[0, 2], F[1, 2] = -step * np.sin(theta), step * np.cos(theta)
            P = np.linalg.inv(np.linalg.inv(F @ P @ F.T + step * Q) + J)
            error = of.sigmas * np.sqrt(np.linalg.eigvalsh(P[:2, :2])[-1])
            excess += step * max(0.0, error / limit - 1)
    return excess


def deap_rate(problem: PlacementProblem, evaluate, *, seconds: float, size: int = 20, seed: int = 0) -> float:
    """Pairs that a co-evolution in DEAP evaluates a second, with the operators and populations of the paper's."""
    from deap import base, tools

    random.seed(seed)
    n, k = len(problem.points) - 1, len(problem.sites)
    box = base.Toolbox()
    box.register("mate", tools.cxUniform, indpb=0.5)
    box.register("mutate", tools.mutFlipBit, indpb=1 / k)
    box.register("vary", tools.mutShuffleIndexes, indpb=2 / n)
    box.register("evaluate", evaluate)

    class Fitness(base.Fitness):
        weights = (1.0,)

    class Individual(list):
        def __init__(self, items):
            super().__init__(items)
            self.fitness = Fitness()

    routes = [Individual(random.sample(range(1, n + 1), n)) for _ in range(size)]
    sets = [Individual(random.random() < 0.5 for _ in range(k)) for _ in range(size)]
    evaluations, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        young_routes = [box.clone(random.choice(routes)) for _ in range(size)]
        for route in young_routes:
            box.vary(route)
        young_sets = []
        while len(young_sets) < size:
            pair = [box.clone(individual) for individual in random.sample(sets, 2)]
            box.mate(*pair)
            for individual in pair:
                box.mutate(individual)
            young_sets += pair
        for pool, others, first in ((routes + young_routes, sets, True), (sets + young_sets[:size], routes, False)):
            for one in pool:
                total = 0.0
                for other in others:
                    route, chosen = (one, other) if first else (other, one)
                    total += box.evaluate(np.array(route), np.array(chosen, bool))
                    evaluations += 1
                    if time.perf_counter() - began > 4 * seconds:
                        return evaluations / (time.perf_counter() - began)
                one.fitness.values = (total,)
        routes = tools.selBest(routes + young_routes, size)
        sets = tools.selBest(sets + young_sets[:size], size)
    return evaluations / (time.perf_counter() - began)


def ortools_order(lengths: np.ndarray, seconds: int) -> list[int]:
    """The order of an open route from point 0 by OR-Tools' routing solver with guided local search."""
    from ortools.constraint_solver import pywrapcp, routing_enums_pb2

    n = len(lengths)
    # A depot at the end that is as near to everything: the route is open.
    manager = pywrapcp.RoutingIndexManager(n + 1, 1, [0], [n])
    routing = pywrapcp.RoutingModel(manager)
    whole = np.zeros((n + 1, n + 1), int)
    whole[:n, :n] = np.round(lengths * 1000)
    index = routing.RegisterTransitCallback(lambda a, b: int(whole[manager.IndexToNode(a), manager.IndexToNode(b)]))
    routing.SetArcCostEvaluatorOfAllVehicles(index)
    parameters = pywrapcp.DefaultRoutingSearchParameters()
    parameters.first_solution_strategy = routing_enums_pb2.FirstSolutionStrategy.PATH_CHEAPEST_ARC
    parameters.local_search_metaheuristic = routing_enums_pb2.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
    parameters.time_limit.seconds = seconds
    found = routing.SolveWithParameters(parameters)
    at, order = routing.Start(0), []
    while not routing.IsEnd(at):
        order.append(manager.IndexToNode(at))
        at = found.Value(routing.NextVar(at))
    return order[1:]


def greedy_visibility_cover(problem: PlacementProblem, order: np.ndarray) -> np.ndarray:
    """Sites (k,) bool for a route by the usual set cover: every pose that the walls leave unknown must be fixed by what
    its own scan sees of one box; the box that does so at most of those left is put up next, while there is any."""
    of, n = problem.config.information, len(problem.points)
    legs = np.concatenate([[0], order[:-1]]) * n + order
    at = np.concatenate([np.arange(problem.first[leg], problem.first[leg + 1]) for leg in legs])

    def fixed(info: np.ndarray) -> np.ndarray:
        matrices = info[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*info.shape[:-1], 3, 3)
        spread = np.linalg.eigvalsh(np.linalg.inv(matrices + 1e-6 * np.eye(3))[..., :2, :2])[..., -1]
        return of.sigmas * np.sqrt(spread) <= problem.limit[at].reshape(-1, *[1] * (info.ndim - 2))

    covers = fixed(problem.base[at][:, None] + problem.added[at]) & ~fixed(problem.base[at])[:, None]
    left, chosen = covers.any(axis=1), np.zeros(len(problem.sites), bool)
    while left.any():
        best = int(np.argmax(covers[left].sum(axis=0)))
        chosen[best] = True
        left &= ~covers[:, best]
    return chosen


def greedy_cover(problem: PlacementProblem, order: np.ndarray) -> np.ndarray:
    """Sites (k,) bool for a route by the greedy set cover: the one that takes away most of the excess, until there is
    none. All when that is not enough."""
    tables, chosen = problem.tables(), np.zeros(len(problem.sites), bool)

    def excess(some: np.ndarray) -> float:
        return follow(order, word_of(some), tables, np.zeros(0))[0]

    while excess(chosen) > 0 and not chosen.all():
        trials = []
        for s in np.flatnonzero(~chosen):
            chosen[s] = True
            trials.append((excess(chosen), s))
            chosen[s] = False
        chosen[min(trials)[1]] = True
    return chosen
