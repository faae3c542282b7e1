"""What all missions share: the run, its interruption, and what it leaves in its folder."""

import json
import math
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, Literal

from naraha.systems.errors import InputError, NarahaError
from naraha.systems.files import replacing
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from .scenario import dump_scenario

Status = Literal["done", "failed", "interrupted"]
EXIT_CODES: dict[Status, int] = {"done": 0, "failed": 1, "interrupted": 130}


@dataclass(frozen=True)
class Ending:
    """How a run ended: why it is `done`, `failed` or `interrupted`."""

    status: Status
    reason: str


@dataclass(kw_only=True)
class Options:
    """What the command line says about every mission, apart from the scenario."""

    # Folder for everything that the mission leaves.
    out: Path = Path("out")
    # Show the run in a browser while it goes on.
    meshcat: bool = False
    # Simulated seconds a second; 0 is as fast as possible.
    realtime_rate: float = 0.0
    console: Console = field(default_factory=lambda: Console(stderr=True))


@contextmanager
def stop_flag() -> Iterator[Callable[[], bool]]:
    """While inside, Ctrl-C and SIGTERM set a flag that the yielded function reads; a second Ctrl-C is immediate."""
    stopped = False

    def request(number: int, frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
        signal.signal(signal.SIGINT, signal.default_int_handler)

    try:
        before = {number: signal.signal(number, request) for number in (signal.SIGINT, signal.SIGTERM)}
    except ValueError:  # not in the main thread: nobody can send us a Ctrl-C
        before = {}
    try:
        yield lambda: stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Mission:
    """One run of one mission, from its first simulated second to the files it leaves.

    Attributes:
        name: of the mission.
        options: of the command line.
        metrics: one flat mapping, SI units in the key names; written to `metrics.json` whatever happens.
    """

    def __init__(self, name: str, scenario: Any, options: Options):
        self.name, self.scenario, self.options = name, scenario, options
        self.metrics: dict[str, Any] = {}
        self._wall_time, self._sim_time = 0.0, 0.0
        existing = next(folder for folder in (options.out, *options.out.absolute().parents) if folder.exists())
        if not existing.is_dir() or not os.access(existing, os.W_OK):
            raise InputError("not a folder that can be written", where=f"--out {options.out}")

    @property
    def wall_time(self) -> float:
        """How long the run took [s]."""
        return self._wall_time

    def path(self, name: str) -> Path:
        """Path of a product in the mission's folder, which is made at the first call."""
        try:
            self.options.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(error.strerror or "cannot be made", where=f"--out {self.options.out}") from None
        return self.options.out / name

    def simulate(
        self,
        simulator: Simulator,
        *,
        duration: float,
        step: float,
        on_step: Callable[[Context], Ending | None],
        status_line: Callable[[Context], str],
        bar: bool = True,
    ) -> Ending:
        """Advances until `on_step` returns an ending, `duration` [s] is over, Ctrl-C, or an error.

        Args:
            step: `on_step` is called every so many simulated seconds.
            status_line: what the progress bar says.
        """
        if self.options.realtime_rate > 0:
            simulator.set_target_realtime_rate(self.options.realtime_rate)
        progress = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:6.1f} s  {task.fields[line]}"),
            TimeElapsedColumn(),
            console=self.options.console,
            transient=True,
            disable=not (bar and self.options.console.is_terminal),
        )
        ending = None
        context = simulator.get_context()
        start = time.perf_counter()
        with progress, stop_flag() as stopped:
            task = progress.add_task(self.name, total=duration, line="")
            try:
                simulator.Initialize()
                ending = on_step(context)
                steps = math.ceil(duration / step - 1e-9)
                for i in range(1, steps + 1):
                    if ending is not None:
                        break
                    simulator.AdvanceTo(min(i * step, duration))
                    ending = on_step(context)
                    progress.update(task, completed=context.get_time(), line=status_line(context))
                    if ending is None and stopped():
                        ending = Ending("interrupted", f"interrupted after {context.get_time():.1f} s")
            except KeyboardInterrupt:
                ending = Ending("interrupted", f"interrupted after {context.get_time():.1f} s")
            except Exception as error:  # whatever it is, what was measured is kept
                ending = Ending("failed", f"after {context.get_time():.1f} s: {_in_words(error)}")
        self._wall_time, self._sim_time = time.perf_counter() - start, context.get_time()
        return ending or Ending("done", f"the time budget of {duration:g} s is over")

    @contextmanager
    def timed(self) -> Iterator[None]:
        """While inside, the time counts as the mission's, for one that is not a single simulation."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._wall_time = time.perf_counter() - start

    def finish(self, ending: Ending, *products: Callable[[], None]) -> int:
        """Writes the products, `scenario.yaml` and `metrics.json`, prints a summary, and returns the exit code.

        A product that cannot be written makes the mission fail, but never loses the others.
        """
        for product in products:
            try:
                product()
            except Exception as error:  # the other products do not suffer
                self.options.console.print(f"{product.__name__}: {error}", markup=False)
                if ending.status != "failed":
                    ending = Ending("failed", f"{product.__name__}: {_in_words(error)}")
        self.metrics = {
            "status": ending.status,
            "reason": ending.reason,
            "seed": getattr(self.scenario, "seed", 0),
            "sim_time_s": round(self._sim_time, 6),
            "wall_time_s": self._wall_time,
            "realtime_factor": self._sim_time / max(self._wall_time, 1e-9),
            "peak_rss_mb": peak_rss_mb(),
            **self.metrics,
        }
        with replacing(self.path("scenario.yaml")) as path:
            path.write_text(dump_scenario(self.scenario))
        with replacing(self.path("metrics.json")) as path:
            path.write_text(json.dumps(jsonable(self.metrics), indent=1, allow_nan=False) + "\n")
        self._print_summary(ending)
        return EXIT_CODES[ending.status]

    def _print_summary(self, ending: Ending) -> None:
        table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
        for key, value in self.metrics.items():
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                table.add_row(key, f"{value:.4g}" if isinstance(value, float) else str(value))
        console = self.options.console
        console.print(table)
        console.print(f"{self.name}: {ending.status}: {ending.reason}", highlight=False, markup=False)
        console.print(f"everything is in {self.options.out}", highlight=False, markup=False, soft_wrap=True)


def _in_words(error: Exception) -> str:
    kind = "" if isinstance(error, (NarahaError, RuntimeError, OSError)) else f"{type(error).__name__}: "
    return kind + " ".join(str(error).split())


def jsonable(value: Any) -> Any:
    """Numbers of numpy as Python's, and what is not finite as null, since JSON has no NaN."""
    if isinstance(value, dict):
        return {key: jsonable(item) for key, item in value.items()}
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def peak_rss_mb() -> float:
    """Peak resident memory of this process [MB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)
