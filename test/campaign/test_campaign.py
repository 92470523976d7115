"""The campaign and the soak in short: over a running graph and in process."""

from campaign.faults import run_faults
from campaign.graph_faults import GRAPH_FAULTS
from campaign.mutations import read_mutations
from campaign.soak import episodes, Soak
from multicontact_control.nodes.topics import CONTROLLER
import numpy as np
import pytest
from ros_graph import ROOT


def test_soak_in_process_sees_nothing_unsafe():
    lines = episodes('rigid', 0, 20.0)
    assert lines[-1]['time_s'] >= 20.0
    for line in lines:
        assert line['problems'] == []


class Shaken(Soak):
    """The table swings by 0.3 mm, as fast as a limit cycle: too fast for the law to follow."""

    def advance(self, faults=()):
        super().advance(faults)
        phase = 0.4 * self.loop.tick
        change = np.sin(phase) - np.sin(phase - 0.4)
        self.loop.plant.contacts.shift_surface(0, 3e-4 * change)


def test_soak_reports_an_oscillating_force():
    shaken = Shaken('rigid', 0)
    problems = shaken.episode()['problems']
    assert 'table oscillates at 32 Hz' in '\n'.join(problems)
    shaken.loop.close()


def test_mutations_name_lines_and_tests_that_there_are():
    for _, file, before, _, test in read_mutations():
        path, _, name = test.partition('::')
        mutated = ROOT / 'multicontact_control' / file
        assert before in mutated.read_text(encoding='utf-8')
        assert f'def {name}(' in (ROOT / path).read_text(encoding='utf-8')


@pytest.mark.nightly
@pytest.mark.ros
def test_running_graph_survives_faults(tmp_path):
    chosen = [
        GRAPH_FAULTS['killed', CONTROLLER],
        GRAPH_FAULTS['wrong_names', 'variance'],
        GRAPH_FAULTS['dropped', 'wrench'],
    ]
    rows = {row.kind: row for row in run_faults('rigid', chosen, 0, tmp_path)}
    assert rows.keys() == {'killed', 'wrong_names', 'dropped', 'ended'}
    on_a_busy_machine = 'commands stopped'
    assert {row.problems for row in rows.values()} <= {'', on_a_busy_machine}
    assert rows['killed'].reaction == 'silent'
