"""A soak over a real graph, and what it says of one that does not come back."""

from collections import deque
from dataclasses import replace
from pathlib import Path
import re

from multicontact_control.errors import RunError
from multicontact_control.experiment.faults import graph_soak, graph_watch
from multicontact_control.experiment.faults.graph_soak import GraphSoak
from multicontact_control.experiment.scenario import resolve
from multicontact_control.nodes import topics
import numpy as np
import pytest

pytestmark = [pytest.mark.ros, pytest.mark.slow]


@pytest.fixture
def soak(tmp_path, monkeypatch):
    # Not the folder for all that is temporary: domains are reserved by files in it.
    (tmp_path / 'soak').mkdir()
    monkeypatch.setattr(graph_soak, 'mkdtemp', lambda **_: str(tmp_path / 'soak'))
    return GraphSoak(resolve('quick', plant='rigid', seed=0), 2)


def test_graph_goes_on_through_forces_and_faults(soak, tmp_path, monkeypatch):
    monkeypatch.setattr(graph_soak, 'MINUTE', 4.0)
    monkeypatch.setattr(graph_soak, 'REST_CHANCE', 1.0)
    outcome = soak.run(15.0)
    assert (outcome.unsafe, outcome.oscillating, outcome.stuck) == ([], [], [])
    assert outcome.simulated_s >= 15.0
    assert sum(outcome.episodes.values()) >= 2
    assert outcome.minutes and outcome.minutes[0].memory_mb > 200.0  # of some five processes
    errors = [minute.error_n for minute in outcome.minutes if minute.error_n is not None]
    assert np.nanmin(errors) < 3.0
    if not outcome.counts:
        assert not (tmp_path / 'soak').exists()  # bags and logs of what went well


def test_graph_that_does_not_come_back_is_stuck_and_its_logs_are_kept(soak, monkeypatch):
    def lost(*_):
        raise RunError('commands: not within 90 s')
    monkeypatch.setattr(graph_soak, 'FAULT_CHANCE', 1.0)
    monkeypatch.setattr(graph_soak, 'break_once', lost)
    outcome = soak.run(5.0)
    assert outcome.counts['stuck'] == len(outcome.stuck) >= 1
    assert 'commands: not within 90 s' in outcome.stuck[0]
    folder = Path(re.search(r'see (.*)\)', outcome.stuck[0])[1])
    assert list(folder.glob('*/logs/controller_node.log'))


class Shaken(deque):
    """Forces as of a limit cycle, in the time of the samples."""

    number = 0

    def append(self, message):
        self.number += 1
        wave = np.sin(200.0 * 0.002 * self.number)
        super().append(replace(message, values={
            name: force + wave for name, force in message.values.items()}))


@pytest.mark.parametrize('broken', ['limits', 'forces'])
def test_what_is_wrong_without_a_fault_is_reported(soak, monkeypatch, broken):
    class Session(graph_soak.FaultSession):
        def __enter__(self):
            entered = super().__enter__()
            if broken == 'limits':  # it is judged by others than it is held to
                config = self.setup.controller
                limits = config.limits.model_copy(update={'torque_rate': (1e-3,) * 6})
                soak._setup = replace(
                    self.setup, controller=config.model_copy(update={'limits': limits}))
            else:
                self.watch.said[topics.TRUE_FORCES] = Shaken(maxlen=graph_watch.REMEMBERED)
            return entered

        def __exit__(self, *error):
            soak._setup = self.setup
            super().__exit__(*error)

    monkeypatch.setattr(graph_soak, 'FaultSession', Session)
    monkeypatch.setattr(graph_soak, 'FAULT_CHANCE', 0.0)
    monkeypatch.setattr(graph_soak, 'REST_CHANCE', 1.0)
    outcome = soak.run(4.0)  # one episode
    assert set(outcome.counts) == {'unsafe' if broken == 'limits' else 'oscillating'}
    if broken == 'limits':
        assert 'after forces: torque rate beyond its limit' in outcome.unsafe[0]
    else:
        assert 'table at 32 Hz' in outcome.oscillating[0]
