"""What `multicontact study compare` says beside its table: findings, and the paper's claims."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.claims import (
    Claim,
    FIXED,
    judge_claims,
    PAPER_ESTIMATOR,
    Row,
)
from multicontact_control.experiment.page import claims_table
from multicontact_control.experiment.study.study import read_results, Results, Section, Study
from multicontact_control.experiment.study.table import times_text
import pandas as pd

ACTIVE, PLAIN, OVER_DAMPING, CAUSES = 'active state', 'no active state', 'K_2', 'causes'
DAMPING = 'controller.force.damping_rate'
Claims = Mapping[float, list[Claim]]  # by K_2 [1/s]


class CompareStudy(Study):
    """Noise estimators; the claims of the paper are judged over K_2 on every plant."""

    def findings(self, results: Results) -> list[str]:
        """Return the counts and figures that the paper's claims rest on."""
        found = []
        for plant, claims in comparison_claims(results).items():
            depends = [each[0].claim for each in zip(*claims.values())
                       if {True, False} <= {claim.holds for claim in each}]
            if len(claims) > 1:
                found.append(
                    f'Plant {plant}: over K_2 = {", ".join(f"{rate:g}" for rate in claims)} 1/s, '
                    f'{len(depends)} of the claims change their verdict'
                    + (f': {"; ".join(depends)}' if depends else '') + '.')
        for plant, frame in results.frame.groupby('plant', sort=False):
            counts = [f'{label}: {_stability(group)}' for label, group in _groups(frame)]
            found += [f'Plant {plant}: {"; ".join(counts)}.'] if counts else []
            found += _without_active_state(str(plant), frame)
        return found

    def warnings(self, results: Results) -> list[str]:
        """Return the runs that ended early, and the claims that do not hold."""
        return super().warnings(results) + [
            f'does not hold on {plant} with K_2 = {rate:g} 1/s: {claim.claim}'
            for plant, claims in comparison_claims(results).items()
            for rate, judged in claims.items() for claim in judged if claim.holds is False]

    def sections(self, results: Results) -> list[Section]:
        """Return the claims with each value of K_2."""
        return [(f'Claims of the paper over K_2, plant {plant}', claims_table(
            {f'K_2 = {rate:g} 1/s': judged for rate, judged in claims.items()}))
            for plant, claims in comparison_claims(results).items()]


def claim_rows(results: Results) -> list[Row]:
    """Return the runs of a comparison as what claims are judged from."""
    return [Row(label, metrics['evidence'], {
        name: contact['recoveries']
        for name, contact in metrics['disturbances']['contacts'].items()})
        for label, metrics in zip(results.frame['estimator'], results.metrics)
        if metrics['summary']]


def comparison_claims(results: Results) -> dict[str, dict[float, list[Claim]]]:
    """Judge the claims on every plant with every K_2, each by its first run like the paper's."""
    rows = claim_rows(results)
    claims: dict[str, dict[float, list[Claim]]] = {}
    for (_, row), metrics in zip(results.frame.iterrows(), results.metrics):
        here = claims.setdefault(str(row['plant']), {})
        if row['part'] in (ACTIVE, OVER_DAMPING) and row['estimator'] == PAPER_ESTIMATOR and (
                row[DAMPING] not in here and metrics['summary']):
            here[row[DAMPING]] = judge_claims(metrics['evidence'], rows)
    return {plant: here for plant, here in claims.items() if here}


def read_claim_rows(folder: Path) -> list[Row]:
    """Return the runs of a comparison in a folder; ConfigError if it holds none."""
    study, results = read_results(folder)
    if not isinstance(study, CompareStudy):
        raise ConfigError('comparison', 'a folder of `multicontact study compare`',
                          f'{folder}, of the study {study.config.name}')
    return claim_rows(results)


def _groups(frame: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """Return the groups of runs whose stability is counted: a fixed R, the paper's, causes."""
    found = []
    for part, label in ((ACTIVE, FIXED), (ACTIVE, PAPER_ESTIMATOR)):
        found.append((label, frame[(frame['part'] == part) & (frame['estimator'] == label)]))
    causes = frame[frame['part'] == CAUSES]
    found += [(str(label), group) for label, group in causes.groupby('estimator', sort=False)]
    plain = frame[(frame['part'] == PLAIN) & (frame['estimator'] == FIXED)]
    return [(label, group) for label, group in [*found, (f'{FIXED}, {PLAIN}', plain)]
            if len(group)]


def _stability(frame: pd.DataFrame) -> str:
    """Return how many runs are stable, from when on others are not, and how they oscillate."""
    text = f'{int(frame["stable"].sum())} of {len(frame)} runs stable'
    times = times_text(frame['unstable_after_motion_s'])
    if times:
        text += f', unstable {times} s after the motion began' if times != 'rest' else (
            ', unstable at rest')
    tone = frame['oscillation_hz'].astype(float).median()
    return text + (f', with an oscillation at {tone:.0f} Hz' if tone == tone else '')


def _without_active_state(plant: str, frame: pd.DataFrame) -> list[str]:
    """Return what the active state is good for, with the paper's estimator."""
    def medians(part: str) -> Any:
        chosen = frame[(frame['part'] == part) & (frame['estimator'] == PAPER_ESTIMATOR)]
        return chosen[['rest_rms_n', 'lasting_push_s']].astype(float).median()

    plain, whole = medians(PLAIN), medians(ACTIVE)
    if plain.isna().any() or whole.isna().any():
        return []
    return [f'Plant {plant}, {PAPER_ESTIMATOR}: with the active state the error at rest is '
            f'{whole.iloc[0]:.2f} N rms against {plain.iloc[0]:.2f} N without, recovery from a '
            f'lasting push takes {whole.iloc[1]:.3f} s against {plain.iloc[1]:.3f} s.']
