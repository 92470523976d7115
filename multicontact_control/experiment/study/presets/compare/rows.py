"""``comparison.json``: the runs of the matrix as rows, and what they say of the claims."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.claims import Claim, judge_claims, PAPER_ESTIMATOR, Row
from multicontact_control.experiment.study.jobs import JobResult
from multicontact_control.experiment.study.presets.compare.matrix import AOB, Entry, KINDS
from multicontact_control.files import read_json

COMPARISON_FILE = 'comparison.json'


def row_of(entry: Entry, key: str, result: JobResult) -> dict[str, Any]:
    """Return one row of ``comparison.json``."""
    metrics = result.metrics
    summary, answers = metrics['summary'], metrics['disturbances']['contacts']
    return {
        'label': entry.label, 'kind': entry.kind, 'plant': entry.job.plant,
        'seed': entry.job.seed, 'key': key, 'stable': summary['stable'],
        'verdict': summary['verdict'], 'instabilities': summary['instabilities'],
        'unstable_at_s': metrics['disturbances']['unstable_at_s'],
        'unstable_after_motion_s': metrics['disturbances']['unstable_after_motion_s'],
        'oscillation_hz': metrics['disturbances']['oscillation_hz'],
        'rest_rms_n': _worst(answers, 'rest', 'rms_n'),
        'moving_rms_n': _worst(answers, 'moving', 'rms_n'),
        'moving_lost': _worst(answers, 'moving', 'lost'),
        'rest_variance_n2': _worst(answers, 'rest', 'variance_n2'),
        'moving_variance_n2': _worst(answers, 'moving', 'variance_n2'),
        'pushes': _pushes(answers),
        'torque_max_fraction': summary['torque']['max_fraction_of_limit'],
        'torque_saturated_fraction': summary['torque']['saturated_fraction'],
        'trajectory_sha256': summary['trajectory_sha256'],
        'contacts': answers, 'evidence': metrics['evidence']}


def _worst(answers: dict[str, Any], window: str, name: str) -> float | None:
    values = [contact[window][name] for contact in answers.values()
              if contact[window][name] is not None]
    return max(values) if values else None


def _pushes(answers: dict[str, Any]) -> list[dict[str, Any]]:
    """Return for each push the slower contact's recovery, None if one never recovered."""
    pushes = []
    for each in zip(*(contact['recoveries'] for contact in answers.values())):
        times = [answer['recovery'] for answer in each]
        pushes.append({
            'start_s': each[0]['start'], 'duration_s': each[0]['duration'],
            'moving': each[0]['moving'], 'peak_n': max(answer['peak'] for answer in each),
            'recovery_s': None if None in times else max(times)})
    return pushes


def claim_rows(rows: Sequence[dict[str, Any]]) -> list[Row]:
    """Return the rows of ``comparison.json`` as what claims are judged from."""
    return [Row(row['label'], row['evidence'],
                {name: contact['recoveries'] for name, contact in row['contacts'].items()})
            for row in rows]


def comparison_claims(rows: Sequence[dict[str, Any]]) -> dict[str, list[Claim]]:
    """Judge the claims on every plant, from its first run with the paper's estimator."""
    claims = {}
    for row in rows:
        if row['label'] == PAPER_ESTIMATOR and row['kind'] == AOB and row['plant'] not in claims:
            claims[row['plant']] = judge_claims(row['evidence'], claim_rows(rows))
    return claims


def read_comparison(folder: Path) -> dict[str, Any]:
    """
    Read what `multicontact compare` wrote.

    Raises
    ------
    ConfigError
        If the folder does not hold it.

    """
    content = read_json(folder / COMPARISON_FILE)
    if not isinstance(content, dict) or content.get('schema') != 1:
        raise ConfigError('comparison', 'a folder of `multicontact compare`', folder)
    return content


def grouped(rows: Sequence[dict[str, Any]]) -> dict[tuple[str, str, str], list[dict[str, Any]]]:
    """Return the rows of each plant, kind and label, one for each seed, kind after kind."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda row: KINDS.index(row['kind'])):
        groups.setdefault((row['plant'], row['kind'], row['label']), []).append(row)
    return groups
