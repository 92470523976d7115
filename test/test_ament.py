"""ament's flake8 and pep257 in their own configuration, as in every ROS 2 package."""

import importlib
from pathlib import Path

import pytest

pytestmark = [pytest.mark.nightly, pytest.mark.linter]

ROOT = Path(__file__).resolve().parents[1]
SOURCES = (
    'multicontact_control',
    'sim_bridge',
    'test',
    'benchmarks',
    'docs',
    'examples',
    'setup.py',
)


@pytest.mark.parametrize('linter', ['ament_flake8', 'ament_pep257'])
def test_sources_are_as_ament_wants_them(linter, capsys):
    pytest.importorskip(linter, reason=f'{linter} is not installed')
    argv = [str(ROOT / name) for name in SOURCES]
    code = importlib.import_module(f'{linter}.main').main(argv=argv)
    printed = ''.join(capsys.readouterr()).splitlines()
    found = [line for line in printed if line.startswith(str(ROOT))]
    assert code == 0 or found
    for line in found:
        # ruff spaces the colon of a slice like an operator, as PEP 8 has it; E203 knows no slices.
        assert ' E203 ' in line
