"""Co-evolution: the paper's equations and operators, and ours against proofs."""

import itertools
from functools import cache

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, InputError, PlanError
from naraha.systems.placement import EvolutionConfig, evolve, fewest_sites, placement_of, shortest_order
from naraha.systems.placement.follow_kernels import follow, route_length, sides_seen
from naraha.systems.placement.memetic_kernels import cost_table, shorten
from naraha.systems.placement.paper_kernels import evolve_as_published, vary_route, vary_sites
from naraha.systems.placement.problem import sites_of, word_of
from naraha.systems.random_kernels import draw, seeded, shuffled, uniform

from .halls import small_problem


def length_of(order, lengths):
    return sum(lengths[a, b] for a, b in itertools.pairwise([0, *order]))


def best_by_trial(lengths):
    return min(length_of(order, lengths) for order in itertools.permutations(range(1, len(lengths))))


def test_words_hold_sets_of_sites():
    chosen = np.random.default_rng(0).random(62) < 0.5
    assert (sites_of(word_of(chosen), 62) == chosen).all()
    assert word_of(np.zeros(24, bool)) == 0


def test_random_numbers_are_even():
    rng = seeded(0)
    drawn = np.array([draw(rng, 5) for _ in range(5000)])
    assert np.abs(np.bincount(drawn, minlength=5) / 5000 - 0.2).max() < 0.03
    assert np.mean([uniform(rng) for _ in range(5000)]) == pytest.approx(0.5, abs=0.02)
    firsts = np.array([shuffled(rng, 6) for _ in range(3000)])
    assert (np.sort(firsts, axis=1) == np.arange(6)).all()
    assert np.abs(firsts.mean(axis=0) - 2.5).max() < 0.15


def test_the_papers_eval_counts_the_sides_on_which_landmarks_are_seen():
    problem = small_problem()
    rng = np.random.default_rng(2)
    order, chosen = rng.permutation(6) + 1, rng.random(len(problem.sites)) < 0.3
    places = np.vstack([problem.landmarks.positions, problem.sites[chosen]])
    scores = []
    for a, b in itertools.pairwise([0, *order]):
        path = problem.topology.nodes[problem.topology.path(a, b)[0]]
        for before, here in itertools.pairwise(path):
            away, ahead = places - here, here - before
            near = np.hypot(*away.T) <= problem.config.sight_range
            cross = ahead[0] * away[:, 1] - ahead[1] * away[:, 0]
            scores.append(int((near & (cross >= 0)).any()) + int((near & (cross < 0)).any()))
    found = sides_seen(order, word_of(chosen), len(problem.points), problem.sides())
    assert found == pytest.approx(np.mean(scores), abs=1e-12)  # in this bare hall nothing hides a landmark


def test_the_papers_operators_swap_move_and_swap_neighbours():
    rng = seeded(3)
    kinds = set()
    for _ in range(400):
        order = np.arange(1, 9)
        vary_route(order, rng)
        assert sorted(order) == list(range(1, 9))
        changed = np.flatnonzero(order != np.arange(1, 9))
        if len(changed) == 2:
            kinds.add("neighbours" if changed[1] - changed[0] == 1 else "two")
        elif len(changed):
            # One point moved: without it all others are in order.
            moved = [p for p in order if (np.diff([q for q in order if q != p]) > 0).all()]
            assert moved
            kinds.add("moved")
    assert kinds == {"neighbours", "two", "moved"}


def test_crossover_takes_each_site_from_one_parent_and_fills_up():
    rng = seeded(4)
    children = np.array([vary_sites(0b1100, 0b1010, 4, 0.0, 0, rng) for _ in range(400)])
    bits = (children[:, None] >> np.arange(4)) & 1
    assert set(bits[:, 0]) == {0}
    assert set(bits[:, 3]) == {1}
    assert 0.4 < bits[:, 1].mean() < 0.6
    flipped = np.array([vary_sites(0b1100, 0b1100, 4, 1.0, 0, rng) for _ in range(100)])
    assert {bin(int(word) ^ 0b1100).count("1") for word in flipped} == {1}
    assert all(bin(int(vary_sites(0, 0, 10, 0.0, 7, rng))).count("1") == 7 for _ in range(20))


def test_the_paper_preset_keeps_those_that_are_best_by_equations_1_and_2():
    problem = small_problem()
    n, k = len(problem.points), len(problem.sites)
    rng = np.random.default_rng(5)
    routes = np.array([rng.permutation(6) + 1 for _ in range(8)])
    sets = np.array([word_of(rng.random(k) < 0.5) for _ in range(8)])
    before = routes.copy(), sets.copy()
    curve, evaluations = evolve_as_published(
        routes, sets, k, problem.lengths, problem.sides(), 1, 10, 0.3, 3, seeded(6)
    )
    # The children are made again from the same random numbers.
    rng = seeded(6)
    children = []
    for _ in range(8):
        child = before[0][draw(rng, 8)].copy()
        vary_route(child, rng)
        children.append(child)
    young = []
    for _ in range(8):
        mothers = [before[1][draw(rng, 8)] for _ in range(2)]
        young.append(vary_sites(*mothers, k, 0.3, 3, rng))
    pool, words = np.vstack([before[0], children]), np.concatenate([before[1], young])
    metres = np.array([length_of(order, problem.lengths) for order in pool])
    score = np.array([[sides_seen(order, word, n, problem.sides()) for word in before[1]] for order in pool])
    fitness_path = (1 - metres / metres.max()) * score.sum(axis=1)
    count = np.array([sites_of(word, k).sum() for word in words])
    score = np.array([[sides_seen(order, word, n, problem.sides()) for order in before[0]] for word in words])
    fitness_land = (1 - count / k) * score.sum(axis=1)
    assert (routes == pool[np.argsort(-fitness_path, kind="stable")[:8]]).all()
    assert (sets == words[np.argsort(-fitness_land, kind="stable")[:8]]).all()
    assert evaluations == 4 * 8 * 8
    assert curve[0, 0] == sites_of(sets[0], k).sum()


