"""ament's pep257, in its own configuration, as in every ROS 2 package."""

import logging
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = [str(ROOT / name)
           for name in ('multicontact_control', 'sim_bridge', 'test', 'benchmarks', 'docs',
                        'setup.py')]


@pytest.mark.linter
@pytest.mark.pep257
def test_pep257(capsys, caplog):
    ament_pep257 = pytest.importorskip('ament_pep257.main', reason='ament_pep257 not installed')
    caplog.set_level(logging.WARNING)  # or it names every file
    code = ament_pep257.main(argv=SOURCES)
    lines = [x for x in ''.join(capsys.readouterr()).splitlines() if not x.startswith('checking')]
    assert code == 0, '\n'.join(lines)
