"""`multicontact faults`: many faults in every situation, judged and tabled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from multicontact_control.errors import ConfigError, counted
from multicontact_control.experiment.faults.fault import PHASES, PROCESS, START, TWO
from multicontact_control.experiment.faults.judge import FaultRow
from multicontact_control.experiment.faults.vocabulary import faults_of, pairs_of_faults
from multicontact_control.experiment.scenario import plants_of
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.measure import largest_known, middle_known
from multicontact_control.experiment.study.page import Page, Section
from multicontact_control.experiment.study.presets.faults.jobs import (
    FaultJob,
    PHASE_TIMES,
    run_fault_job,
)
from multicontact_control.experiment.study.study import Study
from multicontact_control.experiment.study.table import Column, format_number, Line, Listing
import numpy as np

SEEDS = 14
PAIRS, QUICK_PAIRS = 300, 12  # of faults at the same time
FAULTS_PER_JOB = 12
COLUMNS = (
    Column('input', number=False), Column('kind', number=False), Column('n', 'n'),
    Column('reaction', number=False), Column('to safe [ms]', 'safe ms', spare=True),
    Column('force [N]', 'N'), Column('torque', 'torque', spare=True),
    Column('off command [ms]: median', 'off ms', spare=True), Column('largest', 'off ms'),
    Column('changes', 'changes', spare=True), Column('short', number=False),
    Column('safe', number=False))
SAFE = 11  # place of that column


def situation(
    number: int, plants: Sequence[str], phases: Sequence[str] = PHASES,
) -> tuple[str, str]:
    """Return plant and phase of the number-th seed of a kind: all pairs in turn."""
    return plants[number % len(plants)], phases[number // len(plants) % len(phases)]


@dataclass(frozen=True)
class FaultStudy(Study[FaultJob, list[FaultRow]]):
    """Kinds of faults and seeds, in the situations in turn."""

    seed: int = 0  # from which those of the faults count
    quick: bool = False  # one fault of each kind
    plants: tuple[str, ...] = field(default_factory=plants_of)

    title = 'faults'
    name = 'faults'
    measure = staticmethod(run_fault_job)
    unit = 'jobs'

    def check(self) -> None:
        """Check the seed; ConfigError if it is negative."""
        if self.seed < 0:
            raise ConfigError('seed', 'a whole number >= 0', self.seed)

    @property
    def _situations(self) -> int:
        return len(self.plants) * len(PHASES)

    def grid(self) -> Mapping[str, Sequence[Any]]:
        """Return kinds, seeds and situations."""
        return {
            'kinds': [f'{source} {kind}' for kind, source in faults_of(PROCESS)],
            'seeds': range(self.seed, self.seed + (self._situations if self.quick else SEEDS)),
            'plants': self.plants, 'phases': PHASES,
            'pairs of faults at once': range(QUICK_PAIRS if self.quick else PAIRS)}

    def jobs(self) -> list[FaultJob]:
        """
        Return the faults, up to 12 in a job, early phases first.

        In this order a worker that has got to one phase only has to go on to the next.
        """
        places: dict[tuple[str, str], list[tuple[Any, ...]]] = {
            (plant, phase): [] for phase in sorted(PHASE_TIMES, key=PHASE_TIMES.__getitem__)
            for plant in self.plants}
        for index, (name, fault) in enumerate(faults_of(PROCESS).items()):
            phases = (START, *PHASES) if fault.from_start else PHASES
            # One of each, yet in every situation.
            for number in (index % self._situations,) if self.quick else range(SEEDS):
                places[situation(number, self.plants, phases)].append((*name, self.seed + number))
        pairs = pairs_of_faults(QUICK_PAIRS if self.quick else PAIRS, self.seed)
        for number, (one, other) in enumerate(pairs):
            places[situation(number, self.plants)].append(
                (one.kind, one.input, self.seed + number, other.kind, other.input))
        return [FaultJob(plant, phase, self.seed, tuple(faults[i:i + FAULTS_PER_JOB]))
                for (plant, phase), faults in places.items()
                for i in range(0, len(faults), FAULTS_PER_JOB)]

    def content(self, run: JobRun[FaultJob]) -> list[FaultRow]:
        """Return what became of every fault, by kind and seed."""
        rows = [FaultRow(**row) for job in self.jobs() for row in run.metrics(job)['rows']]
        order = {fault: i for i, fault in enumerate(faults_of(PROCESS))}
        return sorted(rows, key=lambda row: (
            order.get((row.kind, row.input), len(order)), row.seed))

    def tables(self, content: list[FaultRow], run: JobRun[FaultJob]) -> Mapping[str, Any]:
        """Return ``faults.json``."""
        return {f'{self.name}.json': {'faults': [asdict(row) for row in content]}}

    def page(self, content: list[FaultRow], folder: Path) -> Page:
        """Return a line for each kind, and every fault that was not safe."""
        unsafe = [row for row in content if not row.safe]
        kinds = {(row.input, row.kind) for row in content}
        return Page(
            'Faults of inputs and plant', [Section('Faults by kind', _listing(content))],
            warnings=[f'{what}: {row.plant}, {row.phase}, {row.input} {row.kind}, '
                      f'seed {row.seed}: {why}' for row in content
                      for what, why in (('not safe', row.problems), ('short', row.shortfalls))
                      if why],
            findings=[f'{counted(len(content), "faults")} of {counted(len(kinds), "kinds")}, '
                      f'{len(unsafe)} unsafe, '
                      f'{sum(bool(row.shortfalls) for row in content)} short of what the arm '
                      f'should do; {_distribution(content)}'])


def _distribution(rows: Sequence[FaultRow]) -> str:
    """Return how long forces were off their commands, in words."""
    times = [1e3 * row.off_command_s for row in rows if row.off_command_s >= 0.0]
    if not times:
        return 'time off command not known'
    p50, p90, p99 = np.percentile(times, [50.0, 90.0, 99.0])
    return (f'off command in {100.0 * np.mean(np.array(times) > 0.0):.0f} % of them, for '
            f'{p50:.0f} / {p90:.0f} / {p99:.0f} / {max(times):.0f} ms (p50, p90, p99, largest)')


def _listing(rows: Sequence[FaultRow]) -> Listing:
    """Return one line per kind."""
    groups: dict[tuple[str, str], list[FaultRow]] = {}
    for row in rows:
        groups.setdefault(('' if row.kind == TWO else row.input, row.kind), []).append(row)
    lines = []
    for (source, kind), group in groups.items():
        never = any(row.time_to_safe_s < 0.0 for row in group)
        unsafe = sum(not row.safe for row in group)
        short = sum(bool(row.shortfalls) for row in group)
        off = [1e3 * row.off_command_s for row in group if row.off_command_s >= 0.0]
        lines.append(Line([
            source, kind, str(len(group)), ', '.join(sorted({row.reaction for row in group})),
            'never' if never else f'{1e3 * max(row.time_to_safe_s for row in group):.0f}',
            f'{max(row.peak_force_n for row in group):.1f}',
            f'{max(row.peak_torque_fraction for row in group):.2f}',
            format_number(middle_known(off), 0), format_number(largest_known(off), 0),
            str(max(row.transitions for row in group)), f'{short}' if short else '-',
            f'{unsafe} not' if unsafe else 'yes'], not unsafe))
    return Listing(COLUMNS, lines, verdict=SAFE)
