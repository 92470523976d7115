"""TSID beside the control law: what its script says, and what happens where it is not."""

from importlib.util import find_spec
import os
import sys

from multicontact_control.errors import RunError
from multicontact_control.experiment.bench.against_tsid import (
    bench_tsid,
    compare,
    next_answer,
    SCRIPT,
)
import numpy as np
import pytest

TSID_PYTHON = os.environ.get('MULTICONTACT_TSID_PYTHON', '')


def answer(tick, unsolved=0):
    return {'tick_us': [tick] * 4, 'dynamics_us': [5.0] * 4, 'unsolved': unsolved}


def test_laps_are_put_side_by_side():
    floor = np.full(4, 3.0)
    laps = [((np.full(4, law), floor), answer(20.0, unsolved))
            for law, unsolved in ((10.0, 0), (12.0, 2), (11.0, 0))]
    found = compare({'variables': 12}, laps)
    assert (found['ratio'], found['ratio_spread']) == (0.55, pytest.approx(0.1818))
    assert (found['laps'], found['unsolved'], found['problem']) == (3, 2, {'variables': 12})
    assert [found[name]['p50'] for name in (
        'law_us', 'dynamics_us', 'tsid_us', 'tsid_dynamics_us')] == [11.0, 3.0, 20.0, 5.0]


def test_answers_are_found_among_what_else_is_printed():
    lines = iter(['[tick] resized\n', '{"unsolved": 0}\n', '\n', '{"unsolved": 1}\n'])
    assert [next_answer(lines) for _ in range(3)] == [{'unsolved': 0}, {'unsolved': 1}, None]


def stand_in(folder, *lines):
    """Return a Python that takes a few lines in the place of the script."""
    path = folder / 'python'
    path.write_text('\n'.join([f'#!{sys.executable}', 'import sys', *lines]), encoding='utf-8')
    path.chmod(0o755)
    return str(path)


@pytest.mark.slow
def test_script_and_law_take_turns(tmp_path):
    python = stand_in(
        tmp_path, f'assert sys.argv[1:3] == ["-I", {str(SCRIPT)!r}]', 'print("hello")',
        """print('{"variables": 12}', flush=True)""", 'for _ in sys.stdin:',
        """    print('{"tick_us": [80.0], "dynamics_us": [9.0], "unsolved": 0}', flush=True)""")
    found, note = bench_tsid(python, 100)
    assert note == ''
    assert found['problem'] == {'variables': 12}
    assert found['ratio'] == pytest.approx(found['law_us']['p50'] / 80.0, rel=0.5)


@pytest.mark.slow
def test_script_that_ends_too_early_is_named(tmp_path):
    python = stand_in(tmp_path, """print('{"variables": 12}', flush=True)""",
                      'sys.stdin.readline()', 'sys.exit("no more")')
    with pytest.raises(RunError, match="TSID's tick: expected the times of a lap, found no more"):
        bench_tsid(python, 100)


@pytest.mark.slow
@pytest.mark.skipif(find_spec('tsid') is not None, reason='it is there')
def test_environment_without_tsid_is_a_note():
    found, note = bench_tsid(sys.executable, 100)
    assert found is None
    assert note.startswith("tsid: not found, ModuleNotFoundError: No module named 'tsid'; python3")


@pytest.mark.slow
@pytest.mark.skipif(not TSID_PYTHON, reason='MULTICONTACT_TSID_PYTHON does not say where it is')
def test_tsid_solves_every_sample():
    found, note = bench_tsid(TSID_PYTHON, 100)
    assert note == ''
    assert found['unsolved'] == 0
    assert found['problem']['variables'] == 12
    assert 0.0 < found['tsid_dynamics_us']['p50'] < found['tsid_us']['p50']
    assert 0.05 < found['ratio'] < 20.0
