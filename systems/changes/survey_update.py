"""An earlier survey map brought up to date by new keyframes: what stayed, appeared, vanished or was filled in."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem, ValueProducer
from scipy.spatial import KDTree

from ..config import check_config
from ..errors import PortError
from ..ports import eval_typed, weak_method
from ..slam.keyframe import Keyframe
from .earlier_survey import Alignment, EarlierSurvey, align_to_earlier, earlier_survey, read_survey
from .seen_space import SeenSpace, make_seen_space
from .sight import keyframe_rays
from .survey_changes import CHANGES, NOT_SEEN_AGAIN, UNCHANGED, ChangedObject, SurveyUpdateConfig, find_changes
from .survey_history import attach_history, history_of, join_maps, map_of, times_seen


@dataclass(frozen=True)
class UpdateSummary:
    """What an update found, in numbers.

    Attributes:
        valid: whether the new keyframes could be laid on the earlier map; `reason` says why not.
        survey: number of the new survey.
        keyframes: used ones.
        alignment: how the new keyframes lie on the earlier map, None without keyframes.
        points: number of points of the updated map, by the words of `CHANGES`.
        objects: number of objects that "appeared" and "vanished"; volumes: of the boxes around them [m³].
        seen_volume: space that the new keyframes saw free [m³].
        new_seen_volume: of it, space that no earlier survey had seen [m³].
    """

    valid: bool
    reason: str
    survey: int
    keyframes: int
    alignment: Alignment | None
    points: dict[str, int]
    objects: dict[str, int]
    volumes: dict[str, float]
    seen_volume: float
    new_seen_volume: float

    def __deepcopy__(self, memo: dict) -> "UpdateSummary":
        return self


@dataclass(frozen=True, eq=False)
class UpdatedSurvey:
    """Result of `update_survey`: the map with its history, the objects, the numbers, and what is now seen space."""

    map_M: PointCloud
    changes: tuple[ChangedObject, ...]
    summary: UpdateSummary
    seen: SeenSpace

    def __deepcopy__(self, memo: dict) -> "UpdatedSurvey":
        return self


def update_survey(
    earlier: EarlierSurvey,
    keyframes: Sequence[Keyframe],
    p_BS: np.ndarray,
    config: SurveyUpdateConfig | None = None,
    X_MK_guess: RigidTransform | None = None,
) -> UpdatedSurvey:
    """Brings `earlier` up to date with `keyframes`, whose map K is M but for a small error.

    Every point of the updated map has `change` (uint8: 0 unchanged, 1 appeared, 2 vanished, 3 filled in: no survey
    saw it or its space before, so nobody can say whether it is new, 4 not seen again: kept from the earlier survey),
    `first_survey`, `first_seen`, `survey` and `last_seen`: numbers of the surveys (uint16) and times in them
    (float32 [s], NaN unknown) when it was first and last seen. Other attributes are the means of both surveys, each
    point of the earlier map with its `count`; where one of them does not know a value, it is that of the other.

    When the keyframes do not fit the earlier map, or have no points, it is returned as it was, all of it *not seen
    again*, with `summary.valid` False and the reason.
    """
    config = config or SurveyUpdateConfig()
    survey = earlier.survey + 1
    usable = [k for k in keyframes if np.isfinite(k.p_BP).all(axis=1).any()]
    if not usable:
        return _refused(earlier, survey, 0, None, "no keyframe with points")
    new_K = map_of(usable, RigidTransform(), config.voxel_size)
    alignment = align_to_earlier(new_K, earlier, config, X_MK_guess)
    if not alignment.valid:
        return _refused(earlier, survey, len(usable), alignment, alignment.reason)
    new_M = map_of(usable, alignment.X_MK, config.voxel_size)
    rays = [keyframe_rays(k, p_BS, alignment.X_MK) for k in usable]
    seen = make_seen_space(rays, replace(config.seen, voxel_size=earlier.seen.voxel_size), survey=survey)
    p_old, p_new = (c.point.positions.numpy().astype(float) for c in (earlier.map_M, new_M))
    found = find_changes(p_old, p_new, earlier.seen, seen, rays, config)
    first, last = times_seen(usable, alignment.X_MK, config.voxel_size)
    old = history_of(earlier.map_M)
    new = {"change": found.new, "first_seen": first, "last_seen": last}
    new |= {name: np.full(len(p_new), survey) for name in ("survey", "first_survey")}
    known = found.new == UNCHANGED  # more points of a surface that was there
    nearest = KDTree(p_old).query(p_new[known])[1]
    for name in ("first_survey", "first_seen"):
        new[name][known] = old[name][nearest]
    old["change"] = found.earlier
    again = found.earlier == UNCHANGED
    old["survey"][again] = survey
    old["last_seen"][again] = last[KDTree(p_new).query(p_old[again])[1]]
    map_M = join_maps(earlier.map_M, old, new_M, new, config.voxel_size)
    merged = earlier.seen.merge(seen)
    summary = _summary(map_M, found.objects, survey, len(usable), alignment, seen, merged.volume - earlier.seen.volume)
    return UpdatedSurvey(map_M, found.objects, summary, merged)


def _refused(
    earlier: EarlierSurvey, survey: int, keyframes: int, alignment: Alignment | None, reason: str
) -> UpdatedSurvey:
    map_M = earlier.map_M.clone()
    history = history_of(earlier.map_M)
    history["change"][:] = NOT_SEEN_AGAIN
    attach_history(map_M, history)
    summary = UpdateSummary(
        valid=False,
        reason=reason,
        survey=survey,
        keyframes=keyframes,
        alignment=alignment,
        points=_points_by_change(map_M),
        objects={"appeared": 0, "vanished": 0},
        volumes={"appeared": 0.0, "vanished": 0.0},
        seen_volume=0.0,
        new_seen_volume=0.0,
    )
    return UpdatedSurvey(map_M, (), summary, earlier.seen)


def _summary(
    map_M: PointCloud,
    objects: tuple[ChangedObject, ...],
    survey: int,
    keyframes: int,
    alignment: Alignment,
    seen: SeenSpace,
    new_seen_volume: float,
) -> UpdateSummary:
    boxes = {
        kind: [float(thing.extent.prod()) for thing in objects if thing.kind == kind]
        for kind in ("appeared", "vanished")
    }
    return UpdateSummary(
        valid=True,
        reason=alignment.reason,
        survey=survey,
        keyframes=keyframes,
        alignment=alignment,
        points=_points_by_change(map_M),
        objects={kind: len(sizes) for kind, sizes in boxes.items()},
        volumes={kind: sum(sizes) for kind, sizes in boxes.items()},
        seen_volume=seen.volume,
        new_seen_volume=new_seen_volume,
    )


def _points_by_change(map_M: PointCloud) -> dict[str, int]:
    counts = np.bincount(map_M.point["change"].numpy()[:, 0], minlength=len(CHANGES))
    return dict(zip(CHANGES, counts.tolist(), strict=True))


class SurveyUpdate(LeafSystem):
    """
    .. pydrake_system::

        name: SurveyUpdate
        input_ports:
        - keyframes
        output_ports:
        - updated_map_M
        - changes
        - summary
        - seen_space

    Brings an earlier survey up to date, row S0-d; see `update_survey`, which it calls when an output is asked for and
    the keyframes are not those of the last time. M is the frame of the earlier map and stays that of the building.

    - `keyframes` (tuple of `Keyframe`): as `SurveyMap` gives them; their map may be off a little, which is corrected.
    - `updated_map_M` (`open3d.t.geometry.PointCloud`): both surveys in one map, with `change` and when seen.
    - `changes` (tuple of `ChangedObject`): what appeared or vanished.
    - `summary` (`UpdateSummary`): counts, volumes, and whether the keyframes fit the earlier map at all.
    - `seen_space` (`SeenSpace`): what all surveys saw free, for the next update.

    Until there are keyframes, and when they do not fit, the map is the earlier one, nothing has changed, and the
    summary is not valid.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: the input is not connected or of another type.
    """

    def __init__(self, earlier: EarlierSurvey, config: SurveyUpdateConfig | None = None, *, p_BS: np.ndarray):
        """
        Args:
            earlier: see `read_survey`.
            p_BS: the LiDAR in the base, where its rays start (3,) [m].
        """
        super().__init__()
        self._config = config or SurveyUpdateConfig()
        check_config(self._config)
        self._earlier, self._p_BS = earlier, np.asarray(p_BS, float)
        port = self.DeclareAbstractInputPort("keyframes", AbstractValue.Make(object()))
        start = update_survey(earlier, (), self._p_BS, self._config)
        entry = self.DeclareCacheEntry(
            "update", ValueProducer(lambda: AbstractValue.Make(start), weak_method(self._CalcUpdate)), {port.ticket()}
        )
        # Its index, because a system that holds its own cache entry is never freed.
        self._update_index, ticket = entry.cache_index(), {entry.ticket()}
        outputs = {
            "updated_map_M": (start.map_M, self._CalcMap),
            "changes": (start.changes, self._CalcChanges),
            "summary": (start.summary, self._CalcSummary),
            "seen_space": (start.seen, self._CalcSeen),
        }
        for name, (first, calc) in outputs.items():
            self.DeclareAbstractOutputPort(name, partial(AbstractValue.Make, first), weak_method(calc), ticket)

    def _update(self, context: Context) -> UpdatedSurvey:
        held: Any = self.get_cache_entry(self._update_index).EvalAbstract(context)
        return held.get_value()

    def _CalcMap(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._update(context).map_M)

    def _CalcChanges(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._update(context).changes)

    def _CalcSummary(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._update(context).summary)

    def _CalcSeen(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._update(context).seen)

    def _CalcUpdate(self, context: Context, output: AbstractValue) -> None:
        keyframes = eval_typed(self, context, "keyframes", tuple)
        for keyframe in keyframes:
            if not isinstance(keyframe, Keyframe):
                raise PortError(
                    "wrong type", where="SurveyUpdate.keyframes", value=type(keyframe).__name__, valid="Keyframe"
                )
        output.set_value(update_survey(self._earlier, keyframes, self._p_BS, self._config))


__all__ = [
    "Alignment",
    "EarlierSurvey",
    "SurveyUpdate",
    "SurveyUpdateConfig",
    "UpdateSummary",
    "UpdatedSurvey",
    "align_to_earlier",
    "earlier_survey",
    "read_survey",
    "update_survey",
]
