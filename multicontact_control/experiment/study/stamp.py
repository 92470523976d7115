"""What code a result comes from: a result of other code is no longer the one asked for."""

from __future__ import annotations

from functools import cache
import hashlib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

# Of multicontact_control: what only shows, talks or listens decides no outcome, and of
# experiment/ only this does.
WITHOUT = ('cli', 'client.py', 'nodes', 'tools')
DECISIVE = (
    'claims.py', 'closed_loop.py', 'faults/fault.py', 'faults/in_process.py',
    'faults/judge.py', 'faults/situation.py', 'faults/vocabulary.py', 'judge.py', 'metrics.py',
    'oscillation.py', 'overrides.py', 'recording.py', 'scenario.py', 'study/jobs.py',
    'study/measure.py', 'study/presets/faults/jobs.py', 'study/presets/laws/jobs.py',
    'summary.py')
LIBRARIES = ('mujoco', 'numba', 'numpy', 'pin', 'pybullet', 'scipy')


@cache
def code_stamp() -> str:
    """Return a hash over the sources and libraries that decide what a run gives."""
    package = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for folder in (package, package.parent / 'sim_bridge'):
        for path in sorted(folder.rglob('*.py')):
            name = path.relative_to(folder)
            if folder != package or _decides(name):
                digest.update(f'{folder.name}/{name.as_posix()}\0'.encode())
                digest.update(path.read_bytes())
    for library in LIBRARIES:
        digest.update(f'{library} {_version(library)}\0'.encode())
    return digest.hexdigest()


def _decides(name: Path) -> bool:
    """Return whether a module of multicontact_control decides what a run gives."""
    if name.parts[0] == 'experiment':
        return name.relative_to('experiment').as_posix() in DECISIVE
    return name.parts[0] not in WITHOUT


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:  # there, but not from a wheel
        return ''
