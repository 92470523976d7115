"""Scenarios and a user's own parameter files, and what they resolve to before a run starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
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
from multicontact_control.control.tasks import ReferenceConfig, ScenarioTask
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError, run_all_checks
from multicontact_control.files import replace_text_file
from multicontact_control.paths import find_config_folder, find_named_file
from multicontact_control.runs.parameter_file import write_parameters
import numpy as np
from sim_bridge.config import PlantConfig
from sim_bridge.robots import DEFAULT, find_robot, Robot
import yaml

EXTERNAL = 'external'  # in the place of a plant's name
CONTROLLER, ESTIMATOR = PRESET_NODES = ('controller_node', 'noise_estimator_node')
COMMANDS = 'commands'  # in the place of a scenario's name
NO_PLANT: Any = None  # in the place of the plant where the robot is the user's own
SHORTEST, UNTIL_STOPPED = 1.0, 1e6  # s, of a run, and of one that Ctrl-C ends
OF_THE_RUN = ('startup_peers', 'timing_file')
NODES_FILE = 'nodes.yaml'  # of what only nodes know


class ScenarioConfig(Config):
    """One experiment: what is commanded when, and what differs from the defaults."""

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
    """Everything a run needs, resolved and checked."""

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
        return dotted(self.nodes.get(section, {}))

    @property
    def simulated(self) -> bool:
        """Whether the plant is one of this package."""
        return self.plant is not NO_PLANT

    @property
    def ticks(self) -> int:
        """Return the number of samples of the run."""
        return round(self.scenario.duration * self.controller.rate)

    def commanded_over_topics(self) -> Setup:
        """Return the same arm and surfaces, for commands instead of the scenario's."""
        scenario = self.scenario.model_copy(
            update={'name': COMMANDS, 'description': ''}
        )
        return replace(self, scenario=scenario, commanded_by_topic=True)

    def reference(self) -> ScenarioTask:
        """Return the scenario's reference, at its start."""
        return ScenarioTask.for_controller(self.scenario.reference, self.controller)

    def commanded(self, time: Vector) -> Matrix:
        """Return the scenario's forces at some times [s], first its preload, shape (m, r) [N]."""
        steps = [step.time for step in self.scenario.reference.force_steps]
        commanded: Matrix = self.reference().forces[
            np.searchsorted(steps, time + 1e-9, side='right')
        ]
        return commanded

    def write(self, folder: Path) -> dict[str, Path]:
        """
        Write the exact configuration into a folder, and return the file of each node.

        What only nodes know, as far as it was set, is in a file of its own.
        """
        folder.mkdir(parents=True, exist_ok=True)
        urdf = Path(self.controller.robot.urdf)
        shutil.copyfile(self.urdf_dir / urdf, folder / urdf.name)
        robot = self.controller.robot.model_copy(update={'urdf': urdf.name})
        nodes: dict[str, tuple[str, Config]] = {
            'controller_node': (
                'controller.yaml',
                self.controller.model_copy(update={'robot': robot}),
            ),
            'noise_estimator_node': ('noise_estimator.yaml', self.noise_estimator),
        }
        if self.simulated:
            nodes['sim_node'] = ('plant.yaml', self.plant)
        for node, (name, config) in nodes.items():
            write_parameters(
                folder / name, {f'/**/{node}': config.model_dump(mode='json')}
            )
        of_nodes = {
            f'/**/{node}': self.nodes[Path(name).stem]
            for node, (name, _) in nodes.items()
            if self.nodes.get(Path(name).stem)
        }
        if of_nodes:
            write_parameters(folder / NODES_FILE, of_nodes)
        for name, config in (
            ('reference.yaml', self.scenario.reference),
            ('scenario.yaml', self.scenario),
        ):
            replace_text_file(
                folder / name,
                yaml.safe_dump(config.model_dump(mode='json'), sort_keys=False),
            )
        return {node: folder / name for node, (name, _) in nodes.items()}


def scenario_with(
    values: Mapping[str, Any],
    overrides: Mapping[str, Any],
    duration: float | None,
    path: Path,
) -> ScenarioConfig:
    """Return the scenario of a file with values, and a length [s], laid over those in it."""
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
    return validate(ScenarioConfig, merge(values, overrides), str(path))


