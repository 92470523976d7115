"""What the commands of studies have in common: bad input leaves nothing and exits with 2."""

import pytest


@pytest.mark.parametrize(('arguments', 'fields'), [
    (('compare', '--plants', 'ur5', '--estimators', 'kalman', '--seeds', '0'),
     ['plant', 'estimators', 'seeds']),
    (('compare', '--laws', '--plants', 'ur5'), ['plant']),
    (('map', '--plants', 'ur5', '--estimators', 'kalman'), ['plant', 'estimators']),
    (('sweep', 'stifness', '--seeds', 'x'), ['study', 'seeds']),
    (('sweep', 'stiffness', '--seeds', '0'), ['seeds']),
    (('tune', 'pid'), ['law']), (('faults', '--seed', '-4'), ['seed']),
    (('robots', '--robots', 'robbie', '--engines', 'ode', '--seeds', '0'),
     ['robot', 'engines', 'seeds'])])
def test_bad_options_are_all_named(multicontact, tmp_path, arguments, fields):
    done = multicontact(*arguments, '--jobs', '-1', cwd=tmp_path)
    assert done.returncode == 2
    lines = done.stderr.removeprefix('multicontact: ').splitlines()
    assert {line.split(': ')[0] for line in lines} == {'jobs', *fields}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('options', [('--jobs', '2', '--dask', 'nowhere'), ('--dask', 'nowhere')])
@pytest.mark.parametrize('command', ['compare', 'map', 'faults', 'robots'])
def test_dask_scheduler_that_does_not_answer_is_refused(multicontact, tmp_path, command, options):
    done = multicontact(command, *options, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count('\n') == 1
    assert done.stderr.split(': ')[1] == ('jobs' if '--jobs' in options else 'dask')
    assert list(tmp_path.iterdir()) == []
