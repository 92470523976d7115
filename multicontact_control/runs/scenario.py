"""Scenarios and a user's own parameter files, and what they resolve to before a run starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path
import shutil
from typing import Any, NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import (
    Config,
    ControllerConfig,
    merge,
    NoiseEstimatorConfig,
    parameter,
    read_parameters,
    read_yaml,
    validate,
)
from multicontact_control.config.base import ANY_NODE, read_node_parameters
from multicontact_control.control.motions import WaypointsConfig, with_waypoints_of_file
from multicontact_control.control.tasks import ReferenceConfig, ScenarioTask
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError, run_all_checks
from multicontact_control.files import replace_text_file
from multicontact_control.force.laws.design import find_law
from multicontact_control.force.noise import find_noise_estimator
from multicontact_control.paths import find_config_folder, find_named_file
from multicontact_control.runs.parameter_file import write_parameters
import numpy as np
from sim_bridge.config import PlantConfig
from sim_bridge.robots import DEFAULT, find_robot, Robot
import yaml

EXTERNAL = 'external'  # in the place of a plant's name
CONTROLLER = 'controller_node'
ESTIMATOR = 'noise_estimator_node'
PRESET_NODES = (CONTROLLER, ESTIMATOR)
NODES = {  # which runs with a section of a setup
    'controller': CONTROLLER,
    'noise_estimator': ESTIMATOR,
    'plant': 'sim_node',
}
COMMANDS = 'commands'  # in the place of a scenario's name
NO_PLANT: Any = None  # in the place of the plant where the robot is the user's own
SHORTEST = 1.0  # s, of a run
UNTIL_STOPPED = 1e6  # s, of a run that Ctrl-C ends
OF_ANY_NODE = ('startup_peers', 'timing_file')  # each run sets its own
REFUSED_OF_EXTERNAL = {  # parameters of the controller's node, and what to do instead
    'reference_file': 'give --scenario',
    'lockstep': 'set it to false',
}
NODES_FILE = 'nodes.yaml'  # of what only nodes know
STAMP_TOLERANCE = 1e-9  # s


class ScenarioConfig(Config):
    """
    One experiment: what is commanded when, and what differs from the defaults.

    It is a file of ``config/scenarios``, or one of the user's. The reference has the motion of the
    operational point and the steps of the contact forces; the sections lay values over those of
    controller, noise estimator and plant, for this experiment only.
    """

    name: str = parameter(..., 'Name, as used in file names.', min_length=1)
    description: str = parameter('', 'What it shows.')
    duration: float = parameter(..., 'Length of the run.', unit='s', ge=SHORTEST)
    reference: ReferenceConfig = ReferenceConfig()
    controller: dict[str, Any] = parameter(
        {}, 'Values laid over config/controller.yaml.'
    )
    noise_estimator: dict[str, Any] = parameter(
        {}, 'Values laid over config/noise_estimator.yaml.'
    )
    plant: dict[str, Any] = parameter({}, "Values laid over the plant preset's.")


@dataclass(frozen=True)
class Setup:
    """
    Everything a run needs, resolved and checked: files, presets and settings are laid over.

    The three configurations fit each other: rate, names of the contacts, bounds of R. The URDF
    exists.
    """

    scenario: ScenarioConfig
    controller: ControllerConfig
    noise_estimator: NoiseEstimatorConfig
    plant: PlantConfig  # `NO_PLANT` where the robot is the user's own
    plant_name: str  # as `plant_source` names it, or a path, or `EXTERNAL`
    seed: int  # of every random number of the plant
    urdf_dir: Path  # that `controller.robot.urdf` is relative to
    commanded_by_topic: bool = False  # the recording has the forces, not the scenario
    # Of a run on the graph, nested, by section: what only the section's node knows.
    nodes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def node_parameters(self, section: str) -> dict[str, Any]:
        """Return what only the node of a section knows, by dotted names."""
        return flatten_parameters(self.nodes.get(section, {}))

    @property
    def simulated(self) -> bool:
        """Whether the plant is one of this package, and not the user's own robot."""
        return self.plant is not NO_PLANT

    @property
    def ticks(self) -> int:
        """Return the number of samples of the run."""
        return round(self.scenario.duration * self.controller.rate)

    @property
    def endless(self) -> bool:
        """Whether the run lasts until a signal ends it."""
        return self.scenario.duration == UNTIL_STOPPED

    def commanded_over_topics(self, duration: float = UNTIL_STOPPED) -> Setup:
        """
        Return the same arm and surfaces, for forces and motions commanded over topics.

        The run then has another `duration` [s]. The reference of the scenario stays in the setup,
        but is not played.
        """
        scenario = self.scenario.model_copy(
            update={'name': COMMANDS, 'description': '', 'duration': duration}
        )
        return replace(self, scenario=scenario, commanded_by_topic=True)

    def reference(self) -> ScenarioTask:
        """Return a new task that plays the scenario's reference, at its start; ConfigError."""
        return ScenarioTask.for_controller(self.scenario.reference, self.controller)

    def commanded(self, time: Vector) -> Matrix:
        """Return the scenario's forces at some times [s], first its preload, shape (m, r) [N]."""
        task = self.reference()
        steps_taken = np.searchsorted(
            task.step_times, time + STAMP_TOLERANCE, side='right'
        )
        commanded: Matrix = task.forces[steps_taken]
        return commanded

    def write(self, folder: Path) -> dict[str, Path]:
        """
        Write the exact configuration into a folder, and return the file of each node.

        The folder alone then repeats the run: it has the URDF and the scenario, too. What only
        nodes know, as far as it was set, is in a file of its own, ``nodes.yaml``.
        """
        folder.mkdir(parents=True, exist_ok=True)
        urdf = Path(self.controller.robot.urdf)
        shutil.copyfile(self.urdf_dir / urdf, folder / urdf.name)
        robot = self.controller.robot.model_copy(update={'urdf': urdf.name})
        configs: dict[str, Config] = {
            'controller': self.controller.model_copy(update={'robot': robot}),
            'noise_estimator': self.noise_estimator,
        }
        if self.simulated:
            configs['plant'] = self.plant
        files = {}
        of_nodes = {}
        for section, config in configs.items():
            node = NODES[section]
            key = f'/**/{node}'
            files[node] = folder / f'{section}.yaml'
            write_parameters(files[node], {key: config.model_dump(mode='json')})
            if self.nodes.get(section):
                of_nodes[key] = self.nodes[section]
        if of_nodes:
            write_parameters(folder / NODES_FILE, of_nodes)
        _write_config(folder / 'reference.yaml', self.scenario.reference)
        _write_config(folder / 'scenario.yaml', self.scenario)
        return files


