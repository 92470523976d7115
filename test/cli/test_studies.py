"""What `compare`, `map`, `sweep` and `faults` have in common on the command line."""

import pytest

COMMANDS = [('compare',), ('map',), ('sweep', 'stiffness'), ('faults',),
            ('compare', '--laws'), ('tune', 'feedforward'), ('robots',)]


@pytest.mark.parametrize('command', COMMANDS)
def test_bad_options_are_all_said_in_one_line(multicontact, tmp_path, command):
    done = multicontact(*command, '--jobs', '2', '--dask', 'nowhere', cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == ('multicontact: jobs: expected nothing together with --dask, whose '
                           'workers decide, found 2\n')
    done = multicontact(*command, '--dask', 'nowhere', cwd=tmp_path)
    assert done.returncode == 2
    assert 'dask: expected the address of a Dask scheduler that answers' in done.stderr
    assert done.stderr.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(('arguments', 'messages'), [
    (('compare', '--plants', 'ur5', '--estimators', 'kalman,x', '--seeds', '0'),
     ["plant: expected one of rigid, puma, or a path, found 'ur5'", "found 'kalman'", "found 'x'",
      'seeds: expected at least 1, found 0']),
    (('map', '--plants', 'ur5', '--estimators', 'kalman'), ["found 'ur5'", "found 'kalman'"]),
    (('sweep', 'stifness', '--seeds', 'x'), ["found 'stifness'", "found 'x'"]),
    (('faults', '--seed', '-4'), ['seed: expected a whole number >= 0, found -4']),
    (('robots', '--robots', 'robbie', '--engines', 'ode', '--seeds', '0'),
     ["found 'robbie'", "found 'ode'", 'seeds: expected at least 1, found 0'])])
def test_everything_wrong_with_a_study_is_said_at_once(
        multicontact, tmp_path, arguments, messages):
    done = multicontact(*arguments, '--jobs', '-1', cwd=tmp_path)
    assert done.returncode == 2
    for message in ['jobs: expected a whole number >= 0, found -1', *messages]:
        assert message in done.stderr
    assert done.stderr.count('\n') == 1 + len(messages)  # a line for each
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize(('command', 'line'), list(zip(COMMANDS[:5], [
    ' estimators: lead_window, fixed, ', ' stiffness ratios: 0.1, ',
    ' noise_estimator.estimator: lead_window, fixed ', ' phases: rest, sliding, approach ',
    ' situations: task, vanishing, '])))
def test_dry_run_lists_the_grid_and_leaves_nothing(multicontact, tmp_path, command, line):
    quick = () if command[0] == 'sweep' else ('--quick',)
    done = multicontact(*command, *quick, '--jobs', '1', '--dry-run', cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    text = ' '.join(done.stdout.split())
    assert ' plants: rigid' in text and line in text
    assert ', 0 of them finished before; the other' in text and 'with 1 at once' in text
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('command', COMMANDS)
def test_help_teaches_what_all_studies_can_do(multicontact, command):
    shown = ' '.join(multicontact(command[0], '--help').stdout.split())
    for text in ('--dask', '--dry-run', '--jobs', '--overwrite', '--out', 'Ctrl-C',
                 'goes on from there', 'Dask scheduler'):
        assert text in shown, text


@pytest.mark.slow
def test_second_start_writes_the_same_files_from_what_is_kept(multicontact, tmp_path):
    """Also without --out, in a folder that is called like the command."""
    arguments = ('robots', '--robots', 'puma', '--engines', 'pybullet', '--scenarios', 'quick')
    first = multicontact(*arguments, cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    folder = tmp_path / 'runs' / 'robots'
    assert {path.name for path in folder.iterdir()} == {'cells', 'robots.json', 'robots.html'}
    kept = {path: path.stat().st_mtime_ns for path in folder.glob('cells/*')}
    report = (folder / 'robots.json').read_bytes()
    again = multicontact(*arguments, cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert len(kept) == 1 and '1 run, 1 of them finished before' in again.stdout
    assert {path: path.stat().st_mtime_ns for path in folder.glob('cells/*')} == kept
    assert (folder / 'robots.json').read_bytes() == report
