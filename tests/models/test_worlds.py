from itertools import pairwise

import numpy as np
import pytest
from naraha.models.worlds import BUILDERS, e2827, load_world, ramps, real_like, rough_field, stair_hall
from naraha.systems.errors import ConfigError, WorldError
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

GROUND = """
surfaces: {concrete: {label: floor}}
solids:
- {name: floor, box: [4, 4, 0.2], xyz: [0, 0, -0.1], surface: concrete}
"""


@pytest.mark.parametrize("name", sorted(BUILDERS))
@pytest.mark.parametrize("seed", [0, 1])
def test_every_shipped_world_builds_in_a_plant_with_every_surface_found(name, seed):
    world = load_world(name, seed)
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.004)
    world.add_to(plant)
    plant.Finalize()
    table = world.surface_table()
    inspector = scene_graph.model_inspector()
    assert inspector.num_geometries() == len(world.solids) + sum(s.collides for s in world.solids)
    for solid in world.solids:
        assert table.lookup(solid.name) is world.surfaces[solid.surface]


@pytest.mark.parametrize("name", sorted(BUILDERS))
def test_a_seed_repeats_a_world_and_another_seed_changes_it(name):
    assert load_world(name, 3) == load_world(name, 3)
    assert load_world(name, 3) != load_world(name, 4)


def test_stair_hall_has_what_the_sources_hall_has():
    world = load_world("stair_hall", 0)
    labels = [world.surfaces[s.surface].label for s in world.solids]
    assert labels.count("water") == 5
    assert all(s.cylinder[0] == 0.4 for s in world.solids if world.surfaces[s.surface].label == "water")
    assert labels.count("heat") == 1
    assert labels.count("source") == 1
    assert sum(surface.activity > 0 for surface in world.surfaces.values()) == 1
    risers = [s for s in world.solids if s.name.startswith("riser_west")]
    tops = sorted(s.xyz[2] + s.box[2] / 2 for s in risers)
    np.testing.assert_allclose(np.diff(tops), 0.18)
    np.testing.assert_allclose(np.abs(np.diff(sorted(s.xyz[0] for s in risers))), 0.26)
    landing = next(s for s in world.solids if s.name == "landing")
    assert landing.xyz[2] + landing.box[2] / 2 == pytest.approx(tops[-1])


@pytest.mark.parametrize("seed", range(5))
def test_crates_and_debris_leave_the_way_free(seed):
    world = load_world("stair_hall", seed)
    loose = [s for s in world.solids if s.name.startswith(("crate", "debris"))]
    reach = np.array([np.hypot(*s.box[:2]) / 2 for s in loose])
    gap = stair_hall.clearance(np.array([s.xyz[:2] for s in loose]), stair_hall.FREE_WAY) - reach
    assert gap.min() > 0.45


@pytest.mark.parametrize("seed", range(5))
def test_every_pool_can_be_seen_from_the_way(seed):
    world = load_world("stair_hall", seed)
    loose = [s for s in world.solids if s.name.startswith(("crate", "debris"))]
    reach = np.array([np.hypot(*s.box[:2]) / 2 for s in loose])
    for pool, start in stair_hall.SIGHT_LINES.items():
        line = np.array([start, stair_hall.POOLS[pool]])
        assert np.linalg.norm(np.diff(line, axis=0)) < 5
        assert (stair_hall.clearance(np.array([s.xyz[:2] for s in loose]), line) - reach).min() > 0
        assert stair_hall.clearance(np.array([start]), stair_hall.FREE_WAY)[0] < 1e-9


def test_the_hall_has_what_a_near_infrared_camera_takes_for_water():
    world = load_world("stair_hall", 0)
    dark = {s.name for s in world.solids if world.surfaces[s.surface].nir_reflectance < 0.1}
    assert dark == {*stair_hall.POOLS, "panel", "mat", "wet_wall"}
    lamp, wall = 0.44, next(s for s in world.solids if s.name == "low_wall")
    assert wall.xyz[2] + wall.box[2] / 2 < lamp  # the lamp shines over it, but the floor behind is in its shadow


@pytest.mark.parametrize("seed", range(3))
def test_later_ten_crates_have_moved_five_are_gone_and_five_are_new(seed):
    before, later = ({s.name: s for s in load_world(name, seed).solids} for name in ("stair_hall", "stair_hall_later"))
    assert sum(name not in later for name in before) == 5
    assert sum(name not in before for name in later) == 5
    changed = [name for name in before if name in later and before[name] != later[name]]
    assert len(changed) == 10
    assert all(name.startswith("crate_") for name in changed)
    assert all(np.hypot(*np.subtract(before[n].xyz, later[n].xyz)[:2]) > 1.2 for n in changed)
    loose = [s for s in later.values() if s.name.startswith("crate_")]
    reach = np.array([np.hypot(*s.box[:2]) / 2 for s in loose])
    assert (stair_hall.clearance(np.array([s.xyz[:2] for s in loose]), stair_hall.FREE_WAY) - reach).min() > 0.45


