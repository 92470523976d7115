"""`multicontact sweep` as users start it: Ctrl-C, and a row that is the run of `simulate`."""

import json
import os
import signal
import subprocess
import sys

import pyarrow.parquet as pq
import pytest
from ros_graph import end_of, ROOT, wait_for

STUDY = """
name: small
scenario: step
plants: [rigid]
duration: 1.7
seeds: 4
grid: {noise_estimator.estimator: [fixed, lead_window]}
"""


def interrupt(process):
    os.killpg(process.pid, signal.SIGINT)  # Ctrl-C reaches the workers, too


@pytest.mark.slow
@pytest.mark.parametrize(('end', 'code'), [
    (interrupt, 130), pytest.param(subprocess.Popen.terminate, 143, marks=pytest.mark.nightly)])
def test_ended_sweep_goes_on_where_it_was(multicontact, tmp_path, end, code):
    study, out = tmp_path / 'small.yaml', tmp_path / 'out'
    study.write_text(STUDY)
    # In a group of its own, as a terminal does.
    process = subprocess.Popen(
        [sys.executable, '-m', 'multicontact_control.cli', 'sweep', str(study), '--jobs', '2',
         '--out', str(out)], cwd=ROOT, start_new_session=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
        # A test in the background ignores Ctrl-C, and so would all that it starts.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
    wait_for(lambda: process.poll() is not None or len(list(out.glob('cells/*.json'))) >= 2,
             'two finished runs')
    end(process)
    _, errors = end_of(process)
    assert process.returncode == code, errors
    assert 'the same command goes on' in errors and 'Traceback' not in errors
    finished = {path: path.stat().st_mtime_ns for path in out.glob('cells/*.json')}
    assert 2 <= len(finished) < 8
    assert not (out / 'sweep.parquet').exists()
    again = multicontact('sweep', str(study), '--jobs', '1', '--out', str(out))
    assert again.returncode == 0, again.stderr
    assert f'8 runs, {len(finished)} of them' in ' '.join(again.stdout.split())
    assert all(path.stat().st_mtime_ns == age for path, age in finished.items())
    assert pq.read_table(out / 'sweep.parquet').num_rows == 8


@pytest.mark.slow
@pytest.mark.parametrize('bare', [False, True])
def test_row_is_the_run_that_simulate_gives(multicontact, tmp_path, bare):
    study = tmp_path / 'one.yaml'
    study.write_text('{name: one, scenario: step, plants: [rigid], duration: 1.7, seeds: [3]'
                     f'{", supervised: false" if bare else ""}}}')
    assert multicontact('sweep', str(study), '--out', str(tmp_path / 'sweep')).returncode == 0
    multicontact('simulate', '--scenario', 'step', '--plant', 'rigid', '--duration', '1.7',
                 '--seed', '3', '--out', str(tmp_path / 'run'), *(['--bare'] if bare else []))
    summary = json.loads((tmp_path / 'run' / 'summary.json').read_text())
    row, = pq.read_table(tmp_path / 'sweep' / 'sweep.parquet').to_pylist()
    assert row['trajectory_sha256'] == summary['trajectory_sha256']
    assert row['torque.max_fraction_of_limit'] == summary['torque']['max_fraction_of_limit']
