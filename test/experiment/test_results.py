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
    (run / 'summary.json').write_text('{}')
    with pytest.raises(ConfigError, match='out: expected a folder without a run, or --overwrite'):
        prepare_folder(run, 'paper', overwrite=False, now=NOW)
    assert (run / 'summary.json').is_file()
    assert prepare_folder(run, 'paper', overwrite=True, now=NOW) == run
    assert list(run.iterdir()) == []


def test_folder_with_other_files_is_never_touched(tmp_path):
    """Not even with --overwrite."""
    (tmp_path / 'thesis.tex').write_text('all of it')
    with pytest.raises(ConfigError, match='out: expected a new or empty folder'):
        prepare_folder(tmp_path, 'paper', overwrite=True, now=NOW)
    assert (tmp_path / 'thesis.tex').is_file()


def test_out_that_is_a_file_is_refused(tmp_path):
    """The message says so."""
    (tmp_path / 'file').write_text('')
    with pytest.raises(ConfigError, match='out: expected a folder, found .*file, a file'):
        prepare_folder(tmp_path / 'file', 'paper', overwrite=True, now=NOW)


def test_loading_a_folder_without_a_recording_says_so(tmp_path):
    """One line with the file."""
    with pytest.raises(RunError, match='samples.npz: expected a recording of a run'):
        RunData.load(tmp_path)
