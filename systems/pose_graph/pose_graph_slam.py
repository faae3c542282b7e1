"""Poses of keyframes that follow from everything known of them, loops included, while the robot drives."""

from dataclasses import dataclass
from typing import Any

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config
from ..ports import eval_typed, weak_method
from ..slam.keyframe import Keyframe, KeyframePoses
from .keyframe_graph import KeyframeGraph, PoseGraphConfig, add_keyframe, finish, misfit
from .loop_detection import PlaceRecognition


@dataclass(frozen=True)
class GraphHealth:
    """How the pose graph is doing.

    Attributes:
        valid: it has two keyframes or more, and their edges agree within their covariances.
        reason: why not; "" when all is well.
        keyframes: number of them.
        loops_accepted, loops_refused: number of loops in the graph, and of candidates that are not.
        misfit: ξᵀ Ω ξ a degree of freedom; near 1 when covariances are right, far above it when edges contradict.
    """

    valid: bool
    reason: str
    keyframes: int
    loops_accepted: int
    loops_refused: int
    misfit: float

    def __deepcopy__(self, memo: dict) -> "GraphHealth":
        return self


# Edges whose errors are this much larger, in variance, than they say of themselves contradict each other.
_MAX_MISFIT = 9.0


class PoseGraphSlam(LeafSystem):
    """
    .. pydrake_system::

        name: PoseGraphSlam
        input_ports:
        - keyframe
        output_ports:
        - keyframe_poses
        - loops
        - health
        - batch_poses

    Keeps a pose graph of all keyframes: steps as the scan matcher found them, with their covariance; odometry, with the
    slip that `PoseGraphConfig` states; gravity, where that is asked for; and loops, of places that are seen again.

    Every `period` it looks at `keyframe` (`Keyframe`), and takes in each index once; a later version of the newest, to
    which a camera has added what it saw, only replaces its cloud. Earlier places that it may be at are registered, at
    most `loops.max_candidates` an update, and judged by fit, overlap and classes (`check_loop`); those that pass are
    judged together with all others by consistency (`decide_loops`), so that a loop which was accepted can be refused
    later, and the other way round.

    - `keyframe_poses` (`KeyframePoses`): X_MB of every keyframe by its index. `version` rises when a pose that was
      given before has moved by more than `tolerance` or `tolerance_deg`; until then it is given as before.
    - `loops` (tuple of `Loop`): every candidate that was registered, whether it is accepted, and why not.
    - `health` (`GraphHealth`): counts, and whether the edges agree.
    - `batch_poses` (`KeyframePoses`): the optimum over all with every loop judged anew (`finish`). It is computed when
      it is asked for; ask at the end.

    The graph is optimised as a batch that starts at the last poses: milliseconds for hundreds of keyframes;
    the state of iSAM2 could not be copied with a context.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: the input is not connected or of another type.
    """

    def __init__(self, config: PoseGraphConfig | None = None, *, recognition: PlaceRecognition | None = None):
        """
        Args:
            recognition: knows places by their clouds; without, candidates are only those that the poses say are near.
        """
        super().__init__()
        self._config = config or PoseGraphConfig()
        check_config(self._config)
        self._recognition = recognition
        self.DeclareAbstractInputPort("keyframe", AbstractValue.Make(object()))
        start = KeyframeGraph()
        ticket = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._AddKeyframe)
        outputs: tuple[tuple[str, Any, Any], ...] = (
            ("keyframe_poses", KeyframePoses(), self._CalcPoses),
            ("loops", (), self._CalcLoops),
            ("health", GraphHealth(False, "no keyframe yet", 0, 0, 0, 0.0), self._CalcHealth),
            ("batch_poses", KeyframePoses(), self._CalcBatch),
        )
        for name, example, calc in outputs:
            self.DeclareAbstractOutputPort(
                name, lambda example=example: AbstractValue.Make(example), weak_method(calc), {ticket}
            )

    def _AddKeyframe(self, context: Context, state: State) -> EventStatus:
        keyframe = eval_typed(self, context, "keyframe", Keyframe)
        known = self._graph(context)
        if known.keyframes and keyframe is known.keyframes[-1]:
            return EventStatus.DidNothing()
        grown = add_keyframe(known, keyframe, self._config, self._recognition)
        if grown is known:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(0).set_value(grown)
        return EventStatus.Succeeded()

    @staticmethod
    def _graph(context: Context) -> KeyframeGraph:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _CalcPoses(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._graph(context).published)

    def _CalcLoops(self, context: Context, output: AbstractValue) -> None:
        known = self._graph(context)
        output.set_value((*known.loops, *known.refused))

    def _CalcHealth(self, context: Context, output: AbstractValue) -> None:
        known = self._graph(context)
        accepted = sum(loop.accepted for loop in known.loops)
        refused = len(known.loops) + len(known.refused) - accepted
        error = misfit(known)
        reason = ""
        if len(known.keyframes) < 2:
            reason = "no keyframe yet" if not known.keyframes else "only one keyframe"
        elif error > _MAX_MISFIT:
            reason = f"edges contradict each other: {error:.1f} times the variance that they state"
        output.set_value(GraphHealth(not reason, reason, len(known.keyframes), accepted, refused, error))

    def _CalcBatch(self, context: Context, output: AbstractValue) -> None:
        output.set_value(finish(self._graph(context), self._config).published)
