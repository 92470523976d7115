"""Options that several commands have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import wraps
import inspect
from pathlib import Path
import signal
from typing import Annotated, Any, Literal, TYPE_CHECKING

from multicontact_control.errors import ConfigError
from multicontact_control.paths import find_config_folder
import typer

if TYPE_CHECKING:
    from multicontact_control.runs.scenario import External, Setup

EXIT_FAILED, EXIT_USAGE, EXIT_SIGNAL = 1, 2, 128  # and the number of the signal
SHORT = {
    'noise_estimator': 'noise_estimator.estimator',
    'law': 'controller.force.law',
    'engine': 'plant.engine',
}  # options that set one value of a file

Law = Literal['aob', 'pi', 'dob', 'lqg', 'admittance', 'impedance', 'feedforward']
Estimator = Literal[
    'lead_window',
    'hf_window',
    'window',
    'fixed',
    'innovation',
    'sage_husa',
    'variational_bayes',
]
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
class SetupOptions:
    """Options of `run`, `simulate` and `view`: what is simulated."""

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
        typer.Option(help='Physics engine; that of the plant, pybullet, if not given.'),
    ] = None

    def values(self) -> list[str]:
        """Return all that is laid over the files, as for ``--set``."""
        return [
            *(
                f'{key}={value}'
                for name, key in SHORT.items()
                if (value := getattr(self, name, ''))
            ),
            *(self.settings or ()),
        ]

    def setup(self, *, nodes: bool = False) -> Setup:
        """Return the configuration, checked, with `nodes` of a graph; ConfigError."""
        from multicontact_control.runs.overrides import resolve_with
        from multicontact_control.runs.scenario import resolve

        return resolve_with(
            resolve,
            {
                'scenario': self.scenario,
                'robot': self.robot,
                'plant': self.plant,
                'seed': self.seed,
                'preset': self.preset,
                'duration': getattr(self, 'duration', None),
            },
            self.values(),
            nodes=nodes,
        )


@dataclass(frozen=True)
class RunOptions(SetupOptions):
    """Options of `run` and `simulate`."""

    duration: Annotated[
        float | None,
        typer.Option(help="Length of the run [s]; the scenario's own if not given."),
    ] = None
    noise_estimator: Annotated[
        Estimator | None,
        typer.Option(
            help='How R, the variance of the force noise, is estimated, in the paper by '
            'lead_window; that of the preset if not given.'
        ),
    ] = None
    law: Annotated[
        Law | None,
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

    def external(self, files: Sequence[Path], context: typer.Context) -> External:
        """Return that of a robot behind the topics; scenario and preset count if given."""
        from multicontact_control.runs.overrides import resolve_with
        from multicontact_control.runs.scenario import resolve_external

        return resolve_with(
            resolve_external,
            {
                'files': files,
                'duration': self.duration,
                'scenario': self.scenario if is_given(context, 'scenario') else None,
                'preset': self.preset if is_given(context, 'preset') else '',
            },
            self.values(),
            nodes=True,
        )


def flattened(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that has the fields of a dataclass parameter, `chosen`, as options."""
    own = dict(inspect.signature(command, eval_str=True).parameters)
    kind: Any = own.pop('chosen').annotation
    parameters = {**inspect.signature(kind, eval_str=True).parameters, **own}

    @wraps(command)
    def flat(**values: Any) -> None:
        chosen = kind(**{field.name: values.pop(field.name) for field in fields(kind)})
        command(chosen=chosen, **values)

    flat.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [each.replace(kind=each.KEYWORD_ONLY) for each in parameters.values()]
    )
    flat.__annotations__ = {name: each.annotation for name, each in parameters.items()}
    return flat


def described(folder: str) -> dict[str, str]:
    """Return the names of the files in a folder of ``config/``, with the first line of each."""
    there = find_config_folder() / folder
    files = {
        path.relative_to(there).with_suffix('').as_posix(): path.read_text(
            encoding='utf-8'
        )
        for path in sorted(there.rglob('*.yaml'))
    }
    return {name: text.partition('\n')[0].strip('# .') for name, text in files.items()}


def end_at_signals(text: str) -> None:
    """Let SIGINT and SIGTERM end this process with a line."""

    def end(number: int, _frame: object) -> None:
        typer.echo(f'multicontact: {text}', err=True)
        raise SystemExit(EXIT_SIGNAL + number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)


def is_given(context: typer.Context, name: str) -> bool:
    """Return whether an option was given on the command line."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == 'COMMANDLINE'


def refuse_options(context: typer.Context, names: Sequence[str], where: str) -> None:
    """Refuse options that have no meaning; ConfigError naming the first."""
    for name in names:
        if is_given(context, name):
            raise ConfigError(name, hint=f'leave it out {where}')
