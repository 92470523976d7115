"""
The start of the real graph: who is waited for, and what becomes of a node that dies then.

`test_graph.py` has the nodes that die once samples flow.
"""

from __future__ import annotations

import os
import re
import resource
import signal
import threading
import time

from multicontact_control.errors import RunError
from multicontact_control.experiment.graph import watching
from multicontact_control.experiment.graph.processes import NodeProcesses
from multicontact_control.experiment.graph.run import run_graph
from multicontact_control.experiment.graph.spec import (
    CONTROLLER,
    ESTIMATOR,
    GraphSpec,
    RECORDER,
    SIM,
)
from multicontact_control.experiment.scenario import resolve
import pytest
from ros_graph import wait_for

pytestmark = [pytest.mark.ros, pytest.mark.slow]

NODES = (RECORDER, ESTIMATOR, CONTROLLER, SIM)


@pytest.fixture
def spec(tmp_path, monkeypatch):
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)
    setup = resolve('quick', duration=100.0)
    config = tmp_path / 'config'
    setup.write(config)
    return GraphSpec(
        out=tmp_path, ticks=setup.ticks, rate=setup.controller.rate,
        reference_file=config / 'reference.yaml', parameter_files={
            CONTROLLER: config / 'controller.yaml', SIM: config / 'plant.yaml',
            ESTIMATOR: config / 'noise_estimator.yaml'})


class Nodes:
    """The processes of a graph as they are started, and their logs."""

    def __init__(self, monkeypatch, spec):
        self.processes, self._spec = {}, spec
        start = NodeProcesses.start

        def noting(nodes, name, parameters=None):
            start(nodes, name, parameters)
            self.processes[name] = nodes._running[name]

        monkeypatch.setattr(NodeProcesses, 'start', noting)

    def log(self, name):
        path = self._spec.logs / f'{name}.log'
        return path.read_text(encoding='utf-8') if path.exists() else ''

    def kill(self, name, number=signal.SIGKILL):
        os.kill(self.processes[name].pid, number)


@pytest.fixture
def nodes(monkeypatch, spec):
    return Nodes(monkeypatch, spec)


def killed_when(nodes, name, condition):
    """Kill a node as soon as something is so, from a thread beside `run_graph`."""
    def work():
        wait_for(lambda: name in nodes.processes and condition(), f'{name} to be killed')
        nodes.kill(name)

    thread = threading.Thread(target=work)
    thread.start()
    return thread


@pytest.fixture
def halted(nodes):
    """Halt the controller as soon as it is there: that start takes for ever, however fast."""
    def work():
        wait_for(lambda: CONTROLLER in nodes.processes, 'the controller to be started')
        nodes.kill(CONTROLLER, signal.SIGSTOP)

    thread = threading.Thread(target=work)
    thread.start()
    yield nodes
    thread.join()


STAGES = {
    'before it is ready': lambda nodes: True,
    'while the controller is configured': lambda nodes: 'asked to configure' in nodes.log(
        CONTROLLER),
    'between configure and activate': lambda nodes: 'inactive' in nodes.log(CONTROLLER)}


@pytest.mark.parametrize('stage', STAGES)
@pytest.mark.parametrize('name', NODES)
def test_node_that_is_killed_during_the_start_ends_the_run_and_is_named(
        spec, nodes, name, stage):
    thread = killed_when(nodes, name, lambda: STAGES[stage](nodes))
    with pytest.raises(RunError, match=f'^{name} was killed by SIGKILL; the end of .*{name}.log'):
        run_graph(spec)
    thread.join()
    # What is killed on a busy machine takes its time to go.
    wait_for(lambda: all(process.poll() is not None for process in nodes.processes.values()),
             'all to have ended')


def test_first_node_that_ended_is_the_one_named(spec, nodes):
    """Not the first in some list: the controller goes first, the recorder starts first."""
    def work():
        wait_for(lambda: len(nodes.processes) == len(NODES), 'all nodes to be started')
        for name in (CONTROLLER, RECORDER):
            nodes.kill(name)
            nodes.processes[name].wait()

    thread = threading.Thread(target=work)
    thread.start()
    with pytest.raises(RunError, match=f'^{CONTROLLER} was killed by SIGKILL'):
        run_graph(spec)
    thread.join()


def test_long_start_is_told_of_and_costs_the_waiting_parent_nothing(spec, halted, monkeypatch):
    """The parent says whom it waits for, and leaves the processor alone."""
    monkeypatch.setattr(watching, 'TELL_PERIOD', 1.0)
    told, used = [], []

    def tell(text):
        told.append(text)
        used.append((time.monotonic(), sum(resource.getrusage(resource.RUSAGE_SELF)[:2])))
        if len(told) == 5:
            halted.kill(CONTROLLER)

    with pytest.raises(RunError, match=f'^{CONTROLLER} was killed by SIGKILL'):
        run_graph(spec, on_wait=tell)
    assert all(re.match(r'\d+ s: waiting for \w+_node to ', text) for text in told)
    (start, before), (end, after) = used[1], used[-1]
    assert (after - before) / (end - start) < 0.1


def test_start_that_takes_too_long_says_who_is_waited_for(spec, halted, monkeypatch):
    monkeypatch.setattr(watching, 'START_BUDGET', 1.0)
    with pytest.raises(RunError, match=r'not up after 1 s, still waiting for \w+_node to'):
        run_graph(spec)
    # What is killed on a busy machine takes its time to go.
    wait_for(lambda: all(process.poll() is not None for process in halted.processes.values()),
             'all to have ended')
