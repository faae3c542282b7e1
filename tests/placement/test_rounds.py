"""Rounds: falling bounds, failures that are learnt from, runs in parallel; the runs here are synthetic."""

from dataclasses import replace

import numpy as np
import pytest
from naraha.models.plans import load_floor_plan
from naraha.systems.errors import ConfigError
from naraha.systems.placement import EvolutionConfig, RoundsConfig, Verification, learn_from, make_problem, run_rounds

from .halls import small_problem

CONFIG = RoundsConfig(evolution=EvolutionConfig(generations=60, patience=15))


def strict_world(problem, factor):
    """A run whose errors are `factor` times those expected, and fails where they are largest."""

    def verify(plan, placement, sites):
        poses, errors = problem.errors_along(placement.order, placement.chosen)
        worst = int(np.argmax(errors))
        error = factor * errors[worst]
        assert (sites == placement.sites).all()
        if error <= 0.3:
            return Verification(True, error)
        return Verification(False, error, poses[worst, :2], "lost")

    return verify


def test_a_model_that_is_right_goes_through_all_bounds_without_a_failure():
    problem = small_problem(0.3)
    found = run_rounds(problem, strict_world(problem, 1.0), CONFIG)
    k = len(problem.sites)
    assert [r.least for r in found.rounds] == [9, 6, 3, 0]
    assert found.landmarks[:2] == [round(0.75 * k), round(0.5 * k)]
    assert found.best is found.rounds[-1]
    assert found.landmarks[-1] <= found.landmarks[-2]
    assert all(r.placement.within_limit for r in found.rounds)


def test_a_failure_is_learnt_from_until_it_is_well():
    problem = small_problem(0.3)
    found = run_rounds(problem, strict_world(problem, 1.5), CONFIG)
    failed = [r for r in found.rounds if not r.verification.ok]
    assert failed
    assert found.best is not None
    assert found.best.verification.max_error <= 0.3
    least = found.rounds[-1].least
    again = [r.placement.chosen.sum() for r in found.rounds if r.least == least]
    assert again[-1] > again[0]
    # Nobody tries again what has failed.
    tried = [(tuple(r.placement.order), tuple(r.placement.chosen)) for r in found.rounds if r.least == least]
    assert len(set(tried)) == len(tried)


def test_what_has_been_driven_is_not_driven_again():
    """The same bound twice often gives the same placement, which both rounds are told of."""
    problem = small_problem(0.3)
    truth, driven = strict_world(problem, 1.5), []

    def verify(plan, placement, sites):
        driven.append(what(placement))
        return truth(plan, placement, sites)

    def what(placement):
        return tuple(placement.order), tuple(placement.chosen)

    found = run_rounds(problem, verify, replace(CONFIG, shares=[0.25, 0.0, 0.0]))
    assert driven == list(dict.fromkeys(what(r.placement) for r in found.rounds))
    assert len(driven) < len(found.rounds)
    for r in found.rounds:
        expected = truth(problem.plan, r.placement, r.placement.sites)
        assert (r.verification.ok, r.verification.max_error) == (expected.ok, expected.max_error)


def test_what_failed_is_within_the_limit_no_more_and_far_away_nothing_changes():
    problem = small_problem(0.3)
    placement = run_rounds(problem, strict_world(problem, 1.0), CONFIG).rounds[-1].placement
    poses, errors = problem.errors_along(placement.order, placement.chosen)
    where = poses[int(np.argmax(errors)), :2]
    after = learn_from(problem, placement, Verification(False, 0.5, where, "lost"), CONFIG)
    gap = np.hypot(*(problem.poses[:, :2] - where).T)
    assert after.limit[gap <= 6.0].max() == pytest.approx(0.6 * errors.max())
    assert (after.limit[gap > 6.0] == problem.limit[gap > 6.0]).all()
    near = np.hypot(*(after.sight.places - where).T) <= 6.0
    assert (after.sight.penalty[near] > 0).all()
    assert after.sight.reach[near] == pytest.approx(0.5 * problem.sight.reach[near])
    assert (after.sight.penalty[~near] == 0).all()
    everywhere = learn_from(problem, placement, Verification(False, 9.0, None, "stuck"), CONFIG)
    assert everywhere.limit.max() == pytest.approx(0.5 * errors.max())


