"""What a job is, and the key by which its result is kept."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
import hashlib
from importlib.metadata import PackageNotFoundError, version
import json
from pathlib import Path
from typing import Any, ClassVar, Protocol

from multicontact_control.experiment.scenario import resolve, Setup
from sim_bridge.robots import find_robot

LIBRARIES = ('mujoco', 'numba', 'numpy', 'pin', 'pybullet', 'scipy')


class Job(Protocol):
    """One piece of work: a frozen dataclass that describes it in full and can be pickled."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def key(self) -> str:
        """Return the hash of all that decides the outcome; ConfigError if it is not acceptable."""
        ...

    def run(self) -> dict[str, Any]:
        """Do the work in this process; return what was measured as JSON values."""
        ...


@cache
def code_stamp() -> str:
    """Return a hash over all sources and the versions of the numerical libraries."""
    package = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for folder in (package, package.parent / 'sim_bridge'):
        for path in sorted(folder.rglob('*.py')):
            digest.update(f'{path.relative_to(folder.parent).as_posix()}\0'.encode())
            digest.update(path.read_bytes())
    for library in LIBRARIES:
        with suppress(PackageNotFoundError):  # an extra, or not from a wheel
            digest.update(f'{library} {version(library)}\0'.encode())
    return digest.hexdigest()


def content_key(kind: str, content: Mapping[str, Any]) -> str:
    """Return the key of a kind of work on JSON values, which with the code decide the outcome."""
    text = json.dumps({'kind': kind, 'code': code_stamp(), **content}, sort_keys=True,
                      separators=(',', ':'))
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def setup_content(setup: Setup) -> dict[str, Any]:
    """Return what decides the outcome of a run, as JSON values."""
    urdf = (setup.urdf_dir / setup.controller.robot.urdf).read_bytes()
    configurations = {
        name: getattr(setup, name).model_dump(mode='json')
        for name in ('scenario', 'controller', 'noise_estimator', 'plant')}
    return {'seed': setup.seed, 'urdf': hashlib.sha256(urdf).hexdigest(),
            'arm': repr(find_robot(setup.plant.robot).arm), **configurations}


@dataclass(frozen=True, slots=True)
class RunJob:
    """One run of a scenario; made by `job_of`."""

    scenario: str
    plant: str
    seed: int
    overrides: str = '{}'  # canonical JSON of the other arguments of `resolve`
    supervised: bool = False
    surface_gone: tuple[float, float] | None = None  # from when to when the last one is away [s]

    def setup(self) -> Setup:
        """Return everything the run needs, checked."""
        return replace(_resolved(replace(self, seed=0)), seed=self.seed)

    def key(self) -> str:
        """Return the hash of all that decides the outcome; see `Job.key`."""
        content = _content(replace(self, seed=0))
        return content_key('run', {**content, 'seed': self.seed, 'supervised': self.supervised,
                                   'surface_gone': self.surface_gone})

    def run(self) -> dict[str, Any]:
        """Run it and measure it; see `measure_run`."""
        # Only here: what gives out the work to others needs neither kernels nor simulator.
        from multicontact_control.experiment.study.measure import measure_run

        return measure_run(self.setup(), self.supervised, self.surface_gone)


# Jobs that differ in their seed only follow each other: one is remembered.
@lru_cache(maxsize=1)
def _resolved(job: RunJob) -> Setup:
    return resolve(job.scenario, plant=job.plant, **json.loads(job.overrides))


@lru_cache(maxsize=1)
def _content(job: RunJob) -> dict[str, Any]:
    return setup_content(_resolved(job))


def job_of(
    scenario: str, plant: str, seed: int, *, supervised: bool = False,
    surface_gone: tuple[float, float] | None = None, **overrides: Any,
) -> RunJob:
    """Return a job; `overrides` are arguments of `resolve`."""
    kept = {name: value for name, value in overrides.items() if value}
    return RunJob(scenario, plant, seed, json.dumps(
        kept, sort_keys=True, separators=(',', ':')), supervised, surface_gone)
