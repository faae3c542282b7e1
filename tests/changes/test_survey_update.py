import gc
import weakref
from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from naraha.models.worlds import World, load_world
from naraha.systems.changes.seen_space import make_seen_space, write_seen
from naraha.systems.changes.sight import keyframe_rays
from naraha.systems.changes.survey_changes import APPEARED, CHANGES, FILLED_IN, NOT_SEEN_AGAIN, UNCHANGED, VANISHED
from naraha.systems.changes.survey_update import (
    SurveyUpdate,
    SurveyUpdateConfig,
    align_to_earlier,
    earlier_survey,
    read_survey,
    update_survey,
)
from naraha.systems.clouds import VoxelCloud
from naraha.systems.errors import ConfigError, PortError, ScanFileError
from naraha.systems.sensing import write_cloud
from naraha.systems.slam import Keyframe
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw

from tests.changes.changed_hall import P_BS, box_distance, changed_hall, near_free, scan_tour, score, tour

SLIP = RigidTransform(RollPitchYaw(0, 0, np.deg2rad(1.5)), [0.15, -0.1, 0.03])


def survey_of(keyframes, survey=0):
    """What an earlier survey leaves behind."""
    voxels = VoxelCloud(0.1)
    for keyframe in keyframes:
        voxels = voxels.insert(keyframe.cloud_B, keyframe.X_MB.GetAsMatrix4())
    return earlier_survey(
        voxels.to_cloud(), make_seen_space([keyframe_rays(k, P_BS) for k in keyframes], survey=survey)
    )


def column(cloud, name):
    return cloud.point[name].numpy().ravel()


def positions(cloud):
    return cloud.point.positions.numpy()


def scanned(seed, count, **options):
    before, after, changes = changed_hall(load_world("stair_hall", seed), seed)
    poses = tour(count)
    return changes, scan_tour(before, poses, 1000 + seed, **options), scan_tour(after, poses, 2000 + seed, **options)


@pytest.fixture(scope="module")
def hall():
    """Two surveys of one hall, 12 poses each: changes, before, after, and the update."""
    changes, before, after = scanned(0, 12)
    return changes, before, after, update_survey(survey_of(before.keyframes), after.keyframes, P_BS)


def test_crates_that_were_moved_added_and_taken_away_are_found(hall):
    changes, before, after, update = hall
    result = score(update.changes, changes, before, after, RigidTransform())
    assert result.visible >= 15
    assert result.found >= 0.9 * result.visible, result.missed
    assert result.correct >= 0.9 * result.reported, result.false


def test_nothing_is_reported_in_space_that_was_not_seen(hall):
    _, before, after, update = hall
    for thing in update.changes:
        seen = near_free(thing.points, (before if thing.kind == "appeared" else after).free)
        assert seen.mean() > 0.95  # the rest is within the errors of the poses


def test_two_scans_of_one_hall_show_no_change_but_fill_in(hall):
    _, before, _, _ = hall
    world, _, _ = changed_hall(load_world("stair_hall", 0), 0)
    again = scan_tour(world, tour(13), 5)
    update = update_survey(survey_of(before.keyframes), again.keyframes, P_BS)
    assert update.changes == ()
    assert update.summary.points["filled in"] > 100
    assert update.summary.points["unchanged"] > 0.9 * len(positions(update.map_M)) - update.summary.points["filled in"]


def test_objects_are_where_their_points_are_and_the_summary_counts_them(hall):
    _, _, _, update = hall
    kinds = [thing.kind for thing in update.changes]
    summary = update.summary
    assert summary.valid
    assert summary.objects == {"appeared": kinds.count("appeared"), "vanished": kinds.count("vanished")}
    assert sum(summary.points.values()) == len(positions(update.map_M))
    assert summary.volumes["appeared"] > 0.5
    assert 0 < summary.new_seen_volume < summary.seen_volume
    for thing in update.changes:
        assert 0.5 < thing.confidence <= 1
        assert (np.abs(thing.points - thing.centre) <= thing.extent / 2 + 1e-5).all()
        flagged = positions(update.map_M)[column(update.map_M, "change") == CHANGES.index(thing.kind)]
        assert np.linalg.norm(flagged - thing.centre, axis=1).min() < 1.0


def test_every_point_keeps_when_it_was_first_and_last_seen(hall):
    _, _, after, update = hall
    change, survey, first_survey, first, last = (
        column(update.map_M, n) for n in ("change", "survey", "first_survey", "first_seen", "last_seen")
    )
    new = np.isin(change, [APPEARED, FILLED_IN])
    assert change.dtype == np.uint8
    assert (first_survey[new] == 1).all()
    assert (survey[np.isin(change, [VANISHED, NOT_SEEN_AGAIN])] == 0).all()
    assert (survey[new | (change == UNCHANGED)] == 1).all()
    assert (first[new] <= last[new]).all()
    times = [k.time for k in after.keyframes]
    assert np.isin(last[survey == 1], times).all()
    assert np.isnan(first[~new & (first_survey == 0)]).all()  # this earlier survey did not say
    assert len(np.unique(last[survey == 1])) > 5


