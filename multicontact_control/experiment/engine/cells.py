"""What a cell is, what it leaves, and who can carry it out."""

from __future__ import annotations

from collections.abc import Callable, Generator, Hashable, Mapping, Sequence
from dataclasses import dataclass
import hashlib
import json
from typing import Any, Protocol, TypeVar

from multicontact_control.arrays import Matrix
from multicontact_control.experiment.engine.stamp import code_stamp
from multicontact_control.experiment.scenario import resolve, Setup
from sim_bridge.puma560 import load_robot

CELL_SCHEMA = 2  # to be raised when a cell's result means something else than before


class Cell(Hashable, Protocol):
    """One piece of work, described in full; it can be pickled."""

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


CellT = TypeVar('CellT', bound=Cell)


@dataclass(frozen=True)
class CellResult:
    """
    What a cell leaves.

    Attributes
    ----------
    metrics
        JSON values; the same whatever ran the cell.
    traces
        Series by name, kept in single precision; may be empty.
    wall_time
        Of the run [s].

    """

    metrics: dict[str, Any]
    traces: dict[str, Matrix]
    wall_time: float


@dataclass(frozen=True)
class LostCell:
    """
    A cell without a result, because whatever process ran it died.

    Attributes
    ----------
    reason
        What happened.

    """

    reason: str


Outcome = CellResult | LostCell
Notify = Callable[[str], None]


class Executor(Protocol):
    """Carries out cells somewhere."""

    def results(
        self, task: Callable[[CellT], CellResult], cells: Sequence[CellT], notify: Notify,
    ) -> Generator[tuple[CellT, Outcome], None, None]:
        """
        Yield the outcome of every cell, in whatever order they come.

        Parameters
        ----------
        task
            An importable function.
        cells
            What to call it with, each once.
        notify
            Is told in one line what the user should know, e.g. that a worker died.

        """
        ...


def content_key(kind: str, content: Mapping[str, Any]) -> str:
    """
    Return the key of a cell.

    Parameters
    ----------
    kind
        Of the work: the same content is another cell for other work.
    content
        JSON values that decide the outcome together with the code.

    """
    text = json.dumps({'schema': CELL_SCHEMA, 'kind': kind, 'code': code_stamp(), **content},
                      sort_keys=True, separators=(',', ':'))
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def setup_content(setup: Setup) -> dict[str, Any]:
    """Return what decides the outcome of a run, as JSON values."""
    urdf = (setup.urdf_dir / setup.controller.robot.urdf).read_bytes()
    configurations = {
        name: getattr(setup, name).model_dump(mode='json')
        for name in ('scenario', 'controller', 'noise_estimator', 'plant')}
    return {'seed': setup.seed, 'urdf': hashlib.sha256(urdf).hexdigest(),
            'arm': load_robot().model_dump(mode='json'), **configurations}


@dataclass(frozen=True, slots=True, order=True)
class RunCell:
    """
    One run of a scenario; made by `cell_of`.

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
        """Return the hash of all that decides the outcome; see `Cell.key`."""
        return content_key('run', {
            'supervised': self.supervised, **setup_content(self.setup())})

    def describe(self) -> dict[str, Any]:
        """Return scenario, plant, seed and what differs from their files."""
        return {'scenario': self.scenario, 'plant': self.plant, 'seed': self.seed,
                'overrides': json.loads(self.overrides), 'supervised': self.supervised}


def cell_of(
    scenario: str, plant: str, seed: int, *, duration: float | None = None,
    noise_estimator: Mapping[str, Any] | None = None,
    controller: Mapping[str, Any] | None = None,
    plant_overrides: Mapping[str, Any] | None = None,
    scenario_overrides: Mapping[str, Any] | None = None, supervised: bool = False,
) -> RunCell:
    """Return a cell; the arguments are those of `resolve` and `run_in_process`."""
    given = {'duration': duration, 'noise_estimator': noise_estimator, 'controller': controller,
             'plant_overrides': plant_overrides, 'scenario_overrides': scenario_overrides}
    kept = {name: value for name, value in given.items() if value}
    return RunCell(scenario, plant, seed,
                   json.dumps(kept, sort_keys=True, separators=(',', ':')), supervised)
