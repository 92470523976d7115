"""`multicontact soak`: hours of random commands and faults, in as many processes as there are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from multicontact_control.errors import check_all, ConfigError
from multicontact_control.experiment.scenario import plants_of
from multicontact_control.experiment.soak import PROBLEMS
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.page import Page, Section
from multicontact_control.experiment.study.presets.soak.graph_job import run_graph_soak_job
from multicontact_control.experiment.study.presets.soak.jobs import run_soak_job, SoakJob
from multicontact_control.experiment.study.study import Study
from multicontact_control.experiment.study.table import Column, Line, Listing
import numpy as np

WARM_UP = 10  # minutes, before which memory is not looked at
LARGEST_GROWTH = 2.0  # MB per simulated hour that is no leak
LARGEST_DRIFT = 0.2  # N between the first and the last quarter's error at rest, mean or rms
SHORT = ('unsafe', 'alt.', 'osc.', 'stuck')  # heads of PROBLEMS in a terminal
COLUMNS = (
    Column('plant', number=False), Column('seed', 'seed'), Column('hours', 'hours'),
    Column('episodes', 'epis.'), Column('helped', 'helped', spare=True),
    *(Column(name, short) for name, short in zip(PROBLEMS, SHORT, strict=True)),
    Column('memory [MB/h]', 'MB/h'),
    Column('error at rest [N]: first quarter', 'first N', spare=True), Column('last', 'last N'),
    Column('rms', 'first rms', spare=True), Column('last', 'last rms', spare=True),
    Column('good', number=False))
GOOD = 14  # place of that column


@dataclass(frozen=True)
class SoakStudy(Study[SoakJob, list[dict[str, Any]]]):
    """
    Soaks of some plants, which share the hours.

    Attributes
    ----------
    hours
        Simulated, of all together.
    plants
        Which.
    seed
        The first; every process has the next.
    parts
        Processes per plant.

    """

    hours: float = 1.0
    plants: tuple[str, ...] = field(default_factory=plants_of)
    seed: int = 0
    parts: int = 1

    graph: ClassVar[bool] = False
    title = 'soak'
    name = 'soak'
    measure = staticmethod(run_soak_job)
    unit = 'soaks'

    def check(self) -> None:
        """Check the options; ConfigError with all that are not acceptable."""
        def above(name: str, value: float, least: float) -> None:
            if not value >= least:
                raise ConfigError(name, f'a number >= {least:g}', value)

        check_all(lambda: above('hours', self.hours, 1.0 / 60.0),
                  lambda: above('seed', self.seed, 0), lambda: above('parts', self.parts, 1))

    def grid(self) -> Mapping[str, Sequence[Any]]:
        """Return plants and seeds."""
        return {'plants': self.plants, 'seeds': [job.seed for job in self.jobs()]}

    def jobs(self) -> list[SoakJob]:
        """Return the soaks, of equal length."""
        count = len(self.plants) * self.parts
        return [SoakJob(self.plants[k % len(self.plants)], self.seed + k, self.hours / count,
                        self.graph) for k in range(count)]

    def content(self, run: JobRun[SoakJob]) -> list[dict[str, Any]]:
        """Return what came of every soak."""
        return [{**job.describe(), **run.result(job).metrics} for job in run.kept(self.jobs())]

    def tables(
        self, content: list[dict[str, Any]], run: JobRun[SoakJob],
    ) -> Mapping[str, Any]:
        """Return ``soak.json``."""
        return {f'{self.name}.json': {'soaks': content}}

    def page(self, content: list[dict[str, Any]], folder: Path) -> Page:
        """Return a line for each soak, and all that should not have happened."""
        problems = [
            f'{what}: {soak["plant"]}, seed {soak["seed"]}, {text}' for soak in content
            for what in PROBLEMS for text in soak[what]]
        kinds = sum((Counter(soak['episodes']) for soak in content), Counter())
        hours = sum(soak['simulated_s'] for soak in content) / 3600.0
        what = 'hours over the graph' if self.graph else 'simulated hours'
        return Page(
            'Soak', [Section('Soaks', _listing(content))], warnings=problems,
            findings=[f'{hours:.2f} {what}: ' + ', '.join(
                f'{count} x {kind}' for kind, count in sorted(kinds.items()))])


class GraphSoakStudy(SoakStudy):
    """Soaks over ROS 2 graphs, in real time."""

    graph = True
    measure = staticmethod(run_graph_soak_job)


def memory_growth(minutes: Sequence[Mapping[str, Any]]) -> float | None:
    """Return the slope of the resident memory after ten minutes [MB/h], None if it is shorter."""
    memory = [minute['memory_mb'] for minute in minutes][WARM_UP:]
    if len(memory) < WARM_UP:
        return None
    return float(np.polyfit(np.arange(len(memory)) / 60.0, memory, 1)[0])


def errors_at_rest(
    minutes: Sequence[Mapping[str, Any]], name: str = 'error_n',
) -> tuple[float, float]:
    """Return the force error at rest, a field of `Minute`, in the first and last quarter [N]."""
    errors = np.array([np.nan if minute[name] is None else minute[name] for minute in minutes])
    quarter = max(len(errors) // 4, 1)
    return tuple(float(np.nanmean(part)) if np.isfinite(part).any() else np.nan
                 for part in (errors[:quarter], errors[-quarter:]))  # type: ignore[return-value]


def is_good(soak: Mapping[str, Any]) -> bool:
    """Return whether nothing happened that should not have; too short a soak shows no trend."""
    growth = memory_growth(soak['minutes'])
    if soak['counts'] or growth is None:
        return not soak['counts']
    errors = [errors_at_rest(soak['minutes'], name) for name in ('error_n', 'error_rms_n')]
    return growth <= LARGEST_GROWTH and not any(
        abs(last - first) > LARGEST_DRIFT for first, last in errors)


def _listing(content: Sequence[Mapping[str, Any]]) -> Listing:
    lines = []
    for soak in content:
        growth = memory_growth(soak['minutes'])
        errors = (*errors_at_rest(soak['minutes']),
                  *errors_at_rest(soak['minutes'], 'error_rms_n'))
        counts = soak['counts']
        good = is_good(soak)
        lines.append(Line([
            soak['plant'], str(soak['seed']), f'{soak["simulated_s"] / 3600.0:.2f}',
            str(sum(soak['episodes'].values())), str(soak['helped']),
            *(str(counts.get(name, 0)) for name in PROBLEMS),
            '-' if growth is None else f'{growth:.2f}', *(f'{error:.3f}' for error in errors),
            'yes' if good else 'no'], good))
    return Listing(COLUMNS, lines, verdict=GOOD)
