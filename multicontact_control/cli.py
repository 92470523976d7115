"""The `multicontact` command."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
import os
from pathlib import Path
import sys
from typing import Annotated, Any

from multicontact_control import __version__
from multicontact_control.errors import ConfigError, MulticontactError, RunError
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
    duration: Duration = None, out: Out = None, overwrite: Overwrite = False,
) -> None:
    """
    Run a scenario in one process, without ROS, as fast as it goes.

    The same seed gives the same run, bit for bit. Exit code 0: stable; 1: not stable; 2: bad
    input.
    """
    from multicontact_control.experiment.results import prepare_folder
    from multicontact_control.experiment.scenario import resolve

    with _errors_in_one_line():
        setup = resolve(scenario, plant=plant, seed=seed, duration=duration)
        folder = prepare_folder(
            out, setup.scenario.name, overwrite=overwrite, now=datetime.now())
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.run import run_simulate

        summary = run_simulate(setup, folder)
    _end(summary)


@app.command()
def run(
    scenario: Scenario = 'paper', plant: Plant = 'puma', seed: Seed = 0,
    duration: Duration = None, out: Out = None, overwrite: Overwrite = False,
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
        setup = resolve(scenario, plant=plant, seed=seed, duration=duration)
        folder = prepare_folder(
            out, setup.scenario.name, overwrite=overwrite, now=datetime.now())
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.run import run_real_time

        summary, interrupted = run_real_time(
            setup, folder, lockstep=lockstep, domain_id=domain_id, namespace=namespace)
    if interrupted is not None:
        raise typer.Exit(EXIT_SIGNAL + interrupted)
    _end(summary)


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
    app(prog_name='multicontact')


if __name__ == '__main__':
    main()
