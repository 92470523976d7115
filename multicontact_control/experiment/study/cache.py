"""The folder in which the results of jobs are kept."""

from __future__ import annotations

from collections.abc import Collection
import hashlib
import json
from pathlib import Path
from typing import Any
import zipfile

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.study.jobs import Job, JOB_SCHEMA, JobResult
from multicontact_control.files import replacing, write_json
import numpy as np

JOB_FOLDER = 'cells'


class JobCache:
    """
    The finished jobs of a folder: ``cells/<key>.json``, and ``cells/<key>.npz`` for traces.

    The JSON is written last and holds the hash of the traces, so a job that was cut off while
    being written does not count as finished.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder / JOB_FOLDER

    def save(self, key: str, job: Job, result: JobResult) -> None:
        """Keep a result."""
        self.folder.mkdir(parents=True, exist_ok=True)
        digest = self._save_traces(key, result) if result.traces else ''
        write_json(self.folder / f'{key}.json', {
            'schema': JOB_SCHEMA, 'key': key, **job.describe(), 'traces_sha256': digest,
            'wall_s': result.wall_time, 'metrics': result.metrics})

    def _save_traces(self, key: str, result: JobResult) -> str:
        traces: dict[str, Any] = {name: np.asarray(values, dtype=np.float32)
                                  for name, values in result.traces.items()}
        path = self.folder / f'{key}.npz'
        with replacing(path) as partial, partial.open('wb') as file:
            np.savez_compressed(file, **traces)
        return _sha256(path)

    def load(self, key: str) -> JobResult | None:
        """Return a result, None if it is not there or not whole."""
        path = self.folder / f'{key}.npz'
        try:
            content = json.loads((self.folder / f'{key}.json').read_text(encoding='utf-8'))
            digest = content['traces_sha256']
            if content['schema'] != JOB_SCHEMA or (digest and digest != _sha256(path)):
                return None
            traces = {}
            if digest:
                with np.load(path, allow_pickle=False) as data:
                    traces = {name: data[name] for name in data.files}
            return JobResult(content['metrics'], traces, float(content['wall_s']))
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
            return None

    def finished(self, key: str) -> bool:
        """Return whether a whole result is there."""
        return self.load(key) is not None


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


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
    if folder.is_dir() and not (folder / JOB_FOLDER).is_dir() and any(
            path.name not in results for path in folder.iterdir()):
        raise ConfigError('out', 'a new or empty folder, or one with cells/',
                          f'{folder}, which holds other files')
    if overwrite and (folder / JOB_FOLDER).is_dir():
        for path in (folder / JOB_FOLDER).iterdir():
            if path.suffix in ('.json', '.npz', '.partial'):
                path.unlink()
    try:
        (folder / JOB_FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError('out', 'a folder that can be made',
                          f'{folder} ({error.strerror})') from None
