"""How right an updated survey is about what changed, against both worlds; nothing in the loop may use this."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from naraha.models.worlds import Solid, World
from naraha.systems.changes import ChangedObject, SeenSpace, UpdateSummary
from naraha.systems.clouds import transform_points

# A point this near to a solid is on it [m]; a solid with this many points in a map was seen.
NEAR, ENOUGH = 0.15, 15


@dataclass(frozen=True)
class View:
    """What a survey saw: points of its map (N, 3) [m], and the space that it saw free."""

    points: np.ndarray
    seen: SeenSpace


def changed_solids(before: World, after: World) -> list[tuple[str, Solid]]:
    """What vanished and what appeared; a solid that was moved did both."""
    old, new = ({solid.name: solid for solid in world.solids} for world in (before, after))
    vanished = [("vanished", solid) for name, solid in old.items() if new.get(name) != solid]
    return vanished + [("appeared", solid) for name, solid in new.items() if old.get(name) != solid]


def box_distance(solid: Solid, points: np.ndarray) -> np.ndarray:
    """Distance (N,) [m] of points (N, 3) to a box, or to the box around another shape, 0 inside."""
    size = solid.box or [2 * (solid.cylinder or solid.sphere)[0]] * 2 + [
        (solid.cylinder or [0, 2 * solid.sphere[0]])[1]
    ]
    local = transform_points(solid.X_WG().inverse().GetAsMatrix4(), np.asarray(points, float))
    return np.linalg.norm(np.maximum(np.abs(local) - np.array(size) / 2, 0), axis=1)


def could_tell(kind: str, solid: Solid, earlier: View, new: View) -> bool:
    """Whether one survey has `ENOUGH` points on the solid in places that the other one saw free."""
    there, gone = (new, earlier) if kind == "appeared" else (earlier, new)
    on_it = there.points[box_distance(solid, there.points) <= 0.5 * NEAR]
    return bool(np.count_nonzero(gone.seen.views_at(on_it)) >= ENOUGH)


def change_metrics(
    worlds: tuple[World, World], views: tuple[View, View], summary: UpdateSummary, changes: Sequence[ChangedObject]
) -> dict[str, float]:
    """Precision and recall by object.

    A reported object is right when half of its points are within `NEAR` of solids that changed in this way. A solid is
    found when a right one has a quarter of `ENOUGH` points at it; it counts when the surveys `could_tell`.

    Args:
        worlds, views: before and after.
    """
    solids = changed_solids(*worlds)
    right = []
    for thing in changes:
        distances = [box_distance(solid, thing.points) for kind, solid in solids if kind == thing.kind]
        if distances and np.mean(np.min(distances, axis=0) <= NEAR) >= 0.5:
            right.append(thing)
    visible = [(kind, solid) for kind, solid in solids if could_tell(kind, solid, *views)]
    found = 0
    for kind, solid in visible:
        near = [np.count_nonzero(box_distance(solid, thing.points) <= NEAR) for thing in right if thing.kind == kind]
        found += int(max(near, default=0) >= ENOUGH / 4)
    return {
        "update_valid": int(summary.valid),
        "changes_reported": len(changes),
        "changes_right": len(right),
        "changes_visible": len(visible),
        "changes_found": found,
        "changes_precision": len(right) / len(changes) if changes else 1.0,
        "changes_recall": found / len(visible) if visible else 1.0,
        **{f"points_{word.replace(' ', '_')}": count for word, count in summary.points.items()},
    }
