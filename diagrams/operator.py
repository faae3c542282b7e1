"""The operator of a survey: who drives, how, and which of the offered routes (rows S0-i, S0-k)."""

import sys
from collections.abc import Sequence

import numpy as np
from naraha.systems.drive.mode_switch import AUTONOMOUS, STOP, TELEOPERATION
from naraha.systems.routes import Route
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, Diagram
from rich.console import Console
from rich.table import Table

from .mission import Ending
from .wiring import DiagramReader


class Operator(DiagramReader):
    """What the operator says to a running diagram that `add_loop` has made; it counts from the instant it is said.

    As long as nothing is said the robot drives itself and no route is chosen.
    """

    def __init__(self, diagram: Diagram, context: Context):
        super().__init__(diagram)
        self.context = self._root = context
        self._say(mode_command=AUTONOMOUS, teleoperation_twist=np.zeros(2), teleoperation_time=[-np.inf], choice=[-1.0])

    def drive(self, v: float, omega: float) -> None:
        """Drives by hand; the link is lost unless this is said again and again. v [m/s], omega [rad/s]."""
        stamp = [self._root.get_time()]
        self._say(mode_command=TELEOPERATION, teleoperation_twist=[v, omega], teleoperation_time=stamp)

    def stop(self) -> None:
        """Stops the robot."""
        self._say(mode_command=STOP)

    def give_back(self) -> None:
        """Lets the robot drive itself."""
        self._say(mode_command=AUTONOMOUS)

    def choose(self, index: int) -> None:
        """Chooses one of the offered routes; -1 takes the choice back."""
        self._say(choice=[float(index)])

    def _say(self, **said: str | Sequence[float] | np.ndarray) -> None:
        for name, value in said.items():
            port = self.diagram.GetInputPort(name)
            if isinstance(value, str):
                port.FixValue(self._root, AbstractValue.Make(value))
            else:
                port.FixValue(self._root, np.asarray(value, float))


class Prompt:
    """The operator at the terminal: offered routes are printed, and a number chooses."""

    def __init__(self, operator: Operator):
        self._operator, self._asked = operator, False

    def step(self, context: Context) -> Ending | None:
        """Asks when routes are offered, once for each offer; an ending when nobody wants to answer."""
        if self._operator.read("loop.phase") != "offer":
            if self._asked:
                self._operator.choose(-1)
            self._asked = False
            return None
        if self._asked:
            return None
        try:
            chosen = ask(self._operator.read("loop.offers"), context.get_time())
        except EOFError:
            return Ending(
                "failed", f"the operator's input ended at {context.get_time():.1f} s, before a route was chosen"
            )
        if chosen is None:
            return Ending("interrupted", f"stopped by the operator at {context.get_time():.1f} s")
        self._operator.choose(chosen)
        self._asked = True
        return None


def route_table(routes: Sequence[Route], title: str = "") -> Table:
    """What the operator decides by, a line for each route, numbered from 1."""
    table = Table(title=title or None, title_justify="left")
    for name in ("", "length", "time", "clearance", "dose", "slope", "tilt", "how sure", "passes"):
        table.add_column(name, justify="left" if name == "passes" else "right")
    for number, route in enumerate(routes, 1):
        table.add_row(
            str(number),
            f"{route.length_m:.1f} m",
            f"{route.time_s:.0f} s",
            f"{route.clearance_m:.2f} m",
            f"{route.dose:.2g} µSv",
            f"{np.rad2deg(route.steepest_rad):.0f}°",
            f"{np.rad2deg(route.tilt_rad):.0f}°",
            f"{100 * route.confidence:.0f} %",
            ", ".join(route.sides),
        )
    return table


def ask(routes: Sequence[Route], time: float) -> int | None:
    """Prints the routes and asks for a number until one fits; None for an empty line. Raises `EOFError`."""
    goal = routes[0].xy[-1]
    Console(file=sys.stdout).print(route_table(routes, f"{time:.0f} s: routes to ({goal[0]:.1f}, {goal[1]:.1f}) m"))
    while True:
        answer = input(f"Which one, 1 to {len(routes)}, or nothing to stop? ").strip()
        if not answer:
            return None
        if answer.isdecimal() and 1 <= int(answer) <= len(routes):
            return int(answer) - 1