def test_a_world_from_a_file(tmp_path):
    path = tmp_path / "yard.yaml"
    path.write_text(GROUND)
    world = load_world("yard.yaml", 0, tmp_path)
    assert [s.name for s in world.solids] == ["floor"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GROUND.replace("label: floor", "label: wall"), "the world has no ground"),
        (GROUND.replace("surface: concrete}", "surface: sand}"), r"solids\[0\]\.surface: unknown surface.*concrete"),
        (GROUND.replace("box: [4, 4, 0.2]", "box: [4, 4]"), r"solids\[0\].*exactly one of box"),
        (GROUND.replace("4, 4, 0.2", "4, -4, 0.2"), r"solids\[0\]\.box: out of range"),
        (GROUND.replace("name: floor, ", ""), r"solids\[0\]: name is missing"),
        (GROUND.replace("box:", "cube:"), "not a world.*cube"),
        ("just a sentence", "not a world.*mapping"),
        ("solids: [", "not a world"),
    ],
)
def test_a_bad_world_file_gives_one_line_that_names_it(tmp_path, text, message):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises((WorldError, ConfigError), match=message) as caught:
        load_world(str(path), 0)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_world_and_a_missing_file_are_refused():
    with pytest.raises(WorldError, match=r"unknown world.*'moon'.*corridor, e2827, .*stair_hall_later"):
        load_world("moon", 0)
    with pytest.raises(WorldError, match=r"nowhere\.yaml: No such file"):
        load_world("nowhere.yaml", 0)


def heights(world, xy):
    """Height of the ground at each place, from above, (N,) [m]."""
    above = np.column_stack([xy, np.full(len(xy), 3.0)]).astype(np.float32)
    down = np.tile(np.float32([0, 0, -1]), (len(xy), 1))
    return 3.0 - world.ray_scene().cast(above, down).distance.astype(float)


def along(way, step):
    """Places every `step` [m] along a polyline, and the unit vectors across it, (N, 2) each."""
    places, across = [], []
    for first, last in pairwise(way):
        length = np.linalg.norm(last - first)
        t = np.arange(0, length, step)[:, None] / length
        places.append(first + t * (last - first))
        across.append(np.tile(np.array([first[1] - last[1], last[0] - first[0]]) / length, (len(t), 1)))
    return np.vstack(places), np.vstack(across)


def corridor_heights(field_world, way, width, step=0.02):
    """Heights in strips along each leg of a way: list of (along, across) arrays."""
    strips = []
    for first, last in pairwise(way):
        places, across = along(np.array([first, last]), step)
        offsets = np.arange(-width / 2, width / 2 + 1e-9, step)
        grid = places[:, None] + offsets[None, :, None] * across[:, None]
        strips.append(heights(field_world, grid.reshape(-1, 2)).reshape(grid.shape[:2]))
    return strips


def test_a_wedge_rises_from_its_foot_at_its_slope_and_is_solid_down_to_the_floor():
    solid = ramps.wedge("w", (1.0, 2.0), yaw=0.5, run=0.8, width=1.0, slope_deg=20)
    ahead = np.array([np.cos(0.5), np.sin(0.5)])
    for share in (0.05, 0.5, 0.95):
        top = solid.X_WG().inverse() @ np.array([*(np.array([1.0, 2.0]) + share * 0.8 * ahead), 0.0])
        surface = np.array([*(np.array([1.0, 2.0]) + share * 0.8 * ahead), share * 0.8 * np.tan(np.deg2rad(20))])
        assert (solid.X_WG().inverse() @ surface)[2] == pytest.approx(solid.box[2] / 2, abs=1e-9)
        assert np.all(np.abs(top) < np.array(solid.box) / 2)  # the floor below is inside


