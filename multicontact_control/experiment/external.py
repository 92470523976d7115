"""The user's own robot or simulator: its configuration, from parameter files or a recording."""

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
    merged,
    NO_PLANT,
    PRESET_NODES,
    preset_values,
    scenario_with,
    ScenarioConfig,
    Setup,
)
from multicontact_control.paths import config_dir, named_file
import numpy as np

CONTROLLER, ESTIMATOR = PRESET_NODES
COMMANDS = 'commands'  # in the place of a scenario's name
UNTIL_STOPPED = 1e6  # s, of a run that Ctrl-C ends
WHOLE = 1e-3  # of a rate, within which it is taken for one of whole Hz
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
    gets what it knows. A relative URDF is looked for beside the file that names it. Raises
    ConfigError if there is none, or one is no parameter file or has a section of another node.
    """
    if not files:
        raise ConfigError('--controller', 'the parameter file of your controller', 'none')
    own = ControllerConfig.model_fields.keys()
    of_estimator = NoiseEstimatorConfig.model_fields.keys() - own
    given: dict[str, Any] = {}
    estimator: dict[str, Any] = {}
    urdf_dir = Path()
    for path in files:
        sections = read_node_parameters(path, (EVERY_NODE, *PRESET_NODES))
        # What both know, the rate and the contacts, the estimator gets from the controller's.
        shared = sections.get(EVERY_NODE, {})
        section = merged({name: value for name, value in shared.items()
                          if name not in of_estimator}, sections.get(CONTROLLER))
        given = merge(given, section)
        estimator = merged(estimator, {name: value for name, value in shared.items()
                                       if name in of_estimator}, sections.get(ESTIMATOR))
        robot = section.get('robot')
        if isinstance(robot, Mapping) and 'urdf' in robot:
            urdf_dir = path.resolve().parent
    return ControllerFiles(
        {name: value for name, value in given.items() if name in own},
        {name: value for name, value in given.items() if name not in own},
        estimator, urdf_dir, ', '.join(map(str, files)))


class External(NamedTuple):
    """Everything a run needs on the user's own robot."""

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
    Read and check everything for a run on the user's own robot; ConfigError.

    Parameter `files` are those of the controller. Without a `scenario` it obeys the command
    topics; `duration` is the length of the run [s], by default that of the scenario. The noise
    estimator's file is by default that of the package, for the controller's contacts and rate.
    The other arguments are laid over all these files, as by `resolve`.
    """
    read, laid_over = read_controller_files(files), preset_values(preset)
    path, values = Path(COMMANDS), {'name': COMMANDS, 'duration': UNTIL_STOPPED}
    if scenario is not None:
        path = named_file('scenario', 'scenarios', scenario)
        values = read_yaml(path)
    elif scenario_overrides:
        raise ConfigError(f'scenario.{min(scenario_overrides)}',
                          '--scenario that it is laid over, or --duration for the length', 'none')
    config = scenario_with(values, scenario_overrides or {}, duration, path)
    controller_config = read.config(
        merged(laid_over['controller'], config.controller, controller))
    estimator_config = validate(NoiseEstimatorConfig, merged(
        read_parameters(config_dir() / 'noise_estimator.yaml'),
        {'contact_names': list(controller_config.column_names), 'rate': controller_config.rate},
        read.estimator, read_parameters(estimator_file) if estimator_file else {},
        laid_over['noise_estimator'], config.noise_estimator, noise_estimator),
        str(estimator_file or 'noise_estimator.yaml'))
    setup = Setup(
        scenario=config, controller=controller_config, noise_estimator=estimator_config,
        plant=NO_PLANT, plant_name=EXTERNAL, seed=0, urdf_dir=read.urdf_dir,
        commanded_by_topic=scenario is None)
    check_together(setup, path)
    RobotModel(controller_config.robot, read.urdf_dir)  # now, and not in a node's log
    for name, instead in (('reference_file', '--scenario'), ('lockstep', 'nothing')):
        if read.node.get(name):
            raise ConfigError(name, f'{instead} in an external run', read.node[name], read.source)
    node = {name: value for name, value in read.node.items()
            if name not in (*OF_THE_RUN, 'reference_file', 'lockstep')}
    return External(setup, node, duration if scenario is None else config.duration)


def dotted(values: Mapping[str, Any], start: str = '') -> dict[str, Any]:
    """Return nested parameters by their dotted names."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= dotted(value, f'{start}{name}.') if isinstance(value, Mapping) else {
            start + name: value}
    return found


def setup_of_recording(path: Path, found: BagMessages, files: Sequence[Path] = ()) -> Setup:
    """
    Return what is known of what a recording was made with.

    Without parameter `files` of the controller, joints, contacts and rate are those of its
    messages, and nothing else is known. Raises ConfigError if a file is not acceptable, RunError
    if the messages have no rate.
    """
    urdf_dir = Path()
    if files:
        read = read_controller_files(files)
        controller, urdf_dir = read.config(), read.urdf_dir
    else:
        robot = RobotConfig.model_construct(
            urdf='', joint_names=_names(found, ('joint_states', 'joint_effort_command')),
            operational_frame='', sensor_frame='')
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
    named = (found.by_topic[topic].names for topic in topics if topic in found.by_topic)
    return tuple(dict.fromkeys(next(filter(None, named), ())))


def _rate(path: Path, found: BagMessages) -> float:
    """Return the rate of the samples' stamps without their gaps [Hz], whole if it nearly is."""
    topic = sample_topic(found)
    apart = np.diff(np.unique(found.by_topic[topic].stamps))
    if not len(apart):
        raise RunError(f'{path}: {topic}: expected at least 2 samples, found 1')
    usual = np.median(apart)
    rate = 1e9 / float(np.mean(apart[np.abs(apart - usual) <= 0.5 * usual]))
    return float(round(rate)) if abs(rate - round(rate)) <= WHOLE * rate else rate


def contact_types(names: Sequence[str]) -> dict[str, ContactType]:
    """Return the types of contacts by name, from the names of forces and couples."""
    along, across = SUFFIXES[ALONG], SUFFIXES[ACROSS]
    return {name: 'plane' if name + across in names else 'edge' if name + along in names
            else 'point' for name in names if not name.endswith((along, across))}
