"""A robot or simulator that is not this package's: its configuration, read and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from multicontact_control.config import (
    ContactConfig,
    ControllerConfig,
    merge,
    NoiseEstimatorConfig,
    read_node_parameters,
    read_parameters,
    read_yaml,
    RobotConfig,
    validate,
)
from multicontact_control.config.base import EVERY_NODE
from multicontact_control.config.contact import ACROSS, ALONG, ContactType, SUFFIXES
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.bag import BagMessages
from multicontact_control.experiment.recording import sample_topic
from multicontact_control.experiment.scenario import (
    check_together,
    EXTERNAL,
    NO_PLANT,
    PRESET_NODES,
    preset_values,
    scenario_path,
    scenario_with,
    ScenarioConfig,
    Setup,
)
from multicontact_control.paths import config_dir
import numpy as np

CONTROLLER, ESTIMATOR = PRESET_NODES
COMMANDS = 'commands'  # in the place of a scenario's name
UNTIL_STOPPED = 1e6  # s, of a run that Ctrl-C ends
WHOLE = 2e-4  # of a rate, by which a clock may be off one of whole Hz
OF_THE_RUN = ('autostart', 'startup_peers', 'timing_file', 'base_dir')
NAMED_BY = ('contact_forces/measured', 'contact_forces/estimated', 'contact_forces/desired',
            'contact_forces/noise_variance', 'contact_forces/command',
            'ground_truth/contact_forces')


class ControllerFiles(NamedTuple):
    """What a user's parameter files say of controller and noise estimator."""

    controller: dict[str, Any]
    node: dict[str, Any]  # of the controller's node, and not of the controller in it
    estimator: dict[str, Any]
    urdf_dir: Path  # that a relative URDF is relative to
    source: str

    def config(self, overrides: Mapping[str, Any] | None = None) -> ControllerConfig:
        """Return the controller's configuration; ConfigError if it is not acceptable."""
        return validate(ControllerConfig, merge(self.controller, overrides or {}), self.source)


def read_controller_files(files: Sequence[Path]) -> ControllerFiles:
    """
    Read the parameter files of a controller, each laid over those before.

    One may have sections of both nodes, and one for every node (``/**``), below these: each node
    gets what it knows. A relative URDF is looked for beside the file that names it.

    Raises
    ------
    ConfigError
        If one cannot be read, is no parameter file, or has a section of another node.

    """
    if not files:
        raise ConfigError('--controller', 'the parameter file of your controller', 'none')
    values: dict[str, dict[str, Any]] = {CONTROLLER: {}, ESTIMATOR: {}}
    urdf_dir = Path()
    for path in files:
        for name, section in _sections(path).items():
            values[name] = merge(values[name], section)
            robot = section.get('robot')
            if name == CONTROLLER and isinstance(robot, Mapping) and 'urdf' in robot:
                urdf_dir = path.resolve().parent
    own = ControllerConfig.model_fields
    given = values[CONTROLLER]
    return ControllerFiles(
        {name: value for name, value in given.items() if name in own},
        {name: value for name, value in given.items() if name not in own},
        values[ESTIMATOR], urdf_dir, ', '.join(str(path) for path in files))


def _sections(path: Path) -> dict[str, dict[str, Any]]:
    """Return the parameters in a file by node; those for every node lie below its own."""
    found = read_node_parameters(path, (EVERY_NODE, *PRESET_NODES))
    shared = found.get(EVERY_NODE, {})
    # What both know, the rate and the contacts, the estimator gets from the controller's anyway.
    of_estimator = {name: value for name, value in shared.items() if name in
                    NoiseEstimatorConfig.model_fields.keys() - ControllerConfig.model_fields}
    of_controller = {name: value for name, value in shared.items() if name not in of_estimator}
    return {CONTROLLER: merge(of_controller, found.get(CONTROLLER, {})),
            ESTIMATOR: merge(of_estimator, found.get(ESTIMATOR, {}))}


class External(NamedTuple):
    """Everything a run needs on a robot of somebody else."""

    setup: Setup
    node: dict[str, Any]  # parameters of the controller's node
    duration: float | None  # s; None until it is stopped


def resolve_external(
    files: Sequence[Path], *, scenario: str | None = None, duration: float | None = None,
    estimator_file: Path | None = None, preset: str = '',
    noise_estimator: dict[str, Any] | None = None, controller: dict[str, Any] | None = None,
    scenario_overrides: dict[str, Any] | None = None,
) -> External:
    """
    Read and check everything for a run on a robot of somebody else.

    Parameters
    ----------
    files
        Parameter files of the controller, each laid over those before.
    scenario
        Name or path; None to obey the command topics.
    duration
        Length of the run, by default that of the scenario [s].
    estimator_file
        Parameter file of the noise estimator; by default that of the package, for the
        controller's contacts and rate.
    preset
        Name or path of what is laid over all these files.
    noise_estimator, controller
        Values laid over the files', the preset's and the scenario's.
    scenario_overrides
        Values laid over the scenario's file; none without a scenario.

    Raises
    ------
    ConfigError
        With the first value that is not acceptable.

    """
    read = read_controller_files(files)
    chosen = preset_values(preset) if preset else {}
    path, config = _scenario(scenario, duration, scenario_overrides or {})
    controller_config = read.config(merge(
        merge(chosen.get('controller', {}), config.controller), controller or {}))
    given = merge(read.estimator, read_parameters(estimator_file) if estimator_file else {})
    defaults = {'contact_names': list(controller_config.column_names),
                'rate': controller_config.rate}
    estimator_config = validate(NoiseEstimatorConfig, merge(
        merge(merge(merge(merge(
            read_parameters(config_dir() / 'noise_estimator.yaml'), defaults), given),
            chosen.get('noise_estimator', {})), config.noise_estimator),
        noise_estimator or {}), str(estimator_file or 'noise_estimator.yaml'))
    setup = Setup(
        scenario=config, controller=controller_config, noise_estimator=estimator_config,
        plant=NO_PLANT, plant_name=EXTERNAL, seed=0, urdf_dir=read.urdf_dir,
        commanded_by_topic=scenario is None)
    check_together(setup, path)
    RobotModel(controller_config.robot, read.urdf_dir)  # now, and not in a node's log
    return External(setup, _node_parameters(read), (
        duration if scenario is None else config.duration))


