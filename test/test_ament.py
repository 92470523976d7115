"""ament's flake8 and pep257 in their own configuration, as in every ROS 2 package."""

from pathlib import Path

import pytest

pytestmark = [pytest.mark.nightly, pytest.mark.linter]

ROOT = Path(__file__).resolve().parents[1]
SOURCES = [str(ROOT / name)
           for name in ('multicontact_control', 'sim_bridge', 'test', 'benchmarks', 'docs',
                        'setup.py')]


@pytest.mark.flake8
def test_flake8():
    ament_flake8 = pytest.importorskip('ament_flake8.main', reason='ament_flake8 not installed')
    code, errors = ament_flake8.main_with_errors(argv=SOURCES)
    assert code == 0, f'{len(errors)} errors:\n' + '\n'.join(errors)


@pytest.mark.pep257
def test_pep257(capsys):
    ament_pep257 = pytest.importorskip('ament_pep257.main', reason='ament_pep257 not installed')
    code = ament_pep257.main(argv=SOURCES)
    lines = [x for x in ''.join(capsys.readouterr()).splitlines() if not x.startswith('checking')]
    assert code == 0, '\n'.join(lines)
