"""Terrain: fuzzy inference beside scikit-fuzzy and pyfuzzylite, whole updates, risk maps, and planes with outliers.

    python -m tests.benchmarks.terrain [--scene inference|update|risk_map|outliers|all] [--json FILE]

One core, everything seeded. `inference`: τ of fresh inputs (scikit-fuzzy remembers inputs that it has seen), one by one
where a peer can do no more, and in a batch; the largest difference is that of τ as part of its range. `update`: 30 000
points to features, τ and the histogram. `risk_map`: 100 000 cells from 600 000 points. `outliers`: planes of 5 to 25°
with a growing share of points up to 1 m off, half of them one-sided, least squares against the robust fit.

scikit-fuzzy and pyfuzzylite are not installed with the project (`pip install scikit-fuzzy pyfuzzylite`; the second one
asks for an older numpy than it needs, `--no-deps` leaves the installed one alone). Without them ours stands alone.
"""

import argparse
import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
from naraha.systems.traversability import (
    Ability,
    FuzzyConfig,
    Mamdani,
    TerrainConfig,
    describe_terrain,
    make_risk_map,
)
from naraha.systems.traversability.histogram import make_histogram
from naraha.systems.traversability.mamdani import GRADES, INPUTS, SIZES

from tests.traversability.grounds import ground, plane

from .report import print_table, time_in_turns, use_one_core, write_json

Results = dict[str, object]
FRESH, BATCH = 60, 10_000


def scikit_fuzzy(config: FuzzyConfig) -> Callable[[np.ndarray], np.ndarray]:
    """τ of rows, one inference after the other, or ImportError."""
    import skfuzzy
    from skfuzzy import control

    top = config.traversability.high[-1]
    inputs = []
    for name in INPUTS:
        terms = getattr(config, name)
        # Sampled finely enough that its interpolation does not matter.
        variable = control.Antecedent(np.linspace(0, 1.0, 2001), name)
        for size in SIZES:
            a, b, c, d = getattr(terms, size.lower())
            variable[size] = skfuzzy.trapmf(variable.universe, [a, b, c, 1.0 if size == "LARGE" else d])
        inputs.append(variable)
    output = control.Consequent(np.linspace(0, top, config.samples), "traversability")
    for grade in GRADES:
        output[grade] = skfuzzy.trapmf(output.universe, getattr(config.traversability, grade.lower()))
    rules = [control.Rule(inputs[0][p] & inputs[1][r] & inputs[2][g], output[grade]) for p, r, g, grade in config.rules]
    simulation = control.ControlSystemSimulation(control.ControlSystem(rules))

    def infer(features: np.ndarray) -> np.ndarray:
        found = []
        for row in features:
            for name, value in zip(INPUTS, row, strict=True):
                simulation.input[name] = value
            simulation.compute()
            found.append(simulation.output["traversability"])
        return np.array(found)

    return infer


def fuzzylite(config: FuzzyConfig) -> Callable[[np.ndarray], np.ndarray]:
    """τ of rows, all at once, or ImportError."""
    import fuzzylite as fl

    def variable(name: str) -> "fl.InputVariable":
        terms = getattr(config, name)
        corners = {size: list(getattr(terms, size.lower())) for size in SIZES}
        corners["LARGE"][2:] = [1e3, 1e3]
        return fl.InputVariable(name, minimum=0, maximum=1e3, terms=[fl.Trapezoid(s, *c) for s, c in corners.items()])

    grades = {grade: getattr(config.traversability, grade.lower()) for grade in GRADES}
    engine = fl.Engine(
        "traversability",
        input_variables=[variable(name) for name in INPUTS],
        output_variables=[
            fl.OutputVariable(
                "traversability",
                minimum=0,
                maximum=config.traversability.high[-1],
                aggregation=fl.Maximum(),
                defuzzifier=fl.Centroid(config.samples),
                terms=[fl.Trapezoid(grade, *corners) for grade, corners in grades.items()],
            )
        ],
        rule_blocks=[
            fl.RuleBlock(
                conjunction=fl.Minimum(),
                implication=fl.Minimum(),
                activation=fl.General(),
                rules=[
                    fl.Rule.create(
                        "if "
                        + " and ".join(f"{name} is {size}" for name, size in zip(INPUTS, sizes, strict=True))
                        + f" then traversability is {grade}"
                    )
                    for *sizes, grade in config.rules
                ],
            )
        ],
    )

    def infer(features: np.ndarray) -> np.ndarray:
        for i, name in enumerate(INPUTS):
            engine.input_variable(name).value = features[:, i]
        engine.process()
        return np.asarray(engine.output_variable("traversability").value)

    return infer


