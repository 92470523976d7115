"""A soak over a real graph, and what it says of one that does not come back."""

from pathlib import Path
import re

from multicontact_control.errors import RunError
from multicontact_control.experiment.faults import graph_soak
from multicontact_control.experiment.faults.graph_soak import GraphSoak
from multicontact_control.experiment.scenario import resolve
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
    outcome = soak.run(15.0)
    assert (outcome.unsafe, outcome.oscillating, outcome.stuck) == ([], [], [])
    assert outcome.simulated_s >= 15.0
    assert sum(outcome.episodes.values()) >= 2
    assert outcome.minutes and outcome.minutes[0].memory_mb > 200.0  # of some five processes
    assert min(minute.error_n for minute in outcome.minutes) < 3.0
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
