"""`multicontact compare`: every noise estimator on the disturbances of the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from multicontact_control.errors import check_all
from multicontact_control.experiment.claims import judge_over_damping
from multicontact_control.experiment.page import claims_over_damping, claims_table
from multicontact_control.experiment.scenario import plants_of, preset_values
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.jobs import RunJob
from multicontact_control.experiment.study.measure import measure_run
from multicontact_control.experiment.study.page import Page, Section
from multicontact_control.experiment.study.presets.compare import forces, matrix
from multicontact_control.experiment.study.presets.compare.results import (
    comparison_claims,
    comparison_listing,
    findings,
    row_of,
)
from multicontact_control.experiment.study.study import check_seeds, Study


@dataclass(frozen=True)
class ComparisonStudy(Study[RunJob, dict[str, Any]]):
    """Plants, estimators and seeds, with and without the active state."""

    plants: tuple[str, ...] = field(default_factory=plants_of)
    estimators: tuple[str, ...] = ()  # all, or those of the quick matrix, if empty
    seeds: int | None = None  # how many; None for 3, or 1 of the quick matrix
    quick: bool = False
    # Controller and estimator; with the paper's, the claims are judged over K_2.
    preset: str = matrix.PRESET

    title = 'compare'
    name = 'comparison'
    measure = staticmethod(measure_run)

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the estimators that are compared."""
        return self.estimators or (matrix.QUICK_LABELS if self.quick else matrix.LABELS)

    @property
    def seed_count(self) -> int:
        """Return how many seeds there are."""
        return self.seeds if self.seeds is not None else (1 if self.quick else 3)

    @property
    def damping_rates(self) -> tuple[float, ...]:
        """Return the values of K_2, that of the matrix first; none with another preset."""
        return matrix.DAMPING_RATES if self.preset == matrix.PRESET else ()

    def check(self) -> None:
        """Check plants, estimators and seeds; ConfigError with all that are not acceptable."""
        check_all(*matrix.name_checks(self.plants, self.labels),
                  partial(check_seeds, self.seed_count), partial(preset_values, self.preset))

    def grid(self) -> Mapping[str, Sequence[Any]]:
        """Return plants, estimators and seeds, and what runs beside their matrix."""
        beside = dict.fromkeys(entry.label for entry in self.entries()
                               if entry.kind in (matrix.STIFFNESS, matrix.CAUSE))
        return {'plants': self.plants, 'estimators': self.labels,
                'observers': (matrix.AOB,) if self.quick else (matrix.AOB, matrix.PLAIN),
                'seeds': range(self.seed_count),
                'values of K_2': self.damping_rates or ('as in the preset',),
                'variants beside them': list(beside)}

    def entries(self) -> list[matrix.Entry]:
        """Return every run and its place in the matrix."""
        return matrix.comparison_matrix(
            self.plants, self.labels, self.seed_count, plain=not self.quick, preset=self.preset,
            damping_rates=self.damping_rates[1:]) + matrix.beside_the_matrix(
            self.plants, self.seed_count, quick=self.quick, preset=self.preset,
            damping_rates=self.damping_rates[1:])

    def jobs(self) -> list[RunJob]:
        """Return the runs."""
        return [entry.job for entry in self.entries()]

    def content(self, run: JobRun[RunJob]) -> dict[str, Any]:
        """Return the content of ``comparison.json``."""
        rows = [row_of(entry, run.keys[entry.job], run.metrics(entry.job))
                for entry in self.entries()]
        return {'scenario': matrix.SCENARIO, 'preset': self.preset, 'rows': rows,
                'claims': {plant: [{'damping_rate': rate, **claim.to_json()}
                                   for rate, claims in found.items() for claim in claims]
                           for plant, found in comparison_claims(rows).items()}}

    def page(self, content: dict[str, Any], folder: Path) -> Page:
        """Return tables, forces, findings and claims."""
        rows, claims = content['rows'], comparison_claims(content['rows'])
        sections = [
            Section(f'Plant {plant}: worse contact, median over the seeds',
                    comparison_listing(rows, plant), before='' if number else forces.NOTE,
                    after=forces.forces_of_plant(rows, plant, number))
            for number, plant in enumerate(self.plants)]
        sections += [Section(f'Claims of the paper over K_2, plant {plant}',
                             after=claims_over_damping(judge_over_damping(found)))
                     for plant, found in claims.items()]
        sections += [Section(f'Claims of the paper, plant {plant}, K_2 = {rate:g} 1/s',
                             after=claims_table(judged))
                     for plant, found in claims.items() for rate, judged in found.items()]
        against = [f'does not hold on {plant} with K_2 = {rate:g} 1/s: {claim.claim}'
                   for plant, found in claims.items() for rate, judged in found.items()
                   for claim in judged if claim.holds is False]
        return Page(f'Noise estimators compared: scenario {matrix.SCENARIO}', sections,
                    warnings=against, findings=findings(rows),
                    script=forces.forces_script(rows, JobCache(folder)))
