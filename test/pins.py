"""
What a redesign must not change: torques, summaries and study tables, kept in ``data/pins.json``.

`test_pins` compares them; ``python test/pins.py 'REASON'`` pins them anew.
"""

from __future__ import annotations

from collections import defaultdict
import json
from pathlib import Path
import subprocess
import sys
import tempfile

from canonical_runs import run_of, summary_of
from multicontact_control.runs.scenario import resolve
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / 'test' / 'data' / 'pins.json'
EVERY = 500  # ticks, between two torques that are kept
SETUPS = {
    f'{scenario}, preset {preset}, {plant}, {"supervised" if supervised else "bare"}': (
        scenario,
        preset,
        plant,
        supervised,
    )
    for scenario, preset in (('quick', 'paper'), ('disturbance', 'best'))
    for plant in ('rigid', 'puma')
    for supervised in (False, True)
}
SUMMARIES = [
    name for name in SETUPS if 'puma, supervised' in name or 'paper, rigid, b' in name
]
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
    return {
        'sha256': summary_of(setup, supervised=supervised)['trajectory_sha256'],
        'torque_share': (data.torque[::EVERY] / setup.controller.torque_limit).tolist(),
    }


def summary(name: str) -> dict:
    """Return all numbers of a run's ``summary.json`` but those of timing."""
    setup, supervised = _resolved(name)
    return dict(
        _numbers(json.loads(json.dumps(summary_of(setup, supervised=supervised))))
    )


def study(name: str) -> dict:
    """Return the table of a small study: for each measure the count and the mean of its cells."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [
                sys.executable,
                '-m',
                'multicontact_control.cli',
                'study',
                *STUDIES[name].split(),
                '--out',
                folder,
            ],
            cwd=ROOT,
            check=True,
            stdout=subprocess.DEVNULL,
        )
        values = defaultdict(list)
        for path in Path(folder, 'cells').glob('*.json'):
            for key, value in _numbers(json.loads(path.read_text())['metrics']):
                values[''.join(c for c in key if not c.isdigit())].append(value)
    return {
        key: [len(some), float(np.mean(some))] for key, some in sorted(values.items())
    }


def _numbers(content, path=''):
    """Yield the path and the value of every number and truth value."""
    if isinstance(content, dict | list):
        items = content.items() if isinstance(content, dict) else enumerate(content)
        for key, value in items:
            if key not in VOLATILE:
                yield from _numbers(value, f'{path}.{key}')
    elif isinstance(content, bool | int | float):
        yield path, float(content)


def differences(pinned: dict, now: dict) -> list[str]:
    """Return a line for every number that is not the pinned one."""
    return [
        f'{key}: pinned {pinned.get(key)}, now {now.get(key)}'
        for key in sorted({*pinned, *now})
        if key not in pinned
        or key not in now
        or not np.allclose(pinned[key], now[key], rtol=1e-6, atol=1e-12)
    ]


def main() -> None:
    """Pin everything anew; the reason is the argument."""
    if len(sys.argv) != 2 or sys.argv[1].startswith('-'):
        sys.exit(__doc__)
    reason = sys.argv[1]
    reasons = json.loads(FILE.read_text())['reasons']
    FILE.write_text(
        json.dumps(
            {
                'reasons': [*reasons, reason],
                **{
                    kind: {name: compute(name) for name in names}
                    for kind, names, compute in (
                        ('trajectories', SETUPS, trajectory),
                        ('summaries', SUMMARIES, summary),
                        ('studies', STUDIES, study),
                    )
                },
            },
            indent=1,
        )
        + '\n'
    )


if __name__ == '__main__':
    main()
