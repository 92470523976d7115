"""What a graph of processes is made of: which nodes, with which parameters, how started."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import sys
from typing import Any

from multicontact_control.nodes.runtime import FOLLOW_PARENT
from multicontact_control.nodes.topics import CONTROLLER, ESTIMATOR, RECORDER, SIM
from multicontact_control.process import THREAD_VARIABLES

START_ORDER = (RECORDER, ESTIMATOR, CONTROLLER, SIM)
MANAGED = (ESTIMATOR, CONTROLLER)  # in the order in which they are activated
MODULES = {
    RECORDER: 'multicontact_control.nodes.recorder_node',
    ESTIMATOR: 'multicontact_control.nodes.noise_estimator_node',
    CONTROLLER: 'multicontact_control.nodes.controller_node',
    SIM: 'sim_bridge.sim_node'}
BARE_EFFORTS = 'std_msgs/msg/Float64MultiArray'


@dataclass(frozen=True)
class GraphSpec:
    """
    What to run.

    Attributes
    ----------
    out
        Folder of the run; must exist.
    parameter_files
        Parameter file per node name; a node without one gets its defaults.
    ticks
        Samples until the run ends, 0 for a signal to end it.
    rate
        Control rate [Hz].
    lockstep
        Whether the nodes wait for each other instead of the wall clock.
    seed
        Seed of the plant.
    reference_file
        Scenario for the controller; none lets it obey the command topics.
    domain_id
        ROS domain; by default that of the environment, else one that is free.
    namespace
        Namespace of all nodes, topics and services, without a leading slash; empty for none.
    extra_parameters
        More parameters per node name, over those of its file.
    remappings
        Other names of topics per node name.
    extra_nodes
        More nodes by name: the module that each is.

    """

    out: Path
    parameter_files: Mapping[str, Path]
    ticks: int
    rate: float
    lockstep: bool = False
    seed: int = 0
    reference_file: Path | None = None
    domain_id: int | None = None
    namespace: str = ''
    extra_parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    remappings: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    extra_nodes: Mapping[str, str] = field(default_factory=dict)

    @property
    def node_names(self) -> tuple[str, ...]:
        """Names of all nodes, in the order in which they are started."""
        return (*START_ORDER[:-1], *self.extra_nodes, SIM)

    @property
    def bag(self) -> Path:
        """Folder of the recording."""
        return self.out / 'bag'

    @property
    def logs(self) -> Path:
        """Folder of the nodes' logs and counts."""
        return self.out / 'logs'


def timing_file(spec: GraphSpec, name: str) -> Path:
    """Return where a node writes its counts and times."""
    return spec.logs / f'{name}.json'


def node_command(
    name: str, spec: GraphSpec, overrides: Mapping[str, Any] | None = None,
) -> list[str]:
    """
    Return the command line of a node: its installed script, or its module.

    `overrides` are parameters over those of the graph.
    """
    script = Path(sys.executable).parent / name
    command = [str(script)] if os.access(script, os.X_OK) else (
        [sys.executable, '-m', {**MODULES, **spec.extra_nodes}[name]])
    command.append('--ros-args')
    if spec.namespace:
        command += ['-r', f'__ns:=/{spec.namespace}']
    for topic, other in spec.remappings.get(name, {}).items():
        command += ['-r', f'{topic}:={other}']
    parameter_file = spec.parameter_files.get(name)
    if parameter_file is not None:
        command += ['--params-file', str(parameter_file.resolve())]
    for key, value in {**node_parameters(name, spec), **(overrides or {})}.items():
        command += ['-p', f'{key}:={_as_argument(value)}']
    return command


def node_parameters(name: str, spec: GraphSpec) -> dict[str, Any]:
    """Return the parameters that belong to the run, not to a file."""
    values: dict[str, Any] = {
        'timing_file': str(timing_file(spec, name).resolve()), 'startup_peers': list(START_ORDER)}
    if name == RECORDER:
        values['folder'] = str(spec.bag.resolve())
        bare = spec.extra_parameters.get(CONTROLLER, {}).get('effort_output_topic')
        if bare:
            values['extra_topics'] = [f'{bare} {BARE_EFFORTS}']
    if name == SIM:
        values |= {'ticks': spec.ticks, 'rate': float(spec.rate), 'seed': spec.seed}
    if name == CONTROLLER and spec.reference_file is not None:
        values['reference_file'] = str(spec.reference_file.resolve())
    if name in (SIM, CONTROLLER):
        values['lockstep'] = spec.lockstep
    if name in MANAGED:
        values['use_sim_time'] = spec.lockstep
    return {**values, **spec.extra_parameters.get(name, {})}


def _as_argument(value: Any) -> str:
    """Return a value as YAML on one line; JSON is that, and keeps 500.0 a double."""
    return json.dumps(value)


def node_environment(spec: GraphSpec, domain_id: int) -> dict[str, str]:
    """Return the environment of the nodes."""
    environment = dict(os.environ)
    for variable in THREAD_VARIABLES:
        environment.setdefault(variable, '1')
    environment['ROS_DOMAIN_ID'] = str(domain_id)
    environment['ROS_LOG_DIR'] = str((spec.logs / 'ros').resolve())
    environment['PYTHONUNBUFFERED'] = '1'
    environment[FOLLOW_PARENT] = str(os.getpid())
    root = Path(__file__).resolve().parents[2]
    if (root / 'package.xml').is_file():
        # A checkout that is run without being installed.
        paths = [str(root), *filter(None, environment.get('PYTHONPATH', '').split(os.pathsep))]
        environment['PYTHONPATH'] = os.pathsep.join(paths)
    return environment
