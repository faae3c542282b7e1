"""Pictures show what was planned: as many boxes, curves as long as the evolution, failures where they were."""

import numpy as np
from matplotlib.figure import Figure
from naraha.diagrams.illuminate_drawing import (
    draw_errors,
    draw_evolution,
    draw_illuminance,
    draw_placement,
    draw_rounds,
    save_figure,
)
from naraha.systems.placement import EvolutionConfig, RoundsConfig, Verification, run_rounds
from naraha.systems.sensing import fit_field
from PIL import Image

from .halls import small_problem


def two_rounds():
    problem = small_problem()
    lost = Verification(False, 0.6, np.array([18.0, 8.0]), "lost")
    config = RoundsConfig(shares=[0.5], retries=1, evolution=EvolutionConfig(generations=3))
    return problem, run_rounds(problem, lambda *_: lost, config).rounds


def test_a_placement_is_drawn_with_its_boxes_and_where_it_failed():
    problem, rounds = two_rounds()
    axes = Figure().subplots()
    draw_placement(axes, problem, rounds[0].placement, failed_at=np.array([18.0, 8.0]))
    labels = axes.get_legend_handles_labels()[1]
    assert f"{len(rounds[0].placement.sites)} added landmarks" in labels
    lines = {line.get_label(): np.array(line.get_data()) for line in axes.lines}
    assert (problem.sites == lines["sites"].T).all()
    assert lines["failed here"].ravel().tolist() == [18.0, 8.0]
    assert len(axes.patches) == len(problem.plan.wall_boxes()) + len(rounds[0].placement.sites)


def test_rounds_have_a_map_each_and_curves_over_all_generations(tmp_path):
    problem, rounds = two_rounds()
    maps = draw_rounds(problem, rounds)
    assert ["failed" in axes.get_title() for axes in maps.axes] == [True, True]
    panels = draw_evolution(rounds).axes
    assert len(panels) == 3
    expected = np.concatenate([r.placement.curve for r in rounds])
    assert all((axes.lines[0].get_ydata() == expected[:, k]).all() for k, axes in enumerate(panels))
    save_figure(maps, tmp_path / "rounds.png")
    with Image.open(tmp_path / "rounds.png") as image:
        assert len(set(image.convert("L").tobytes())) > 20


def test_errors_and_illuminance_are_drawn_as_they_are():
    problem, rounds = two_rounds()
    placement = rounds[0].placement
    track = np.zeros((30, 8))
    track[:, 1], track[:, 4] = np.linspace(0, 10, 30), np.linspace(0, 10, 30) + 0.07
    lines = draw_errors(problem, placement, track).axes[0].lines
    assert np.max(lines[0].get_ydata()) == placement.largest_error
    assert np.allclose(lines[2].get_ydata(), 0.07)
    points = problem.plan.measuring_points
    field = fit_field(points, 100.0 + points[:, 0])
    mean, deviation = (axes.collections[0].get_array() for axes in draw_illuminance(problem.plan, field).axes[:2])
    assert 100 < np.nanmin(mean) < np.nanmax(mean) < 140
    assert np.nanmin(deviation) < 0.3 * np.nanmax(deviation)
