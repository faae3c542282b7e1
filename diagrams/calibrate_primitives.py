"""`naraha calibrate --kind primitives`: writes down what the motions of route learning come to."""

import csv

from naraha.systems.files import replacing
from naraha.systems.routes import Ground, Primitives, write_primitives

from .calibrate import CalibrateScenario, drives_bar
from .mission import Ending, Mission, Options, stop_flag
from .primitive_trials import measure, sites

_COLUMNS = ("ground", "motion", "drive", "ahead_m", "left_m", "turn_rad", "ended", "time_s", "slip", "tilt_rad")


def calibrate_primitives(scenario: CalibrateScenario, options: Options) -> int:
    """Runs the mission, writes `primitives.yaml` and `trials.csv`, and returns the exit code."""
    mission = Mission("calibrate", scenario, options)
    grounds: dict[str, Ground] = {}
    rows: list[list[object]] = []
    ending = Ending("done", "every motion was tried on every kind of ground")
    bar = drives_bar(options)
    with mission.timed(), bar, stop_flag() as stopped:
        task = bar.add_task("")

        def tell(words: str) -> None:
            if stopped():
                raise KeyboardInterrupt
            bar.update(task, description=words)

        try:
            for ground, drives in measure(scenario, scenario.primitives, scenario.seed, tell):
                grounds |= ground
                rows += drives
        except KeyboardInterrupt:
            ending = Ending("interrupted", f"interrupted after {len(rows)} drives")

    def write_trials() -> None:
        with replacing(mission.path("trials.csv")) as temporary, temporary.open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(_COLUMNS)
            table.writerows([f"{v:.5f}" if isinstance(v, float) else v for v in row] for row in rows)

    def write_metrics() -> None:
        for name, ground in grounds.items():
            for motion, outcome in ground.motions.items():
                mission.metrics[f"{name}_{motion}_failed"] = outcome.failed
                mission.metrics[f"{name}_{motion}_time_s"] = outcome.time
        mission.metrics["drives"] = len(rows)

    def write_file() -> None:
        if len(grounds) == len(sites(scenario.primitives)):
            source = (
                f"naraha calibrate --robot {scenario.robot.model} --kind primitives --seed {scenario.seed}, "
                f"{scenario.primitives.trials} drives each"
            )
            step = scenario.primitives.motions.step
            primitives = Primitives(robot=scenario.robot.model, source=source, step=step, grounds=grounds)
            write_primitives(mission.path("primitives.yaml"), primitives)

    return mission.finish(ending, write_trials, write_metrics, write_file)