def test_less_is_allowed_the_more_a_run_exceeded_its_own_limit():
    problem = small_problem(0.3)
    placement = run_rounds(problem, strict_world(problem, 1.0), CONFIG).rounds[-1].placement
    _, errors = problem.errors_along(placement.order, placement.chosen)
    for limit, share in ((0.26, 0.65), (None, 0.75)):
        after = learn_from(problem, placement, Verification(False, 0.4, None, "lost", limit), CONFIG)
        assert after.limit.max() == pytest.approx(share * errors.max())


def test_two_bounds_that_gave_one_placement_learn_from_its_failure_once():
    problem = small_problem(0.3)
    truth, before = strict_world(problem, 1.5), []

    def verify(plan, placement, sites):
        before.append(placement)
        return truth(plan, placement, sites)

    found = run_rounds(problem, verify, replace(CONFIG, shares=[0.0, 0.0], retries=0))
    assert [r.verification.ok for r in found.rounds] == [False, False]
    assert len(before) == 1
    once = learn_from(problem, before[0], found.rounds[0].verification, CONFIG)
    np.testing.assert_array_equal(found.problem.sight.reach, once.sight.reach)
    np.testing.assert_array_equal(found.problem.sight.penalty, once.sight.penalty)
    assert (once.sight.penalty > 0).any()


def test_the_paper_preset_puts_landmarks_where_it_failed():
    """As in the paper: five landmarks fail, and another one is put up where they did."""
    problem = make_problem(load_floor_plan("construction_hall"))
    runs = []

    def verify(plan, placement, sites):
        runs.append(placement)
        poses, errors = problem.errors_along(placement.order, placement.chosen)
        worst = int(np.argmax(errors))
        return Verification(len(runs) != 4, 0.45, poses[worst, :2] if len(runs) == 4 else None, "lost")

    found = run_rounds(problem, verify, RoundsConfig(evolution=EvolutionConfig(preset="paper")))
    assert found.landmarks == [18, 12, 6, 5, 6]
    failed, again = found.rounds[3], found.rounds[4]
    gaps = [np.hypot(*(r.placement.sites - failed.verification.where).T) for r in (failed, again)]
    assert np.count_nonzero(gaps[1] < 8) > np.count_nonzero(gaps[0] < 8)
    assert found.best.placement.chosen.sum() == 6


def test_runs_may_be_made_in_parallel_and_are_reported_in_turn():
    problem = small_problem(0.3)
    batches, told = [], []

    def together(verify, *sequences):
        batches.append(len(sequences[0]))
        return [verify(*arguments) for arguments in zip(*sequences, strict=True)]

    found = run_rounds(problem, strict_world(problem, 1.5), CONFIG, map_=together, report=told.append)
    assert batches[0] == 4
    assert sum(batches) == len({(tuple(r.placement.order), tuple(r.placement.chosen)) for r in found.rounds})
    assert told == list(found.rounds)


def test_without_any_success_there_is_no_best_round_and_the_retries_end():
    problem = small_problem(0.3)
    config = RoundsConfig(shares=[0.5, 0.0], retries=2, evolution=EvolutionConfig(generations=3))
    found = run_rounds(problem, lambda *_: Verification(False, 2.0, None, "blind"), config)
    assert len(found.rounds) == 6
    assert found.best is None


def test_rounds_that_make_no_sense_are_refused():
    with pytest.raises(ConfigError, match=r"rounds\.tighten"):
        run_rounds(small_problem(), lambda *_: Verification(True, 0.0), RoundsConfig(tighten=[0.9, 0.5]))
    with pytest.raises(ConfigError, match=r"rounds\.shares"):
        run_rounds(small_problem(), lambda *_: Verification(True, 0.0), RoundsConfig(shares=[1.5]))