class PlantSource(NamedTuple):
    """A robot, and the way to simulate it."""

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
    chosen = find_robot(robot or DEFAULT)
    if plant := chosen.plant_name(name):
        title = plant if chosen.name == DEFAULT else f'{chosen.name}/{plant}'
        return PlantSource(chosen, title, plant)
    if Path(name).is_file():
        named = read_parameters(Path(name)).get('robot', '')
        return PlantSource(find_robot(robot or named or DEFAULT), name, '', Path(name))
    first, slash, last = name.rpartition('/')
    if slash and not robot:
        return plant_source(last, first)
    raise ConfigError(
        'plant', f'one of {", ".join(chosen.file.plants)}, or a path', f"'{name}'"
    )


def preset_values(name: str) -> dict[str, dict[str, Any]]:
    """Return what a preset of config/presets, or a file, lays over controller and estimator."""
    by_node = (
        read_node_parameters(find_named_file('preset', 'presets', name), PRESET_NODES)
        if name
        else {}
    )
    return {node.removesuffix('_node'): by_node.get(node, {}) for node in PRESET_NODES}


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

    `scenario` and `preset`, of controller and estimator, are names or paths, `plant` and `robot`
    are as for `plant_source`, `seed` is that of the plant's noise and roughness, `duration` the
    length instead of the scenario's [s]. `scenario_overrides` are laid over the scenario's file,
    the others over all values. Raises ConfigError with every value that is not acceptable.
    """
    if not isinstance(seed, int) or seed < 0:
        raise ConfigError('seed', 'a whole number >= 0', seed)
    path, source = (
        find_named_file('scenario', 'scenarios', scenario),
        plant_source(plant, robot),
    )
    config = scenario_with(read_yaml(path), scenario_overrides or {}, duration, path)
    laid_over = preset_values(preset)
    contacts = merge(config.controller, controller or {}).get('contact_names', ())
    # The estimator has the controller's bounds of R, as it has its contacts.
    bounds = merged(laid_over['controller'], config.controller, controller).get(
        'noise_variance', {}
    )
    special = source.robot.controller_special(source.plant) if source.plant else {}
    controller_config, estimator_config, plant_config = run_all_checks(
        lambda: validate(
            ControllerConfig,
            merged(
                source.robot.controller_base(contacts),
                laid_over['controller'],
                special,
                config.controller,
                controller,
            ),
            'controller.yaml',
        ),
        lambda: validate(
            NoiseEstimatorConfig,
            merged(
                read_parameters(find_config_folder() / 'noise_estimator.yaml'),
                {
                    'contact_names': source.robot.controller_base()['contact_names'],
                    'noise_variance': bounds,
                },
                laid_over['noise_estimator'],
                config.noise_estimator,
                noise_estimator,
            ),
            'noise_estimator.yaml',
        ),
        lambda: validate(
            PlantConfig,
            merged(
                {'torque_limit': source.robot.arm.torque_limit},
                source.robot.plant_values(source.plant, contacts)
                if source.file is None
                else {'robot': source.robot.name, **read_parameters(source.file)},
                config.plant,
                plant_overrides,
            ),
            f'plant {source.name}' if source.file is None else source.file.name,
        ),
    )
    setup = Setup(
        scenario=config,
        controller=controller_config,
        noise_estimator=estimator_config,
        plant=plant_config,
        plant_name=source.name,
        seed=seed,
        urdf_dir=source.robot.urdf_dir(),
    )
    urdf = setup.urdf_dir / setup.controller.robot.urdf
    if not urdf.is_file():
        raise ConfigError('controller.robot.urdf', 'a URDF file', urdf)
    check_together(setup, path)
    return setup


def merged(*layers: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return nested values, each layer laid over those before."""
    return reduce(merge, (layer or {} for layer in layers), {})


def check_together(setup: Setup, path: Path) -> None:
    """Check that estimator, plant and scenario, of a file, fit the controller; ConfigError."""
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
    bounds, expected = (
        setup.noise_estimator.noise_variance,
        setup.controller.noise_variance,
    )
    if bounds != expected:
        raise ConfigError(
            'noise_estimator.noise_variance',
            f"the controller's {expected.smallest:g} to {expected.largest:g} N^2",
            f'{bounds.smallest:g} to {bounds.largest:g} N^2',
        )
    state = setup.controller.contact_state
    for index, step in enumerate(setup.scenario.reference.force_steps):
        for name, force in step.forces.items():
            if (
                name in setup.controller.contact_names
                and force != 0.0
                and not (state.smallest_force <= force < state.force_ceiling)
            ):
                raise ConfigError(
                    f'reference.force_steps.{index}.forces.{name}',
                    f'0 or {state.smallest_force:g} to {state.force_ceiling:g} N '
                    '(contact_state.smallest_force, .force_ceiling)',
                    f'{force:g} N',
                    str(path),
                )
    try:
        setup.reference()
    except ConfigError as error:
        raise error.as_config_error(source=str(path)) from None


