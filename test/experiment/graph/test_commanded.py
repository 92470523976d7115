"""`multicontact run --commanded`: a simulated arm that obeys commands, as somebody starts it."""

import json
import signal
import subprocess
import sys

from multicontact_control.client import MultiContactClient
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.report import run_claims
from multicontact_control.experiment.results import load_run
import pytest
from ros_graph import end_of, PATIENCE, ROOT

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def test_a_simulated_arm_obeys_until_it_is_interrupted_and_is_judged_by_what_was_commanded(
        tmp_path):
    out = tmp_path / 'run'
    with reserve_domain() as domain_id:
        process = subprocess.Popen(
            [sys.executable, '-m', 'multicontact_control.cli', 'run', '--commanded',
             '--speed', '0', '--scenario', 'quick', '--plant', 'rigid',
             '--domain-id', str(domain_id), '--out', str(out)],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        try:
            with MultiContactClient(domain_id=domain_id, timeout=PATIENCE) as arm:
                arm.set_forces({'table': 10.0, 'board': 5.0})
                state = arm.wait_until_reached(timeout=PATIENCE)
                assert state.forces_desired == {'table': 10.0, 'board': 5.0}
                arm.move(state.position_world + [0.02, 0.0, 0.0], duration=1.0)
                moved = arm.wait_until_reached(timeout=PATIENCE)
                while (end := arm.read()).time < moved.time + 1.5:  # rest begins after 1 s
                    pass
        finally:
            process.send_signal(signal.SIGINT)
            said, _ = end_of(process)
    assert process.returncode == 0, said
    assert 'stable' in said
    summary = json.loads((out / 'summary.json').read_text(encoding='utf-8'))
    assert (summary['verdict'], summary['commanded_by_topic']) == ('stable', True)
    assert summary['ticks'] / summary['rate_hz'] > end.time - state.time
    assert summary['contacts']['table']['rest']['true_error_rms_n'] < 0.1
    run = load_run(out)
    assert summary['claims'] == run_claims(run) == []  # of a scenario nobody played
    assert run.data.command[-1].tolist() == [10.0, 5.0]
    assert run.setup.scenario.duration == pytest.approx(run.data.ticks / run.data.rate)
