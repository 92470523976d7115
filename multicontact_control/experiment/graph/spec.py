"""What a graph of processes is made of: which nodes, with which parameters, how started."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import sys
from typing import Any

from multicontact_control.experiment.graph.fork_server import base_environment
from multicontact_control.nodes.topics import CONTROLLER, ESTIMATOR, RECORDER, SIM
from multicontact_control.process import FOLLOW_PARENT

START_ORDER = (RECORDER, ESTIMATOR, CONTROLLER, SIM)
MANAGED = (ESTIMATOR, CONTROLLER)  # in the order in which they are activated
MODULES = {
    RECORDER: 'multicontact_control.nodes.recorder_node',
    ESTIMATOR: 'multicontact_control.nodes.noise_estimator_node',
    CONTROLLER: 'multicontact_control.nodes.controller_node',
    SIM: 'sim_bridge.sim_node',
    'composed_node': 'multicontact_control.nodes.composed_node',
    'composed_sim_node': 'sim_bridge.composed_sim_node'}
# Nodes that may share a process: the name of that, and which they are.
COMPOSED = {
    'none': ('', ()),
    'control': ('composed_node', (ESTIMATOR, CONTROLLER)),
    'all': ('composed_sim_node', (ESTIMATOR, CONTROLLER, SIM))}
FIFO_PRIORITY = 80  # below the kernel's own threads
ROS_ARGUMENTS = '--ros-args'
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
    composed
        Which nodes share a process, see `COMPOSED`.
    external
        Whether the robot, or its simulator, is somebody else's: there is no plant among the nodes,
        and `ticks`, `seed` and `lockstep` have no meaning.
    realtime
        Whether the nodes that control ask for a real-time priority and keep their memory.

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
    composed: str = 'none'
    realtime: bool = False
    external: bool = False

    @property
    def processes(self) -> dict[str, tuple[str, ...]]:
        """Names of the nodes of each process, in the order in which they are started."""
        shared, members = COMPOSED[self.composed]
        alone: dict[str, tuple[str, ...]] = {
            name: (name,) for name in self.node_names if name not in members}
        return {**alone, shared: members} if members else alone

    def process_of(self, name: str) -> str:
        """Return the name of the process that a node is in."""
        shared, members = COMPOSED[self.composed]
        return shared if name in members else name

    @property
    def node_names(self) -> tuple[str, ...]:
        """Names of all nodes, in the order in which they are started."""
        return (*START_ORDER[:-1], *self.extra_nodes, *(() if self.external else (SIM,)))

    @property
    def peers(self) -> tuple[str, ...]:
        """Names of the nodes that wait for each other at the start."""
        return START_ORDER[:-1] if self.external else START_ORDER

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


def node_module(process: str, spec: GraphSpec) -> str:
    """Return the module whose `main` a process is."""
    return {**MODULES, **spec.extra_nodes}[process]


def node_command(
    process: str, spec: GraphSpec, overrides: Mapping[str, Any] | None = None,
) -> list[str]:
    """
    Return the command line of a process: its installed script, or its module.

    `overrides` are parameters over those of the graph. What is for several nodes is written to a
    file among the logs.
    """
    script = Path(sys.executable).parent / process
    command = [str(script)] if os.access(script, os.X_OK) else (
        [sys.executable, '-m', node_module(process, spec)])
    command.append(ROS_ARGUMENTS)
    if spec.namespace:
        command += ['-r', f'__ns:=/{spec.namespace}']
    names = spec.processes[process]
    files = [spec.parameter_files[name] for name in names if name in spec.parameter_files]
    parameters = {name: {**node_parameters(name, spec), **(overrides or {})} for name in names}
    if len(names) > 1:
        files.append(_shared_parameters(spec.logs / f'{process}.yaml', parameters))
        parameters = {}
    for path in files:
        command += ['--params-file', str(path.resolve())]
    for name in names:
        # Of several nodes, remappings are for one by its name.
        whose = f'{name}:' if len(names) > 1 else ''
        for topic, other in spec.remappings.get(name, {}).items():
            command += ['-r', f'{whose}{topic}:={other}']
    for values in parameters.values():
        for key, value in values.items():
            command += ['-p', f'{key}:={_as_argument(value)}']
    return command


def _shared_parameters(path: Path, parameters: Mapping[str, Mapping[str, Any]]) -> Path:
    """Write the parameters of the nodes of one process, which a command line cannot tell apart."""
    path.write_text(json.dumps({
        f'/**/{name}': {'ros__parameters': values} for name, values in parameters.items()},
        indent=1), encoding='utf-8')
    return path


def node_parameters(name: str, spec: GraphSpec) -> dict[str, Any]:
    """Return the parameters that belong to the run, not to a file."""
    values: dict[str, Any] = {
        'timing_file': str(timing_file(spec, name).resolve()), 'startup_peers': list(spec.peers)}
    if name == RECORDER:
        values['folder'] = str(spec.bag.resolve())
        bare = spec.extra_parameters.get(CONTROLLER, {}).get('effort_output_topic')
        if bare:
            values['extra_topics'] = [f'{bare} {BARE_EFFORTS}']
    if name == SIM:
        values |= {'ticks': spec.ticks, 'rate': float(spec.rate), 'seed': spec.seed}
    if name == CONTROLLER and spec.reference_file is not None:
        values['reference_file'] = str(spec.reference_file.resolve())
    if name == CONTROLLER and name in spec.parameter_files:
        values['base_dir'] = str(spec.parameter_files[name].resolve().parent)
    if name in (SIM, CONTROLLER):
        values['lockstep'] = spec.lockstep
    if spec.realtime and name != RECORDER:
        values |= {'fifo_priority': FIFO_PRIORITY, 'lock_memory': True}
        if spec.composed == 'all':
            values['cpus'] = [max(os.sched_getaffinity(0))]  # the last: interrupts like the first
    return {**values, **spec.extra_parameters.get(name, {})}


def _as_argument(value: Any) -> str:
    """Return a value as YAML on one line; JSON is that, and keeps 500.0 a double."""
    return json.dumps(value)


def node_environment(spec: GraphSpec, domain_id: int) -> dict[str, str]:
    """Return the environment of the nodes."""
    environment = base_environment()
    environment['ROS_DOMAIN_ID'] = str(domain_id)
    environment['ROS_LOG_DIR'] = str((spec.logs / 'ros').resolve())
    environment[FOLLOW_PARENT] = str(os.getpid())
    return environment
