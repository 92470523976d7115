"""
Runs that many tests look at: each is computed once, whichever worker asks for it first.

They are kept in ``.pytest_cache/runs`` by a hash of their configuration, seed and sources.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
import pickle

from multicontact_control.experiment.closed_loop import LoopResult, run_in_process
from multicontact_control.experiment.results import summarise
from multicontact_control.experiment.scenario import Setup
from multicontact_control.experiment.study.jobs import content_key, setup_content

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / '.pytest_cache' / 'runs'
_memory: dict[str, LoopResult] = {}


def run_of(setup: Setup, *, supervised: bool = True) -> LoopResult:
    """Return the result of `run_in_process`; do not change its arrays."""
    key = content_key('test', {'supervised': supervised, **setup_content(setup)})
    if key not in _memory:
        FOLDER.mkdir(parents=True, exist_ok=True)
        path = FOLDER / f'{key}.pickle'
        with (FOLDER / f'{key}.lock').open('w') as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                partial = path.with_suffix(f'.{os.getpid()}')
                partial.write_bytes(pickle.dumps(run_in_process(setup, supervised=supervised)))
                partial.replace(path)
        _memory[key] = pickle.loads(path.read_bytes())
    return _memory[key]


def summary_of(setup: Setup, *, supervised: bool = True) -> dict:
    """Return the content of its ``summary.json``."""
    result = run_of(setup, supervised=supervised)
    return summarise(result.data, setup, mode='in_process', timing={},
                     ended_early=result.ended_early,
                     events=result.events if supervised else None)
