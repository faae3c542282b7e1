"""LeafSystem that gives every point of a scan its class probabilities."""

from dataclasses import dataclass, replace
from typing import Any

import open3d as o3d
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method
from ..sensing.scan import Scan
from .class_counts import ClassCounts
from .class_model import ClassModel, class_probabilities, fit_class_model


@dataclass(kw_only=True)
class PointClassesConfig:
    """When and how long classes are learnt."""

    # [s] How often it learns from a scan: the next one is much like the last.
    period: float = quantity(1.0, unit="s", above=0)
    # [scans] After so many the model stays as it is; 0 learns for ever.
    learn_scans: int = quantity(0, unit="scans", low=0)


@dataclass(frozen=True, eq=False)
class _Learnt:
    """Counts and model so far, and the index of the last scan in them."""

    counts: ClassCounts
    model: ClassModel
    index: int = -1

    def __deepcopy__(self, memo: dict) -> "_Learnt":
        return self

    def after(self, scan: Scan) -> "_Learnt":
        counts = self.counts.add(scan.cloud_S)
        return _Learnt(counts, fit_class_model(counts), scan.index)


class PointClasses(LeafSystem):
    """
    .. pydrake_system::

        name: PointClasses
        input_ports:
        - scan_S
        output_ports:
        - classified_scan_S
        - class_model

    Classes of the points of a scan (S2-a): levels of LiDAR intensity × near-infrared brightness, heat and dose, with
    thresholds in the valleys of the histograms of all scans so far; nothing is set by hand.

    - `scan_S` (`Scan`): with any of `intensity` or `reflectivity`, `nir` or `near_ir`, `temperature`, `dose_rate`.
    - `classified_scan_S` (`Scan`): the same with the attribute `class_probabilities`, (N, K) float32, the columns as in
      `CLASS_NAMES`, see `class_probabilities`. Its classes are those of the model then; the first scan is judged by its
      own histograms.
    - `class_model` (`ClassModel`): thresholds, shares and which classes are rare.

    Every `period` the scan is added to the histograms, if its index is new, and the model is fitted again.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: `scan_S` is not connected or of another type.
    """

    def __init__(self, config: PointClassesConfig | None = None):
        super().__init__()
        self._config = config or PointClassesConfig()
        check_config(self._config, where="point_classes")
        self.DeclareAbstractInputPort("scan_S", AbstractValue.Make(object()))
        start = _Learnt(ClassCounts(), fit_class_model(ClassCounts()))
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._Learn)
        # No tensor at all: one that lived until the interpreter ends would make Open3D warn of a leak.
        nothing = Scan(o3d.t.geometry.PointCloud(), 0.0, 0.0, -1)
        needs = {state, self.input_port_ticket(self.GetInputPort("scan_S").get_index())}
        self.DeclareAbstractOutputPort(
            "classified_scan_S", lambda: AbstractValue.Make(nothing), weak_method(self._CalcScan), needs
        )
        self.DeclareAbstractOutputPort(
            "class_model", lambda: AbstractValue.Make(start.model), weak_method(self._CalcModel), {state}
        )

    @staticmethod
    def _learnt(context: Context) -> _Learnt:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _Learn(self, context: Context, state: State) -> EventStatus:
        scan, learnt = eval_typed(self, context, "scan_S", Scan), self._learnt(context)
        full = 0 < self._config.learn_scans <= learnt.counts.scans
        if scan.index >= 0 and scan.index != learnt.index and not full:
            state.get_mutable_abstract_state(0).set_value(learnt.after(scan))
        return EventStatus.Succeeded()

    def _CalcScan(self, context: Context, output: AbstractValue) -> None:
        scan, learnt = eval_typed(self, context, "scan_S", Scan), self._learnt(context)
        model = learnt.model if learnt.counts.scans else learnt.after(scan).model
        cloud = o3d.t.geometry.PointCloud()
        for name, values in scan.cloud_S.point.items():  # shared, not copied
            cloud.point[name] = values
        cloud.point["class_probabilities"] = o3d.core.Tensor(class_probabilities(scan.cloud_S, model))
        output.set_value(replace(scan, cloud_S=cloud))

    def _CalcModel(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._learnt(context).model)
