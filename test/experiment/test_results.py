"""Run folders: named, kept, replaced only when asked."""

from datetime import datetime

from multicontact_control.errors import ConfigError, RunError
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
