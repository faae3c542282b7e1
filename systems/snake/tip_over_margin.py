"""How far the snake is from tipping over (row S1-f): the centre of mass against the edge of the support polygon."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method


@dataclass(kw_only=True)
class TipOverMarginConfig:
    """What counts as support."""

    # A contact carries when the vertical part of its force is at least this.
    min_vertical_force: float = quantity(0.05, unit="N", low=0.0)


@dataclass(frozen=True, eq=False)
class Support:
    """What the robot stands on, seen from above.

    Attributes:
        polygon: (K, 2) corners of the convex hull of the contact points in W, counter-clockwise [m].
        centre_of_mass: (3,) in W [m].
        margin: distance of its projection from the nearest edge [m]; negative outside, -inf with fewer than three
            corners.
    """

    polygon: np.ndarray
    centre_of_mass: np.ndarray
    margin: float

    def __deepcopy__(self, memo: dict) -> "Support":
        return self


def convex_hull(points: np.ndarray) -> np.ndarray:
    """Corners (K, 2) of the convex hull of `points` (N, 2), counter-clockwise, by Andrew's monotone chain."""
    ordered = sorted({(float(x), float(y)) for x, y in points})
    if len(ordered) < 3:
        return np.array(ordered).reshape(-1, 2)

    def half(sequence: list[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for p in sequence:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0:
                chain.pop()
            chain.append(p)
        return chain[:-1]

    return np.array(half(ordered) + half(ordered[::-1]))


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def tip_over_margin(polygon: np.ndarray, point: np.ndarray) -> float:
    """Signed distance [m] of `point` (2,) from the nearest edge of a convex polygon (K, 2), positive inside.

    Outside, it is the distance to the line of the edge that is missed by most, so that it is continuous across the
    edge. -inf for a polygon with fewer than three corners, on which nothing stands.
    """
    if len(polygon) < 3:
        return -np.inf
    edge = np.roll(polygon, -1, axis=0) - polygon
    inward = np.c_[-edge[:, 1], edge[:, 0]] / np.linalg.norm(edge, axis=1)[:, None]
    return float(np.min(np.sum((point - polygon) * inward, axis=1)))


def support_points(results: ContactResults, bodies: Collection[int], min_vertical_force: float) -> np.ndarray:
    """Contact points (N, 2) [m] in W at which something carries one of `bodies` from below."""
    points = []
    for k in range(results.num_point_pair_contacts()):
        info = results.point_pair_contact_info(k)
        on_A, on_B = int(info.bodyA_index()) in bodies, int(info.bodyB_index()) in bodies
        if on_A == on_B:  # within the robot, or not at the robot
            continue
        upward = info.contact_force()[2] if on_B else -info.contact_force()[2]
        if upward >= min_vertical_force:
            points.append(info.contact_point()[:2])
    return np.array(points).reshape(-1, 2)


class TipOverMargin(LeafSystem):
    """
    .. pydrake_system::

        name: TipOverMargin
        input_ports:
        - contact_results
        - body_poses
        output_ports:
        - tip_margin
        - support

    Distance of the centre of mass to the edge of the support polygon (row S1-f). `contact_results` and `body_poses`
    are the plant's output ports of these names; of the contacts, those that carry the robot from below count.

    - `tip_margin` (1): [m], positive while the centre of mass is above the polygon; -1e3 where there is none.
    - `support`: the `Support` that it comes from.

    It is the static margin: the robot moves slowly. With contacts at different heights the polygon is that of their
    projections, as in the source. Raises `PortError` when a port is not connected.
    """

    def __init__(self, config: TipOverMarginConfig, *, plant: MultibodyPlant, model: ModelInstanceIndex):
        super().__init__()
        check_config(config, key="tip_over_margin")
        self._config = config
        context = plant.CreateDefaultContext()
        bodies = [plant.get_body(i) for i in plant.GetBodyIndices(model)]
        self._indices = [int(body.index()) for body in bodies]
        self._bodies = frozenset(self._indices)
        self._masses = np.array([body.get_mass(context) for body in bodies])
        self._p_BBcm = np.array([body.CalcCenterOfMassInBodyFrame(context) for body in bodies])
        self.DeclareAbstractInputPort("contact_results", AbstractValue.Make(ContactResults()))
        self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self.DeclareVectorOutputPort("tip_margin", 1, self._CalcTipMargin)
        nothing = Support(np.zeros((0, 2)), np.zeros(3), -np.inf)
        self.DeclareAbstractOutputPort("support", lambda: AbstractValue.Make(nothing), weak_method(self._CalcSupport))

    def _support(self, context: Context) -> Support:
        results = eval_typed(self, context, "contact_results", ContactResults)
        poses = eval_typed(self, context, "body_poses", list)
        centres = np.array([poses[i].multiply(p) for i, p in zip(self._indices, self._p_BBcm, strict=True)])
        centre = self._masses @ centres / self._masses.sum()
        polygon = convex_hull(support_points(results, self._bodies, self._config.min_vertical_force))
        return Support(polygon, centre, tip_over_margin(polygon, centre[:2]))

    def _CalcTipMargin(self, context: Context, output: BasicVector) -> None:
        support: Any = self.GetOutputPort("support").Eval(context)
        output.SetFromVector(np.array([max(-1e3, support.margin)]))

    def _CalcSupport(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._support(context))


__all__ = [
    "Support",
    "TipOverMargin",
    "TipOverMarginConfig",
    "convex_hull",
    "support_points",
    "tip_over_margin",
]
