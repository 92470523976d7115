"""Options that several commands have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from importlib.util import find_spec
import inspect
from pathlib import Path
import signal
from typing import Annotated, Any, Literal, TYPE_CHECKING

from multicontact_control.choices import EstimatorChoice, LawChoice
from multicontact_control.errors import ConfigError
from multicontact_control.paths import list_named_files
import typer

if TYPE_CHECKING:
    from multicontact_control.runs.scenario import Setup

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_SIGNAL = 128  # and the number of the signal
SHORTCUTS = {  # options that set one value of a file
    'noise_estimator': 'noise_estimator.estimator',
    'law': 'controller.force.law',
    'engine': 'plant.engine',
}

Robot = Annotated[
    str,
    typer.Option(help='Robot: one of those below, or a YAML file; puma if not given.'),
]
ControllerFiles = Annotated[
    list[Path] | None,
    typer.Option(
        '--controller',
        metavar='FILE',
        help='Parameter file of your controller; may be repeated, '
        'each laid over those before. A relative URDF is looked for beside its file.',
    ),
]
DomainId = Annotated[
    int | None,
    typer.Option(
        envvar='ROS_DOMAIN_ID',
        min=0,
        max=232,
        help='ROS_DOMAIN_ID of the graph; that of the environment if not given, else 0, or, for a '
        'simulated graph that is started, the first one that is free on this machine.',
    ),
]
Namespace = Annotated[
    str | None,
    typer.Option(
        help='Namespace of the graph; of a recording, the only one in it if not given.'
    ),
]
Overwrite = Annotated[bool, typer.Option('--overwrite', help='Replace what is there.')]


@dataclass(frozen=True)
class PlaceOptions:
    """Options of commands that meet a running graph, or start one: where it is, or is to be."""

    domain_id: DomainId = None
    namespace: Namespace = None


@dataclass(frozen=True)
class SetupOptions:
    """
    Options of `run`, `simulate` and `view`: which arm is simulated, and what it is to do.

    Later ones are laid over earlier ones: the robot and its plant, the preset, the scenario, and
    the values of ``--set``.
    """

    robot: Robot = ''
    plant: Annotated[
        str,
        typer.Option(
            help='Plant: rigid (ideal drives), flexible (drives with springs and friction), '
            "ROBOT/PLANT, or a parameter file; the robot's default if not given."
        ),
    ] = ''
    seed: Annotated[
        int, typer.Option(help='Seed of sensor noise and surface roughness.')
    ] = 0
    scenario: Annotated[
        str, typer.Option(help='Scenario: one of those below, or a YAML file.')
    ] = 'paper'
    preset: Annotated[
        str,
        typer.Option(
            help='Parameters laid over the files of controller and noise estimator: one of those '
            'below, or a file.'
        ),
    ] = 'best'
    settings: Annotated[
        list[str] | None,
        typer.Option(
            '--set',
            metavar='KEY=VALUE',
            help='A value laid over all files, in SI units, e.g. '
            'plant.surfaces.*.stiffness=60000; may be repeated.',
        ),
    ] = None
    engine: Annotated[
        Literal['pybullet', 'mujoco'] | None,
        typer.Option(
            help='Physics engine; that of the plant if not given: pybullet where it is '
            'installed, else mujoco.'
        ),
    ] = None

    def list_settings(self) -> list[str]:
        """Return all that is laid over the files, as for ``--set``, shortcuts before others."""
        settings = []
        for name, key in SHORTCUTS.items():
            value = getattr(self, name, None)  # `view` has not all of them
            if value is not None:
                settings.append(f'{key}={value}')
        if self.settings is not None:
            settings += self.settings
        return settings

    def setup(self, *, nodes: bool = False) -> Setup:
        """
        Return the configuration of a simulated arm, checked.

        With `nodes` the settings may be those that only a node of the graph knows, too. Raises
        ConfigError with every value that is not acceptable.
        """
        from multicontact_control.runs.overrides import resolve_with
        from multicontact_control.runs.scenario import resolve

        names = ('scenario', 'robot', 'plant', 'seed', 'preset', 'duration')
        arguments = {name: getattr(self, name, None) for name in names}
        return resolve_with(resolve, arguments, self.list_settings(), nodes=nodes)

    def external(self, files: Sequence[Path], context: typer.Context) -> Setup:
        """
        Return the configuration of the robot behind the topics, checked.

        `files` are the parameter files of its controller. Scenario and preset count if they were
        given on the command line: their defaults are for the simulated arm. Raises ConfigError.
        """
        from multicontact_control.runs.overrides import resolve_with
        from multicontact_control.runs.scenario import resolve_external

        arguments: dict[str, Any] = {
            'files': files,
            'duration': getattr(self, 'duration', None),
        }
        for name in ('scenario', 'preset'):
            if is_given(context, name):
                arguments[name] = getattr(self, name)
        return resolve_with(
            resolve_external, arguments, self.list_settings(), nodes=True
        )


@dataclass(frozen=True)
class RunOptions(SetupOptions):
    """Options of `run` and `simulate`: how long it runs, how it is controlled, where it goes."""

    duration: Annotated[
        float | None,
        typer.Option(help="Length of the run [s]; the scenario's own if not given."),
    ] = None
    noise_estimator: Annotated[
        EstimatorChoice | None,
        typer.Option(
            help='How R, the variance of the force noise, is estimated, in the paper by '
            'lead_window; that of the preset if not given.'
        ),
    ] = None
    law: Annotated[
        LawChoice | None,
        typer.Option(
            help='Force law of all contacts, aob in the paper; that of the preset if not '
            'given.'
        ),
    ] = None
    out: Annotated[
        Path | None,
        typer.Option(
            help='Folder for the results; runs/<date>-<time>-<scenario> if not given.'
        ),
    ] = None
    overwrite: Overwrite = False
    bare: Annotated[
        bool,
        typer.Option('--bare', help='The control law alone, without its supervisor.'),
    ] = False


def flatten_options(command: Callable[..., None]) -> Callable[..., None]:
    """
    Return a command in which the fields of dataclasses are options.

    A parameter of the command whose type is a dataclass is replaced by the fields of that class,
    in their order, so that typer sees them; the command gets an object made of them.
    """
    groups: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        kind: Any = parameter.annotation
        if isinstance(kind, type) and is_dataclass(kind):
            groups[parameter.name] = kind
            parameters += inspect.signature(kind, eval_str=True).parameters.values()
        else:
            parameters.append(parameter)

    @wraps(command)
    def flat(**values: Any) -> None:
        for name, kind in groups.items():
            of_group = {field.name: values.pop(field.name) for field in fields(kind)}
            values[name] = kind(**of_group)
        command(**values)

    flat.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [each.replace(kind=each.KEYWORD_ONLY) for each in parameters]
    )
    flat.__annotations__ = {each.name: each.annotation for each in parameters}
    return flat


def tell_missing_engine() -> None:
    """Say what `auto` stands for where PyBullet is not installed."""
    if find_spec('pybullet') is None:
        typer.echo('PyBullet is not installed: engine auto is mujoco', err=True)


def describe_files(folder: str) -> dict[str, str]:
    """
    Return the names of the files in a folder of ``config/``, with the first line of each.

    The line is a comment that says what the file is.
    """
    descriptions = {}
    for name, path in list_named_files(folder).items():
        first_line = path.read_text(encoding='utf-8').partition('\n')[0]
        descriptions[name] = first_line.strip('# .')
    return descriptions


def end_at_signals(text: str) -> None:
    """
    Let SIGINT and SIGTERM end this process with a line of text, and exit code 128 + n.

    What is going on is left by SystemExit, so that contexts end and folders are put in order.
    """

    def end(number: int, _frame: object) -> None:
        typer.echo(f'multicontact: {text}', err=True)
        raise SystemExit(EXIT_SIGNAL + number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)


def is_given(context: typer.Context, name: str) -> bool:
    """Return whether an option was given on the command line: not by default or environment."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == 'COMMANDLINE'


def refuse_options(context: typer.Context, names: Sequence[str], where: str) -> None:
    """
    Refuse options that have no meaning beside others; ConfigError naming the first that is given.

    `where` completes the line, as in "leave it out with --external".
    """
    for name in names:
        if is_given(context, name):
            raise ConfigError(name, hint=f'leave it out {where}')
