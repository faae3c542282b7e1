"""Snakes in the worlds in which they are stuck, for tests."""

from dataclasses import replace

from naraha.diagrams.recover import RecoverScenario, make_recover
from naraha.diagrams.snake_moves import SnakeRun, make_snake_moves
from naraha.models.worlds.stuck import stuck_case
from naraha.systems.snake.snake_pilot import Move
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource

SPEED = 0.1


def moving_snake(seed, meshcat=None):
    """A root diagram with a snake on a stone that turns its wheels."""
    case = stuck_case(4, seed)
    builder = DiagramBuilder()
    snake = builder.AddSystem(
        make_snake_moves(
            RecoverScenario(),
            case.world,
            X_WB=case.X_WB,
            joint_angles=case.joint_angles,
            seed=seed,
            meshcat=meshcat,
        )
    )
    move = builder.AddSystem(ConstantValueSource(AbstractValue.Make(Move(kind="wheels", speed=SPEED))))
    builder.Connect(move.get_output_port(), snake.GetInputPort("move"))
    return builder.Build()


def settled(kind, seed, *, stuck=True, friction=None, sensors=True, **changes) -> tuple:
    """(case, run): a snake at rest in a case of class `kind`."""
    scenario = RecoverScenario(stuck=kind, seed=seed, really=stuck, **changes)
    if friction is None and sensors:
        case, run = make_recover(scenario)
    else:
        case = stuck_case(kind, seed, stuck=stuck, friction=friction)
        config = scenario if sensors else replace(scenario, imu=None, pads=None, ranges=None)
        run = SnakeRun(make_snake_moves(config, case.world, X_WB=case.X_WB, joint_angles=case.joint_angles, seed=seed))
    run.give(Move(joints=tuple(float(q) for q in case.joint_command)))
    run.advance(1.2)
    return case, run


def driven(run, seconds, **move):
    """How far the nose gets in x [m] while the wheels turn."""
    start = run.head()
    run.give(Move(kind="wheels", speed=SPEED, **move))
    run.advance(seconds)
    return float((run.head() - start)[0])
