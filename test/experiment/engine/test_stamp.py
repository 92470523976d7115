from pathlib import Path
import shutil

from multicontact_control.experiment.engine import stamp

ROOT = Path(__file__).parents[3]


def _stamp_of(root, monkeypatch):
    monkeypatch.setattr(stamp, '__file__', str(
        root / 'multicontact_control' / 'experiment' / 'engine' / 'stamp.py'))
    return stamp.code_stamp.__wrapped__()


def test_stamp_follows_what_decides_an_outcome_and_nothing_else(tmp_path, monkeypatch):
    for package in ('multicontact_control', 'sim_bridge'):
        shutil.copytree(ROOT / package, tmp_path / package,
                        ignore=shutil.ignore_patterns('__pycache__'))
    before = _stamp_of(tmp_path, monkeypatch)
    assert before == _stamp_of(tmp_path, monkeypatch) == _stamp_of(ROOT, monkeypatch)
    for name in ('multicontact_control/cli/run.py', 'multicontact_control/client.py'):
        (tmp_path / name).write_text('# other text')
    assert _stamp_of(tmp_path, monkeypatch) == before
    for name in ('multicontact_control/force/kalman.py', 'sim_bridge/pybullet_plant.py'):
        (tmp_path / name).write_text('# other text')
        after = _stamp_of(tmp_path, monkeypatch)
        assert after != before
        before = after
