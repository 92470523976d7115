"""A run in one process, from the command line."""

import json
import math

from multicontact_control.experiment import run
from multicontact_control.experiment.closed_loop import LoopResult
from multicontact_control.experiment.scenario import resolve
import numpy as np
from rich.console import Console
from synthetic_run import perfect_run


def test_simulate_leaves_a_run_folder(multicontact, tmp_path):
    """Series, summary, figures and the exact configuration."""
    out = tmp_path / 'run'
    done = multicontact('simulate', '--scenario', 'quick', '--plant', 'rigid', '--duration',
                        '3.0', '--seed', '5', '--out', str(out))
    assert done.returncode == 0, done.stderr
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['schema'] == 1
    assert (summary['scenario'], summary['plant'], summary['seed']) == ('quick', 'rigid', 5)
    assert (summary['mode'], summary['ticks']) == ('in_process', 1500)
    assert len(list((out / 'figures').glob('*.png'))) == 4
    assert summary['verdict'] == 'stable' and '\nstable\n' in done.stdout
    again = multicontact('simulate', '--scenario', 'quick', '--out', str(out))
    assert again.returncode == 2
    assert again.stderr.count('\n') == 1
    assert '--overwrite' in again.stderr
    assert multicontact('report', str(out)).returncode == 0
    replaced = multicontact('simulate', '--scenario', 'quick', '--plant', 'rigid', '--duration',
                            '0.2', '--out', str(out), '--overwrite')
    assert replaced.returncode == 1 and 'no contact was made' in replaced.stdout
    assert json.loads((out / 'summary.json').read_text())['ticks'] == 100
    assert not (out / 'report.html').exists()


def test_simulate_that_is_not_stable_exits_with_one(multicontact, tmp_path):
    """A run that ends before any contact holds no force."""
    done = multicontact('simulate', '--scenario', 'quick', '--plant', 'rigid', '--duration',
                        '0.2', '--out', str(tmp_path / 'run'))
    assert done.returncode == 1
    assert 'not stable: table: no contact was made' in done.stdout
    assert json.loads((tmp_path / 'run' / 'summary.json').read_text())['stable'] is False


def test_simulate_that_ends_before_the_first_force_step_is_not_judged_and_no_failure(
        multicontact, tmp_path):
    done = multicontact('simulate', '--scenario', 'quick', '--plant', 'rigid', '--duration',
                        '2.0', '--out', str(tmp_path / 'run'))
    assert done.returncode == 0, done.stderr
    assert 'not judged: never under load' in done.stdout


def test_run_with_a_number_that_is_not_finite_leaves_a_summary(tmp_path, monkeypatch):
    """The verdict says so, and the file has no number there."""
    setup = resolve('quick', plant='rigid', duration=9.0)
    data = perfect_run(setup)
    data.position[-1] = data.alpha_true[-1] = math.inf
    monkeypatch.setattr(run, 'run_in_process', lambda *_, **__: LoopResult(
        data, np.ones(data.ticks), 1.0))
    run.run_simulate(setup, tmp_path, supervised=False, console=Console(quiet=True))
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert 'a number is not finite' in summary['instabilities']
    assert summary['contacts']['table']['moving']['true_error_rms_n'] is None
