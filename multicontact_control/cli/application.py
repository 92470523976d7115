"""The application: its commands, in the order in which the help lists them."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
import os
import sys
from typing import Annotated, Any

from multicontact_control import __version__
from multicontact_control.cli.calibrate import calibrate
from multicontact_control.cli.compare import compare
from multicontact_control.cli.compile_kernels import compile_kernels
from multicontact_control.cli.design import design
from multicontact_control.cli.faults import faults
from multicontact_control.cli.identify import identify
from multicontact_control.cli.new_robot import new_robot
from multicontact_control.cli.push_test import push_test
from multicontact_control.cli.report import report
from multicontact_control.cli.robots import robots
from multicontact_control.cli.robustness_map import robustness_map
from multicontact_control.cli.run import run
from multicontact_control.cli.simulate import simulate
from multicontact_control.cli.sweep import sweep
from multicontact_control.cli.topic import echo, list_topics
from multicontact_control.cli.tune import tune
from multicontact_control.cli.view import view
from multicontact_control.process import limit_threads
from rich.markup import escape
import typer
from typer.core import TyperCommand

FIRST = """\
Press a simulated or a real arm on several surfaces at once. Try first:
  multicontact view                       see an arm in the browser, press, slide, push it
  multicontact simulate --scenario quick  a first run, with figures and numbers
  multicontact run                        the paper's experiment on the ROS 2 graph, recorded
  multicontact view runs/latest           any run, replayed
All commands: multicontact --help; the Tab key: multicontact --install-completion"""

app = typer.Typer(
    pretty_exceptions_enable=False,
    context_settings={'help_option_names': ['-h', '--help']},
    help='Press a torque-controlled arm on several surfaces at once, with a commanded force at '
         'each contact (Park, Cortesão and Khatib, ICRA 2004).')


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option('--version', help='Print the version.')] = False,
) -> None:
    if version:
        typer.echo(f'multicontact {__version__}')
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(FIRST)


class _Command(TyperCommand):
    """A command whose help has its texts as they are: a unit in brackets is no markup."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        shown = copy(self)
        shown.params = [copy(parameter) for parameter in self.params]
        each: Any
        for each in (shown, *shown.params):
            each.help = escape(getattr(each, 'help', None) or '')
        TyperCommand.format_help(shown, ctx, formatter)


_COMMANDS: dict[str, Callable[..., None]] = {
    'simulate': simulate, 'run': run, 'view': view, 'calibrate': calibrate,
    'push-test': push_test, 'new-robot': new_robot, 'compare': compare, 'design': design,
    'tune': tune, 'identify': identify, 'map': robustness_map, 'robots': robots, 'sweep': sweep,
    'report': report, 'faults': faults}
for _name, _function in _COMMANDS.items():
    app.command(_name, cls=_Command)(_function)
app.command('compile', cls=_Command, hidden=True)(compile_kernels)
_topic = typer.Typer(help='See what a running graph publishes.', no_args_is_help=True)
_topic.command('list', cls=_Command)(list_topics)
_topic.command('echo', cls=_Command)(echo)
app.add_typer(_topic, name='topic')


def main() -> None:
    """Run the command line."""
    if sys.getfilesystemencoding() != 'utf-8' and os.environ.get('PYTHONUTF8') != '1':
        os.environ['PYTHONUTF8'] = '1'  # in a locale of another encoding begin anew
        os.execv(sys.executable, sys.orig_argv)
    limit_threads()
    app(prog_name='multicontact')
