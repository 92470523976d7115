"""Run folders: named, kept, replaced only when asked."""

from datetime import datetime
from pathlib import Path

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment import results
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.results import prepare_folder
import pytest

NOW = datetime(2026, 1, 2, 3, 4, 5)


def test_run_without_out_goes_to_a_dated_folder_and_latest_leads_there(tmp_path, monkeypatch):
    """runs/<date>-<time>-<scenario>, runs/latest the newest."""
    monkeypatch.chdir(tmp_path)
    first = prepare_folder(None, 'paper', overwrite=False, now=NOW)
    assert str(first) == 'runs/20260102-030405-paper'
    second = prepare_folder(None, 'quick', overwrite=False, now=NOW)
    latest = tmp_path / 'runs' / 'latest'
    assert latest.resolve() == second.resolve()
    assert sorted(path.name for path in latest.parent.iterdir()) == [
        '20260102-030405-paper', '20260102-030405-quick', 'latest']


def test_folder_with_a_run_is_kept_unless_overwritten(tmp_path):
    """Nothing is lost without --overwrite."""
    run = tmp_path / 'run'
    (run / 'config').mkdir(parents=True)
    (run / 'config' / 'scenario.yaml').write_text('')
    (run / 'summary.json').write_text('{}')
    with pytest.raises(ConfigError, match='out: expected a folder without a run, or --overwrite'):
        prepare_folder(run, 'paper', overwrite=False, now=NOW)
    assert (run / 'summary.json').is_file()
    assert prepare_folder(run, 'paper', overwrite=True, now=NOW) == run
    assert list(run.iterdir()) == []


def test_runs_of_one_second_have_folders_of_their_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folders = [prepare_folder(None, 'paper', overwrite=False, now=NOW) for _ in range(3)]
    assert [folder.name for folder in folders] == [
        f'20260102-030405-paper{end}' for end in ('', '-2', '-3')]
    assert (tmp_path / 'runs/latest').resolve() == folders[-1].resolve()


def test_run_that_latest_leads_to_is_overwritten_where_it_is(tmp_path, monkeypatch):
    """The link stays, and what it leads to later is no matter of this run."""
    monkeypatch.chdir(tmp_path)
    run = prepare_folder(None, 'paper', overwrite=False, now=NOW)
    scenario_file = run / 'config' / 'scenario.yaml'
    scenario_file.parent.mkdir()
    scenario_file.write_text('')
    latest = Path('runs/latest')
    with pytest.raises(ConfigError, match='out: expected a folder without a run, or --overwrite'):
        prepare_folder(latest, 'paper', overwrite=False, now=NOW)
    assert prepare_folder(latest, 'paper', overwrite=True, now=NOW) == run.resolve()
    assert list(run.iterdir()) == []
    assert latest.is_symlink() and latest.resolve() == run.resolve()


def test_folder_that_cannot_be_emptied_is_told_in_a_line(tmp_path, monkeypatch):
    def refuse(path):
        raise PermissionError(13, 'Permission denied', str(path))

    (tmp_path / 'config').mkdir()
    (tmp_path / 'config' / 'scenario.yaml').write_text('')
    monkeypatch.setattr(results.shutil, 'rmtree', refuse)
    with pytest.raises(ConfigError, match=r'out: expected a folder that can be made, and emptied '
                       r'of a run, found .* \(Permission denied\)$'):
        prepare_folder(tmp_path, 'paper', overwrite=True, now=NOW)


@pytest.mark.parametrize('files', [
    ('thesis.tex',), ('config/controller.yaml',), ('config/scenario.yaml', '.git/HEAD'),
    ('config/scenario.yaml', 'summary.json', 'notes.md')])
def test_folder_with_other_files_is_never_touched(tmp_path, files):
    """Not even with --overwrite, and not either where there is a run or a folder `config`."""
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text('all of it')
    with pytest.raises(ConfigError, match='out: expected a new or empty folder, or that of a run'):
        prepare_folder(tmp_path, 'paper', overwrite=True, now=NOW)
    assert all((tmp_path / name).is_file() for name in files)


def test_out_that_is_a_file_is_refused(tmp_path):
    """The message says so."""
    (tmp_path / 'file').write_text('')
    with pytest.raises(ConfigError, match='out: expected a folder, found .*file, a file'):
        prepare_folder(tmp_path / 'file', 'paper', overwrite=True, now=NOW)


def test_loading_a_folder_without_a_recording_says_so(tmp_path):
    """One line with the file."""
    with pytest.raises(RunError, match='samples.npz: expected a recording of a run'):
        RunData.load(tmp_path)
