"""`multicontact study` as users start it: bad input, Ctrl-C, rows that are runs."""

import os
import signal

import pandas as pd
import pytest
from ros_graph import end_of, start_command, wait_for

STUDY = """
name: small
scenario: step
plants: [rigid]
duration: 1.7
seeds: 12
factors: {noise_estimator.estimator: [fixed, lead_window]}
"""


@pytest.mark.parametrize(
    ('arguments', 'fields'),
    [
        (('compare', '--plants', 'ur5'), ['--plants']),
        (('delay', '--set', 'seed=x'), ['seed']),
        (('map', '--set', 'estimator=kalman'), ['estimator']),
        (('stifness', '--set', 'x'), ['STUDY', '--set']),
        (('laws', '--law', 'pi'), ['--law']),
        (('robots', '--set', 'robot=robbie'), ['robot']),
        (('faults', '--dask', 'nowhere'), ['--dask']),
    ],
)
def test_bad_options_are_all_named_and_leave_nothing(
    multicontact, tmp_path, monkeypatch, arguments, fields
):
    monkeypatch.chdir(tmp_path)
    done = multicontact('study', *arguments)
    assert done.exit_code == 2
    lines = done.stderr.removeprefix('multicontact: ').splitlines()
    assert {line.split(': ')[0] for line in lines} == {*fields}
    assert list(tmp_path.iterdir()) == []


def test_robot_chooses_plants_and_the_factor_of_that_name(multicontact):
    done = multicontact('study', 'robots', '--robot', 'panda', '--dry-run')
    assert ' robot: panda\n' in done.stdout and ' plant: panda/rigid\n' in done.stdout


@pytest.mark.slow
def test_ended_study_goes_on_where_it_was(multicontact, tmp_path):
    study = tmp_path / 'small.yaml'
    out = tmp_path / 'out'
    study.write_text(STUDY)
    # In a group of its own, as a terminal does.
    process = start_command(
        'study',
        study,
        '--jobs',
        '2',
        '--out',
        out,
        start_new_session=True,
        # A test in the background ignores Ctrl-C, and so would all that it starts.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    wait_for(
        lambda: process.poll() is not None or len(list(out.glob('cells/*.json'))) >= 2,
        'two finished runs',
    )
    os.killpg(process.pid, signal.SIGINT)  # Ctrl-C reaches the workers
    _, errors = end_of(process)
    assert process.returncode == 130, errors
    assert 'the same command goes on' in errors and 'Traceback' not in errors
    finished = {path: path.stat().st_mtime_ns for path in out.glob('cells/*.json')}
    assert 2 <= len(finished) < 24
    assert not (out / 'study.parquet').exists()
    again = multicontact('study', str(study), '--jobs', '1', '--out', str(out))
    assert again.exit_code == 0, again.stderr
    assert f'24 jobs, {len(finished)} of them' in ' '.join(again.stdout.split())
    assert all(path.stat().st_mtime_ns == age for path, age in finished.items())
    assert len(pd.read_parquet(out / 'study.parquet')) == 24
