"""Options that several commands have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields, is_dataclass
from datetime import datetime
from functools import wraps
import inspect
from pathlib import Path
import signal
from typing import Annotated, Any, Literal, TYPE_CHECKING

from multicontact_control.errors import ConfigError
from multicontact_control.paths import config_dir
import typer

if TYPE_CHECKING:
    from multicontact_control.experiment.scenario import External, Setup

EXIT_FAILED, EXIT_USAGE, EXIT_SIGNAL = 1, 2, 128  # and the number of the signal
SHORT = {'noise_estimator': 'noise_estimator.estimator', 'law': 'controller.force.law',
         'engine': 'plant.engine'}  # options that set one value of a file

Law = Literal['aob', 'pi', 'dob', 'lqg', 'admittance', 'impedance', 'feedforward']
Estimator = Literal['lead_window', 'hf_window', 'window', 'fixed', 'innovation', 'sage_husa',
                    'variational_bayes']
Robot = Annotated[str, typer.Option(
    help='Robot: one of those below, or a YAML file; puma if not given.')]
ControllerFiles = Annotated[list[Path] | None, typer.Option(
    '--controller', metavar='FILE', help='Parameter file of your controller; may be repeated, '
    'each laid over those before. A relative URDF is looked for beside its file.')]
DomainId = Annotated[int | None, typer.Option(
    envvar='ROS_DOMAIN_ID', min=0, max=232,
    help='ROS_DOMAIN_ID of the graph; that of the environment, or 0, if not given.')]
Namespace = Annotated[str | None, typer.Option(
    help='Namespace of the controller; of a recording, the only one in it if not given.')]


@dataclass(frozen=True)
class SetupOptions:
    """Options of `run`, `simulate` and `view`: what is simulated."""

    robot: Robot = ''
    plant: Annotated[str, typer.Option(
        help='How the robot is simulated: rigid (ideal drives), flexible (drives with springs '
        "and friction), ROBOT/PLANT, or a parameter file; the robot's default if not given.",
        )] = ''
    seed: Annotated[int, typer.Option(help='Seed of sensor noise and surface roughness.')] = 0
    scenario: Annotated[str, typer.Option(
        help='Scenario: one of those below, or a YAML file.')] = 'paper'
    preset: Annotated[str, typer.Option(
        help='Parameters laid over the files of controller and noise estimator: one of those '
        'below, or a file.')] = 'best'
    settings: Annotated[list[str] | None, typer.Option(
        '--set', metavar='KEY=VALUE', help='A value laid over all files, in SI units, e.g. '
        'plant.surfaces.*.stiffness=60000; may be repeated.')] = None
    engine: Annotated[Literal['pybullet', 'mujoco'] | None, typer.Option(
        help='Physics engine; that of the plant, pybullet, if not given. MuJoCo is an extra: '
        'pip install mujoco.')] = None

    def values(self) -> list[str]:
        """Return all that is laid over the files, as for ``--set``."""
        return [*(f'{key}={value}' for name, key in SHORT.items()
                  if (value := getattr(self, name, ''))), *(self.settings or ())]

    def setup(self) -> Setup:
        """Return the configuration, checked; ConfigError."""
        from multicontact_control.experiment.overrides import resolve_with
        from multicontact_control.experiment.scenario import resolve

        return resolve_with(resolve, {
            'scenario': self.scenario, 'robot': self.robot, 'plant': self.plant,
            'seed': self.seed, 'preset': self.preset,
            'duration': getattr(self, 'duration', None)}, self.values())


@dataclass(frozen=True)
class RunOptions(SetupOptions):
    """Options of `run` and `simulate`."""

    duration: Annotated[float | None, typer.Option(
        help="Length of the run [s]; the scenario's own if not given.")] = None
    noise_estimator: Annotated[Estimator | None, typer.Option(
        metavar='NAME', help='How R, the variance of the force noise, is estimated: lead_window '
        '(the paper), hf_window, window, fixed (0.6 N^2), innovation, sage_husa or '
        'variational_bayes; that of the preset if not given.')] = None
    law: Annotated[Law | None, typer.Option(
        metavar='NAME', help='Force law of all contacts: aob (the active observer of the paper), '
        'pi, dob, lqg, admittance, impedance or feedforward; that of the preset if not '
        'given.')] = None
    out: Annotated[Path | None, typer.Option(
        help='Folder for the results; runs/<date>-<time>-<scenario> if not given.')] = None
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Replace the run in that folder.')] = False
    bare: Annotated[bool, typer.Option(
        '--bare', help='The control law alone, without the contact states, checks, limits and '
        'gate of the supervisor.')] = False

    def external(self, files: Sequence[Path], context: typer.Context) -> External:
        """Return that of a robot behind the topics; scenario and preset count if given."""
        from multicontact_control.experiment.overrides import resolve_with
        from multicontact_control.experiment.scenario import resolve_external

        return resolve_with(resolve_external, {
            'files': files, 'duration': self.duration,
            'scenario': self.scenario if is_given(context, 'scenario') else None,
            'preset': self.preset if is_given(context, 'preset') else ''}, self.values())

    def folder(self, setup: Setup) -> AbstractContextManager[Path]:
        """Return what makes the folder of the run; ConfigError if there is a run in it."""
        from multicontact_control.experiment.results import run_folder

        return run_folder(
            self.out, setup.scenario.name, overwrite=self.overwrite, now=datetime.now())


def flattened(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that has the fields of each of its dataclass parameters as options."""
    groups: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        if is_dataclass(parameter.annotation):
            kind: Any = parameter.annotation
            groups[parameter.name] = kind
            parameters += inspect.signature(kind, eval_str=True).parameters.values()
        else:
            parameters.append(parameter)

    @wraps(command)
    def flat(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{field.name: values.pop(field.name) for field in fields(group)})
        command(**values)

    ordered = [parameter.replace(kind=parameter.KEYWORD_ONLY) for parameter in parameters]
    flat.__signature__ = inspect.Signature(ordered)  # type: ignore[attr-defined]
    # Click keeps the lines of a paragraph after a backspace, which a raw docstring spells.
    flat.__doc__ = (command.__doc__ or '').replace(r'\b', '\b')
    flat.__annotations__ = {each.name: each.annotation for each in ordered}
    return flat


def described(folder: str) -> dict[str, str]:
    """Return the names of the files in a folder of ``config/``, with the first line of each."""
    there = config_dir() / folder
    files = {path.relative_to(there).with_suffix('').as_posix(): path.read_text(encoding='utf-8')
             for path in sorted(there.rglob('*.yaml'))}
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
            option = 'set' if name == 'settings' else name.replace('_', '-')
            raise ConfigError(f'--{option}', hint=f'leave it out {where}')