def _write_config(path: Path, config: Config) -> None:
    replace_text_file(
        path, yaml.safe_dump(config.model_dump(mode='json'), sort_keys=False)
    )


def scenario_with(
    values: Mapping[str, Any],
    overrides: Mapping[str, Any],
    duration: float | None,
    path: Path,
) -> ScenarioConfig:
    """
    Return a scenario with values laid over those of its file.

    `values` are those of the file at `path`, `overrides` the values laid over them, `duration` a
    length [s] laid over both. Raises ConfigError if the length is given twice or out of range.
    """
    if duration is not None:
        if 'duration' in overrides:
            raise ConfigError(
                '--duration', hint='give either this or --set scenario.duration'
            )
        if not SHORTEST <= duration <= UNTIL_STOPPED:
            raise ConfigError(
                'duration', f'{SHORTEST:g} to {UNTIL_STOPPED:g} s', duration
            )
        overrides = {**overrides, 'duration': duration}
    merged = merge(values, overrides)
    if isinstance(merged.get('reference'), Mapping):
        merged['reference'] = with_waypoints_of_file(merged['reference'], path.parent)
    return validate(ScenarioConfig, merged, str(path))


class PlantSource(NamedTuple):
    """A robot, and the way to simulate it: one of the plants in its file, or a file."""

    robot: Robot
    name: str  # the plant alone for the default robot, ROBOT/PLANT for others
    plant: str  # of the robot's plants; empty for a file
    file: Path | None = None  # parameter file, if it is none of them


