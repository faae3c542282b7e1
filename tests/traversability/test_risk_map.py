"""Risk maps of grounds that are known, and against layers that others computed."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, InputError
from naraha.systems.traversability import IMPASSABLE, Ability, RiskMapConfig, SizeTerms, SurfaceConfig, make_risk_map
from naraha.systems.traversability.mamdani import FuzzyConfig

from tests.traversability.grounds import ground, plane, pole, step


def middle(values, border=8):
    return values[border:-border, border:-border]


@pytest.mark.parametrize("slope", [0, 10, 20, 35])
def test_a_plane_has_its_slope_everywhere_and_no_steps(slope):
    found = make_risk_map(ground(plane(slope, 30)), Ability())
    np.testing.assert_allclose(np.rad2deg(middle(found.slope)), slope, atol=1.5)
    assert middle(found.seen).all()
    assert middle(found.step).max() < 0.05
    assert middle(found.coverage).min() == pytest.approx(1.0)


def test_risk_grows_with_slope_and_the_limit_is_that_of_the_ability():
    risks = [
        float(np.median(middle(make_risk_map(ground(plane(slope)), Ability()).risk))) for slope in (0, 8, 14, 20, 30)
    ]
    assert risks == sorted(risks)
    assert risks[0] == pytest.approx(17, abs=0.2)
    assert risks[-1] > 100


def test_a_step_is_impassable_only_for_a_robot_that_cannot_climb_it():
    points = ground(step(0.17, at=0.0))
    easy = FuzzyConfig(
        pitch_slope=SizeTerms(small=[0, 0, 0.7, 0.8], medium=[0.7, 0.8, 0.9, 1.0], large=[0.9, 1.0, 1.0, 1.0]),
        roll_slope=SizeTerms(small=[0, 0, 0.7, 0.8], medium=[0.7, 0.8, 0.9, 1.0], large=[0.9, 1.0, 1.0, 1.0]),
    )
    for threshold, impassable in ((0.1, True), (0.25, False)):
        found = make_risk_map(points, Ability(fuzzy=easy, step_threshold=threshold))
        edge = found.risk[np.abs(np.arange(found.risk.shape[0]) - 20) <= 1][:, 8:-8]
        assert (edge.max() == IMPASSABLE) == impassable
        assert found.at(np.array([[-1.0, 0.0], [1.0, 0.0]])).max() < 60


def side_of_a_ramp(highest):
    """Flat beside a ramp that rises from 0 at x = -2 m to `highest` at x = 2 m; the edge is at y = 0."""
    return ground(lambda x, y: np.where(y > 0, highest * (x + 2) / 4, 0), noise=0.004)


def test_a_step_that_fades_is_followed_below_what_a_single_cell_shows():
    points = side_of_a_ramp(0.16)

    def end(**values):
        found = make_risk_map(points, Ability(step_threshold=0.03, **values))
        return found.origin[0] + found.cell * np.argwhere(found.risk == IMPASSABLE)[:, 0].min()

    # With what noise may make of it, 0.05 m at -0.75 m and 0.037 m at -1.08 m.
    assert -1.2 < end() < -0.6
    assert end() - 0.6 < end(step_limit=0.017) < end() - 0.15


def test_a_low_step_that_joins_no_higher_one_is_not_impassable():
    points = ground(lambda x, y: np.where(np.abs(y) < 0.3, 0.025, 0.0), noise=0.004)
    found = make_risk_map(points, Ability(step_threshold=0.03, step_limit=0.017))
    assert not (found.risk == IMPASSABLE).any()


def test_a_pole_is_impassable_where_it_stands_and_not_around_it():
    found = make_risk_map(np.vstack([ground(plane(0)), pole((0.55, 0.55))]), Ability())
    assert found.at(np.array([[0.55, 0.55]]))[0] == IMPASSABLE
    far = found.at(np.array([[0.55, -0.55], [-0.95, 0.55]]))
    assert far.max() < 20
    assert (found.risk == IMPASSABLE).sum() < 30


def test_beside_a_wall_the_ground_is_as_smooth_as_it_is():
    wall = np.mgrid[0.5:0.7:0.02, -2.0:2.0:0.02, 0.0:1.0:0.05].reshape(3, -1).T
    floor = ground(plane(0))
    found = make_risk_map(np.vstack([floor[floor[:, 0] < 0.5], wall]), Ability())
    beside = found.at(np.array([[0.2, y] for y in np.arange(-1.0, 1.1, 0.1)]))
    assert beside.max() < 1.2 * make_risk_map(floor, Ability()).at(np.array([[0.2, 0.0]]))[0]
    assert found.at(np.array([[0.55, 0.0]]))[0] == IMPASSABLE


def test_what_was_not_seen_is_not_judged():
    points = ground(plane(0))
    found = make_risk_map(
        points[np.hypot(points[:, 0], points[:, 1]) > 0.5], Ability(), origin=np.array([-2.0, -2.0]), shape=(40, 40)
    )
    assert np.isnan(found.at(np.array([[0.0, 0.0], [9.0, 0.0]]))).all()
    assert np.isfinite(found.at(np.array([[1.5, 1.5]]))).all()
    nothing = make_risk_map(np.full((10, 3), np.nan), Ability())
    assert not nothing.seen.any()


def test_a_stray_point_kilometres_away_is_an_error_and_not_a_huge_map():
    with pytest.raises(InputError, match="reach too far"):
        make_risk_map(np.array([[0, 0, 0], [1e6, 1e6, 0.0]]), Ability())
    with pytest.raises(ConfigError, match="window"):
        make_risk_map(np.zeros((5, 3)), Ability(), RiskMapConfig(window=0.0))


def test_slope_and_roughness_of_a_map_agree_with_those_of_others(shared_data):
    """The reference fits planes within 0.05 m on a grid of 0.03 m; so does this, over 3 × 3 cells."""
    with np.load(shared_data / "terrain_elevation_bag" / "elevation_map.npz") as data:
        layers = {name: data[name] for name in data.files}
    elevation = layers["elevation"]
    cell, (nx, ny) = 0.03, elevation.shape
    x, y = np.meshgrid((np.arange(nx) + 0.5) * cell, (np.arange(ny) + 0.5) * cell, indexing="ij")
    one = np.column_stack([x.ravel(), y.ravel(), elevation.ravel()])
    # Three of each: a cell with one point counts only where its neighbours agree.
    config = RiskMapConfig(surface=SurfaceConfig(cell=cell), window=3 * cell)
    found = make_risk_map(np.repeat(one, 3, axis=0), Ability(), config, origin=np.zeros(2), shape=(nx, ny))
    # Its layers are 1 − slope / 1 rad and 1 − roughness / 0.05 m, cut at 0.
    for ours, theirs in (
        (found.slope, 1 - layers["traversability_slope"]),
        (np.sqrt(found.roughness), 0.05 * (1 - layers["traversability_roughness"])),
    ):
        both = np.isfinite(ours) & np.isfinite(theirs) & (layers["traversability_slope"] > 0)
        assert both.mean() > 0.5
        assert np.corrcoef(ours[both], theirs[both])[0, 1] > 0.8
    assert np.median(np.abs(found.slope - (1 - layers["traversability_slope"]))[both]) < 0.03
