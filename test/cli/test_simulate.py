"""A run in one process, from the command line."""

import json


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


def test_simulate_that_is_not_stable_exits_with_one(multicontact, tmp_path):
    """A run that ends before any contact holds no force."""
    done = multicontact('simulate', '--scenario', 'quick', '--plant', 'rigid', '--duration',
                        '0.2', '--out', str(tmp_path / 'run'))
    assert done.returncode == 1
    assert 'not stable: table: no contact was made' in done.stdout
    assert json.loads((tmp_path / 'run' / 'summary.json').read_text())['stable'] is False