def plant_source(name: str = '', robot: str = '') -> PlantSource:
    """
    Return what a plant's name stands for; ConfigError if there is no such robot or plant.

    The name is ``PLANT``, ``ROBOT/PLANT``, the path of a parameter file, or empty for the robot's
    default; the robot is a name, a path, or empty for that in the plant's name, or the default.
    """
    if robot:
        chosen = find_robot(robot)
    else:
        chosen = find_robot()
    plant = chosen.plant_name(name)
    if plant:
        title = plant if chosen.name == DEFAULT else f'{chosen.name}/{plant}'
        return PlantSource(chosen, title, plant)
    path = Path(name)
    if path.is_file():
        if not robot:
            chosen = find_robot(read_parameters(path).get('robot', DEFAULT))
        return PlantSource(chosen, name, '', path)
    robot_in_name, slash, plant_in_name = name.rpartition('/')
    if slash and not robot:
        return plant_source(plant_in_name, robot_in_name)
    raise ConfigError(
        'plant', f'one of {", ".join(chosen.file.plants)}, or a path', f"'{name}'"
    )


def preset_values(name: str) -> dict[str, dict[str, Any]]:
    """
    Return what a preset of config/presets, or a file, lays over controller and estimator.

    It has a mapping for each of the two, which is empty if the preset does not change it.
    """
    by_node: dict[str, dict[str, Any]] = {}
    if name:
        file = find_named_file('preset', 'presets', name)
        by_node = read_node_parameters(file, PRESET_NODES)
    return {
        'controller': by_node.get(CONTROLLER, {}),
        'noise_estimator': by_node.get(ESTIMATOR, {}),
    }


def resolve(
    scenario: str,
    *,
    plant: str = '',
    robot: str = '',
    seed: int = 0,
    duration: float | None = None,
    noise_estimator: dict[str, Any] | None = None,
    controller: dict[str, Any] | None = None,
    plant_overrides: dict[str, Any] | None = None,
    scenario_overrides: dict[str, Any] | None = None,
    preset: str = '',
) -> Setup:
    """
    Read and check everything a run needs.

    Values are laid over each other in the order: files of the robot, preset, what the controller
    knows of the plant, scenario, and the overrides.

    Parameters
    ----------
    scenario, preset
        Names in config/scenarios and config/presets, or paths; an empty preset changes nothing.
    plant, robot
        As for `plant_source`.
    seed
        Seed of the plant's noise and roughness, a whole number >= 0.
    duration
        Length of the run instead of the scenario's own [s].
    noise_estimator, controller, plant_overrides
        Nested values laid over all others of the section.
    scenario_overrides
        Nested values laid over the scenario's file.

    Raises
    ------
    ConfigError
        With every value that is not acceptable.

    """
    if not isinstance(seed, int) or seed < 0:
        raise ConfigError('seed', 'a whole number >= 0', seed)
    path = find_named_file('scenario', 'scenarios', scenario)
    source = plant_source(plant, robot)
    config = scenario_with(read_yaml(path), scenario_overrides or {}, duration, path)
    laid_over = preset_values(preset)
    over_preset = merge_layers(config.controller, controller)
    contacts = over_preset.get('contact_names', ())

    def controller_config() -> ControllerConfig:
        of_plant: dict[str, Any] = {}
        if source.plant:
            of_plant = source.robot.controller_special(source.plant)
        values = merge_layers(
            source.robot.controller_base(contacts),
            laid_over['controller'],
            of_plant,
            over_preset,
        )
        return validate(ControllerConfig, values, 'controller.yaml')

    def estimator_config() -> NoiseEstimatorConfig:
        # The estimator has the controller's contacts, and its bounds of R.
        of_controller = merge(laid_over['controller'], over_preset)
        return _estimator_config(
            {
                'contact_names': source.robot.controller_base()['contact_names'],
                'noise_variance': of_controller.get('noise_variance', {}),
            },
            laid_over['noise_estimator'],
            config.noise_estimator,
            noise_estimator,
        )

    def plant_config() -> PlantConfig:
        if source.file is None:
            name = f'plant {source.name}'
            of_plant = source.robot.plant_values(source.plant, contacts)
        else:
            name = source.file.name
            of_plant = {'robot': source.robot.name, **read_parameters(source.file)}
        values = merge_layers(
            {'torque_limit': source.robot.arm.torque_limit},
            of_plant,
            config.plant,
            plant_overrides,
        )
        return validate(PlantConfig, values, name)

    checked = run_all_checks(controller_config, estimator_config, plant_config)
    controller_checked, estimator_checked, plant_checked = checked
    setup = Setup(
        config,
        controller_checked,
        estimator_checked,
        plant_checked,
        plant_name=source.name,
        seed=seed,
        urdf_dir=source.robot.urdf_dir(),
    )
    urdf = setup.urdf_dir / setup.controller.robot.urdf
    if not urdf.is_file():
        raise ConfigError('controller.robot.urdf', 'a URDF file', urdf)
    check_together(setup, path)
    return setup


