from pathlib import Path
import shutil

from multicontact_control.experiment.study import stamp
import pytest
from source_imports import imports_of

ROOT = Path(__file__).parents[3]


def _stamp_of(root, monkeypatch):
    monkeypatch.setattr(stamp, '__file__', str(
        root / 'multicontact_control' / 'experiment' / 'study' / 'stamp.py'))
    return stamp.code_stamp.__wrapped__()


def test_stamp_follows_what_decides_an_outcome_and_nothing_else(tmp_path, monkeypatch):
    for package in ('multicontact_control', 'sim_bridge'):
        shutil.copytree(ROOT / package, tmp_path / package,
                        ignore=shutil.ignore_patterns('__pycache__'))
    before = _stamp_of(tmp_path, monkeypatch)
    assert before == _stamp_of(tmp_path, monkeypatch) == _stamp_of(ROOT, monkeypatch)
    for name in ('cli/run.py', 'client.py', 'experiment/page.py'):
        name = f'multicontact_control/{name}'
        (tmp_path / name).write_text('# other text')
    assert _stamp_of(tmp_path, monkeypatch) == before
    for name in ('multicontact_control/force/kalman.py', 'sim_bridge/plant.py',
                 'multicontact_control/experiment/metrics.py'):
        (tmp_path / name).write_text('# other text')
        after = _stamp_of(tmp_path, monkeypatch)
        assert after != before
        before = after


@pytest.mark.parametrize('task', [
    'measure', 'presets.faults.jobs', 'presets.laws.jobs'])
def test_stamp_covers_all_that_a_task_imports(task):
    graph = imports_of(ROOT)
    reached, ahead = set(), [f'multicontact_control.experiment.study.{task}']
    while ahead:
        module = ahead.pop()
        if module in graph and module not in reached:
            reached.add(module)
            ahead += graph[module]
    paths = [Path(*module.split('.')[1:]).with_suffix('.py') for module in reached
             if module.startswith('multicontact_control.')]
    left_out = {path.as_posix() for path in paths if not stamp._decides(path)
                and (ROOT / 'multicontact_control' / path).is_file()}
    assert left_out <= {'experiment/study/stamp.py'}
    assert len(paths) > 30
