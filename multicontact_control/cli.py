"""The `multicontact` command."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
import json
import os
from pathlib import Path
import sys
from typing import Annotated, Any

from multicontact_control import __version__
from multicontact_control.errors import ConfigError, MulticontactError, RunError
from multicontact_control.process import limit_threads
from rich.console import Console
import typer

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_SIGNAL = 128

app = typer.Typer(
    no_args_is_help=True, pretty_exceptions_enable=False, add_completion=False,
    context_settings={'help_option_names': ['-h', '--help']},
    help='Press a torque-controlled arm on several surfaces at once, with a commanded force at '
         'each contact (Park, Cortesão and Khatib, ICRA 2004).')

Scenario = Annotated[str, typer.Option(
    help='Scenario: a name from config/scenarios (paper, quick) or the path of a YAML file.')]
Plant = Annotated[str, typer.Option(
    help='Plant: `puma` (flexible drives, joint friction), `rigid` (ideal drives) or the path of '
         'a parameter file.')]
Seed = Annotated[int, typer.Option(help='Seed of the sensor noise and the surface roughness.')]
Duration = Annotated[float | None, typer.Option(
    help="Length of the run [s]; the scenario's own if not given.")]
Out = Annotated[Path | None, typer.Option(
    help='Folder for the results; runs/<date>-<time>-<scenario> if not given.')]
Estimator = Annotated[str | None, typer.Option(
    '--noise-estimator', help='How R is estimated: lead_window (the paper), hf_window, window, '
    'fixed (0.6 N^2), innovation, sage_husa or variational_bayes; the configured one if not '
    'given.')]
Overwrite = Annotated[bool, typer.Option(
    '--overwrite', help='Replace a run that is already in that folder.')]


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option('--version', help='Print the version.')] = False,
) -> None:
    if version:
        typer.echo(f'multicontact {__version__}')
        raise typer.Exit


@app.command()
def simulate(
    scenario: Scenario = 'paper', plant: Plant = 'puma', seed: Seed = 0,
    duration: Duration = None, noise_estimator: Estimator = None, out: Out = None,
    overwrite: Overwrite = False,
) -> None:
    """
    Run a scenario in one process, without ROS, as fast as it goes.

    The same seed gives the same run, bit for bit. Exit code 0: stable; 1: not stable; 2: bad
    input.
    """
    from multicontact_control.experiment.results import prepare_folder
    from multicontact_control.experiment.scenario import resolve

    with _errors_in_one_line():
        setup = resolve(
            scenario, plant=plant, seed=seed, duration=duration,
            noise_estimator={'estimator': noise_estimator} if noise_estimator else None)
        folder = prepare_folder(
            out, setup.scenario.name, overwrite=overwrite, now=datetime.now())
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.run import run_simulate

        summary = run_simulate(setup, folder)
    _end(summary)


@app.command()
def run(
    scenario: Scenario = 'paper', plant: Plant = 'puma', seed: Seed = 0,
    duration: Duration = None, noise_estimator: Estimator = None, out: Out = None,
    overwrite: Overwrite = False,
    lockstep: Annotated[bool, typer.Option(
        '--lockstep', help='Let the nodes wait for each other instead of for the wall clock: '
        'the same torques as `simulate`, bit for bit.')] = False,
    domain_id: Annotated[int | None, typer.Option(
        help='ROS_DOMAIN_ID of the graph; that of the environment, or the first one without '
        'participants on this machine, if not given.')] = None,
    namespace: Annotated[str, typer.Option(
        help='Namespace of the graph, e.g. `left`: two graphs can then share one domain.')] = '',
) -> None:
    """
    Run a scenario on the ROS 2 graph, record it to MCAP and report it.

    Starts simulator, controller, noise estimator and recorder as processes of their own, stops
    them together, then draws the figures from the bag. Exit code 0: stable; 1: not stable or a
    node died; 2: bad input; 128 + n: ended by signal n.
    """
    from multicontact_control.experiment.domain import check_namespace
    from multicontact_control.experiment.results import prepare_folder
    from multicontact_control.experiment.scenario import resolve

    with _errors_in_one_line():
        namespace = check_namespace(namespace)
        setup = resolve(
            scenario, plant=plant, seed=seed, duration=duration,
            noise_estimator={'estimator': noise_estimator} if noise_estimator else None)
        folder = prepare_folder(
            out, setup.scenario.name, overwrite=overwrite, now=datetime.now())
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.run import run_real_time

        summary, interrupted = run_real_time(
            setup, folder, lockstep=lockstep, domain_id=domain_id, namespace=namespace)
    if interrupted is not None:
        raise typer.Exit(EXIT_SIGNAL + interrupted)
    _end(summary)


@app.command()
def calibrate(
    plant: Plant = 'puma', seed: Seed = 0,
    out: Annotated[Path, typer.Option(help='Folder for tool.yaml.')] = Path('.'),
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Replace a tool.yaml that is already there.')] = False,
) -> None:
    """
    Weigh the tool of the simulated arm: mass, centre of mass and bias of the wrist sensor.

    The arm goes through the poses of config/calibration.yaml. What is found is shown beside the
    truth, which includes a bias drawn from the seed, and written to tool.yaml, to lay over the
    controller's parameters. Exit code 0: mass within 2 %, centre of mass within 3 mm, force bias
    within 0.1 N; 1: not; 2: bad input.
    """
    from multicontact_control.experiment import calibration

    with _errors_in_one_line():
        target = out / calibration.TOOL_FILE
        if target.exists() and not overwrite:
            raise ConfigError('out', 'a folder without a tool.yaml, or --overwrite', out)
        setup = calibration.sensor_setup(plant, seed)
        result = calibration.calibrate(setup, calibration.calibration_config())
        calibration.write_tool(out, result)
    found, (mass, com, bias) = result.found, result.errors
    console = Console()
    console.print(calibration.calibration_table(result, f'tool of {plant}, seed {seed}'))
    for line in (
            f'{found.poses} poses, condition {found.condition:.3g}, residual '
            f'{found.force_residual:.3g} N and {found.torque_residual:.3g} N m rms',
            f'mass {100.0 * mass:.3f} %, centre of mass {1e3 * com:.3f} mm, force bias '
            f'{bias:.4f} N off: {"within" if result.good else "NOT within"} 2 %, 3 mm and 0.1 N',
            f'written to {target}'):
        console.print(line, highlight=False, soft_wrap=True)
    if not result.good:
        raise typer.Exit(EXIT_FAILED)


@app.command()
def push_test(
    plant: Plant = 'puma', seed: Seed = 0,
    fault: Annotated[str, typer.Option(
        help='What is wrong with the sensor: none, sign (flipped), rotate (a quarter turn, about '
        'x, y, z for seeds 0, 1, 2, the other way for 3, 4, 5) or scale (half).')] = 'none',
) -> None:
    """
    Prove sign, frame and scale of the wrist sensor by pushing the tool.

    In simulation a scripted hand pushes as the test asks. Exit code 0: passed; 1: refused, naming
    what is wrong; 2: bad input.
    """
    from multicontact_control.experiment import push_trial

    with _errors_in_one_line():
        config = push_trial.PushTestConfig()
        setup = push_trial.push_setup(
            plant, seed, config, push_trial.fault_mounting(fault, seed))
        result = push_trial.run_push_test(setup, config, on_instruction=typer.echo)
    if not result.passed:
        raise typer.Exit(EXIT_FAILED)


@app.command()
def compare(
    quick: Annotated[bool, typer.Option(
        '--quick', help='A reduced matrix: four estimators, one seed, no runs without active '
        'state.')] = False,
    plants: Annotated[str, typer.Option(
        help='Plants, with commas between: presets or paths.')] = 'rigid,puma',
    estimators: Annotated[str, typer.Option(
        help='Noise estimators, with commas between; `window rescaled` is `window` with the same '
        'R at rest as `lead_window`. All if not given.')] = '',
    seeds: Annotated[int | None, typer.Option(
        help='Number of seeds, from 0: 3, or 1 with --quick.')] = None,
    jobs: Annotated[int, typer.Option(help='Runs at once; 0 for every core.')] = 0,
    out: Annotated[Path, typer.Option(
        help='Folder for the results. Runs that are finished there are not run again.',
    )] = Path('runs/compare'),
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Run everything again.')] = False,
) -> None:
    """
    Compare the noise estimators on the paper's disturbances, with and without the active state.

    Writes comparison.json and comparison.html. Exit code 0, whatever the verdicts; 2: bad input.
    """
    from multicontact_control.experiment.comparing import compare_and_report, ComparisonRequest

    with _errors_in_one_line():
        compare_and_report(ComparisonRequest(
            plants=_split(plants), estimators=_split(estimators), seeds=seeds, jobs=jobs,
            quick=quick, out=out, overwrite=overwrite))


@app.command('map')
def robustness_map(
    quick: Annotated[bool, typer.Option(
        '--quick', help='Two estimators on plant `rigid`, a coarse grid.')] = False,
    plants: Annotated[str, typer.Option(
        help='Plants, with commas between; rigid,puma, or rigid with --quick.')] = '',
    estimators: Annotated[str, typer.Option(
        help='Noise estimators, with commas between. All if not given.')] = '',
    jobs: Annotated[int, typer.Option(help='Runs at once; 0 for every core.')] = 0,
    out: Annotated[Path, typer.Option(
        help='Folder for the results. Runs that are finished there are not run again.',
    )] = Path('runs/map'),
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Run everything again.')] = False,
) -> None:
    """
    Map how wrong stiffness and delay may be, simulated and by the linear loop.

    True stiffness 0.1 to 20 times the model's, actuator delay 0 to 3 periods. Writes
    robustness.json, robustness.png and robustness.html.
    """
    from multicontact_control.experiment.comparing import map_and_report, MapRequest

    with _errors_in_one_line():
        map_and_report(MapRequest(
            plants=_split(plants), estimators=_split(estimators), jobs=jobs, quick=quick,
            out=out, overwrite=overwrite))


@app.command()
def report(
    runs: Annotated[list[Path], typer.Argument(
        metavar='RUN...', help='Folders of `run` or `simulate`.')],
    comparison: Annotated[Path | None, typer.Option(
        help='Folder of `compare`, for the claims that compare estimators.')] = None,
    out: Annotated[Path | None, typer.Option(
        help='Folder for report.html and the figures; the first run if not given.')] = None,
) -> None:
    """Judge recorded runs by the claims of the paper: report.html, and figures as PNG and PDF."""
    from multicontact_control.experiment.comparison import read_comparison
    from multicontact_control.experiment.load import load_run
    from multicontact_control.experiment.report import write_report

    with _errors_in_one_line():
        content = read_comparison(comparison) if comparison is not None else None
        paths = write_report([load_run(folder) for folder in runs], out or runs[0], content)
    typer.echo(f'report in {paths[0]}, {len(paths) - 1} figures')


def _split(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(',') if part.strip())


DomainId = Annotated[int | None, typer.Option(
    help='ROS_DOMAIN_ID to look at; that of the environment, or 0, if not given.')]


@app.command()
def topics(
    wait: Annotated[float, typer.Option(
        help='How long to wait for nodes to answer [s].', min=0.0)] = 1.0,
    domain_id: DomainId = None,
) -> None:
    """List the topics of a running graph with their types, like `ros2 topic list -t`."""
    with _errors_in_one_line():
        _require_ros()
        from multicontact_control.tools.echo import list_topics

        for line in list_topics(wait, domain_id):
            typer.echo(line)


@app.command()
def echo(
    topic: Annotated[str, typer.Argument(help='Topic, e.g. /contact_forces/measured.')],
    field: Annotated[str, typer.Option(
        help='Show only this field, e.g. `effort` or `header.stamp`.')] = '',
    once: Annotated[bool, typer.Option(
        '--once', help='End after one message.')] = False,
    full_length: Annotated[bool, typer.Option(
        '--full-length', '-f', help='Show lists and strings beyond 128 entries in full.')] = False,
    timeout: Annotated[float, typer.Option(
        help='Longest wait for a publisher [s].', min=0.0)] = 5.0,
    domain_id: DomainId = None,
) -> None:
    """
    Print the messages of a topic, like `ros2 topic echo`.

    The type is found from the graph. YAML documents, `---` after each; Ctrl-C ends it. Exit code
    1: nobody publishes the topic or its type is not installed; 2: there is no such field.
    """
    with _errors_in_one_line():
        _require_ros()
        from multicontact_control.tools.echo import echo as run_echo

        try:
            run_echo(topic, lambda text: print(text, flush=True), field=field, once=once,
                     full_length=full_length, timeout=timeout, domain_id=domain_id)
        except BrokenPipeError:
            # Whoever read it has had enough; nor may the last flush complain.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@app.command()
def record(
    topics: Annotated[list[str] | None, typer.Argument(
        help='Topics to record, e.g. /joint_states /tf; now or as soon as they appear.')] = None,
    all_topics: Annotated[bool, typer.Option(
        '--all', '-a', help='Record every topic that is not hidden.')] = False,
    output: Annotated[Path | None, typer.Option(
        '--output', '-o', help='Folder of the bag, to be created; rosbag2_<date>-<time> if not '
        'given.')] = None,
    domain_id: DomainId = None,
) -> None:
    """
    Record topics to a rosbag2 folder (MCAP), like `ros2 bag record`.

    Messages of any installed type are stored as they come over the wire. Ctrl-C ends it and
    closes the bag.
    """
    with _errors_in_one_line():
        if bool(topics) == all_topics:
            raise ConfigError('topics', 'either names or --all', 'both' if topics else 'neither')
        _require_ros()
        from multicontact_control.tools.record import record as run_record

        folder = output or Path(f'rosbag2_{datetime.now():%Y_%m_%d-%H_%M_%S}')
        run_record(topics or [], folder, lambda line: print(line, flush=True),
                   domain_id=domain_id)


def _require_ros() -> None:
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        raise RunError(f'ROS 2 (rclpy) cannot be loaded: {error}; install the extra [ros] or '
                       'source a ROS 2 Jazzy') from None


@app.command()
def faults(
    seed: Annotated[int, typer.Option(help='Seed of the first fault of every kind.')] = 0,
    out: Annotated[Path, typer.Option(
        help='Folder for faults.json.')] = Path('runs/faults'),
    quick: Annotated[bool, typer.Option(
        '--quick', help='One fault of each kind instead of 14.')] = False,
    jobs: Annotated[int, typer.Option(min=1, help='Faults at a time.')] = 2,
) -> None:
    """
    Break inputs and plant in many ways, and check that the arm stays safe.

    Exit code 0: every fault was safe; 1: one was not; 2: bad input.
    """
    with _errors_in_one_line():
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.fault_campaign import (
            print_report,
            run_campaign,
            write_report,
        )
        from rich.console import Console

        if seed < 0:
            raise ConfigError('seed', 'a whole number >= 0', seed)
        rows = run_campaign(seed, quick=quick, jobs=jobs)
        path = write_report(out, rows)
    print_report(rows, Console())
    typer.echo(f'written to {path}')
    if not all(row.safe for row in rows):
        raise typer.Exit(EXIT_FAILED)


@app.command()
def bench(
    as_json: Annotated[bool, typer.Option(
        '--json', help='Print one JSON object and nothing else.')] = False,
    quick: Annotated[bool, typer.Option('--quick', help='A tenth of everything.')] = False,
    ticks: Annotated[int | None, typer.Option(
        min=100, help='Controller ticks per repeat; 20 000 if not given.')] = None,
    graph: Annotated[bool, typer.Option(
        '--graph/--no-graph', help='Whether to measure the ROS 2 graph, too.')] = True,
) -> None:
    """
    Measure how fast everything is, each part against its floor in the same run.

    Ratios are what to compare between machines; a machine that was too noisy is named as such.
    """
    from multicontact_control.experiment.bench.run import print_bench, run_bench

    with _errors_in_one_line():
        result = run_bench(ticks=ticks, quick=quick, graph=graph)
    if as_json:
        typer.echo(json.dumps(result))
    else:
        print_bench(result, Console())


@contextmanager
def _errors_in_one_line() -> Iterator[None]:
    try:
        yield
    except ConfigError as error:
        typer.echo(f'multicontact: {error}', err=True)
        raise typer.Exit(EXIT_USAGE) from None
    except MulticontactError as error:
        typer.echo(f'multicontact: {error}', err=True)
        raise typer.Exit(EXIT_FAILED) from None


def _end(summary: dict[str, Any]) -> None:
    if not summary['stable']:
        raise typer.Exit(EXIT_FAILED)


def main() -> None:
    """Run the command line."""
    limit_threads()
    app(prog_name='multicontact')


if __name__ == '__main__':
    main()