def _scenario(
    scenario: str | None, duration: float | None, overrides: Mapping[str, Any],
) -> tuple[Path, ScenarioConfig]:
    """Return the scenario and its file; one without commands if there is none."""
    if scenario is None and overrides:
        raise ConfigError(f'scenario.{min(overrides)}',
                          '--scenario that it is laid over, or --duration for the length', 'none')
    if scenario is None:
        path, values = Path(COMMANDS), {'name': COMMANDS, 'duration': UNTIL_STOPPED}
    else:
        path = scenario_path(scenario)
        values = read_yaml(path)
    return path, scenario_with(values, overrides, duration, path)


def _node_parameters(read: ControllerFiles) -> dict[str, Any]:
    """Return the parameters of the controller's node that are the user's."""
    for name, instead in (('reference_file', '--scenario'), ('lockstep', 'nothing')):
        if read.node.get(name):
            raise ConfigError(name, f'{instead} in an external run', read.node[name], read.source)
    return {name: value for name, value in read.node.items()
            if name not in (*OF_THE_RUN, 'reference_file', 'lockstep')}


def dotted(values: Mapping[str, Any], start: str = '') -> dict[str, Any]:
    """Return nested parameters by their dotted names."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            found |= dotted(value, f'{start}{name}.')
        else:
            found[start + name] = value
    return found


def setup_of_recording(
    path: Path, found: BagMessages, files: Sequence[Path] = (),
) -> Setup:
    """
    Return what is known of what a recording was made with.

    Parameters
    ----------
    path
        Of the recording.
    found
        Its messages.
    files
        Parameter files of the controller; without any, joints, contacts and rate are those of
        the messages, and nothing else is known.

    Raises
    ------
    ConfigError
        If a file is not acceptable.
    RunError
        If the messages tell no rate.

    """
    urdf_dir = Path()
    if files:
        read = read_controller_files(files)
        controller, urdf_dir = read.config(), read.urdf_dir
    else:
        joints = _names(found, ('joint_states', 'joint_effort_command'))
        robot = RobotConfig.model_construct(
            urdf='', joint_names=joints, operational_frame='', sensor_frame='')
        types = contact_types(_names(found, NAMED_BY))
        controller = ControllerConfig.model_construct(
            rate=_rate(path, found), robot=robot, contact_names=tuple(types),
            contacts={name: ContactConfig.model_construct(type=kind)
                      for name, kind in types.items()})
    unknown: Any = 'noise estimator not known'
    estimator = NoiseEstimatorConfig.model_construct(
        estimator=unknown, contact_names=controller.column_names, rate=controller.rate)
    return Setup(
        scenario=ScenarioConfig(name=path.stem or 'recording', duration=UNTIL_STOPPED),
        controller=controller, noise_estimator=estimator, plant=NO_PLANT, plant_name=EXTERNAL,
        seed=0, urdf_dir=urdf_dir, commanded_by_topic=True)


def _names(found: BagMessages, topics: Sequence[str]) -> tuple[str, ...]:
    """Return the names in the first message of the first topic that has any."""
    for topic in topics:
        if topic in found.by_topic and found.by_topic[topic].names:
            return tuple(dict.fromkeys(found.by_topic[topic].names))
    return ()


def _rate(path: Path, found: BagMessages) -> float:
    """Return the rate that the stamps of most samples are apart by [Hz], if whole, exactly."""
    topic = sample_topic(found)
    stamps = np.unique(found.by_topic[topic].stamps)
    if len(stamps) < 2:
        raise RunError(f'{path}: {topic}: expected at least 2 samples, found {len(stamps)}')
    apart = np.diff(stamps)
    usual = float(np.percentile(apart, 50.0, method='higher'))  # one of them
    periods = apart[np.abs(apart - usual) <= 0.5 * usual]  # the others are gaps
    duration = float(periods.sum())
    rate = 1e9 * len(periods) / duration
    # In their sum jitter counts once, and not in every period.
    unsure = max(WHOLE, float(np.abs(periods - usual).max()) / duration)
    whole = float(round(rate))
    return whole if whole and abs(rate - whole) <= unsure * rate else rate


def contact_types(names: Sequence[str]) -> dict[str, ContactType]:
    """Return the types of contacts by name, from the names of forces and couples."""
    along, across = SUFFIXES[ALONG], SUFFIXES[ACROSS]
    return {name: 'plane' if name + across in names else 'edge' if name + along in names
            else 'point' for name in names if not name.endswith((along, across))}
