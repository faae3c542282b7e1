"""The command `naraha`: one mission each."""

import gc
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer
from naraha.systems.errors import InputError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Survey robots that go where people cannot: simulate, map, measure.",
)

Scenario = Annotated[str, typer.Argument(help="A shipped scenario or a YAML file.")]
ScenarioOption = Annotated[str, typer.Option("--scenario", help="A shipped scenario or a YAML file.")]
Truth = Annotated[Path | None, typer.Option("--truth", help="Poses (TUM or KITTI form), to compare with.")]
Settings = Annotated[list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Change one scenario value.")]
Out = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for what the mission leaves.")]
Seed = Annotated[int | None, typer.Option("--seed", min=0, help="Seed of all noise; the same seed, the same result.")]
Earlier = Annotated[Path | None, typer.Option("--earlier", metavar="DIR", help="A survey to bring up to date.")]
Live = Annotated[bool, typer.Option("--meshcat/--no-meshcat", help="Watch the run in a browser.")]
Rate = Annotated[float, typer.Option("--realtime-rate", min=0.0, help="Simulated seconds a second; 0: no limit.")]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(version("naraha"))
        raise typer.Exit


@app.callback()
def naraha(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Survey robots that go where people cannot: simulate, map, measure."""


@app.command()
def survey(
    scenario: Scenario = "stair_hall_loop",
    earlier: Earlier = None,
    operator: Annotated[str | None, typer.Option("--operator", help="Who chooses the ways: auto or prompt.")] = None,
    settings: Settings = None,
    out: Out = None,
    seed: Seed = None,
    meshcat: Live = False,
    realtime_rate: Rate = 0.0,
) -> None:
    """Survey a simulated world and map it: by ways that the robot finds itself, or on a tour such as stair_hall."""
    from .mission import Options
    from .scenario import load_scenario
    from .survey import SurveyScenario
    from .survey import survey as run

    options = Options(out=out or Path("out/survey"), meshcat=meshcat, realtime_rate=realtime_rate)
    loaded = load_scenario(SurveyScenario, scenario, settings or (), seed)
    if earlier is not None:
        loaded.earlier = str(earlier)
    if operator is not None:
        if loaded.loop is None:
            raise InputError("a tour has no ways to choose", where="--operator", value=operator, valid="no tour")
        loaded.loop.survey.operator = operator
    raise typer.Exit(run(loaded, options))


@app.command()
def traverse(
    scenario: Scenario = "e2827",
    robot: Annotated[str | None, typer.Option("--robot", help="pioneer, amphibious or crawler.")] = None,
    world: Annotated[str | None, typer.Option("--world", help="Another name for the scenario.")] = None,
    settings: Settings = None,
    out: Out = None,
    seed: Seed = None,
    meshcat: Live = False,
    realtime_rate: Rate = 0.0,
) -> None:
    """Drive to a goal over rough ground, over or around what the robot can."""
    from .mission import Options
    from .traverse import load_traverse
    from .traverse import traverse as run

    name = world or scenario
    # A scenario that a mission has left says which robot; the others leave it open.
    robot = robot or (None if Path(name).is_file() else "pioneer")
    options = Options(out=out or Path("out/traverse"), meshcat=meshcat, realtime_rate=realtime_rate)
    raise typer.Exit(run(load_traverse(name, robot, settings or (), seed), options))


@app.command()
def calibrate(
    robot: Annotated[str, typer.Option("--robot", help="pioneer, amphibious or crawler.")] = "pioneer",
    kind: Annotated[str, typer.Option("--kind", help="ability, or primitives: the motions of routes.")] = "ability",
    settings: Settings = None,
    out: Out = None,
    seed: Seed = None,
) -> None:
    """Drive a robot over ever harder ground, and write down what it can do."""
    from .calibrate import calibrate as run
    from .calibrate import load_calibrate
    from .calibrate_primitives import calibrate_primitives
    from .mission import Options

    kinds = {"ability": run, "primitives": calibrate_primitives}
    if kind not in kinds:
        raise InputError("unknown calibration", where="--kind", value=kind, valid=sorted(kinds))
    options = Options(out=out or Path("out/calibrate"))
    raise typer.Exit(kinds[kind](load_calibrate(robot, settings or (), seed), options))


@app.command()
def recover(
    scenario: Scenario = "stuck",
    stuck: Annotated[int | None, typer.Option("--stuck", min=1, max=5, help="Which of the five ways.")] = None,
    operator: Annotated[str | None, typer.Option("--operator", help="Who chooses the move: auto or prompt.")] = None,
    settings: Settings = None,
    out: Out = None,
    seed: Seed = None,
    meshcat: Live = False,
    realtime_rate: Rate = 0.0,
) -> None:
    """Let the snake notice that it is stuck, and free itself."""
    from .mission import Options
    from .recover import RecoverScenario
    from .recover import recover as run
    from .scenario import load_scenario

    given = [] if stuck is None else [f"stuck={stuck}"]
    given += [] if operator is None else [f"operator={operator}"]
    options = Options(out=out or Path("out/recover"), meshcat=meshcat, realtime_rate=realtime_rate)
    raise typer.Exit(run(load_scenario(RecoverScenario, scenario, [*given, *(settings or ())], seed), options))


@app.command()
def illuminate(
    scenario: Scenario = "construction_hall",
    settings: Settings = None,
    out: Out = None,
    seed: Seed = None,
    meshcat: Live = False,
    realtime_rate: Rate = 0.0,
) -> None:
    """Plan routes and landmarks together, check them in physics, then measure the illuminance."""
    from .illuminate import illuminate as run
    from .illuminate import load_illuminate
    from .mission import Options

    options = Options(out=out or Path("out/illuminate"), meshcat=meshcat, realtime_rate=realtime_rate)
    raise typer.Exit(run(load_illuminate(scenario, settings or (), seed), options))


@app.command()
def learn(
    map_file: Annotated[Path, typer.Argument(metavar="MAP", help="A semantic map, such as survey_map.ply.")],
    start: Annotated[str | None, typer.Option("--start", metavar="X,Y,DEG", help="Where the robot stands.")] = None,
    goal: Annotated[str | None, typer.Option("--goal", metavar="X,Y", help="Where it is to go.")] = None,
    scenario: ScenarioOption = "learn",
    settings: Settings = None,
    out: Out = None,
    seed: Seed = None,
) -> None:
    """Learn routes on a semantic map, and write them and the policy as CSV."""
    from .learn import learn_routes, load_learn
    from .mission import Options

    loaded = load_learn(scenario, _numbers("--start", start), _numbers("--goal", goal), settings or (), seed)
    raise typer.Exit(learn_routes(map_file, loaded, Options(out=out or Path("out/learn"))))


def _numbers(option: str, text: str | None) -> list[float] | None:
    """The numbers of a list with commas."""
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError("not numbers", where=option, value=text, valid="numbers with commas") from None


@app.command("map")
def map_scans(
    scans: Annotated[Path, typer.Argument(help="A folder of .ply, .pcd, .bin or .npz scans, or one of them.")],
    scenario: ScenarioOption = "recorded",
    truth: Truth = None,
    settings: Settings = None,
    out: Out = None,
    seed: Seed = None,
    meshcat: Live = False,
    realtime_rate: Rate = 0.0,
) -> None:
    """Map recorded scans with the systems that map simulated ones."""
    from .mapping import MapScenario, map_recorded
    from .mission import Options
    from .scenario import load_scenario

    options = Options(out=out or Path("out/map"), meshcat=meshcat, realtime_rate=realtime_rate)
    raise typer.Exit(map_recorded(scans, truth, load_scenario(MapScenario, scenario, settings or (), seed), options))


@app.command()
def merge(
    scans: Annotated[Path, typer.Argument(help="A folder of .ply, .pcd, .bin or .npz scans, one a viewpoint.")],
    scenario: ScenarioOption = "viewpoints",
    truth: Truth = None,
    settings: Settings = None,
    out: Out = None,
    seed: Seed = None,
    meshcat: Live = False,
    realtime_rate: Rate = 0.0,
) -> None:
    """Join scans from a handful of viewpoints metres apart, without odometry."""
    from .merging import MergeScenario, merge_recorded
    from .mission import Options
    from .scenario import load_scenario

    options = Options(out=out or Path("out/merge"), meshcat=meshcat, realtime_rate=realtime_rate)
    loaded = load_scenario(MergeScenario, scenario, settings or (), seed)
    raise typer.Exit(merge_recorded(scans, truth, loaded, options))


@app.command()
def extrinsics(
    scenario: Scenario = "extrinsics",
    settings: Settings = None,
    out: Out = None,
    seed: Seed = None,
    meshcat: Live = False,
    realtime_rate: Rate = 0.0,
) -> None:
    """Find where the near-infrared camera sits in its head, from one sweep."""
    from .extrinsics import ExtrinsicsScenario
    from .extrinsics import extrinsics as run
    from .mission import Options
    from .scenario import load_scenario

    options = Options(out=out or Path("out/extrinsics"), meshcat=meshcat, realtime_rate=realtime_rate)
    raise typer.Exit(run(load_scenario(ExtrinsicsScenario, scenario, settings or (), seed), options))


@app.command(context_settings={"allow_interspersed_args": True})
def campaign(
    mission: Annotated[str, typer.Argument(help="A mission, such as survey.")],
    arguments: Annotated[list[str] | None, typer.Argument(help="Its arguments, such as a scenario.")] = None,
    runs: Annotated[int, typer.Option("--runs", help="Seeds at every point of the grid.")] = 10,
    first_seed: Annotated[int, typer.Option("--first-seed", min=0, help="The first of them.")] = 0,
    grid: Annotated[
        list[str] | None, typer.Option("--grid", metavar="PATH=[VALUE,...]", help="Values of one scenario value.")
    ] = None,
    settings: Settings = None,
    jobs: Annotated[int, typer.Option("--jobs", help="Runs at the same time.")] = 1,
    backend: Annotated[str, typer.Option("--backend", help="loky on this machine, ray on a cluster.")] = "loky",
    out: Out = None,
) -> None:
    """Run a mission over many seeds and values, one process each; run it again to go on where it stopped."""
    from .campaign import Campaign, parse_grid, run_campaign

    missions = sorted(
        command.name or command.callback.__name__ for command in app.registered_commands if command.callback
    )
    if mission == "campaign" or mission not in missions:
        valid = [name for name in missions if name != "campaign"]
        raise InputError("unknown mission", where="campaign", value=mission, valid=valid)
    common = [word for setting in settings or () for word in ("--set", setting)]
    planned = Campaign(
        mission=mission,
        arguments=[*(arguments or ()), *common],
        runs=runs,
        first_seed=first_seed,
        grid=parse_grid(grid or ()),
        jobs=jobs,
        backend=backend,
        out=out or Path("out/campaign"),
    )
    raise typer.Exit(run_campaign(planned))


def main() -> None:
    """Runs the command line; bad input is one line and exit code 2."""
    try:
        app()
    except SystemExit as done:
        # Free point clouds while Open3D is still there, or it warns of leaks on the way out.
        gc.collect()
        sys.exit(done.code)
    except InputError as error:
        print(f"naraha: {error}", file=sys.stderr)
        sys.exit(2)
