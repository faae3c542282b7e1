import numpy as np
import pytest
from naraha.models.worlds import BUILDERS, load_world, stair_hall
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
    with pytest.raises(WorldError, match=r"unknown world.*'moon'.*corridor, rough, stair_hall, stair_hall_later"):
        load_world("moon", 0)
    with pytest.raises(WorldError, match=r"nowhere\.yaml: No such file"):
        load_world("nowhere.yaml", 0)
