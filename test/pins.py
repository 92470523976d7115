"""
What a redesign must not change: torques, summaries and study tables, kept in ``data/pins.json``.

`test_pins` compares them; ``python test/pins.py 'REASON'`` pins them anew.
"""

from __future__ import annotations

from collections import defaultdict
import json
from pathlib import Path
import re
import subprocess
import sys
import tempfile

from canonical_runs import run_of, summary_of
from multicontact_control.runs.scenario import resolve
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / 'test' / 'data' / 'pins.json'
EVERY = 500  # ticks, between two torques that are kept
# Scenario, preset, plant, and whether the loop is supervised.
SETUPS = {
    'quick, preset paper, rigid, bare': ('quick', 'paper', 'rigid', False),
    'quick, preset paper, rigid, supervised': ('quick', 'paper', 'rigid', True),
    'quick, preset paper, puma, bare': ('quick', 'paper', 'puma', False),
    'quick, preset paper, puma, supervised': ('quick', 'paper', 'puma', True),
    'disturbance, preset best, rigid, bare': ('disturbance', 'best', 'rigid', False),
    'disturbance, preset best, rigid, supervised': (
        'disturbance',
        'best',
        'rigid',
        True,
    ),
    'disturbance, preset best, puma, bare': ('disturbance', 'best', 'puma', False),
    'disturbance, preset best, puma, supervised': ('disturbance', 'best', 'puma', True),
}
SUMMARIES = (
    'quick, preset paper, rigid, bare',
    'quick, preset paper, puma, supervised',
    'disturbance, preset best, puma, supervised',
)
STUDIES = {
    'compare': 'compare --quick --plants rigid',
    'laws': 'laws --quick --plants rigid',
    'map': 'map --quick --plants rigid',
    'robots': 'robots --set robot=panda',
    'sweep': 'stiffness --seeds 1',
    'tune': 'tune --law pi --plants rigid',
    'faults': 'faults --quick --plants rigid',
}
VOLATILE = ('timing', 'wall_s', 'error_at_s')


def _resolved(name: str):
    scenario, preset, plant, supervised = SETUPS[name]
    return resolve(scenario, plant=plant, preset=preset), supervised


def trajectory(name: str) -> dict:
    """Return the hash of a run, and its torques every 500 ticks over their limits."""
    setup, supervised = _resolved(name)
    data = run_of(setup, supervised=supervised).data
    shares = data.torque[::EVERY] / setup.controller.torque_limit
    return {
        'sha256': summary_of(setup, supervised=supervised)['trajectory_sha256'],
        'torque_share': shares.tolist(),
    }


def summary(name: str) -> dict:
    """Return all numbers of a run's ``summary.json`` but those of timing."""
    setup, supervised = _resolved(name)
    text = json.dumps(summary_of(setup, supervised=supervised))
    return dict(_numbers(json.loads(text)))


def study(name: str) -> dict:
    """Return the table of a small study: for each measure the count and the mean of its cells."""
    values = defaultdict(list)
    command = [sys.executable, '-m', 'multicontact_control.cli', 'study']
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [*command, *STUDIES[name].split(), '--out', folder],
            cwd=ROOT,
            check=True,
            stdout=subprocess.DEVNULL,
        )
        for path in Path(folder, 'cells').glob('*.json'):
            for key, value in _numbers(json.loads(path.read_text())['metrics']):
                measure = re.sub(r'\d', '', key)
                values[measure].append(value)
    table = {}
    for measure, numbers in sorted(values.items()):
        table[measure] = [len(numbers), float(np.mean(numbers))]
    return table


def _numbers(content, path=''):
    """Yield the path and the value of every number and truth value."""
    if isinstance(content, list):
        content = dict(enumerate(content))
    if isinstance(content, dict):
        for key, value in content.items():
            if key not in VOLATILE:
                yield from _numbers(value, f'{path}.{key}')
    elif isinstance(content, bool | int | float):
        yield path, float(content)


def differences(pinned: dict, now: dict) -> list[str]:
    """Return a line for every number that is not the pinned one."""
    lines = []
    for key in sorted({*pinned, *now}):
        old = pinned.get(key, np.nan)
        new = now.get(key, np.nan)
        if not np.allclose(old, new, rtol=1e-6, atol=1e-12):
            lines.append(f'{key}: pinned {old}, now {new}')
    return lines


def main() -> None:
    """Pin everything anew; the reason is the argument."""
    if len(sys.argv) != 2 or sys.argv[1].startswith('-'):
        sys.exit(__doc__)
    reasons = json.loads(FILE.read_text())['reasons']
    pinned = {
        'reasons': [*reasons, sys.argv[1]],
        'trajectories': {name: trajectory(name) for name in SETUPS},
        'summaries': {name: summary(name) for name in SUMMARIES},
        'studies': {name: study(name) for name in STUDIES},
    }
    FILE.write_text(json.dumps(pinned, indent=1) + '\n')


if __name__ == '__main__':
    main()