def inference(results: Results) -> None:
    config = FuzzyConfig(samples=501)
    ours = Mamdani(config)
    rng = np.random.default_rng(0)
    batch = rng.uniform(0, 0.5, (BATCH, 3))
    top = config.traversability.high[-1]
    reference = ours.infer(batch).traversability
    times = {"naraha": (lambda: ours.infer(batch), BATCH)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, make in (("scikit_fuzzy", scikit_fuzzy), ("fuzzylite", fuzzylite)):
            try:
                infer = make(config)
            except ImportError as error:
                print(f"{name}: left out, {error}")
                continue
            size = FRESH if name == "scikit_fuzzy" else BATCH
            difference = np.abs(infer(batch[:size]) - reference[:size]).max() / top
            results[f"{name}_largest_difference"] = float(difference)
            # Other numbers at every call.
            fresh = iter(rng.uniform(0, 0.5, (40, size, 3)))
            times[name] = (lambda infer=infer, fresh=fresh: infer(next(fresh)), size)
        seconds = time_in_turns({name: call for name, (call, _) in times.items()}, repeats=10)
    each = {name: 1e6 * seconds[name] / size for name, (_, size) in times.items()}
    rows = []
    for name, value in each.items():
        results[f"{name}_us_per_inference"], results[f"naraha_times_faster_than_{name}"] = value, value / each["naraha"]
        rows.append((name, value, value / each["naraha"], results.get(f"{name}_largest_difference", 0.0)))
    print_table("27 rules, 3 × 3 terms, 501 samples", ("", "µs each", "× ours", "largest difference"), rows)


def update(results: Results) -> None:
    ability = Ability()
    fuzzy = Mamdani(ability.fuzzy)
    points = ground(plane(5))

    def whole(config: TerrainConfig) -> None:
        features = describe_terrain(points, config)
        make_histogram(features, fuzzy.infer(features.inputs).traversability, ability)

    contestants = {fit: partial(whole, TerrainConfig(fit=fit)) for fit in ("robust", "least_squares")}
    seconds = time_in_turns(contestants, repeats=50)
    for name, value in seconds.items():
        results[f"naraha_{name}_update_ms"] = 1e3 * value
    rows = [(name, 1e3 * value) for name, value in seconds.items()]
    print_table("30 000 points to histogram", ("fit", "ms"), rows)


def risk_maps(results: Results) -> None:
    points = ground(lambda x, y: 0.1 * np.sin(x) + 0.05 * np.sin(3 * y), points=600_000, reach=15.8)
    ability = Ability()
    cells = make_risk_map(points, ability).risk.size
    milliseconds = 1e3 * time_in_turns({"naraha": lambda: make_risk_map(points, ability)}, repeats=10)["naraha"]
    results |= {"naraha_risk_map_ms": milliseconds, "risk_map_cells": cells}
    print_table("risk map of 600 000 points", ("cells", "ms"), [(cells, milliseconds)])


def outliers(results: Results) -> None:
    rng = np.random.default_rng(1)
    rows = []
    for share in (0.0, 0.05, 0.1, 0.2, 0.3):
        errors: dict[str, list[float]] = {"robust": [], "least_squares": []}
        for seed in range(20):
            slope = rng.uniform(5, 25)
            points = ground(plane(slope, rng.uniform(-40, 40)), seed=seed, outliers=share / 2)
            wrong = rng.uniform(size=len(points)) < share / 2
            wrong &= points[:, 0] > 0.8
            points[wrong, 2] += rng.uniform(0.2, 1.0, wrong.sum()).astype(np.float32)
            for fit, found in errors.items():
                table = describe_terrain(points, TerrainConfig(fit=fit, rectangles=1))
                steepness = np.arctan(np.hypot(*table.planes[0, :2]))
                found.append(abs(float(np.rad2deg(steepness)) - slope))
        for fit, found in errors.items():
            results[f"{fit}_slope_error_deg_at_{100 * share:.0f}_percent"] = float(np.mean(found))
        rows.append((f"{100 * share:.0f} %", *(float(f(e)) for e in errors.values() for f in (np.mean, np.max))))
    columns = ("outliers", "robust, mean deg", "largest", "least squares, mean deg", "largest")
    print_table("error of the slope, 20 planes each", columns, rows)


SCENES = {"inference": inference, "update": update, "risk_map": risk_maps, "outliers": outliers}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=[*SCENES, "all"], default="all")
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    arguments = parser.parse_args()
    use_one_core()
    results: Results = {}
    for name, scene in SCENES.items():
        if arguments.scene in (name, "all"):
            scene(results)
    write_json(arguments.json, results)


if __name__ == "__main__":
    main()
