"""Rules that turn measurements into a diagnosis: stuck or not, at which unit, and in which of the five classes."""

from dataclasses import dataclass, field

import numpy as np

from ..config import quantity
from .stuck_features import SnakeMeasures, StuckFeatures

KINDS = (1, 2, 3, 4, 5)
WORDS = {
    0: "free",
    1: "a plate between two axles blocks the wheels",
    2: "a bend is wedged, the sides of the wheels rub",
    3: "something reaches in from the sides and blocks the wheels",
    4: "the belly lies on something",
    5: "the belly lies on an edge",
}


@dataclass(kw_only=True)
class StuckRules:
    """Thresholds of the rules. Assumed, and tried on the worlds `stuck_1` to `stuck_5` with seeds from 1000 on."""

    # Driving means that the wheels are commanded at least this.
    driving_speed: float = quantity(0.02, unit="m/s", above=0.0)
    # Share of the commanded speed at which the body is as likely stuck as not, and the width of the transition.
    speed_share: float = quantity(0.45, low=0.0)
    speed_share_width: float = quantity(0.10, above=0.0)
    # Thrust as a share of the weight, less what lifts it, at which it is as likely stuck as not, and its width.
    thrust_share: float = quantity(0.25, low=0.0)
    thrust_share_width: float = quantity(0.10, above=0.0)
    # Force on the whole belly, as a share of the weight, that adds 2 to the log-odds, no more.
    belly_share: float = quantity(0.15, above=0.0)
    # Force on a half of the belly that counts as lying on something.
    belly_load: float = quantity(4.0, unit="N", above=0.0)
    # Torque of a yaw joint that counts as wedged.
    yaw_torque: float = quantity(4.0, unit="N m", above=0.0)
    # Difference in height of the axles before and behind that counts as a step.
    step_height: float = quantity(0.04, unit="m", above=0.0)
    # Share of the belly's clearance below which something is under it.
    under_share: float = quantity(0.6, low=0.0, high=1.0)
    # Share of the way from the body's side to the wheel's outer face within which something reaches in.
    beside_share: float = quantity(0.6, low=0.0, high=1.0)


@dataclass(frozen=True)
class Diagnosis:
    """What is the matter.

    Attributes:
        stuck: whether the robot is stuck.
        probability: that it is, 0 to 1.
        kind: the likeliest class 1 to 5, 0 while it is not stuck.
        unit: where, counted from the head; -1 while it is not stuck.
        confidence: of the class, 0 to 1.
        scores: of the five classes, 0 to 1.
        body_speed: estimated speed along the head's x axis [m/s].
        thrust: of all wheels [N].
    """

    stuck: bool = False
    probability: float = 0.0
    kind: int = 0
    unit: int = -1
    confidence: float = 0.0
    scores: tuple[float, ...] = field(default=(0.0, 0.0, 0.0, 0.0, 0.0))
    body_speed: float = 0.0
    thrust: float = 0.0

    @property
    def in_words(self) -> str:
        """The class in words."""
        return WORDS[self.kind]


def sigmoid(x: float) -> float:
    """1 / (1 + exp(-x)), without overflow."""
    return float(0.5 * (1 + np.tanh(0.5 * x)))


def stuck_probability(f: StuckFeatures, measures: SnakeMeasures, rules: StuckRules) -> float:
    """How likely the robot is stuck: it does not move although it is to, and its wheels push although nothing moves.

    Speed and thrust count the same, so that neither a wrong speed of the IMU nor a push alone decides; a belly that
    rests on something makes it likelier, and there is less thrust to feel then. Zero while the robot is not to drive.
    """
    command = f.command_speed
    if abs(command) < rules.driving_speed:
        return 0.0
    ahead = np.sign(command)
    share = f.body_speed / command
    # What the robot has to push to lift itself, with its body on the way up that the axles show.
    climb = f.axle_heights[0] - f.axle_heights[-1]
    lifting = ahead * climb / max(2 * measures.half_length * (measures.units - 1), 1e-9)
    push = ahead * f.thrust / measures.weight - max(0.0, lifting)
    slow = (rules.speed_share - share) / rules.speed_share_width
    pushing = (push - rules.thrust_share) / rules.thrust_share_width
    resting = min(2.0, 2.0 * f.belly_loads.sum() / (rules.belly_share * measures.weight))
    return sigmoid(np.clip(slow, -4, 4) + np.clip(pushing, -4, 4) + resting)


def class_scores(f: StuckFeatures, measures: SnakeMeasures, rules: StuckRules) -> tuple[np.ndarray, np.ndarray]:
    """Scores of the five classes (5,) that sum to one, and the unit of each (5,), for a robot that is stuck."""
    load_at = int(np.argmax(f.belly_loads))
    load = f.belly_loads[load_at] / rules.belly_load
    unit_of_load = load_at // 2
    ahead, behind = f.axle_heights[: unit_of_load + 1], f.axle_heights[unit_of_load + 1 :]
    rise = (ahead.max() - behind.min() if len(behind) else 0.0) / rules.step_height
    bend = np.abs(f.yaw_torques).max(initial=0.0) / rules.yaw_torque

    under_at = int(np.argmin(f.under))
    under = rules.under_share * measures.clearance / max(f.under[under_at], 1e-4)
    both = f.beside.max(axis=0)  # something on both sides
    beside_at = int(np.argmin(both))
    beside = rules.beside_share * measures.wheel_side / max(both[beside_at], 1e-4)

    def above(ratio: float) -> float:
        """Log-odds that a quantity is above its threshold, from their ratio."""
        return float(np.clip(3.0 * np.log(max(ratio, 1e-3)), -4, 4))

    # Evidence by class: a sum of log-odds, each bounded, so that no single one decides against all the others.
    on_belly, wedged, step = above(load), above(bend), above(rise)
    below, sides = above(under), above(beside)
    evidence = np.array(
        [
            below - on_belly - wedged - sides,
            2 * wedged - on_belly - sides,
            2 * sides - on_belly - wedged,
            2 * on_belly - step,
            2 * on_belly + step,
        ]
    )
    scores = np.exp(0.5 * (evidence - evidence.max()))
    units = np.array([blocked_unit(under_at), wedged_unit(f), blocked_unit(beside_at), unit_of_load, unit_of_load])
    return scores / scores.sum(), np.clip(units, 0, measures.units - 1)


def blocked_unit(half: int) -> int:
    """The unit whose wheels run into what stands at a half of the body: the next axle behind that half's front."""
    return (half + 1) // 2


def wedged_unit(f: StuckFeatures) -> int:
    """The unit in the middle of the bend: where four yaw torques in a row look most like (1, -1, -1, 1)."""
    tau = np.r_[0.0, f.yaw_torques, 0.0]
    if len(tau) < 4:
        return 0
    match = np.abs(tau[:-3] - tau[1:-2] - tau[2:-1] + tau[3:])
    return int(np.argmax(match)) + 1


def diagnose(
    f: StuckFeatures, probability: float, stuck: bool, measures: SnakeMeasures, rules: StuckRules
) -> Diagnosis:
    """The diagnosis that measurements and the probability over some time give."""
    if not stuck:
        return Diagnosis(probability=probability, body_speed=f.body_speed, thrust=f.thrust)
    scores, units = class_scores(f, measures, rules)
    best = int(np.argmax(scores))
    return Diagnosis(
        stuck=True,
        probability=probability,
        kind=KINDS[best],
        unit=int(units[best]),
        confidence=float(scores[best]),
        scores=tuple(float(score) for score in scores),
        body_speed=f.body_speed,
        thrust=f.thrust,
    )
