"""The folder in which the results of jobs are kept."""

from __future__ import annotations

from collections.abc import Collection
import json
from pathlib import Path
from typing import Any
import zipfile

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.study.jobs import Job, JobResult
from multicontact_control.files import replacing, write_json
import numpy as np

JOB_FOLDER = 'cells'


class JobCache:
    """
    The finished jobs of a folder: ``cells/<key>.json``, and ``cells/<key>.npz`` for traces.

    The JSON is written last, so a job that was cut off while being written is not finished.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder / JOB_FOLDER

    def save(self, key: str, job: Job, result: JobResult) -> None:
        """Keep a result."""
        self.folder.mkdir(parents=True, exist_ok=True)
        if result.traces:
            traces: dict[str, Any] = {name: np.asarray(values, dtype=np.float32)
                                      for name, values in result.traces.items()}
            with replacing(self.folder / f'{key}.npz') as partial, partial.open('wb') as file:
                np.savez_compressed(file, **traces)
        write_json(self.folder / f'{key}.json', {
            'key': key, **job.describe(), 'traces': list(result.traces),
            'wall_s': result.wall_time, 'metrics': result.metrics})

    def load(self, key: str) -> JobResult | None:
        """Return a result, None if it is not there or not whole."""
        try:
            content = json.loads((self.folder / f'{key}.json').read_text(encoding='utf-8'))
            traces = {}
            if content['traces']:
                with np.load(self.folder / f'{key}.npz', allow_pickle=False) as data:
                    traces = {name: data[name] for name in content['traces']}
            return JobResult(content['metrics'], traces, float(content['wall_s']))
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
            return None


def prepare_job_folder(
    folder: Path, *, overwrite: bool, results: Collection[str] = (),
) -> None:
    """
    Make the folder of a study, keeping its finished jobs unless they shall go.

    Raises
    ------
    ConfigError
        If it cannot be made, or holds other files than `results` without any ``cells/``.

    """
    cells = folder / JOB_FOLDER
    if folder.is_dir() and not cells.is_dir() and any(
            path.name not in results for path in folder.iterdir()):
        raise ConfigError('out', 'a new or empty folder, or one with cells/',
                          f'{folder}, which holds other files')
    if overwrite and cells.is_dir():
        for path in cells.iterdir():
            if path.suffix in ('.json', '.npz', '.partial'):
                path.unlink()
    try:
        cells.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError('out', 'a folder that can be made',
                          f'{folder} ({error.strerror})') from None
