"""What every benchmark shares: one core, fair timing, a table on the screen and a flat JSON object in a file."""

import contextlib
import json
import os
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table


def use_one_core() -> None:
    """Pins this process to one core where the system allows it, so that no contestant gains from hidden threads.

    Which core depends on the process, so that two benchmarks at the same time need not meet on one.
    """
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, {cores[os.getpid() % len(cores)]})


def time_in_turns(contestants: Mapping[str, Callable[[], object]], *, repeats: int = 30) -> dict[str, float]:
    """Median time of a call [s] of every contestant.

    They take turns, so that whatever else the machine does at the time falls on all of them.
    """
    for call in contestants.values():
        call()
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(repeats):
        for name, call in contestants.items():
            start = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in times.items()}


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Prints a table; numbers are rounded to four figures and aligned right."""
    table = Table(title=title)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right")
    for row in rows:
        table.add_row(*(f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row))
    console = Console()
    # In a file or a pipe there is no edge that a table must keep within.
    (console if console.is_terminal else Console(width=180)).print(table)


def write_json(path: str | os.PathLike[str] | None, values: Mapping[str, object]) -> None:
    """Writes one flat JSON object; nothing when no path is given."""
    if path is not None:
        Path(path).write_text(json.dumps(dict(values), indent=2) + "\n")