def test_a_third_survey_forgets_what_had_vanished_and_counts_on(hall, tmp_path):
    _, _, after, update = hall
    write_cloud(tmp_path / "survey_map.ply", update.map_M)
    write_seen(tmp_path / "survey_seen.npz", update.seen)
    earlier = read_survey(tmp_path)
    assert earlier.survey == 1
    assert len(positions(earlier.map_M)) == len(positions(update.map_M)) - update.summary.points["vanished"]
    again = update_survey(earlier, after.keyframes, P_BS)
    assert again.changes == ()
    assert again.summary.survey == 2
    change, survey, first_survey = (column(again.map_M, n) for n in ("change", "survey", "first_survey"))
    assert set(np.unique(first_survey)) == {0, 1}
    assert (survey[change == UNCHANGED] == 2).mean() > 0.99


def test_a_slipped_map_frame_is_corrected(hall):
    _, before, after, update = hall
    earlier = survey_of(before.keyframes)
    slipped = [replace(k, X_MB=SLIP.inverse() @ k.X_MB) for k in after.keyframes]
    again = update_survey(earlier, slipped, P_BS)
    error = again.summary.alignment.X_MK @ SLIP.inverse()
    assert np.linalg.norm(error.translation()) < 0.05
    assert np.rad2deg(abs(error.rotation().ToAngleAxis().angle())) < 0.3
    assert again.summary.alignment.correction > 0.1
    assert abs(len(again.changes) - len(update.changes)) <= 3


def test_what_stands_where_the_earlier_survey_could_not_look_is_filled_in():
    hall = load_world("stair_hall", 0)
    quiet = [s for s in hall.solids if s.surface not in ("crate", "debris")]
    crate = replace(next(s for s in hall.solids if s.surface == "crate"), box=[0.6, 0.6, 0.8], rpy_deg=[0.0, 0.0, 0.0])
    hidden = replace(crate, name="crate_hidden", xyz=[0.8, 1.0, 0.4])  # the partition is at y = -0.6
    there = World(solids=[*quiet, hidden], surfaces=hall.surfaces)
    before = scan_tour(World(solids=quiet, surfaces=hall.surfaces), tour(12)[:4], 1)  # south of the partition
    after = scan_tour(there, tour(12), 2)
    update = update_survey(survey_of(before.keyframes), after.keyframes, P_BS)
    change = column(update.map_M, "change")
    on_crate = (box_distance(hidden, positions(update.map_M)) < 0.1) & (positions(update.map_M)[:, 2] > 0.15)
    assert on_crate.sum() > 50
    low = on_crate & (positions(update.map_M)[:, 2] < 0.6)
    assert (change[low] != APPEARED).all()
    assert (change[low] == FILLED_IN).mean() > 0.95


def test_attributes_that_one_survey_lacks_come_from_the_other(hall):
    _, before, after, _ = hall
    earlier = survey_of(before.keyframes)
    temperature = np.full((len(positions(earlier.map_M)), 1), 35.0, np.float32)
    temperature[::2] = np.nan
    earlier.map_M.point["temperature"] = o3d.core.Tensor(temperature)
    update = update_survey(earlier, after.keyframes, P_BS)
    known = np.isfinite(column(update.map_M, "temperature"))
    assert np.allclose(column(update.map_M, "temperature")[known], 35.0)
    assert 0.3 < known.mean() < 0.7
    assert np.isfinite(column(update.map_M, "intensity")).all()


def test_another_building_is_refused_with_the_reason(hall):
    _, before, _, _ = hall
    earlier = survey_of(before.keyframes)
    elsewhere = scan_tour(load_world("corridor", 0), [RigidTransform([x, 0, 0.08]) for x in range(0, 12, 3)], 3)
    update = update_survey(earlier, elsewhere.keyframes, P_BS)
    assert not update.summary.valid
    assert "another place" in update.summary.reason or "overlap" in update.summary.reason
    assert update.changes == ()
    np.testing.assert_array_equal(positions(update.map_M), positions(earlier.map_M))
    assert (column(update.map_M, "change") == NOT_SEEN_AGAIN).all()


