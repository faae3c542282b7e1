"""Contact pads along the belly and the sides of the snake: force-sensing resistors with their faults."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import GeometryId, SceneGraphInspector
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..errors import ConfigError
from ..noise import generator_at
from ..ports import eval_typed

# Places of the pads of one unit, in the order in which `pad_forces` lists them. "front" is the half before the pitch
# joint, "rear" the half behind it.
PAD_PLACES = ("belly_front", "belly_rear", "left", "right")


@dataclass(kw_only=True)
class ContactPadsConfig:
    """Thin force-sensing resistors read by a 12 bit converter. Values are assumed, of the order that makers state."""

    # Time between samples.
    period: float = quantity(0.02, unit="s", above=0.0)
    # Less than this is not felt.
    threshold: float = quantity(0.3, unit="N", low=0.0)
    # More than this reads as this.
    saturation: float = quantity(50.0, unit="N", above=0.0)
    # Standard deviation of the gain from part to part, drawn once a run.
    gain_error_std: float = quantity(0.06, low=0.0)
    # Standard deviation of the noise of a reading.
    noise_std: float = quantity(0.1, unit="N", low=0.0)


def pad_reading(force: np.ndarray, gain: np.ndarray, noise: np.ndarray, config: ContactPadsConfig) -> np.ndarray:
    """What pads under `force` [N] read [N]: zero below the threshold, then gain and noise, never above saturation."""
    felt = np.where(force < config.threshold, 0.0, force * gain) + noise
    return np.clip(np.where(felt < config.threshold, 0.0, felt), 0.0, config.saturation)


def pad_loads(results: ContactResults, pads: Mapping[GeometryId, int], count: int) -> np.ndarray:
    """Magnitude of the contact force on every pad, (count,) [N]: the sum over its contact points.

    Args:
        pads: index of the pad by the id of its collision geometry.
    """
    loads = np.zeros(count)
    for k in range(results.num_point_pair_contacts()):
        info = results.point_pair_contact_info(k)
        pair = info.point_pair()
        for geometry in (pair.id_A, pair.id_B):
            index = pads.get(geometry, -1)
            if index >= 0:
                loads[index] += np.linalg.norm(info.contact_force())
    return loads


def find_pads(
    plant: MultibodyPlant, inspector: SceneGraphInspector, model: ModelInstanceIndex, units: int
) -> dict[GeometryId, int]:
    """Index into `pad_forces` of every collision geometry of `model` that is a pad, 4 × unit + place.

    A pad's geometry is named `pad_<place>` or `pad_<place>_<anything>` with a place of `PAD_PLACES`, or `belly` and
    the like on a link whose name begins with F (front half) or R (rear half) and ends with the number of its unit.

    Raises:
        ConfigError: the model has no pads, or those of a unit that it should not have.
    """
    found: dict[GeometryId, int] = {}
    for body_index in plant.GetBodyIndices(model):
        body = plant.get_body(body_index)
        half, digits = body.name()[:1], body.name()[1:]
        if half not in ("F", "R") or not digits.isdigit():
            continue
        if int(digits) >= units:
            raise ConfigError("a pad on a unit beyond the last", key=body.name(), valid=f"0 to {units - 1}")
        for geometry in plant.GetCollisionGeometriesForBody(body):
            name = inspector.GetName(geometry).rpartition("::")[2]
            place = pad_place(name, half)
            if place is not None:
                found[geometry] = len(PAD_PLACES) * int(digits) + PAD_PLACES.index(place)
    if not found:
        raise ConfigError("the model has no contact pads", key=plant.GetModelInstanceName(model), valid="pad_* shapes")
    return found


def pad_place(name: str, half: str) -> str | None:
    """Place of the pad whose collision geometry has `name`, on the half "F" or "R" of its unit; None for no pad."""
    if not name.startswith("pad"):
        return None
    if "left" in name:
        return "left"
    if "right" in name:
        return "right"
    return "belly_front" if half == "F" else "belly_rear"


class ContactPads(LeafSystem):
    """
    .. pydrake_system::

        name: ContactPads
        input_ports:
        - contact_results
        output_ports:
        - pad_forces

    Contact pads of a snake with n units. `contact_results` is the plant's output port of this name (point contacts).
    `pad_forces` (4n) [N] is what the pads read, unit by unit from the head, each in the order of `PAD_PLACES`: the
    belly before and behind the pitch joint, the left and the right side. A pad feels the sum of the magnitudes of
    the contact forces on it, with a gain of its own, noise, a threshold and saturation (`pad_reading`).

    Sampled every period from t = 0 on and held between; zero before the first sample.

    Args:
        config: noise and thresholds.
        pads: index into `pad_forces` by collision geometry, see `find_pads`.
        units: n.
        seed: of gains and noise; two runs with one seed are equal.

    Raises `ConfigError` on values out of range and `PortError` when the port is not connected.
    """

    def __init__(self, config: ContactPadsConfig, *, pads: Mapping[GeometryId, int], units: int, seed: int = 0):
        super().__init__()
        check_config(config, key="pads")
        self._config, self._pads, self._seed = config, dict(pads), seed
        self._count = len(PAD_PLACES) * units
        self._gain = np.maximum(0.0, 1 + config.gain_error_std * generator_at(seed, 0).standard_normal(self._count))
        self.DeclareAbstractInputPort("contact_results", AbstractValue.Make(ContactResults()))
        self.DeclareDiscreteState(self._count + 1)  # readings, then the number of samples
        self.DeclareVectorOutputPort("pad_forces", self._count, self._CalcPadForces, {self.xd_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Sample)

    def _CalcPadForces(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[:-1])

    def _Sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        results = eval_typed(self, context, "contact_results", ContactResults)
        sample = int(context.get_discrete_state_vector().value()[-1]) + 1
        noise = self._config.noise_std * generator_at(self._seed, sample).standard_normal(self._count)
        reading = pad_reading(pad_loads(results, self._pads, self._count), self._gain, noise, self._config)
        discrete_state.set_value(np.r_[reading, sample])


__all__: Sequence[str] = ["PAD_PLACES", "ContactPads", "ContactPadsConfig", "find_pads", "pad_loads", "pad_reading"]
