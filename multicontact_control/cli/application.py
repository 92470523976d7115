"""The application: its commands, in the order in which the help lists them."""

from __future__ import annotations

from inspect import getdoc
import os
import sys
from typing import Annotated, Any

from multicontact_control import __version__
from multicontact_control.cli import options
from multicontact_control.cli.dataset import dataset
from multicontact_control.cli.design import design
from multicontact_control.cli.export import export
from multicontact_control.cli.follow import follow
from multicontact_control.cli.report import identify, report
from multicontact_control.cli.robot import calibrate, new_robot, push_test
from multicontact_control.cli.run import demo, run, simulate, view
from multicontact_control.cli.study import study
from multicontact_control.cli.topic import echo, list_topics, rate
from multicontact_control.errors import ConfigError, MulticontactError
from multicontact_control.process import limit_threads
import typer
from typer.core import TyperCommand

FIRST = """\
Press a simulated or a real arm on several surfaces at once. Try first:
  multicontact demo                       see an arm in the browser, press, slide, push it
  multicontact simulate --scenario quick  a first run, with figures and numbers
  multicontact run                        the paper's experiment on the ROS 2 graph, recorded
  multicontact view runs/latest           replay the latest run
  multicontact --help                     all commands"""
FOLDERS = {  # of config/, by the option or argument that takes a name from it
    'robot': 'robots',
    'scenario': 'scenarios',
    'preset': 'presets',
    'name': 'studies',
}
COMMANDS = (
    demo,
    run,
    simulate,
    view,
    follow,
    report,
    dataset,
    study,
    identify,
    calibrate,
    push_test,
    new_robot,
    design,
    export,
)
# That need at least one argument.
WITH_ARGUMENTS = (
    follow,
    report,
    dataset,
    study,
    identify,
    new_robot,
    design,
    export,
)

app = typer.Typer(
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={'help_option_names': ['-h', '--help']},
    help='Press a torque-controlled arm on several surfaces at once, with a commanded force at '
    'each contact (Park, Cortesão and Khatib, ICRA 2004).',
    epilog='Exit code 0: done; 1: failed; 2: bad input; 128 + n: ended by signal n. What a '
    'command adds to that is in its help: multicontact COMMAND --help.',
)


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option('--version', help='Print the version.')
    ] = False,
) -> None:
    if version:
        typer.echo(f'multicontact {__version__}')
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(FIRST)


def compile_kernels() -> None:
    """Compile the numerical kernels now, in a minute, instead of at the first run."""
    from multicontact_control.runs.compilation import ensure_compiled

    typer.echo(f'{ensure_compiled()} kernels compiled')


class Command(TyperCommand):
    """A command that lists what its options choose from, and names an error in one line."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """List the files of ``config/`` that the command's options choose from by name."""
        for parameter in self.params:
            folder = FOLDERS.get(parameter.name)
            if folder is not None:
                with formatter.section(folder.capitalize()):
                    formatter.write_dl(list(options.describe_files(folder).items()))

    def invoke(self, ctx: Any) -> Any:
        """
        Run the command; an error of this package becomes a line, and an exit code.

        The code is 2 if a value is not acceptable, which is named by its option, else 1. Other
        exceptions are mistakes of ours and keep their traceback.
        """
        try:
            return super().invoke(ctx)
        except ConfigError as error:
            typer.echo(f'multicontact: {self._name_options(ctx, error)}', err=True)
            raise typer.Exit(options.EXIT_USAGE) from None
        except BrokenPipeError:  # what reads the output has ended
            raise
        except (MulticontactError, OSError) as error:
            typer.echo(f'multicontact: {error}', err=True)
            raise typer.Exit(options.EXIT_FAILED) from None

    def _name_options(self, ctx: Any, error: ConfigError) -> ConfigError:
        """Return an error whose fields are spelled as on the command line, where they were."""
        spellings: dict[str, str] = {}  # by the field of an error
        for parameter in self.params:
            name = str(parameter.name)
            if not options.is_given(ctx, name):
                continue
            spelling = str(parameter.metavar)
            if parameter.param_type_name == 'option':
                spelling = parameter.opts[0]
            for field in (name, name.removesuffix('s'), spelling.lower()):
                spellings[field] = spelling
        errors = []
        for each in error.errors:
            if not each.source:
                each = each.as_config_error(spellings.get(each.field, ''))
            errors.append(each)
        return ConfigError.combine(errors)


for function in COMMANDS:
    # Click keeps the lines of a paragraph after a backspace, which a raw docstring spells.
    app.command(
        cls=Command,
        no_args_is_help=function in WITH_ARGUMENTS,
        help=(getdoc(function) or '').replace(r'\b', '\b'),
    )(function)
app.command('compile', cls=Command, hidden=True)(compile_kernels)
topic = typer.Typer(
    help='List, print or time the topics of a running graph.',
    no_args_is_help=True,
    rich_markup_mode=None,
)
topic.command('list', cls=Command)(list_topics)
topic.command('echo', cls=Command)(echo)
topic.command('hz', cls=Command)(rate)
app.add_typer(topic, name='topic')


def main() -> None:
    """Run the command line, with one thread for linear algebra, and exit."""
    if sys.getfilesystemencoding() != 'utf-8' and os.environ.get('PYTHONUTF8') != '1':
        # Start anew with UTF-8 in a locale of another encoding.
        os.environ['PYTHONUTF8'] = '1'
        os.execv(sys.executable, sys.orig_argv)
    limit_threads()
    app(prog_name='multicontact')
