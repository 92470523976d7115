"""The folder in which the results of cells are kept."""

from __future__ import annotations

from collections.abc import Collection
import hashlib
import json
from pathlib import Path
from typing import Any
import zipfile

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.engine.cells import Cell, CELL_SCHEMA, CellResult
from multicontact_control.experiment.results import write_json
import numpy as np

CELL_FOLDER = 'cells'


class CellStore:
    """
    The finished cells of a folder: ``cells/<key>.json``, and ``cells/<key>.npz`` for traces.

    The JSON is written last and holds the hash of the traces, so a cell that was cut off while
    being written does not count as finished.

    Parameters
    ----------
    folder
        Where ``cells/`` is, or will be.

    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder / CELL_FOLDER

    def save(self, key: str, cell: Cell, result: CellResult) -> None:
        """Keep a result."""
        self.folder.mkdir(parents=True, exist_ok=True)
        digest = self._save_traces(key, result) if result.traces else ''
        write_json(self.folder / f'{key}.json', {
            'schema': CELL_SCHEMA, 'key': key, **cell.describe(), 'traces_sha256': digest,
            'wall_s': result.wall_time, 'metrics': result.metrics})

    def _save_traces(self, key: str, result: CellResult) -> str:
        traces: dict[str, Any] = {name: np.asarray(values, dtype=np.float32)
                                  for name, values in result.traces.items()}
        path = self.folder / f'{key}.npz'
        partial = path.with_suffix('.partial')
        with partial.open('wb') as file:
            np.savez_compressed(file, **traces)
        partial.replace(path)
        return _sha256(path)

    def load(self, key: str) -> CellResult | None:
        """Return a result, None if it is not there or not whole."""
        path = self.folder / f'{key}.npz'
        try:
            content = json.loads((self.folder / f'{key}.json').read_text(encoding='utf-8'))
            digest = content['traces_sha256']
            if content['schema'] != CELL_SCHEMA or (digest and digest != _sha256(path)):
                return None
            traces = {}
            if digest:
                with np.load(path, allow_pickle=False) as data:
                    traces = {name: data[name] for name in data.files}
            return CellResult(content['metrics'], traces, float(content['wall_s']))
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
            return None

    def finished(self, key: str) -> bool:
        """Return whether a whole result is there."""
        return self.load(key) is not None


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def prepare_cell_folder(
    folder: Path, *, overwrite: bool, results: Collection[str] = (),
) -> None:
    """
    Make the folder of a matrix, keeping its finished cells unless they shall go.

    Parameters
    ----------
    folder
        The folder.
    overwrite
        Whether finished cells are run again.
    results
        Names of files that may be there without ``cells/``.

    Raises
    ------
    ConfigError
        If it holds something else, or cannot be made.

    """
    if folder.is_dir() and not (folder / CELL_FOLDER).is_dir() and any(
            path.name not in results for path in folder.iterdir()):
        raise ConfigError('out', 'a new or empty folder, or one with cells/',
                          f'{folder}, which holds other files')
    if overwrite and (folder / CELL_FOLDER).is_dir():
        for path in (folder / CELL_FOLDER).iterdir():
            if path.suffix in ('.json', '.npz', '.partial'):
                path.unlink()
    try:
        (folder / CELL_FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError('out', 'a folder that can be made',
                          f'{folder} ({error.strerror})') from None
