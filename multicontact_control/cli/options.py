"""Options that several commands have, and what `run` and `simulate` make of theirs."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from multicontact_control.experiment.external import External
    from multicontact_control.experiment.scenario import Setup

Scenario = Annotated[str, typer.Option(
    help='Scenario: a name from config/scenarios (paper, quick) or the path of a YAML file.')]
Robot = Annotated[str, typer.Option(
    help='Robot: a name from config/robots (puma, panda, iiwa, ur5, kinova) or the path of such a '
         'file; puma if not given.')]
Plant = Annotated[str, typer.Option(
    help='How the robot is simulated: `rigid` (ideal drives), `flexible` (drives with springs and '
         'friction; of the PUMA, also called `puma`), ROBOT/PLANT, or the path of a parameter '
         'file; the default of the robot if not given.')]
Engine = Annotated[str, typer.Option(
    help='What simulates it: pybullet, or mujoco (extra [mujoco]); as configured, pybullet, if '
         'not given.')]
Plants = Annotated[str, typer.Option(
    help='Plants, with commas between: names, ROBOT/PLANT, or paths; all of the robot if not '
         'given.')]
Seed = Annotated[int, typer.Option(help='Seed of the sensor noise and the surface roughness.')]
Duration = Annotated[float | None, typer.Option(
    help="Length of the run [s]; the scenario's own if not given.")]
Out = Annotated[Path | None, typer.Option(
    help='Folder for the results; runs/<date>-<time>-<scenario> if not given.')]
Estimator = Annotated[str | None, typer.Option(
    '--noise-estimator', help='How R is estimated: lead_window (the paper), hf_window, window, '
    'fixed (0.6 N^2), innovation, sage_husa or variational_bayes; the configured one if not '
    'given.')]
Preset = Annotated[str, typer.Option(
    help='What is laid over the configuration first: `paper` (as published), `best` (the default '
         'of the nodes), `adaptive` (best, with the stiffness found on-line), or the path of a '
         'parameter file.')]
Law = Annotated[str | None, typer.Option(
    help='Force law of all contacts: aob (the paper), pi, dob, lqg, admittance, impedance or '
         'feedforward; the configured one if not given.')]
Settings = Annotated[list[str] | None, typer.Option(
    '--set', metavar='KEY=VALUE', help='A value laid over all files, e.g. '
    'plant.surfaces.*.stiffness=60000 or controller.force.damping_rate=60; may be repeated.')]
Overwrite = Annotated[bool, typer.Option(
    '--overwrite', help='Replace a run that is already in that folder.')]
Bare = Annotated[bool, typer.Option(
    '--bare', help='The control law alone, as the claims are measured, without the contact '
    'states, watchdogs, limits and gate of the supervisor.')]
ControllerFiles = Annotated[list[Path] | None, typer.Option(
    '--controller', metavar='FILE', help='Parameter file of your controller; may be repeated, '
    'each laid over those before. A relative URDF is looked for beside the file that names it.')]
DomainId = Annotated[int | None, typer.Option(
    envvar='ROS_DOMAIN_ID', min=0, max=232,
    help='ROS_DOMAIN_ID to look at; that of the environment, or 0, if not given.')]
Namespace = Annotated[str | None, typer.Option(
    help='Namespace of the controller; of a recording, the only one in it if not given.')]

# Of the studies.
StudyOut = Annotated[Path | None, typer.Option(
    help='Folder for the results; if not given runs/<command>, runs/sweep-<name> for a sweep, '
    'runs/tune-<law>, or runs/laws with `compare --laws`. What is finished there is not run '
    'again.')]
Jobs = Annotated[int, typer.Option(
    help='Jobs at once on this machine; 0 for every core.')]
Dask = Annotated[str, typer.Option(
    metavar='ADDRESS', help='Run on the workers of this Dask scheduler instead, e.g. '
    'tcp://host:8786. They need this package in the same version.')]
DryRun = Annotated[bool, typer.Option(
    '--dry-run', help='Only say what would be run, and how much of it is finished.')]
RunAgain = Annotated[bool, typer.Option('--overwrite', help='Run everything again.')]
Estimators = Annotated[str, typer.Option(
    help='Noise estimators, with commas between; `window rescaled` is `window` with the same R '
    'at rest as `lead_window`. All if not given.')]


def given_options(context: typer.Context) -> set[str]:
    """Return the names of the options that were given on the command line."""
    return {name for name in context.params
            if (source := context.get_parameter_source(name)) is not None
            and source.name == 'COMMANDLINE'}


def refuse_options(given: set[str], names: tuple[str, ...], what: str) -> None:
    """Refuse options that have no meaning; ConfigError naming the first."""
    from multicontact_control.errors import ConfigError

    for name in names:
        if name in given:
            option = 'set' if name == 'settings' else name.replace('_', '-')
            raise ConfigError(f'--{option}', f'nothing with {what}', 'it')


def split_list(text: str) -> tuple[str, ...]:
    """Return the parts of a list with commas between, without the empty ones."""
    return tuple(part.strip() for part in text.split(',') if part.strip())


def prepare(
    scenario: str, plant: str, seed: int, duration: float | None, noise_estimator: str | None,
    out: Path | None, overwrite: bool, *, preset: str = '', law: str | None = None,
    settings: Sequence[str] | None = None, robot: str = '', engine: str = '',
) -> tuple[Setup, Path]:
    """Check all a run needs, then make its folder; MulticontactError for what is wrong."""
    from multicontact_control.experiment.results import prepare_folder

    setup = resolve_settings(scenario, {
        'plant': plant, 'robot': robot, 'seed': seed, 'duration': duration, 'preset': preset,
        'noise_estimator': {'estimator': noise_estimator} if noise_estimator else None,
        'controller': {'force': {'law': law}} if law else None,
        'plant_overrides': {'engine': engine} if engine else None}, settings)
    return setup, prepare_folder(
        out, setup.scenario.name, overwrite=overwrite, now=datetime.now())


def prepare_external(
    files: Sequence[Path], scenario: str | None, duration: float | None,
    noise_estimator: str | None, out: Path | None, overwrite: bool, *, preset: str = '',
    law: str | None = None, settings: Sequence[str] | None = None,
) -> tuple[External, Path]:
    """Do the same as `prepare` for a run with the user's own robot behind the topics."""
    from multicontact_control.experiment.external import resolve_external
    from multicontact_control.experiment.overrides import overridden
    from multicontact_control.experiment.results import prepare_folder

    is_file = noise_estimator is not None and Path(noise_estimator).suffix in ('.yaml', '.yml')
    options: dict[str, Any] = {
        'scenario': scenario, 'duration': duration, 'preset': preset,
        'estimator_file': Path(noise_estimator) if noise_estimator and is_file else None,
        'noise_estimator': {'estimator': noise_estimator} if noise_estimator and (
            not is_file) else None,
        'controller': {'force': {'law': law}} if law else None}
    resolved = resolve_external(files, **options)
    if settings:
        resolved = resolve_external(files, **overridden(options, settings, resolved.setup))
    return resolved, prepare_folder(
        out, resolved.setup.scenario.name, overwrite=overwrite, now=datetime.now())


def resolve_settings(
    scenario: str, options: dict[str, Any], settings: Sequence[str] | None,
) -> Setup:
    """Return a scenario with options of `resolve` and settings over all files, checked."""
    from multicontact_control.experiment.overrides import overridden
    from multicontact_control.experiment.scenario import resolve

    setup = resolve(scenario, **options)
    return resolve(scenario, **overridden(options, settings, setup)) if settings else setup
