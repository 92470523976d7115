"""The application: its commands, in the order in which the help lists them."""

from __future__ import annotations

from typing import Annotated

from multicontact_control import __version__
from multicontact_control.cli.bench import bench
from multicontact_control.cli.calibrate import calibrate
from multicontact_control.cli.compare import compare
from multicontact_control.cli.compile_kernels import compile_kernels
from multicontact_control.cli.design import design
from multicontact_control.cli.echo import echo
from multicontact_control.cli.faults import faults
from multicontact_control.cli.identify import identify
from multicontact_control.cli.new_robot import new_robot
from multicontact_control.cli.push_test import push_test
from multicontact_control.cli.record import record
from multicontact_control.cli.report import report
from multicontact_control.cli.robots import robots
from multicontact_control.cli.robustness_map import robustness_map
from multicontact_control.cli.run import run
from multicontact_control.cli.simulate import simulate
from multicontact_control.cli.soak import soak
from multicontact_control.cli.sweep import sweep
from multicontact_control.cli.topics import topics
from multicontact_control.cli.tune import tune
from multicontact_control.cli.view import view
from multicontact_control.process import limit_threads
import typer

app = typer.Typer(
    no_args_is_help=True, pretty_exceptions_enable=False, add_completion=False,
    context_settings={'help_option_names': ['-h', '--help']},
    help='Press a torque-controlled arm on several surfaces at once, with a commanded force at '
         'each contact (Park, Cortesão and Khatib, ICRA 2004).')


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option('--version', help='Print the version.')] = False,
) -> None:
    if version:
        typer.echo(f'multicontact {__version__}')
        raise typer.Exit


app.command()(simulate)
app.command()(run)
app.command()(view)
app.command()(calibrate)
app.command()(push_test)
app.command('new-robot')(new_robot)
app.command()(compare)
app.command()(design)
app.command()(tune)
app.command()(identify)
app.command('map')(robustness_map)
app.command()(robots)
app.command()(sweep)
app.command()(report)
app.command()(topics)
app.command()(echo)
app.command()(record)
app.command()(faults)
app.command()(soak)
app.command()(bench)
app.command('compile')(compile_kernels)


def main() -> None:
    """Run the command line."""
    limit_threads()
    app(prog_name='multicontact')
