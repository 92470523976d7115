"""What `multicontact study compare` has beside its table: the paper's claims over K_2."""

from __future__ import annotations

from pathlib import Path

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.claims import Claim, judge_claims, PAPER_ESTIMATOR, Runs
from multicontact_control.experiment.page import claims_table
from multicontact_control.experiment.study.study import read_results, Results, Study

LIKE_THE_PAPER = ('active state', 'K_2')  # parts


class CompareStudy(Study):
    """Noise estimators; the claims of the paper are judged over K_2 on every plant."""

    def findings(self, results: Results) -> list[str]:
        """Return how many claims hold, and which of them depend on K_2."""
        found = super().findings(results)
        for plant, claims in comparison_claims(results).items():
            for rate, judged in claims.items():
                verdicts = [claim.holds for claim in judged]
                found.append(f'Plant {plant}, K_2 = {rate:g} 1/s: {verdicts.count(True)} claims '
                             f'of the paper hold, {verdicts.count(False)} do not.')
            found += [f'Plant {plant}: depends on K_2: {each[0].claim}'
                      for each in zip(*claims.values())
                      if {True, False} <= {claim.holds for claim in each}]
        return found

    def sections(self, results: Results) -> dict[str, str]:
        """Return the claims with each value of K_2."""
        return {f'Claims of the paper over K_2, plant {plant}': claims_table(
            {f'K_2 = {rate:g} 1/s': judged for rate, judged in claims.items()})
            for plant, claims in comparison_claims(results).items()}


def claim_rows(results: Results) -> Runs:
    """Return the runs of a comparison as what claims are judged from."""
    return [{**metrics['evidence'], 'estimator': estimator}
            for estimator, metrics in zip(results.frame['estimator'], results.metrics())
            if metrics['summary']]


def comparison_claims(results: Results) -> dict[str, dict[float, list[Claim]]]:
    """Judge the claims on every plant with every K_2, each by its first run like the paper's."""
    rows = claim_rows(results)
    claims: dict[str, dict[float, list[Claim]]] = {}
    for (_, row), metrics in zip(results.frame.iterrows(), results.metrics()):
        if row['part'] in LIKE_THE_PAPER and row['estimator'] == PAPER_ESTIMATOR and (
                metrics['summary']):
            here = claims.setdefault(str(row['plant']), {})
            evidence = metrics['evidence']
            here.setdefault(evidence['damping_rate'], judge_claims(evidence, rows))
    return claims


def read_claim_rows(folder: Path) -> Runs:
    """Return the runs of a comparison in a folder; ConfigError if it holds none."""
    study, results = read_results(folder)
    if not isinstance(study, CompareStudy):
        raise ConfigError('comparison', 'a folder of `multicontact study compare`',
                          f'{folder}, of the study {study.config.name}')
    return claim_rows(results)
