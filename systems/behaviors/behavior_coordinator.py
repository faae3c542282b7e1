"""Multi-objective behaviour coordination: blends what behaviours want by weights that perception moves (row S4-g)."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..errors import ConfigError
from ..ports import eval_typed
from ..sensing import Scan
from .free_way import braked
from .fuzzy_obstacle_avoidance import obstacle_points

GOAL, AVOIDANCE = 0, 1
_SIDE = np.deg2rad(80.0)


@dataclass(kw_only=True)
class CoordinatorConfig:
    """How perception moves the weights, and within what the result is kept."""

    # [1/s] Change of the weights of (goal seeking, obstacle avoidance) for what is perceived: danger, safety, both of
    # 0 to 1.
    goal_gains: list[float] = quantity([-4.0, 4.0], unit="1/s")
    avoidance_gains: list[float] = quantity([8.0, -4.0], unit="1/s")
    # No behaviour is ever quite silent or alone: weights stay within these.
    min_weight: float = quantity(0.02, unit="-", above=0, high=1)
    max_weight: float = quantity(1.0, unit="-", above=0)
    # [m] Free way to the goal at and below which the danger is 1, and at and above which it is 0.
    danger_way: float = quantity(0.3, unit="m", low=0)
    safe_way: float = quantity(1.5, unit="m", above=0)
    # [-] Share that is left of the nearness of what is 80 degrees off the goal's direction.
    side_discount: float = quantity(0.35, unit="-", above=0, high=1)
    # [m] radius of the disc that must never touch anything: the robot's and a small margin.
    radius: float = quantity(0.28, unit="m", above=0)
    # [m/s²] Deceleration that the braking reckons with, and [s] how old what it knows may be.
    deceleration: float = quantity(0.6, unit="m/s²", above=0)
    delay: float = quantity(0.2, unit="s", low=0)
    # [m/s], [rad/s] largest twist.
    max_speed: float = quantity(0.8, unit="m/s", above=0)
    max_yaw_rate: float = quantity(1.0, unit="rad/s", above=0)
    # [s] between two decisions.
    period: float = quantity(0.1, unit="s", above=0)
    weights: list[float] = field(default_factory=lambda: [1.0, 0.02])


def perceive(ways: np.ndarray, directions: np.ndarray, error: np.ndarray, config: CoordinatorConfig) -> np.ndarray:
    """Danger and safety, (2,), each from 0 to 1 and 1 together.

    The danger grows as the free way to the goal falls from `safe_way` to `danger_way`; a way in another direction
    counts as if it were longer, by 1 / `side_discount` for every 80 degrees between. With a free way to the goal there
    is no danger; what is ahead of a robot that has to turn away from it counts little.

    Args:
        ways: free ways, (D,) [m], in the directions (D,) [rad]. error: distance [m] and bearing [rad] of the goal.
    """
    towards = np.clip(error[1], directions[0], directions[-1])
    seen = ways * config.side_discount ** (-np.abs(directions - towards) / _SIDE)
    nearest = float(seen.min())
    if np.interp(towards, directions, ways) > error[0]:
        return np.array([0.0, 1.0])
    danger = float(np.clip((config.safe_way - nearest) / (config.safe_way - config.danger_way), 0.0, 1.0))
    return np.array([danger, 1.0 - danger])


def update_weights(weights: np.ndarray, perceived: np.ndarray, config: CoordinatorConfig) -> np.ndarray:
    """Weights one `period` later: w ← w + T D s with the gains D and what is perceived s, kept within the limits."""
    gains = np.array([config.goal_gains, config.avoidance_gains])
    moved: np.ndarray = np.clip(
        weights + config.period * gains @ perceived, config.min_weight * config.max_weight, config.max_weight
    )
    return moved


def blend(weights: np.ndarray, twists: np.ndarray, config: CoordinatorConfig) -> np.ndarray:
    """Σ w y / Σ w over the behaviours, (2,) v [m/s] and ω [rad/s], within the limits; the robot never drives back.

    Args:
        weights: (K,). twists: (K, 2).
    """
    v, omega = weights @ twists / weights.sum()
    limit = [config.max_speed, config.max_yaw_rate]
    limited: np.ndarray = np.clip([v, omega], [0.0, -config.max_yaw_rate], limit)
    return limited


class BehaviorCoordinator(LeafSystem):
    """
    .. pydrake_system::

        name: BehaviorCoordinator
        input_ports:
        - goal_twist
        - avoidance_twist
        - goal_error
        - free_ways
        - scan_S
        - X_BS
        - stop
        output_ports:
        - twist_command
        - weights

    Multi-objective behaviour coordination (Nojima, Kojima and Kubota, the [4] of S4; its equations are not in our
    source, this is the form in which the robots of that group use it): every behaviour k has a weight w_k, perception s
    moves the weights step by step, w ← w + T D s, and the command is Σ w_k y_k / Σ w_k. Here s is danger and safety,
    see `perceive`. Because the weights move and do not jump, a robot that has begun to go around something goes on.

    Ours is what comes after: the speed is reduced until the robot could stop on its arc before it touches anything that
    the laser sees (`braked`), whatever the rules say; the yaw rate stays.

    - `goal_twist`, `avoidance_twist` (2): v [m/s], ω [rad/s] of the behaviours.
    - `goal_error` (2): distance [m] and bearing [rad] of the goal. `free_ways` (5): [m], see `FuzzyObstacleAvoidance`.
    - `scan_S` (Scan), `X_BS` (RigidTransform): the last scan of the level laser and its pose in the base.
    - `stop` (1), optional: above 0.5 the command is zero.
    - `twist_command` (2): v, ω; decided every `period`, zero until there is a scan, and while the laser sees nothing at
      all: it may be blinded.
    - `weights` (2): of goal seeking and obstacle avoidance, after the last decision.

    Args:
        config: gains, limits, braking. directions: of the free ways, from right to left [rad].

    Raises `ConfigError` for values out of range, `PortError` for inputs that are missing or of another type.
    """

    def __init__(self, config: CoordinatorConfig, directions: np.ndarray, *, where: object = "coordinator"):
        super().__init__()
        check_config(config, where=where)
        _check_lengths(config, where)
        self._config = config
        self._directions = np.array(directions, float)
        if len(self._directions) < 2 or not (np.diff(self._directions) > 0).all():
            value, valid = self._directions.tolist(), "rising, at least two"
            raise ConfigError("directions", where=where, key="directions", value=value, valid=valid)
        for name in ("goal_twist", "avoidance_twist", "goal_error"):
            self.DeclareVectorInputPort(name, 2)
        self.DeclareVectorInputPort("free_ways", len(self._directions))
        self.DeclareAbstractInputPort("scan_S", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("X_BS", AbstractValue.Make(RigidTransform()))
        self.DeclareVectorInputPort("stop", 1)
        self.DeclareDiscreteState(np.array(config.weights, float))
        self.DeclareDiscreteState(2)  # the command
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Update)
        self.DeclareVectorOutputPort("twist_command", 2, self._CalcTwist, {self.xd_ticket()})
        self.DeclareVectorOutputPort("weights", 2, self._CalcWeights, {self.xd_ticket()})

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        config = self._config
        scan = eval_typed(self, context, "scan_S", Scan)
        stop = self.GetInputPort("stop").HasValue(context) and eval_typed(self, context, "stop", np.ndarray)[0] > 0.5
        if scan.index < 0 or not len(scan.p_SP) or stop:
            discrete_state.set_value(1, np.zeros(2))
            return
        goal, avoidance, error, ways = (
            eval_typed(self, context, name, np.ndarray)
            for name in ("goal_twist", "avoidance_twist", "goal_error", "free_ways")
        )
        weights = context.get_discrete_state(0).value()
        perceived = perceive(ways, self._directions, error, config)
        weights = update_weights(weights, perceived, config)
        v, omega = blend(weights, np.array([goal, avoidance]), config)
        points = obstacle_points(scan, eval_typed(self, context, "X_BS", RigidTransform))
        v = braked(v, omega, points, config.radius, config.deceleration, config.delay)
        discrete_state.set_value(0, weights)
        discrete_state.set_value(1, np.array([v, omega]))

    def _CalcTwist(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(1).value())

    def _CalcWeights(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(0).value())


def _check_lengths(config: CoordinatorConfig, where: object) -> None:
    for name in ("goal_gains", "avoidance_gains", "weights"):
        if len(getattr(config, name)) != 2:
            raise ConfigError("wrong length", where=where, key=name, value=getattr(config, name), valid="two numbers")
    if config.safe_way <= config.danger_way:
        valid = f"> danger_way {config.danger_way:g} m"
        raise ConfigError("out of range", where=where, key="safe_way", value=config.safe_way, valid=valid)