class ControllerFiles(NamedTuple):
    """What a user's parameter files say of controller and noise estimator."""

    controller: dict[str, Any]
    node: dict[str, Any]  # of the controller's node, and not of the controller in it
    estimator: dict[str, Any]
    urdf_dir: Path  # that a relative URDF is relative to
    source: str

    def config(self, overrides: Mapping[str, Any] | None = None) -> ControllerConfig:
        """Return the controller's configuration; ConfigError if it is not acceptable."""
        return validate(
            ControllerConfig, merge(self.controller, overrides or {}), self.source
        )


def read_controller_files(files: Sequence[Path]) -> ControllerFiles:
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
    own = ControllerConfig.model_fields.keys()
    of_estimator = NoiseEstimatorConfig.model_fields.keys() - own
    given: dict[str, Any] = {}
    estimator: dict[str, Any] = {}
    urdf_dir = Path()
    for path in files:
        sections = read_node_parameters(path, (ANY_NODE, *PRESET_NODES))
        # What both know, the rate and the contacts, the estimator gets from the controller's.
        shared = sections.get(ANY_NODE, {})
        section = merged(
            {name: value for name, value in shared.items() if name not in of_estimator},
            sections.get(CONTROLLER),
        )
        given = merge(given, section)
        estimator = merged(
            estimator,
            {name: value for name, value in shared.items() if name in of_estimator},
            sections.get(ESTIMATOR),
        )
        robot = section.get('robot')
        if isinstance(robot, Mapping) and 'urdf' in robot:
            urdf_dir = path.resolve().parent
    return ControllerFiles(
        {name: value for name, value in given.items() if name in own},
        {name: value for name, value in given.items() if name not in own},
        estimator,
        urdf_dir,
        ', '.join(map(str, files)),
    )


class External(NamedTuple):
    """Everything a run needs on the user's own robot."""

    setup: Setup
    node: dict[str, Any]  # parameters of the controller's node
    duration: float | None  # s; None until it is stopped


def resolve_external(
    files: Sequence[Path],
    *,
    scenario: str | None = None,
    duration: float | None = None,
    preset: str = '',
    noise_estimator: dict[str, Any] | None = None,
    controller: dict[str, Any] | None = None,
    scenario_overrides: dict[str, Any] | None = None,
) -> External:
    """
    Read and check everything for a run on the user's own robot; ConfigError.

    Parameter `files` are those of the controller; the noise estimator has its contacts, its rate
    and its bounds of R.
    Without a `scenario` it obeys the command topics; `duration` is the length of the run [s], by
    default that of the scenario. The other arguments are as for `resolve`.
    """
    read, laid_over = read_controller_files(files), preset_values(preset)
    path, values = Path(COMMANDS), {'name': COMMANDS, 'duration': UNTIL_STOPPED}
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
        merged(laid_over['controller'], config.controller, controller)
    )
    estimator_config = validate(
        NoiseEstimatorConfig,
        merged(
            read_parameters(find_config_folder() / 'noise_estimator.yaml'),
            {
                'contact_names': list(controller_config.column_names),
                'rate': controller_config.rate,
                'noise_variance': controller_config.noise_variance.model_dump(),
            },
            read.estimator,
            laid_over['noise_estimator'],
            config.noise_estimator,
            noise_estimator,
        ),
        'noise_estimator.yaml',
    )
    setup = Setup(
        scenario=config,
        controller=controller_config,
        noise_estimator=estimator_config,
        plant=NO_PLANT,
        plant_name=EXTERNAL,
        seed=0,
        urdf_dir=read.urdf_dir,
        commanded_by_topic=scenario is None,
    )
    check_together(setup, path)
    RobotModel(controller_config.robot, read.urdf_dir)  # now, and not in a node's log
    for name, instead in (
        ('reference_file', 'give --scenario'),
        ('lockstep', 'set it to false'),
    ):
        if read.node.get(name):
            raise ConfigError(
                name,
                got=read.node[name],
                source=read.source,
                hint=f'{instead} in an external run',
            )
    node = {
        name: value
        for name, value in read.node.items()
        if name not in (*OF_THE_RUN, 'reference_file', 'lockstep')
    }
    return External(setup, node, duration if scenario is None else config.duration)


def dotted(values: Mapping[str, Any], start: str = '') -> dict[str, Any]:
    """Return nested parameters by their dotted names."""
    leaves: dict[str, Any] = {}
    for name, value in values.items():
        leaves |= (
            dotted(value, f'{start}{name}.')
            if isinstance(value, Mapping)
            else {start + name: value}
        )
    return leaves
