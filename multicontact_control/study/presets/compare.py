"""What `multicontact study compare` has beside its table: the paper's claims over K_2."""

from __future__ import annotations

from multicontact_control.judging.claims import Claim, judge_claims, PAPER_ESTIMATOR
from multicontact_control.judging.page import render_claims
from multicontact_control.study.study import Results, Study

LIKE_THE_PAPER = ('active state', 'K_2')  # parts


class CompareStudy(Study):
    """Noise estimators; the claims of the paper are judged over K_2 on every plant."""

    def findings(self, results: Results) -> list[str]:
        """Return how many claims agree with each K_2."""
        sentences = super().findings(results)
        for plant, claims in comparison_claims(results).items():
            judged = {
                rate: [claim.holds for claim in each] for rate, each in claims.items()
            }
            sentences.append(
                f'Of the claims of the paper, on {plant}, '
                + ', '.join(
                    f'{each.count(True)} of {len(each) - each.count(None)} agree '
                    f'with K_2 = {rate:g}'
                    for rate, each in judged.items()
                )
                + ' 1/s.'
            )
        return sentences

    def sections(self, results: Results) -> dict[str, str]:
        """Return the claims with each value of K_2."""
        return {
            f'Claims of the paper over K_2, plant {plant}': render_claims(
                {f'K_2 = {rate:g} 1/s': judged for rate, judged in claims.items()}
            )
            for plant, claims in comparison_claims(results).items()
        }


def comparison_claims(results: Results) -> dict[str, dict[float, list[Claim]]]:
    """Judge the claims on every plant with every K_2, each by its first run like the paper's."""
    rows = [
        {**metrics['evidence'], 'estimator': row['estimator'], 'part': row['part']}
        for _, row in results.frame.iterrows()
        if (metrics := results.metrics[row['key']])['summary']
    ]
    claims: dict[str, dict[float, list[Claim]]] = {}
    for run in rows:
        if run['part'] in LIKE_THE_PAPER and run['estimator'] == PAPER_ESTIMATOR:
            here = claims.setdefault(run['plant'], {})
            if run['damping_rate'] not in here:
                here[run['damping_rate']] = judge_claims(run, rows)
    return claims