def test_the_paper_preset_lets_landmarks_and_length_fall_and_keeps_the_lower_bound():
    problem = small_problem()
    k = len(problem.sites)
    config = EvolutionConfig(preset="paper", seed=1)
    many = evolve(problem, config, least=round(0.75 * k))
    few = evolve(problem, config, least=0, before=many)
    assert many.chosen.sum() == round(0.75 * k)
    assert few.chosen.sum() < many.chosen.sum()
    assert few.length <= many.length
    assert few.length < 1.25 * best_by_trial(problem.lengths)
    assert few.side_score > 1.2


def test_the_exact_order_is_the_best_of_all_orders():
    lengths = small_problem().lengths
    order = shortest_order(lengths)
    assert sorted(order) == list(range(1, 7))
    assert length_of(order, lengths) == pytest.approx(best_by_trial(lengths))
    assert route_length(order, lengths) == pytest.approx(length_of(order, lengths))
    with pytest.raises(InputError, match="too many points"):
        shortest_order(np.ones((40, 40)))


def test_local_search_over_orders_is_within_one_percent_of_the_proof():
    rng = np.random.default_rng(7)
    excess = []
    for _ in range(20):
        points = rng.uniform(0, 30, (13, 2))
        lengths = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
        found = []
        for _ in range(20):
            order = rng.permutation(12) + 1
            before = length_of(order, lengths)
            shorten(order, lengths)
            assert sorted(order) == list(range(1, 13))
            found.append(length_of(order, lengths))
            assert found[-1] <= before
        excess.append(min(found) / length_of(shortest_order(lengths), lengths) - 1)
    assert max(excess) < 0.01


@pytest.mark.parametrize("limit", [0.16, 0.18, 0.3])
def test_the_integer_program_finds_the_fewest_landmarks(limit):
    problem = small_problem(limit)
    order = shortest_order(problem.lengths)
    found = fewest_sites(problem, order)
    assert found.proved
    assert found.least == found.chosen.sum()
    enough = [
        bin(word).count("1")
        for word in range(1 << len(problem.sites))
        if follow(order, word, problem.tables(), np.zeros(0))[0] == 0.0
    ]
    assert found.chosen.sum() == min(enough)
    assert placement_of(problem, order, found.chosen).within_limit
    assert fewest_sites(problem, order, least=found.least + 2).chosen.sum() == found.least + 2


def test_a_limit_that_no_landmarks_keep_is_said():
    problem = small_problem(0.01)
    with pytest.raises(PlanError, match="all sites together"):
        fewest_sites(problem, np.arange(1, 7))


@cache
def cheapest(limit, worth):
    """The least cost of all orders with all sets of up to four sites, and what more sites cost at least."""
    problem = small_problem(limit)
    orders = np.array(list(itertools.permutations(range(1, 7))))
    sets = [
        sum(1 << s for s in some) for m in range(5) for some in itertools.combinations(range(len(problem.sites)), m)
    ]
    table = cost_table(orders, np.array(sets), problem.tables(), np.array([worth, 1e6, 0.0, np.inf, 0.0]))
    return table.min(), best_by_trial(problem.lengths) + 5 * worth


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_ours_costs_no_more_than_the_best_of_all_routes_with_all_sets(seed):
    problem = small_problem(0.2)
    config = EvolutionConfig(seed=seed, calm_worth=0.0)
    found = evolve(problem, config)
    cost = found.length + config.landmark_worth * found.chosen.sum()
    assert found.within_limit
    assert found.largest_error <= 0.2
    assert cost <= 1.001 * min(cheapest(0.2, config.landmark_worth))


def test_ours_keeps_the_longest_length_and_the_lower_bound():
    problem = small_problem(0.16)
    shortest = best_by_trial(problem.lengths)
    found = evolve(problem, EvolutionConfig(longest=shortest + 1e-6), least=7)
    assert found.length == pytest.approx(shortest)
    assert found.chosen.sum() == max(7, fewest_sites(problem, found.order).least)


def test_a_placement_says_where_to_drive_and_stop():
    problem = small_problem()
    found = evolve(problem, EvolutionConfig(generations=5))
    assert found.route[0] == pytest.approx(problem.plan.start[:2])
    assert found.route[found.stops] == pytest.approx(problem.plan.measuring_points[found.order - 1])
    assert np.hypot(*np.diff(found.route, axis=0).T).sum() == pytest.approx(found.length)
    assert (found.sites == problem.sites[found.chosen]).all()
    assert not problem.plan.with_boxes(found.sites).is_occupied(found.route).any()


def test_the_same_seed_gives_the_same_evolution():
    one, same = (evolve(small_problem(), EvolutionConfig(generations=5, seed=9)) for _ in range(2))
    assert (one.order == same.order).all()
    assert (one.sets == same.sets).all()
    assert (one.curve == same.curve).all()


def test_what_cannot_be_evolved_is_refused():
    with pytest.raises(ConfigError, match="least"):
        evolve(small_problem(), least=99)
    with pytest.raises(ConfigError, match=r"preset.*ours, paper"):
        evolve(small_problem(), EvolutionConfig(preset="theirs"))
