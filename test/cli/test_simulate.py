"""A run in one process, from the command line."""

import json

import pytest


@pytest.mark.slow
def test_simulate_leaves_a_run_folder(multicontact, tmp_path):
    """Series, summary, figures; it is not replaced unless it is asked for."""
    out = str(tmp_path / 'run')
    options = ('--scenario', 'quick', '--plant', 'rigid', '--out', out)
    done = multicontact('simulate', *options, '--duration', '3.0', '--seed', '5')
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / 'run/summary.json').read_text())
    assert (summary['scenario'], summary['plant'], summary['seed']) == ('quick', 'rigid', 5)
    assert (summary['mode'], summary['ticks']) == ('in_process', 1500)
    assert len(list((tmp_path / 'run/figures').glob('*.png'))) == 4
    assert summary['verdict'] == 'stable' and '\nstable\n' in done.stdout
    assert multicontact('report', out).returncode == 0
    again = multicontact('simulate', *options)
    assert again.returncode == 2
    assert '--overwrite' in again.stderr and again.stderr.count('\n') == 1
    replaced = multicontact('simulate', *options, '--duration', '0.2', '--overwrite')
    assert replaced.returncode == 1 and 'not stable: table: no contact' in replaced.stdout
    assert json.loads((tmp_path / 'run/summary.json').read_text())['stable'] is False
    assert not (tmp_path / 'run/report.html').exists()


def test_simulate_before_the_first_force_step_is_not_judged(multicontact, tmp_path):
    done = multicontact('simulate', '--scenario', 'quick', '--plant', 'rigid', '--duration',
                        '2.0', '--out', str(tmp_path / 'run'))
    assert done.returncode == 0 and 'not judged: never under load' in done.stdout
