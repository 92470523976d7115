"""What a job is, and what it leaves."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
import hashlib
import json
from typing import Any, Protocol, TypeVar

from multicontact_control.arrays import Matrix
from multicontact_control.experiment.scenario import resolve, Setup
from multicontact_control.experiment.study.stamp import code_stamp
from sim_bridge.robots import find_robot

JOB_SCHEMA = 2  # to be raised when a job's result means something else than before


class Job(Hashable, Protocol):
    """One piece of work, described in full; it can be pickled."""

    @property
    def plant(self) -> str:
        """Return the plant; jobs of one plant are alike in their speed."""
        ...

    @property
    def supervised(self) -> bool:
        """Return whether the law runs within its supervisor, as for `run_in_process`."""
        ...

    def setup(self) -> Setup:
        """Return the scenario in which it happens, checked."""
        ...

    def key(self) -> str:
        """
        Return the hash of all that decides the outcome, whatever files it was read from.

        Raises
        ------
        ConfigError
            If what is described is not acceptable.

        """
        ...

    def describe(self) -> dict[str, Any]:
        """Return what a reader of the result should know, as JSON values."""
        ...

    def simulated_time(self) -> float:
        """Return what its wall time grows with, about the time that is simulated [s]."""
        ...


JobT = TypeVar('JobT', bound=Job)


@dataclass(frozen=True)
class JobResult:
    """
    What a job leaves.

    Attributes
    ----------
    metrics
        JSON values; the same whatever ran the job.
    traces
        Series by name, kept in single precision; may be empty.
    wall_time
        Of the run [s].

    """

    metrics: dict[str, Any]
    traces: dict[str, Matrix]
    wall_time: float


def content_key(kind: str, content: Mapping[str, Any]) -> str:
    """Return the key of a kind of work on JSON values, which with the code decide the outcome."""
    text = json.dumps({'schema': JOB_SCHEMA, 'kind': kind, 'code': code_stamp(), **content},
                      sort_keys=True, separators=(',', ':'))
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def setup_content(setup: Setup) -> dict[str, Any]:
    """Return what decides the outcome of a run, as JSON values."""
    urdf = (setup.urdf_dir / setup.controller.robot.urdf).read_bytes()
    configurations = {
        name: getattr(setup, name).model_dump(mode='json')
        for name in ('scenario', 'controller', 'noise_estimator', 'plant')}
    return {'seed': setup.seed, 'urdf': hashlib.sha256(urdf).hexdigest(),
            'arm': find_robot(setup.plant.robot).arm.content(), **configurations}


@dataclass(frozen=True, slots=True, order=True)
class RunJob:
    """
    One run of a scenario; made by `job_of`.

    Attributes
    ----------
    scenario, plant, seed
        As for `resolve`.
    overrides
        Canonical JSON of the other arguments of `resolve`.
    supervised
        As for `run_in_process`.

    """

    scenario: str
    plant: str
    seed: int
    overrides: str = '{}'
    supervised: bool = False

    def setup(self) -> Setup:
        """Return everything the run needs, checked."""
        return resolve(self.scenario, plant=self.plant, seed=self.seed,
                       **json.loads(self.overrides))

    def key(self) -> str:
        """Return the hash of all that decides the outcome; see `Job.key`."""
        return content_key('run', {
            'supervised': self.supervised, **setup_content(self.setup())})

    def describe(self) -> dict[str, Any]:
        """Return scenario, plant, seed and what differs from their files."""
        return {'scenario': self.scenario, 'plant': self.plant, 'seed': self.seed,
                'overrides': json.loads(self.overrides), 'supervised': self.supervised}

    def simulated_time(self) -> float:
        """Return the length of the run [s]."""
        return self.setup().scenario.duration


def job_of(
    scenario: str, plant: str, seed: int, *, duration: float | None = None,
    noise_estimator: Mapping[str, Any] | None = None,
    controller: Mapping[str, Any] | None = None,
    plant_overrides: Mapping[str, Any] | None = None,
    scenario_overrides: Mapping[str, Any] | None = None, preset: str = '',
    supervised: bool = False,
) -> RunJob:
    """Return a job; the arguments are those of `resolve` and `run_in_process`."""
    given = {'duration': duration, 'noise_estimator': noise_estimator, 'controller': controller,
             'plant_overrides': plant_overrides, 'scenario_overrides': scenario_overrides,
             'preset': preset}
    kept = {name: value for name, value in given.items() if value}
    return RunJob(scenario, plant, seed,
                  json.dumps(kept, sort_keys=True, separators=(',', ':')), supervised)
