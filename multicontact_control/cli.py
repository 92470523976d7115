"""The `multicontact` command."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from multicontact_control import __version__
from multicontact_control.errors import ConfigError, MulticontactError

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
) -> None:
    """
    Run a scenario on the ROS 2 graph, record it to MCAP and report it.

    Starts simulator, controller, noise estimator and recorder as processes of their own, stops
    them together, then draws the figures from the bag. Exit code 0: stable; 1: not stable or a
    node died; 2: bad input; 128 + n: ended by signal n.
    """
    from multicontact_control.experiment.results import prepare_folder
    from multicontact_control.experiment.scenario import resolve

    with _errors_in_one_line():
        setup = resolve(scenario, plant=plant, seed=seed, duration=duration)
        folder = prepare_folder(
            out, setup.scenario.name, overwrite=overwrite, now=datetime.now())
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.run import run_real_time

        summary, interrupted = run_real_time(
            setup, folder, lockstep=lockstep, domain_id=domain_id)
    if interrupted is not None:
        raise typer.Exit(EXIT_SIGNAL + interrupted)
    _end(summary)


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
        from rich.console import Console

        from multicontact_control.experiment.fault_campaign import (
            print_report,
            run_campaign,
            write_report,
        )

        if seed < 0:
            raise ConfigError('seed', 'a whole number >= 0', seed)
        rows = run_campaign(seed, quick=quick, jobs=jobs)
        path = write_report(out, rows)
    print_report(rows, Console())
    typer.echo(f'written to {path}')
    if not all(row.safe for row in rows):
        raise typer.Exit(EXIT_FAILED)


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