def _estimator_config(*layers: Mapping[str, Any] | None) -> NoiseEstimatorConfig:
    """Return the noise estimator with layers of values over its own file; ConfigError."""
    name = 'noise_estimator.yaml'
    values = merge_layers(read_parameters(find_config_folder() / name), *layers)
    return validate(NoiseEstimatorConfig, values, name)


def merge_layers(*layers: Mapping[str, Any] | None) -> dict[str, Any]:
    """
    Return nested values, each layer laid over those before; None is an empty layer.

    Mappings are merged key by key; any other value, a list too, replaces the one below.
    """
    merged: dict[str, Any] = {}
    for layer in layers:
        if layer is not None:
            merged = merge(merged, layer)
    return merged


def check_together(setup: Setup, path: Path) -> None:
    """
    Check that estimator, plant and scenario fit the controller; ConfigError.

    Force laws and estimator are to be there; names of contacts, rate and bounds of R are to be the
    same, and the forces of the scenario, of the file at `path`, are to be those that its contacts
    can hold.
    """
    find_noise_estimator(setup.noise_estimator.estimator)
    for name in setup.controller.contact_names:
        find_law(setup.controller.force_law_of(name))
    names = setup.controller.column_names
    contacts = [('noise_estimator.contact_names', setup.noise_estimator.contact_names)]
    if setup.simulated:
        contacts.append(('plant.contact_names', setup.plant.column_names))
    for what, columns in contacts:
        if columns != names:
            raise ConfigError(
                what,
                f"the controller's forces and couples {list(names)}",
                list(columns),
            )
    if setup.noise_estimator.rate != setup.controller.rate:
        raise ConfigError(
            'noise_estimator.rate',
            f"the controller's {setup.controller.rate:g} Hz",
            f'{setup.noise_estimator.rate:g} Hz',
        )
    bounds = setup.noise_estimator.noise_variance
    expected = setup.controller.noise_variance
    if bounds != expected:
        raise ConfigError(
            'noise_estimator.noise_variance',
            f"the controller's {expected.smallest:g} to {expected.largest:g} N^2",
            f'{bounds.smallest:g} to {bounds.largest:g} N^2',
        )
    _check_force_steps(setup, path)
    try:
        setup.reference()
    except ConfigError as error:
        raise error.as_config_error(source=str(path)) from None


def _check_force_steps(setup: Setup, path: Path) -> None:
    """Check that contacts can hold the forces that a scenario asks for; ConfigError."""
    state = setup.controller.contact_state
    reference = setup.scenario.reference
    asked = []
    for index, step in enumerate(reference.force_steps):
        for name, force in step.forces.items():
            asked.append((f'force_steps.{index}.forces.{name}', name, force))
    if isinstance(reference.motion, WaypointsConfig):
        for index, point in enumerate(reference.motion.points):
            if point.force is not None:
                field = f'motion.points.{index}.force'
                asked.append((field, reference.motion.contact, point.force))
    for field, name, force in asked:
        presses = name in setup.controller.contact_names and force != 0.0
        if presses and not state.smallest_force <= force < state.force_ceiling:
            raise ConfigError(
                f'reference.{field}',
                f'0 or {state.smallest_force:g} to {state.force_ceiling:g} N '
                '(contact_state.smallest_force, .force_ceiling)',
                f'{force:g} N',
                str(path),
            )


class ControllerSections(NamedTuple):
    """
    What a user's parameter files say of controller and noise estimator, not yet checked.

    Several files are laid over each other already.
    """

    controller: dict[str, Any]
    node: dict[str, Any]  # of the controller's node, and not of the controller in it
    estimator: dict[str, Any]
    urdf_dir: Path  # that a relative URDF is relative to
    source: str  # names of the files, for errors

    def config(self, overrides: Mapping[str, Any] | None = None) -> ControllerConfig:
        """Return the controller's configuration; ConfigError if it is not acceptable."""
        return validate(
            ControllerConfig, merge(self.controller, overrides or {}), self.source
        )


