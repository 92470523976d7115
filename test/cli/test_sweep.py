"""`multicontact sweep` as users start it: Ctrl-C, one row, bad input."""

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
duration: 2.0
seeds: 4
grid: {noise_estimator.estimator: [fixed, lead_window]}
"""


@pytest.fixture(name='study')
def fixture_study(tmp_path):
    path = tmp_path / 'small.yaml'
    path.write_text(STUDY)
    return path


def start(study, out):
    """Start a sweep of eight runs on two workers in a group of its own, as a terminal does."""
    return subprocess.Popen(
        [sys.executable, '-m', 'multicontact_control.cli', 'sweep', str(study), '--jobs', '2',
         '--out', str(out)], cwd=ROOT, start_new_session=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
        # Whoever runs the tests in the background has them ignore Ctrl-C, and all they start.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))


def wait_for_cells(out, count, process):
    def finished():
        assert process.poll() is None, process.communicate()
        return len(list(out.glob('cells/*.json'))) >= count

    wait_for(finished, f'{count} finished runs')


@pytest.mark.slow
@pytest.mark.parametrize(('number', 'code'), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupted_sweep_goes_on_where_it_was(multicontact, study, tmp_path, number, code):
    out = tmp_path / 'out'
    process = start(study, out)
    wait_for_cells(out, 2, process)
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # Ctrl-C reaches the workers, too
    else:
        process.send_signal(number)
    _, errors = end_of(process)
    assert process.returncode == code, errors
    assert 'the same command goes on from there' in errors
    assert 'Traceback' not in errors
    finished = {path: path.stat().st_mtime_ns for path in out.glob('cells/*.json')}
    assert 2 <= len(finished) < 8
    assert not (out / 'sweep.parquet').exists()
    # In this process: what is to be shown is what it leaves alone.
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


@pytest.mark.parametrize(('arguments', 'message'), [
    (('nothing',), "study: expected one of delay, stiffness, or a path, found 'nothing'"),
    (('stiffness', '--seeds', 'x'), 'seeds: expected a number of seeds, or seeds with commas'),
    (('stiffness', '--seeds', '0'), 'seeds: expected a number of seeds, or seeds with commas'),
    (('stiffness', '--jobs', '-1'), 'jobs: expected a whole number >= 0, found -1'),
    (('stiffness', '--dask', 'nowhere'), 'dask: expected the address of a Dask scheduler')])
def test_bad_input_exits_with_two_and_one_line(multicontact, tmp_path, arguments, message):
    done = multicontact('sweep', *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_seeds_are_a_number_or_a_list(multicontact, tmp_path):
    for given, runs in (('3', 30), ('4,9', 20)):
        done = multicontact('sweep', 'stiffness', '--seeds', given, '--dry-run', cwd=tmp_path)
        assert f'{runs} runs, 0 of them' in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_help_teaches(multicontact):
    shown = multicontact('sweep', '--help').stdout
    for text in ('plants: [rigid, puma]', 'sweep.parquet', '--dask', '130: interrupted'):
        assert text in shown
