"""ament's flake8, in its own configuration, as in every ROS 2 package."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = [str(ROOT / name)
           for name in ('multicontact_control', 'sim_bridge', 'test', 'docs', 'setup.py')]


@pytest.mark.flake8
@pytest.mark.linter
def test_flake8():
    ament_flake8 = pytest.importorskip('ament_flake8.main', reason='ament_flake8 not installed')
    code, errors = ament_flake8.main_with_errors(argv=SOURCES)
    assert code == 0, f'{len(errors)} errors:\n' + '\n'.join(errors)
