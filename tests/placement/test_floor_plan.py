"""Floor plans: drawn walls, images, boxes, and the one clear error for what cannot be used."""

import numpy as np
import pytest
from naraha.models.plans import PLANS_DIR, load_floor_plan, shipped_plans
from naraha.models.plans.generate import GENERATED, as_yaml
from naraha.systems.errors import ConfigError, PlanError
from naraha.systems.placement import plan_from_walls
from PIL import Image

ROOM = """
size: [6.0, 4.0]
wall_thickness: 0.2
resolution: 0.1
walls:
- [[0.1, 0.1], [5.9, 0.1], [5.9, 3.9], [0.1, 3.9], [0.1, 0.1]]
{more}
start: {start}
measuring_points: {points}
"""


POINTS = "start: [1, 5, 0]\nmeasuring_points: [[2, 5]]\n"


def written(tmp_path, more="", start="[1, 1, 0]", points="[[5, 3]]"):
    path = tmp_path / "room.yaml"
    path.write_text(ROOM.format(more=more, start=start, points=points))
    return path


def test_walls_are_as_thick_as_stated_and_boxes_cover_them_exactly(tmp_path):
    plan = load_floor_plan(written(tmp_path))
    expected = np.ones((40, 60), bool)
    expected[2:-2, 2:-2] = False
    assert (plan.occupied == expected).all()
    drawn = np.zeros_like(expected)
    for x0, y0, x1, y1 in plan.wall_boxes():
        rows, cols = slice(round(y0 / 0.1), round(y1 / 0.1)), slice(round(x0 / 0.1), round(x1 / 0.1))
        assert not drawn[rows, cols].any()
        drawn[rows, cols] = True
    assert (drawn == expected).all()


def test_slanted_walls_and_filled_solids_have_their_area():
    wall = np.array([[[2.0, 2.0], [6.0, 5.0]]])
    plan = plan_from_walls(wall, np.array([10, 10]), np.zeros(3), np.ones((1, 2)), thickness=0.4, resolution=0.02)
    assert plan.occupied.sum() * 0.02**2 == pytest.approx((5 + 0.4) * 0.4, rel=0.01)
    triangle = np.array([[2.0, 2.0], [8.0, 2.0], [2.0, 6.0]])
    plan = plan_from_walls([], np.array([10, 10]), np.zeros(3), np.ones((1, 2)), outlines=[triangle], resolution=0.02)
    assert plan.occupied.sum() * 0.02**2 == pytest.approx(12, rel=0.01)


def test_an_image_is_upright_as_on_paper_and_its_scale_counts(tmp_path):
    grey = np.full((40, 60), 255, np.uint8)
    grey[:2], grey[-2:], grey[:, :2], grey[:, -2:] = 0, 0, 0, 0
    grey[2:10, 50:58] = 0  # upper right corner
    Image.fromarray(grey).save(tmp_path / "room.png")
    path = tmp_path / "plan.yaml"
    path.write_text(
        "image: room.png\nresolution: 0.25\norigin: [-5, 2]\nstart: [0, 5, 0]\nmeasuring_points: [[8, 4]]\n"
    )
    plan = load_floor_plan(path)
    assert plan.size == pytest.approx([15, 10])
    assert plan.is_occupied(np.array([[9.0, 11.0], [-4, 11], [9, 3], [-5.1, 5]])).tolist() == [True, False, False, True]


def test_a_box_that_is_added_is_where_and_as_large_as_stated():
    plan = plan_from_walls([], np.array([4.0, 3.0]), np.zeros(3), np.ones((1, 2)), resolution=0.05)
    boxed = plan.with_boxes(np.array([[1.0, 2.0], [3.0, 0.5]]))
    rows, cols = np.nonzero(boxed.occupied[30:])
    assert boxed.occupied.sum() == 200
    assert (rows.min() + 30, rows.max() + 31, cols.min(), cols.max() + 1) == (35, 45, 15, 25)
    assert not plan.occupied.any()


def test_points_and_cells_are_inverse():
    plan = load_floor_plan("construction_hall")
    cells = np.array([[0, 0], [12, 700], [699, 1199]])
    assert (plan.cell_of(plan.centre_of(cells)) == cells).all()


def test_a_wall_hides_what_is_behind_it_and_an_opening_shows_it(tmp_path):
    """A wall of 0.2 m at x = 3 up to y = 2, seen from both sides of it and from above its end."""
    plan = load_floor_plan(written(tmp_path, more="- [[3, 0], [3, 2]]"))
    points = np.array([[1.0, 1.0], [5.0, 1.0], [1.0, 3.5], [2.85, 1.0]])
    expected = [[1, 0, 1, 1], [0, 1, 1, 0], [1, 1, 1, 1], [1, 0, 1, 1]]
    np.testing.assert_array_equal(plan.sight(points, points), np.array(expected, bool))
    assert plan.sight(points[:1], points).shape == (1, 4)


@pytest.mark.parametrize("name", shipped_plans())
def test_shipped_plans_can_be_used(name):
    plan = load_floor_plan(name)
    plan.check(clearance=0.5)
    assert len(plan.measuring_points) >= 8


@pytest.mark.parametrize("name", GENERATED)
def test_generated_plans_are_those_that_are_shipped_and_other_seeds_can_be_used_too(name, tmp_path):
    assert (PLANS_DIR / f"{name}.yaml").read_text() == as_yaml(GENERATED[name](), name)
    for seed in range(1, 4):
        path = tmp_path / f"{seed}.yaml"
        path.write_text(as_yaml(GENERATED[name](seed), name))
        load_floor_plan(path).check(clearance=0.5)
    assert GENERATED[name](1) != GENERATED[name](2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"points": "[[5, 3.95]]"}, ["measuring_points[0]", "inside a wall"]),
        ({"start": "[7, 1, 0]"}, ["start", "outside the plan", "0..6"]),
        ({"start": "[0.4, 1, 0]"}, ["start", "too near to a wall", "0.3 m"]),
        ({"more": "- [[3, 0], [3, 4]]"}, ["measuring_points[0]", "no way"]),
        ({"points": "[]"}, ["measuring_points", "list of x, y"]),
        ({"start": "[1, 1]"}, ["start", "x, y, heading"]),
        ({"more": "wals: []"}, ["wals", "unknown key"]),
        ({"more": "- [[3, a], [3, 4]]"}, ["not a floor plan"]),
    ],
)
def test_a_plan_that_cannot_be_used_is_refused_in_one_line(tmp_path, changes, words):
    path = written(tmp_path, **changes)
    with pytest.raises(PlanError) as error:
        load_floor_plan(path)
    assert all(word in str(error.value) for word in [str(path), *words])


def test_a_plan_without_scale_or_size_is_refused(tmp_path):
    Image.fromarray(np.full((40, 60), 255, np.uint8)).save(tmp_path / "room.png")
    with pytest.raises(PlanError, match="without scale"):
        load_floor_plan(tmp_path / "room.png")
    path = tmp_path / "plan.yaml"
    path.write_text("image: room.png\n" + POINTS)
    with pytest.raises(PlanError, match="resolution: a plan without scale"):
        load_floor_plan(path)
    path.write_text("image: room.png\nresolution: -1\n" + POINTS)
    with pytest.raises(ConfigError, match=r"resolution.*> 0"):
        load_floor_plan(path)
    with pytest.raises(PlanError, match=r"no such floor plan.*construction_hall"):
        load_floor_plan("hall_of_fame")
