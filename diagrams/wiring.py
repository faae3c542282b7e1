"""Wiring a diagram by port names, and reading it from outside while it runs."""

from typing import Any

from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System


def connect(builder: DiagramBuilder, source: System, output: str, target: System, *inputs: str) -> None:
    """Connects the output port `output` of `source` to the input port of `target` with that name, or to `inputs`."""
    for name in inputs or (output,):
        builder.Connect(source.GetOutputPort(output), target.GetInputPort(name))


def export_outputs(builder: DiagramBuilder) -> None:
    """Exports every output port of every system in `builder` as "<system>.<port>".

    Whoever reads the diagram then needs no context but the root's. (In Drake 1.58 a call of `GetMyContextFromRoot` for
    a system written in Python leaks that system's context.)
    """
    for system in builder.GetSystems():
        for i in range(system.num_output_ports()):
            port = system.get_output_port(i)
            builder.ExportOutput(port, f"{system.get_name()}.{port.get_name()}")


class DiagramReader:
    """Values of a diagram's output ports at `context`, which whoever steps the simulation sets."""

    def __init__(self, diagram: Diagram):
        self.diagram = diagram
        self.context: Context | None = None

    def read(self, port: str) -> Any:
        """Value of the output port "<system>.<port>" now. Raises `RuntimeError` before the first step."""
        if self.context is None:
            raise RuntimeError(f"{port} was read before the first step")
        return self.diagram.GetOutputPort(port).Eval(self.context)


def subsystem(root: System, *path: str) -> Any:
    """The system that one gets to from `root` by the names of `path`. (Its type is for the caller to know.)"""
    system: Any = root
    for name in path:
        system = system.GetSubsystemByName(name)
    return system
