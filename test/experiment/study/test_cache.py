from multicontact_control.errors import ConfigError
from multicontact_control.experiment.study.cache import JobCache, prepare_job_folder
from multicontact_control.experiment.study.jobs import job_of, JobResult
import numpy as np
import pytest

CELL = job_of('quick', 'rigid', 0)


def test_store_returns_what_was_saved_with_and_without_traces(tmp_path):
    store = JobCache(tmp_path)
    assert store.load('a') is None
    store.save('a', CELL, JobResult({'x': 1.5}, {'series': np.arange(6.0).reshape(3, 2)}, 0.5))
    store.save('b', CELL, JobResult({'x': None}, {}, 0.25))
    loaded = store.load('a')
    assert (loaded.metrics, loaded.wall_time) == ({'x': 1.5}, 0.5)
    np.testing.assert_array_equal(loaded.traces['series'], [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]])
    assert store.load('b') == JobResult({'x': None}, {}, 0.25)
    assert not (store.folder / 'b.npz').exists()


def test_store_takes_no_result_of_another_schema(tmp_path):
    store = JobCache(tmp_path)
    store.save('a', CELL, JobResult({}, {}, 0.5))
    path = store.folder / 'a.json'
    path.write_text(path.read_text().replace('"schema": 2', '"schema": 1'))
    assert not store.finished('a')


def test_job_folder_keeps_strangers_and_drops_jobs_only_when_told(tmp_path):
    JobCache(tmp_path).save('a', CELL, JobResult({}, {}, 0.5))
    prepare_job_folder(tmp_path, overwrite=False)
    assert JobCache(tmp_path).finished('a')
    prepare_job_folder(tmp_path, overwrite=True)
    assert not JobCache(tmp_path).finished('a')
    other = tmp_path / 'other'
    other.mkdir()
    (other / 'notes.txt').write_text('mine')
    with pytest.raises(ConfigError, match='other files'):
        prepare_job_folder(other, overwrite=True)
    prepare_job_folder(other, overwrite=False, results=['notes.txt'])
    assert (other / 'notes.txt').read_text() == 'mine'
