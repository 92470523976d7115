"""What a graph is made of: which nodes, with which parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import json
from pathlib import Path
from typing import Any

from multicontact_control.nodes.topics import CONTROLLER, ESTIMATOR, RECORDER, SIM
from multicontact_control.runs.graph.robot import ExpectedRobot

START_ORDER = (RECORDER, ESTIMATOR, CONTROLLER, SIM)
MANAGED = (ESTIMATOR, CONTROLLER)  # in the order in which they are activated
FIFO_PRIORITY = 80  # below the kernel's own threads


@dataclass(frozen=True)
class GraphSpec:
    """
    What to run; with a `robot` there is no simulator, and `ticks`, `seed`, `speed` are void.

    Everything that decides on the processes is here, so that a test, a command and the page start
    the same graph. Files and folder exist before it starts.
    """

    out: Path  # folder of the run, which exists
    parameter_files: Mapping[str, Path]  # by node; one without a file has its defaults
    ticks: int  # samples until the run ends, 0 for a signal to end it
    rate: float  # control rate [Hz]
    free_running: bool = False  # the plant does not wait for commands, as a robot
    speed: float = 1.0  # simulated time per wall time at most; 0 for as fast as it goes
    seed: int = 0  # of the plant
    reference_file: Path | None = None  # scenario; None to obey the command topics
    domain_id: int | None = None  # by default the first one without participants
    namespace: str = ''  # of all nodes, topics and services, without a leading slash
    # More parameters by node name, over those of its file; other names of topics, likewise.
    extra_parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    remappings: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    realtime: bool = False  # the nodes that control ask for priority, and keep memory
    robot: ExpectedRobot | None = None
    recorded: bool = True  # whether a recorder is among the nodes

    @property
    def nodes(self) -> tuple[str, ...]:
        """
        Names of all nodes of the graph, in the order in which they are started.

        The recorder is first, so that no message is missed, and the simulator last, since it
        begins to send samples.
        """
        absent = set()
        if not self.recorded:
            absent.add(RECORDER)
        if self.robot is not None:
            absent.add(SIM)
        return tuple(name for name in START_ORDER if name not in absent)

    @property
    def bag(self) -> Path:
        """Folder of the recording, which the recorder makes; it must not exist before."""
        return self.out / 'bag'

    @property
    def logs(self) -> Path:
        """
        Folder of the nodes' logs and counts.

        For each node ``NAME.log`` is what it printed, and ``NAME.json`` what it counted by its
        end.
        """
        return self.out / 'logs'


def node_arguments(
    name: str,
    spec: GraphSpec,
    overrides: Mapping[str, Any] | None = None,
) -> list[str]:
    """
    Return the command line of a node: namespace, parameter file, remappings and parameters.

    `overrides` are parameters laid over those of the graph, as for a node that is started anew.
    """
    parameters = node_parameters(name, spec)
    if overrides is not None:
        parameters |= overrides
    # The output is in the log of the run already.
    arguments = ['--ros-args', '--disable-external-lib-logs']
    if spec.namespace:
        arguments += ['-r', f'__ns:=/{spec.namespace}']
    if name in spec.parameter_files:
        arguments += ['--params-file', str(spec.parameter_files[name].resolve())]
    for topic, other in spec.remappings.get(name, {}).items():
        arguments += ['-r', f'{topic}:={other}']
    for key, value in parameters.items():
        arguments += ['-p', f'{key}:={json.dumps(value)}']  # JSON keeps 500.0 a double
    return arguments


def node_parameters(name: str, spec: GraphSpec) -> dict[str, Any]:
    """
    Return the parameters of a node that belong to the run, and to no file.

    Where it writes its counts, whom it waits for, how time passes, what it plays or records;
    `extra_parameters` of the graph come last.
    """
    values: dict[str, Any] = {
        'timing_file': str((spec.logs / f'{name}.json').resolve()),
        'startup_peers': list(spec.nodes),
    }
    if name == RECORDER:
        values['folder'] = str(spec.bag.resolve())
        of_controller = spec.extra_parameters.get(CONTROLLER, {})
        efforts = of_controller.get('effort_output_topic')
        if efforts:
            values['effort_output_topic'] = efforts
    if name == SIM:
        values |= {
            'ticks': spec.ticks,
            'rate': float(spec.rate),
            'seed': spec.seed,
            'speed': float(spec.speed),
        }
    if name == CONTROLLER and spec.reference_file is not None:
        values['reference_file'] = str(spec.reference_file.resolve())
    if name in (SIM, CONTROLLER):
        values['lockstep'] = not spec.free_running and spec.robot is None
    if spec.realtime and name != RECORDER:
        values |= {'fifo_priority': FIFO_PRIORITY, 'lock_memory': True}
    return {**values, **spec.extra_parameters.get(name, {})}
