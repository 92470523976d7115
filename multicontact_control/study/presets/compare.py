"""What `multicontact study compare` has beside its table: the paper's claims over K_2."""

from __future__ import annotations

from multicontact_control.judging.claims import Claim, judge_claims, PAPER_ESTIMATOR
from multicontact_control.judging.page import render_claims
from multicontact_control.study.study import Results, Study

LIKE_THE_PAPER = ('active state', 'K_2')  # parts


class CompareStudy(Study):
    """
    Noise estimators compared; the claims of the paper are judged over K_2 on every plant.

    The paper leaves K_2 open, and some claims change their verdict over it (docs/findings.md): so
    the verdicts stand side by side.
    """

    def describe_findings(self, results: Results) -> list[str]:
        """
        Return what every study finds, and how many claims agree with each K_2.

        Claims that no run can tell are left out of both counts, so a sentence may say 9 of 11
        where the paper makes 13.
        """
        sentences = super().describe_findings(results)
        for plant, claims_by_rate in judge_comparison(results).items():
            counts = []
            for rate, claims in claims_by_rate.items():
                verdicts = [claim.holds for claim in claims]
                judged = len(verdicts) - verdicts.count(None)
                counts.append(
                    f'{verdicts.count(True)} of {judged} agree with K_2 = {rate:g}'
                )
            sentences.append(
                f'Of the claims of the paper, on {plant}, {", ".join(counts)} 1/s.'
            )
        return sentences

    def further_sections(self, results: Results) -> dict[str, str]:
        """
        Return a table of the claims on each plant, with a column for each value of K_2.

        The heading names the plant; the tables are HTML of `render_claims`, with what was measured
        beside what is expected.
        """
        sections = {}
        for plant, claims_by_rate in judge_comparison(results).items():
            columns = {}
            for rate, claims in claims_by_rate.items():
                columns[f'K_2 = {rate:g} 1/s'] = claims
            heading = f'Claims of the paper over K_2, plant {plant}'
            sections[heading] = render_claims(columns)
        return sections


def judge_comparison(results: Results) -> dict[str, dict[float, list[Claim]]]:
    """
    Judge the paper's claims by plant and K_2 [1/s].

    Each is judged by the first run with the paper's estimator and an active state, beside the
    evidence of all runs, of which `judge_claims` takes those of the same plant and K_2. Runs that
    ended with an error have no evidence and tell nothing.
    """
    runs = []
    for _, row in results.frame.iterrows():
        metrics = results.metrics[row['key']]
        if metrics['summary']:
            names = {'estimator': row['estimator'], 'part': row['part']}
            runs.append({**metrics['evidence'], **names})
    claims: dict[str, dict[float, list[Claim]]] = {}
    for run in runs:
        if run['part'] in LIKE_THE_PAPER and run['estimator'] == PAPER_ESTIMATOR:
            claims_by_rate = claims.setdefault(run['plant'], {})
            rate = run['damping_rate']
            if rate not in claims_by_rate:
                claims_by_rate[rate] = judge_claims(run, runs)
    return claims
