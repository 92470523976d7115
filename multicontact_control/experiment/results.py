"""The folder a run leaves: making it, filling it, keeping what is already there."""

from __future__ import annotations

from datetime import datetime
import json
import math
import os
from pathlib import Path
import shutil
from typing import Any

from multicontact_control.errors import ConfigError

SUMMARY_FILE = 'summary.json'
CONFIG_FOLDER = 'config'


def prepare_folder(out: Path | None, scenario: str, *, overwrite: bool, now: datetime) -> Path:
    """
    Make the folder of a run.

    Parameters
    ----------
    out
        The folder; None for ``runs/<date>-<time>-<scenario>``.
    scenario
        Name of the scenario.
    overwrite
        Whether a run that is already in `out` may be replaced.
    now
        Date and time for the name.

    Returns
    -------
    Path
        The folder, empty of any earlier run.

    Raises
    ------
    ConfigError
        If the folder holds something and must not be overwritten, or cannot be made.

    """
    folder = out or Path('runs') / f'{now:%Y%m%d-%H%M%S}-{scenario}'
    if folder.exists():
        if not folder.is_dir():
            raise ConfigError('out', 'a folder', f'{folder}, a file')
        if any(folder.iterdir()):
            if not (folder / CONFIG_FOLDER).is_dir():
                raise ConfigError('out', 'a new or empty folder', f'{folder}, which holds files')
            if not overwrite:
                raise ConfigError('out', 'a folder without a run, or --overwrite',
                                  f'{folder}, which holds a run')
            shutil.rmtree(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError('out', 'a folder that can be made',
                          f'{folder} ({error.strerror})') from None
    if out is None:
        point_latest(folder)
    return folder


def point_latest(folder: Path) -> None:
    """Make ``runs/latest`` lead to a run folder."""
    link = folder.parent / 'latest'
    fresh = folder.parent / f'.latest-{os.getpid()}'
    fresh.unlink(missing_ok=True)
    fresh.symlink_to(folder.name)
    fresh.replace(link)


def read_json(path: Path) -> Any:
    """
    Read JSON.

    Raises
    ------
    ConfigError
        If the file cannot be read or is not JSON.

    """
    try:
        return json.loads(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ConfigError(str(path), 'a readable file', error.strerror or error) from None
    except ValueError as error:
        raise ConfigError(str(path), 'valid JSON', error) from None


def finite(value: Any) -> Any:
    """Return JSON values with None for every number that is not finite."""
    if isinstance(value, dict):
        return {name: finite(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
