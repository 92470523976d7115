"""What a graph of processes is made of: which nodes, with which parameters, how started."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import sys
from typing import Any

from multicontact_control.nodes.topics import CONTROLLER, ESTIMATOR, RECORDER, SIM

START_ORDER = (RECORDER, ESTIMATOR, CONTROLLER, SIM)
MANAGED = (ESTIMATOR, CONTROLLER)  # in the order in which they are activated
MODULES = {
    RECORDER: 'multicontact_control.nodes.recorder_node',
    ESTIMATOR: 'multicontact_control.nodes.noise_estimator_node',
    CONTROLLER: 'multicontact_control.nodes.controller_node',
    SIM: 'sim_bridge.sim_node'}
FIFO_PRIORITY = 80  # below the kernel's own threads
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
    free_running
        Whether the plant goes on without the command that answers its last sample, as a robot.
    speed
        Simulated time per wall time at most; 0 for as fast as it goes.
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
    external
        Whether the robot, or its simulator, is somebody else's: there is no plant among the nodes,
        and `ticks`, `seed` and `speed` have no meaning.
    realtime
        Whether the nodes that control ask for a real-time priority and keep their memory.

    """

    out: Path
    parameter_files: Mapping[str, Path]
    ticks: int
    rate: float
    free_running: bool = False
    speed: float = 1.0
    seed: int = 0
    reference_file: Path | None = None
    domain_id: int | None = None
    namespace: str = ''
    extra_parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    remappings: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    realtime: bool = False
    external: bool = False

    @property
    def node_names(self) -> tuple[str, ...]:
        """Names of all nodes, in the order in which they are started."""
        return (*START_ORDER[:-1], *(() if self.external else (SIM,)))

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


def node_command(
    name: str, spec: GraphSpec, overrides: Mapping[str, Any] | None = None,
) -> list[str]:
    """
    Return the command line of a node: its installed script, or its module.

    `overrides` are parameters over those of the graph.
    """
    script = Path(sys.executable).parent / name
    command = [str(script)] if os.access(script, os.X_OK) else (
        [sys.executable, '-m', MODULES[name]])
    command.append('--ros-args')
    if spec.namespace:
        command += ['-r', f'__ns:=/{spec.namespace}']
    if name in spec.parameter_files:
        command += ['--params-file', str(spec.parameter_files[name].resolve())]
    for topic, other in spec.remappings.get(name, {}).items():
        command += ['-r', f'{topic}:={other}']
    for key, value in {**node_parameters(name, spec), **(overrides or {})}.items():
        command += ['-p', f'{key}:={json.dumps(value)}']  # JSON keeps 500.0 a double
    return command


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
        values |= {'ticks': spec.ticks, 'rate': float(spec.rate), 'seed': spec.seed,
                   'speed': float(spec.speed)}
    if name == CONTROLLER and spec.reference_file is not None:
        values['reference_file'] = str(spec.reference_file.resolve())
    if name == CONTROLLER and name in spec.parameter_files:
        values['base_dir'] = str(spec.parameter_files[name].resolve().parent)
    if name in (SIM, CONTROLLER):
        values['lockstep'] = not (spec.free_running or spec.external)
    if spec.realtime and name != RECORDER:
        values |= {'fifo_priority': FIFO_PRIORITY, 'lock_memory': True}
    return {**values, **spec.extra_parameters.get(name, {})}


def node_environment(spec: GraphSpec, domain_id: int) -> dict[str, str]:
    """Return the environment of the nodes."""
    return {**os.environ, 'ROS_DOMAIN_ID': str(domain_id),
            'ROS_LOG_DIR': str((spec.logs / 'ros').resolve())}
