"""A robot that drives the four motions of route learning, in a world, on its odometry."""

from naraha.models.worlds import World
from naraha.systems.drive import MotionPrimitives, MotionPrimitivesConfig
from naraha.systems.slam import Odometry6Dof
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource

from .station import StationConfig, make_station
from .wiring import connect


def make_motions(
    config: StationConfig,
    primitives: MotionPrimitivesConfig,
    *,
    seed: int,
    world: World | None = None,
    X_OB0: RigidTransform | None = None,
    localisation: str = "odometry",
    meshcat: Meshcat | None = None,
) -> Diagram:
    """Builds station → odometry → motions → station; with `localisation` "truth", the motions know the true pose.

    Inputs: `action` (1), see `MotionPrimitives`. Outputs: `status` (str), `motion` (1), `X_MB` (RigidTransform), the
    pose that the motions go by, `track_displacements` (2), and `cheat.X_WB`. Subsystems: `station`, `primitives`,
    `odometry` unless the truth is known, and `flipper_preset`, always "auto", of a robot with flippers.

    Args:
        X_OB0: where the odometry begins; where the scenario says that the robot stands when not given.
    """
    builder = DiagramBuilder()
    station = make_station(config, seed=seed, world=world, meshcat=meshcat)
    builder.AddSystem(station)
    motions = builder.AddNamedSystem("primitives", MotionPrimitives(primitives))
    pose = station.GetOutputPort("cheat.X_WB")
    if localisation != "truth":
        odometry = builder.AddNamedSystem("odometry", Odometry6Dof(X_OB0=X_OB0 or config.robot.X_WB()))
        connect(builder, station, "track_displacements", odometry)
        connect(builder, station, "rpy", odometry)
        pose = odometry.GetOutputPort("X_OB")
    builder.Connect(pose, motions.GetInputPort("X_MB"))
    connect(builder, motions, "twist_command", station)
    if station.HasInputPort("flipper_preset"):
        preset = builder.AddNamedSystem("flipper_preset", ConstantValueSource(Value("auto")))
        builder.Connect(preset.get_output_port(), station.GetInputPort("flipper_preset"))
    builder.ExportInput(motions.GetInputPort("action"), "action")
    for name in ("status", "motion"):
        builder.ExportOutput(motions.GetOutputPort(name), name)
    builder.ExportOutput(pose, "X_MB")
    for name in ("track_displacements", "cheat.X_WB"):
        builder.ExportOutput(station.GetOutputPort(name), name)
    diagram = builder.Build()
    diagram.set_name("motions")
    return diagram