def read_controller_files(files: Sequence[Path]) -> ControllerSections:
    """
    Read the parameter files of a controller, each laid over those before.

    One may have sections of both nodes, and one for every node (``/**``), below these: each node
    gets what it knows. A relative URDF is looked for beside the file that names it. Raises
    ConfigError if there is none, or one is no parameter file or has a section of another node.
    """
    if not files:
        raise ConfigError(
            '--controller', 'the parameter file of your controller', 'none'
        )
    of_controller = ControllerConfig.model_fields.keys()
    # What both know, the rate and the contacts, the estimator gets from the controller's.
    of_estimator = NoiseEstimatorConfig.model_fields.keys() - of_controller
    given: dict[str, Any] = {}
    estimator: dict[str, Any] = {}
    urdf_dir = Path()
    for path in files:
        sections = read_node_parameters(path, (ANY_NODE, *PRESET_NODES))
        for_estimator, for_controller = _split_values(
            sections.get(ANY_NODE, {}), of_estimator
        )
        section = merge_layers(for_controller, sections.get(CONTROLLER))
        given = merge(given, section)
        estimator = merge_layers(estimator, for_estimator, sections.get(ESTIMATOR))
        robot = section.get('robot')
        if isinstance(robot, Mapping) and 'urdf' in robot:
            urdf_dir = path.resolve().parent
    controller, node = _split_values(given, of_controller)
    return ControllerSections(
        controller, node, estimator, urdf_dir, ', '.join(map(str, files))
    )


def _split_values(
    values: Mapping[str, Any], names: Set[str]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the values that have one of some names, and all others."""
    named: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for name, value in values.items():
        if name in names:
            named[name] = value
        else:
            others[name] = value
    return named, others


def resolve_external(
    files: Sequence[Path],
    *,
    scenario: str | None = None,
    duration: float | None = None,
    preset: str = '',
    noise_estimator: dict[str, Any] | None = None,
    controller: dict[str, Any] | None = None,
    scenario_overrides: dict[str, Any] | None = None,
) -> Setup:
    """
    Read and check everything for a run on the user's own robot; ConfigError.

    `files` are the parameter files of the controller; the noise estimator has its contacts, its
    rate and its bounds of R. Without a `scenario` the controller obeys the command topics;
    `duration` is the length of the run [s], by default that of the scenario. The other arguments
    are as for `resolve`.
    """
    read = read_controller_files(files)
    laid_over = preset_values(preset)
    path = Path(COMMANDS)
    values: dict[str, Any] = {'name': COMMANDS, 'duration': UNTIL_STOPPED}
    if scenario is not None:
        path = find_named_file('scenario', 'scenarios', scenario)
        values = read_yaml(path)
    elif scenario_overrides:
        raise ConfigError(
            f'--set scenario.{min(scenario_overrides)}',
            hint='name the --scenario that it changes; --duration sets the length',
        )
    config = scenario_with(values, scenario_overrides or {}, duration, path)
    controller_config = read.config(
        merge_layers(laid_over['controller'], config.controller, controller)
    )
    estimator_config = _estimator_config(
        {
            'contact_names': list(controller_config.column_names),
            'rate': controller_config.rate,
            'noise_variance': controller_config.noise_variance.model_dump(),
        },
        read.estimator,
        laid_over['noise_estimator'],
        config.noise_estimator,
        noise_estimator,
    )
    for name, instead in REFUSED_OF_EXTERNAL.items():
        if read.node.get(name):
            raise ConfigError(
                name,
                got=read.node[name],
                source=read.source,
                hint=f'{instead} in an external run',
            )
    _, node = _split_values(read.node, {*OF_ANY_NODE, *REFUSED_OF_EXTERNAL})
    setup = Setup(
        scenario=config,
        controller=controller_config,
        noise_estimator=estimator_config,
        plant=NO_PLANT,
        plant_name=EXTERNAL,
        seed=0,
        urdf_dir=read.urdf_dir,
        commanded_by_topic=scenario is None,
        nodes={'controller': node} if node else {},
    )
    check_together(setup, path)
    RobotModel(controller_config.robot, read.urdf_dir)  # now, and not in a node's log
    return setup


def flatten_parameters(values: Mapping[str, Any], start: str = '') -> dict[str, Any]:
    """
    Return nested parameters by their dotted names, which begin with `start`.

    {'force': {'law': 'pi'}} becomes {'force.law': 'pi'}. Lists stay values.
    """
    leaves: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            leaves |= flatten_parameters(value, f'{start}{name}.')
        else:
            leaves[start + name] = value
    return leaves