@pytest.mark.parametrize("module", [e2827, real_like])
def test_over_the_ramps_there_are_ridges_of_15_degrees_and_around_them_it_is_flat(module):
    world = module.build(0)
    way = np.array([module.START[:2], module.GOAL])
    places, _ = along(way, 0.01)
    z = heights(world, places)
    assert sum(s.name.startswith("pillar") for s in world.solids) == (2 if module is e2827 else 0)
    low = z < 1.0  # without the pillar
    slope = np.rad2deg(np.arctan(np.abs(np.diff(z[low])) / 0.01))
    steep = slope[(slope > 1) & (slope < 45)]
    assert np.median(steep) == pytest.approx(15, abs=0.5)
    assert z[low].max() == pytest.approx(ramps.RUN * np.tan(np.deg2rad(15)), abs=0.003)
    assert heights(world, along(module.WAY_AROUND, 0.02)[0]).max() < 1e-6
    for strip in corridor_heights(world, module.WAY_AROUND, 0.8):
        assert strip.max() < 1e-6


@pytest.mark.parametrize("module", [e2827, real_like])
def test_over_the_ramps_is_a_good_deal_shorter_than_around(module):
    over = np.linalg.norm(np.subtract(module.GOAL, module.START[:2]))
    around = np.linalg.norm(np.diff(module.WAY_AROUND, axis=0), axis=1).sum()
    assert 0.55 < over / around < 0.7
    assert abs(module.START[2]) < 0.1


def test_where_lanes_of_ramps_meet_there_is_an_upright_face():
    world = load_world("e2827", 0)
    x = np.arange(-1.7, 1.7, 0.01)
    seam = e2827.SOUTH + ramps.LANE
    left, right = (heights(world, np.column_stack([x, np.full_like(x, seam + side)])) for side in (0.01, -0.01))
    assert np.abs(left - right).max() == pytest.approx(0.16, abs=0.005)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("limits", [(7.0, 0.015, 1e-4), (12.0, 0.06, 1e-3)])
def test_the_corridor_of_a_rough_field_keeps_to_the_limits(seed, limits):
    slope, step, roughness = limits
    field = rough_field.build(seed, severity=1.0, max_slope_deg=slope, max_step=step, max_roughness=roughness)
    np.testing.assert_array_equal(field.path[[0, -1]], [field.start_xy, field.goal_xy])
    for strip in corridor_heights(field.world, field.path, 1.2):
        rise = max(np.abs(np.diff(strip, axis=axis)).max() for axis in (0, 1))
        assert rise <= step + 0.02 * np.tan(np.deg2rad(slope)) + 1e-6
    for place in (field.start_xy, field.goal_xy):
        angle = np.linspace(0, 2 * np.pi, 40)[:, None]
        disc = place + np.array([0.3, 0.6, 0.95])[:, None, None] * np.hstack([np.cos(angle), np.sin(angle)])
        assert heights(field.world, disc.reshape(-1, 2)).max() < 1e-6


def reachable(world, start, goal, limit):
    """Whether flooding a raster of heights of 0.1 m from the start, over steps up to `limit` [m], gets to the goal."""
    west, east, south, north = rough_field.BOUNDS
    x, y = np.arange(west - 0.05, east + 0.1, 0.1), np.arange(south - 0.05, north + 0.1, 0.1)
    z = heights(world, np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)).reshape(len(x), len(y))
    seen, front = np.zeros(z.shape, bool), [tuple(np.rint((start - [x[0], y[0]]) / 0.1).astype(int))]
    while front:
        i, j = front.pop()
        if seen[i, j]:
            continue
        seen[i, j] = True
        for a, b in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
            if 0 <= a < len(x) and 0 <= b < len(y) and not seen[a, b] and abs(z[a, b] - z[i, j]) <= limit:
                front.append((a, b))
    return seen[tuple(np.rint((goal - [x[0], y[0]]) / 0.1).astype(int))]


@pytest.mark.parametrize("seed", range(8))
def test_no_way_leads_to_the_goal_of_a_blocked_field_and_without_the_barrier_one_does(seed):
    free, blocked = (rough_field.build(seed, severity=1.0, blocked=flag) for flag in (False, True))
    names = {s.name for s in free.world.solids}
    assert names == {s.name for s in blocked.world.solids if not s.name.startswith("barrier")}
    assert reachable(free.world, free.start_xy, free.goal_xy, 0.05)
    assert not reachable(blocked.world, blocked.start_xy, blocked.goal_xy, 1.0)


def test_a_worse_field_has_more_in_it_and_mostly_bars_the_straight_way():
    barred = 0
    for seed in range(10):
        empty, half, full = (rough_field.build(seed, severity=s) for s in (0.0, 0.5, 1.0))
        assert len(empty.world.solids) < len(half.world.solids) < len(full.world.solids)
        places, across = along(np.array([full.start_xy, full.goal_xy]), 0.05)
        barred += heights(full.world, np.vstack([places + d * across for d in (-0.2, 0, 0.2)])).max() > 0.1
    assert barred >= 7
