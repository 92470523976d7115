"""Recordings as a dataset of LeRobot, version 3.0: frames, episodes, tasks and statistics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple

from multicontact_control.errors import ConfigError
from multicontact_control.files import make_whole_folder, replace_json_file
from multicontact_control.judging.results import LoadedRun
from multicontact_control.judging.run_folders import find_run_folder
from multicontact_control.learning.frames import Feature, Frames, SampleSeries
import numpy as np
from numpy.typing import NDArray
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

VERSION = 'v3.0'
DATA_FILE = Path('data/chunk-000/file-000.parquet')
EPISODES_FILE = Path('meta/episodes/chunk-000/file-000.parquet')
TASKS_FILE = Path('meta/tasks.parquet')
INFO_FILE = Path('meta/info.json')
STATISTICS_FILE = Path('meta/stats.json')
LONGEST_LIST = 100  # characters of the names that a line tells
QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
# What LeRobot counts by.
INDICES = {
    'timestamp': Feature('float32', (1,), None),
    'frame_index': Feature('int64', (1,), None),
    'episode_index': Feature('int64', (1,), None),
    'index': Feature('int64', (1,), None),
    'task_index': Feature('int64', (1,), None),
}
# Every file is the first of the first chunk.
PLACE = {
    'data/chunk_index': 0,
    'data/file_index': 0,
    'meta/episodes/chunk_index': 0,
    'meta/episodes/file_index': 0,
}


class WrittenDataset(NamedTuple):
    """What was written: numbers of episodes and frames, and what was left out, in words."""

    episodes: int
    frames: int
    remarks: tuple[str, ...]


class _EpisodeWriter:
    """Writes the frames of episodes to one file, and keeps a row for each episode."""

    def __init__(self, path: Path, fps: int) -> None:
        self._path = path
        self._fps = fps
        self._parquet: pq.ParquetWriter | None = None
        self.features: dict[str, Feature] = {}
        self.rows: list[dict[str, Any]] = []  # of episodes.parquet
        self.frames = 0

    def write_episode(
        self, frames: Frames, task: str, task_index: int, recording: str
    ) -> None:
        """Add an episode; ConfigError if its features are not those of the first one."""
        self._check_features(frames, recording)
        count = len(frames.values['action'])
        number = len(self.rows)
        first = self.frames
        index = np.arange(count)
        values = {
            **frames.values,
            'timestamp': (index / self._fps).astype(np.float32)[:, None],
            'frame_index': index[:, None],
            'episode_index': np.full((count, 1), number),
            'index': first + index[:, None],
            'task_index': np.full((count, 1), task_index),
        }
        table = pa.table({name: make_column(values[name]) for name in self.features})
        if self._parquet is None:
            self._parquet = pq.ParquetWriter(
                self._path, table.schema, compression='zstd'
            )
        self._parquet.write_table(table)
        self.frames += count
        row: dict[str, Any] = {
            'episode_index': number,
            'tasks': [task],
            'length': count,
            'dataset_from_index': first,
            'dataset_to_index': self.frames,
            'recording': recording,
            **PLACE,
        }
        for name in self.features:
            for kind, statistic in compute_statistics(values[name]).items():
                row[f'stats/{name}/{kind}'] = statistic.tolist()
        self.rows.append(row)

    def _check_features(self, frames: Frames, recording: str) -> None:
        features = {**frames.features, **INDICES}
        if not self.features:
            self.features = features
        for name in [*self.features, *features]:
            first = self.features.get(name)
            found = features.get(name)
            if found != first:
                raise ConfigError(
                    'run',
                    f'recordings alike: {_describe(name, first)} as in the first one',
                    f'{_describe(name, found)} in {recording}',
                )

    def close(self) -> None:
        """End the file, which cannot be read before."""
        if self._parquet is not None:
            self._parquet.close()


def _describe(name: str, feature: Feature | None) -> str:
    """Return a feature in words: its name, how many entries it has, and their names."""
    if feature is None:
        return f'no {name}'
    names = ', '.join(feature.names or ())
    what = shorten(names, LONGEST_LIST, placeholder=' ...')
    return f'{name} [{feature.shape[0]}] {what}'.strip()


def make_column(values: NDArray[Any]) -> pa.Array:
    """Return values, shape (f, k), as a column of f lists, or of numbers where k is 1."""
    column = pa.array(values.ravel())
    size = values.shape[1]
    if size == 1:
        return column
    return pa.FixedSizeListArray.from_arrays(column, size)


def compute_statistics(values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """
    Return what LeRobot knows of a feature: extremes, mean, deviation and quantiles over frames.

    `values` have shape (f, k), and each statistic (k,); `count` is f, shape (1,).
    """
    exact = values.astype(np.float64)
    statistics = {
        'min': values.min(axis=0),
        'max': values.max(axis=0),
        'mean': exact.mean(axis=0),
        'std': exact.std(axis=0),
        'count': np.array([len(values)]),
    }
    for share, quantile in zip(QUANTILES, np.quantile(exact, QUANTILES, axis=0)):
        statistics[f'q{round(100 * share):02d}'] = quantile
    return statistics


def write_dataset(
    runs: Iterable[tuple[LoadedRun, str]], fps: int, folder: Path
) -> WrittenDataset:
    """
    Write recordings, each with its task in words, to a dataset in a new folder.

    Parameters
    ----------
    runs
        Recordings of the same arm and contacts, read one after the other.
    fps
        Frames per second [Hz], a whole part of the rate of each recording.
    folder
        The folder, which is there once it is complete.

    Raises
    ------
    ConfigError
        If the folder is there, the rate does not fit, or the recordings are not alike.
    RunError
        If a recording lacks poses or forces.

    """
    tasks: list[str] = []
    remarks: list[str] = []
    robot = None
    with make_whole_folder(folder) as partial:
        for path in (DATA_FILE, EPISODES_FILE):
            (partial / path).parent.mkdir(parents=True)
        writer = _EpisodeWriter(partial / DATA_FILE, fps)
        for run, task in runs:
            robot = Path(run.setup.controller.robot.urdf).stem or robot
            if task not in tasks:
                tasks.append(task)
            series = SampleSeries(run)
            recording = find_run_folder(run.folder).name
            for frames in series.cut_frames(fps):
                writer.write_episode(frames, task, tasks.index(task), recording)
            remarks += describe_left_out(run, series.left_out)
        writer.close()
        _write_metadata(partial, writer, tasks, fps, robot)
    return WrittenDataset(len(writer.rows), writer.frames, tuple(remarks))


def describe_left_out(run: LoadedRun, features: Sequence[str]) -> list[str]:
    """Return a line for what a recording lacks, and one for its images, where there are any."""
    lines = []
    if features:
        lines.append(f'{run.folder}: not in the recording: {", ".join(features)}')
    if run.content is not None and run.content.images:
        images = ', '.join(f'/{name}' for name in run.content.images)
        lines.append(f'{run.folder}: images are left out: {images}')
    return lines


def _write_metadata(
    folder: Path,
    writer: _EpisodeWriter,
    tasks: Sequence[str],
    fps: int,
    robot: str | None,
) -> None:
    """Write all files but that of the frames, whose statistics are read from it."""
    pd.DataFrame(writer.rows).to_parquet(folder / EPISODES_FILE, index=False)
    indices = pd.DataFrame(
        {'task_index': range(len(tasks))}, index=pd.Index(tasks, name='task')
    )
    indices.to_parquet(folder / TASKS_FILE)
    statistics = {}
    for name, feature in writer.features.items():
        column = pq.read_table(folder / DATA_FILE, columns=[name])[name]
        values = read_column(column, feature)
        of_feature = compute_statistics(values)
        statistics[name] = {kind: value.tolist() for kind, value in of_feature.items()}
    replace_json_file(folder / STATISTICS_FILE, statistics)
    episodes = len(writer.rows)
    info = {
        'codebase_version': VERSION,
        'robot_type': robot,
        'total_episodes': episodes,
        'total_frames': writer.frames,
        'total_tasks': len(tasks),
        'chunks_size': 1000,
        'data_files_size_in_mb': 100,
        'video_files_size_in_mb': 200,
        'fps': fps,
        'splits': {'train': f'0:{episodes}'},
        'data_path': 'data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet',
        'video_path': None,
        'features': {name: each.describe() for name, each in writer.features.items()},
    }
    replace_json_file(folder / INFO_FILE, info)


def read_column(column: pa.ChunkedArray, feature: Feature) -> NDArray[Any]:
    """Return a column of `make_column` as an array, shape (f, k)."""
    array = column.combine_chunks()
    if feature.shape != (1,):
        array = array.flatten()
    return array.to_numpy().reshape(-1, *feature.shape)
