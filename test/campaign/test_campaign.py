"""The campaign and the soak in short: over a running graph and in process."""

import json

from campaign.faults import run_faults
from campaign.graph_faults import GRAPH_FAULTS
from campaign.soak import process_episodes, ProcessSoak, soak
from multicontact_control.nodes.topics import CONTROLLER
import numpy as np
import pytest


def test_soak_in_process_sees_nothing_unsafe(tmp_path):
    path = tmp_path / 'soak.jsonl'
    soak(process_episodes('rigid', 0, tmp_path), path, 20.0)
    lines = [json.loads(line) for line in path.read_text(encoding='utf-8').splitlines()]
    assert lines[-1]['time_s'] >= 20.0
    assert [line['problems'] for line in lines] == [[]] * len(lines)


class Shaken(ProcessSoak):
    """The table swings by 0.3 mm, as fast as a limit cycle: too fast for the law to follow."""

    def advance(self, faults=()):
        super().advance(faults)
        time = self.loop.tick * 0.002
        self.loop.plant.contacts.shift(
            0, 3e-4 * (np.sin(200.0 * time) - np.sin(200.0 * (time - 0.002))))


def test_soak_reports_an_oscillating_force():
    shaken = Shaken('rigid', 0)
    assert any(x.startswith('table oscillates at 32 Hz') for x in shaken.episode()['problems'])
    shaken.loop.close()


@pytest.mark.nightly
@pytest.mark.ros
def test_running_graph_survives_faults(tmp_path, monkeypatch):
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)
    chosen = [('killed', CONTROLLER), ('nan', 'variance'), ('unknown_contact', 'forces command')]
    rows = [*run_faults('rigid', [(GRAPH_FAULTS[key], 0) for key in chosen], 0, tmp_path, [])]
    assert {row.kind for row in rows} == {*(kind for kind, _ in chosen), 'ended'}
    assert {row.problems for row in rows} <= {'', 'commands stopped'}  # on a busy machine
    assert next(x for x in rows if x.kind == 'killed').reaction == 'silent'
