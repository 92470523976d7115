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
    named = [line.partition(': ')[0] for line in lines]
    assert sorted(named) == sorted(fields)
    assert list(tmp_path.iterdir()) == []


def test_robot_chooses_plants_and_the_factor_of_that_name(multicontact):
    done = multicontact('study', 'robots', '--robot', 'panda', '--dry-run')
    assert ' robot: panda\n' in done.stdout
    assert ' plant: panda/rigid\n' in done.stdout


def obey_ctrl_c():
    """Undo what a test in the background does: it ignores Ctrl-C, as would what it starts."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
def test_ended_study_goes_on_where_it_was(multicontact, tmp_path):
    study = tmp_path / 'small.yaml'
    out = tmp_path / 'out'
    study.write_text(STUDY)
    arguments = ('study', study, '--jobs', '2', '--out', out)
    # In a group of its own, as a terminal does.
    process = start_command(*arguments, start_new_session=True, preexec_fn=obey_ctrl_c)

    def find_cells():
        return {path: path.stat().st_mtime_ns for path in out.glob('cells/*.json')}

    def two_cells_are_finished():
        return process.poll() is not None or len(find_cells()) >= 2

    wait_for(two_cells_are_finished, 'two finished runs')
    os.killpg(process.pid, signal.SIGINT)  # Ctrl-C reaches the workers
    _, errors = end_of(process)
    assert process.returncode == 130, errors
    assert 'the same command goes on' in errors
    assert 'Traceback' not in errors
    finished = find_cells()
    assert 2 <= len(finished) < 24
    assert not (out / 'study.parquet').exists()
    done = multicontact('study', str(study), '--jobs', '1', '--out', str(out))
    assert done.exit_code == 0, done.stderr
    assert f'24 jobs, {len(finished)} of them' in ' '.join(done.stdout.split())
    assert finished.items() <= find_cells().items()
    assert len(pd.read_parquet(out / 'study.parquet')) == 24