def test_no_keyframes_and_points_that_are_not_finite_do_no_harm(hall):
    _, before, after, update = hall
    earlier = survey_of(before.keyframes)
    empty = Keyframe(0, 0.0, RigidTransform(), None, PointCloud(), 0.0)
    broken = Keyframe(1, 0.0, RigidTransform(), None, PointCloud(np.full((9, 3), np.nan, np.float32)), 0.0)
    for nothing in ((), (empty,), (broken,), (empty, broken)):
        refused = update_survey(earlier, nothing, P_BS)
        assert refused.summary.reason == "no keyframe with points"
    again = update_survey(earlier, (*after.keyframes, empty, broken), P_BS)
    assert again.summary == update.summary or again.summary.points == update.summary.points
    few = PointCloud(np.eye(3, dtype=np.float32))
    assert "usable points" in align_to_earlier(few, earlier).reason


def test_an_earlier_survey_that_cannot_be_used_is_named(tmp_path, hall):
    earlier = survey_of(hall[1].keyframes)
    with pytest.raises(ScanFileError, match=r"nowhere: no such folder"):
        read_survey(tmp_path / "nowhere")
    with pytest.raises(ScanFileError, match=r"survey_map.ply: no such file"):
        read_survey(tmp_path)
    write_cloud(tmp_path / "survey_map.ply", earlier.map_M)
    with pytest.raises(ScanFileError, match=r"survey_seen.npz: no such file"):
        read_survey(tmp_path)
    for cloud in (PointCloud(), PointCloud(np.full((3, 3), np.nan, np.float32))):
        with pytest.raises(ScanFileError, match="point"):
            earlier_survey(cloud, earlier.seen)
    gone = earlier.map_M.clone()
    gone.point["change"] = o3d.core.Tensor(np.full((len(positions(gone)), 1), VANISHED, np.uint8))
    with pytest.raises(ScanFileError, match="still there"):
        earlier_survey(gone, earlier.seen)


def test_the_system_says_what_the_function_says_and_computes_it_once(hall, monkeypatch):
    _, before, after, update = hall
    calls = []

    def counted(*args):
        calls.append(len(args[1]))
        return update_survey(*args)

    monkeypatch.setattr("naraha.systems.changes.survey_update.update_survey", counted)
    system = SurveyUpdate(survey_of(before.keyframes), p_BS=P_BS)
    context = system.CreateDefaultContext()
    port = system.GetInputPort("keyframes")
    port.FixValue(context, AbstractValue.Make(()))
    assert not system.GetOutputPort("summary").Eval(context).valid
    assert system.GetOutputPort("changes").Eval(context) == ()
    port.FixValue(context, AbstractValue.Make(after.keyframes))
    assert system.GetOutputPort("summary").Eval(context).points == update.summary.points
    assert len(system.GetOutputPort("changes").Eval(context)) == len(update.changes)
    np.testing.assert_array_equal(
        positions(system.GetOutputPort("updated_map_M").Eval(context)), positions(update.map_M)
    )
    np.testing.assert_array_equal(system.GetOutputPort("seen_space").Eval(context).keys, update.seen.keys)
    assert calls == [0, 0, len(after.keyframes)]  # at construction, without and with keyframes


def test_a_system_that_nobody_holds_is_freed(hall):
    system = SurveyUpdate(survey_of(hall[1].keyframes), p_BS=P_BS)
    reference = weakref.ref(system)
    del system
    gc.collect()
    assert reference() is None


def test_the_system_refuses_what_it_cannot_use(hall):
    earlier = survey_of(hall[1].keyframes)
    with pytest.raises(ConfigError, match="tolerance"):
        SurveyUpdate(earlier, SurveyUpdateConfig(tolerance=-1.0), p_BS=P_BS)
    system = SurveyUpdate(earlier, p_BS=P_BS)
    context = system.CreateDefaultContext()
    with pytest.raises(PortError, match="not connected"):
        system.GetOutputPort("changes").Eval(context)
    system.GetInputPort("keyframes").FixValue(context, AbstractValue.Make(("not a keyframe",)))
    with pytest.raises(PortError, match="valid: Keyframe"):
        system.GetOutputPort("changes").Eval(context)


@pytest.mark.slow
def test_changed_objects_are_found_in_twenty_halls():
    found = visible = correct = reported = 0
    for seed in range(20):
        changes, before, after = scanned(seed, 24)
        update = update_survey(survey_of(before.keyframes), after.keyframes, P_BS)
        result = score(update.changes, changes, before, after, RigidTransform())
        found, visible = found + result.found, visible + result.visible
        correct, reported = correct + result.correct, reported + result.reported
        for thing in update.changes:
            assert near_free(thing.points, (before if thing.kind == "appeared" else after).free).mean() > 0.95
    print(f"recall {found}/{visible}, precision {correct}/{reported}")
    assert visible > 400
    assert found >= 0.9 * visible
    assert correct >= 0.9 * reported
