"""The folder that a run leaves: its files, and how it is made without losing what is there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from itertools import count
import os
from pathlib import Path
import shutil

from multicontact_control.errors import ConfigError
from multicontact_control.runs.bag import mcap_files
from multicontact_control.runs.recording import SERIES_FILE

SUMMARY_FILE = 'summary.json'
REPORT_FILE = 'report.html'
PASSES_FILE = 'passes.csv'
PASSES_TABLE = 'passes.parquet'
CONFIG_FOLDER = 'config'
BAG_FOLDER = 'bag'
FIGURE_FOLDER = 'figures'
LOG_FOLDER = 'logs'
# All that a run and its report leave, and all that is ever deleted.
LEFT_BY_RUNS = {
    CONFIG_FOLDER,
    BAG_FOLDER,
    FIGURE_FOLDER,
    LOG_FOLDER,
    SUMMARY_FILE,
    REPORT_FILE,
    PASSES_FILE,
    PASSES_TABLE,
    SERIES_FILE,
}
RUNS_FOLDER = Path('runs')  # of the runs that are not told another place


@contextmanager
def open_run_folder(
    out: Path | None, scenario: str, *, overwrite: bool, now: datetime
) -> Iterator[Path]:
    """
    Yield the folder of a run; remove it if the run leaves nothing.

    The parameters are those of `prepare_run_folder`. ``runs/latest`` leads to a folder with a
    summary or a recording.
    """
    folder = prepare_run_folder(out, scenario, overwrite=overwrite, now=now)
    try:
        yield folder
    finally:
        has_summary = (folder / SUMMARY_FILE).is_file()
        if not has_summary and not (folder / LOG_FOLDER).exists():
            shutil.rmtree(folder, ignore_errors=True)
        elif has_summary or mcap_files(folder / BAG_FOLDER):
            _link_latest(folder)


def _link_latest(folder: Path) -> None:
    """Let ``runs/latest`` lead to a folder."""
    RUNS_FOLDER.mkdir(exist_ok=True)
    link = RUNS_FOLDER / f'.latest-{os.getpid()}'
    link.unlink(missing_ok=True)
    link.symlink_to(os.path.relpath(folder.resolve(), RUNS_FOLDER.resolve()))
    link.replace(RUNS_FOLDER / 'latest')


def prepare_run_folder(
    out: Path | None, scenario: str, *, overwrite: bool, now: datetime
) -> Path:
    """
    Make and return the folder of a run, empty of any earlier run.

    Parameters
    ----------
    out
        The folder; None makes ``runs/<date>-<time>-<scenario>``, numbered if that is taken.
    scenario
        Name of the scenario.
    overwrite
        Whether a run that is in `out` may be deleted.
    now
        Date and time of the run.

    Raises
    ------
    ConfigError
        If the folder cannot be made, or holds anything but a run that may be deleted.

    """
    folder = out or RUNS_FOLDER / f'{now:%Y%m%d-%H%M%S}-{scenario}'
    try:
        if out is None:
            return _make_numbered(folder)
        if out.is_symlink() or not out.name:
            # Where it leads now: `runs/latest` leads elsewhere once another run begins.
            folder = Path(os.path.realpath(out))
        _empty_folder(folder, overwrite=overwrite)
    except OSError as error:
        raise ConfigError(
            'out',
            'a folder that can be made, or whose run can be replaced',
            f'{out or folder} ({error.strerror})',
        ) from None
    return folder


def _make_numbered(folder: Path) -> Path:
    """Make and return a new folder, with -2, -3, ... where it exists."""
    numbered = folder
    for number in count(2):
        with suppress(FileExistsError):
            numbered.mkdir(parents=True)
            break
        numbered = folder.with_name(f'{folder.name}-{number}')
    return numbered


def _empty_folder(folder: Path, *, overwrite: bool) -> None:
    """Make a folder, or empty it of a run; ConfigError if it holds what must be kept."""
    folder.mkdir(parents=True, exist_ok=True)
    names = {entry.name for entry in folder.iterdir()}
    if not names:
        return
    foreign = names - LEFT_BY_RUNS
    if foreign or not (folder / CONFIG_FOLDER / 'scenario.yaml').is_file():
        raise ConfigError(
            'out',
            'a new or empty folder, or that of a run',
            f'{folder}, which holds {min(foreign or names)}',
        )
    if not overwrite:
        raise ConfigError(
            'out',
            'a folder without a run, or --overwrite',
            f'{folder}, which holds a run',
        )
    shutil.rmtree(folder)
    folder.mkdir()


def find_run_folder(path: Path) -> Path:
    """
    Return the folder of a recording: of a file that it is in, of a run's ``bag/`` the run's.

    So every path that a user may name leads to the same run. It is not checked that the folder is
    one.
    """
    folder = path
    if folder.is_file():
        folder = folder.parent
    if folder.name == BAG_FOLDER:
        folder = folder.parent
    return folder


def is_run_folder(path: Path) -> bool:
    """
    Return whether a path is the folder of a run, whether it came to its end or not.

    Its configuration is written before the run begins, and tells it from the folder of a bare
    recording.
    """
    return (path / CONFIG_FOLDER).is_dir()


def is_finished_run(path: Path) -> bool:
    """
    Return whether a path is the folder of a run that came to its end.

    The summary is written last; without it only the recording can be read back.
    """
    return is_run_folder(path) and (path / SUMMARY_FILE).is_file()


def find_report_folder(path: Path) -> Path:
    """
    Return where the report on a path goes: into a run's folder, beside a recording.

    Of a recording ``drive.mcap`` it is ``drive-report``, since the folder is another program's. It
    is not made here.
    """
    if is_run_folder(path) or (path / BAG_FOLDER).is_dir():
        return path
    path = path.resolve()
    return path.with_name(f'{path.stem}-report')
