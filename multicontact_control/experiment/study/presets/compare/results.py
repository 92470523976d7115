"""What came of a comparison: its rows, the claims they speak of, its table, and its findings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.claims import (
    Claim,
    FIXED,
    judge_claims,
    judge_over_damping,
    PAPER_ESTIMATOR,
    Row,
)
from multicontact_control.experiment.metrics import LASTING
from multicontact_control.experiment.study.measure import (
    largest,
    largest_known,
    middle,
    middle_known,
)
from multicontact_control.experiment.study.presets.compare.matrix import (
    AOB,
    CAUSE,
    Entry,
    KINDS,
    PLAIN,
)
from multicontact_control.experiment.study.table import Column, format_number, Line, Listing
from multicontact_control.files import read_json

COMPARISON_FILE = 'comparison.json'
INSTABILITY = ('unstable_at_s', 'unstable_after_motion_s', 'oscillation_hz')
WORST = (  # of the contacts: window and number
    ('rest', 'rms_n'), ('moving', 'rms_n'), ('moving', 'lost'), ('rest', 'variance_n2'),
    ('moving', 'variance_n2'))
CAPTION = ('fails: after the start of the motion; rest, move: rms error of the true force; lost: '
           'contact in motion; R [N²]; push: recovery [s]; torq: largest share of the limit')
COLUMNS = (
    Column('estimator', '', number=False), Column('stable'),
    Column('unstable after motion start [s]', 'fails\n[s]'),
    Column('rest rms [N]', 'rest\n[N]'), Column('moving rms [N]', 'move\n[N]'),
    Column('contact lost moving [%]', 'lost\n[%]', spare=True),
    Column('R rest [N²]', 'R\nrest', spare=True), Column('R moving [N²]', 'R\nmove'),
    Column('recovery, push 0.1 s [s]', 'push\n.1 s'),
    Column('recovery, push 1 s [s]', 'push\n1 s'),
    Column('torque [% of limit]', 'torq\n[%]', spare=True))


def row_of(entry: Entry, key: str, metrics: dict[str, Any]) -> dict[str, Any]:
    """Return one row of ``comparison.json``."""
    summary, answers = metrics['summary'], metrics['disturbances']['contacts']
    return {
        'label': entry.label, 'kind': entry.kind, 'plant': entry.job.plant,
        'seed': entry.job.seed, 'damping_rate': metrics['evidence']['damping_rate'], 'key': key,
        'stable': summary['stable'], 'verdict': summary['verdict'],
        'instabilities': summary['instabilities'],
        **{name: metrics['disturbances'][name] for name in INSTABILITY},
        **{f'{window}_{name}': largest_known(
            contact[window][name] for contact in answers.values()) for window, name in WORST},
        'pushes': _pushes(answers),
        'torque_max_fraction': summary['torque']['max_fraction_of_limit'],
        'torque_saturated_fraction': summary['torque']['saturated_fraction'],
        'trajectory_sha256': summary['trajectory_sha256'],
        'contacts': answers, 'evidence': metrics['evidence']}


def _pushes(answers: dict[str, Any]) -> list[dict[str, Any]]:
    """Return for each push the slower contact's recovery, None if one never recovered."""
    return [{
        'start_s': each[0]['start'], 'duration_s': each[0]['duration'],
        'moving': each[0]['moving'], 'peak_n': max(answer['peak'] for answer in each),
        'recovery_s': largest(answer['recovery'] for answer in each)}
        for each in zip(*(contact['recoveries'] for contact in answers.values()))]


def claim_rows(rows: Sequence[dict[str, Any]]) -> list[Row]:
    """Return the rows of ``comparison.json`` as what claims are judged from."""
    return [Row(row['label'], row['evidence'],
                {name: contact['recoveries'] for name, contact in row['contacts'].items()})
            for row in rows]


def comparison_claims(rows: Sequence[dict[str, Any]]) -> dict[str, dict[float, list[Claim]]]:
    """Judge the claims on every plant with every K_2, each by its first run like the paper's."""
    claims: dict[str, dict[float, list[Claim]]] = {}
    for row in rows:
        here, rate = claims.setdefault(row['plant'], {}), row['damping_rate']
        if row['label'] == PAPER_ESTIMATOR and row['kind'] == AOB and rate not in here:
            here[rate] = judge_claims(row['evidence'], claim_rows(rows))
    return claims


def read_comparison(folder: Path) -> dict[str, Any]:
    """Return what `multicontact compare` wrote; ConfigError if the folder does not hold it."""
    content = read_json(folder / COMPARISON_FILE)
    if not isinstance(content, dict) or 'rows' not in content:
        raise ConfigError('comparison', 'a folder of `multicontact compare`', folder)
    return content


def comparison_listing(rows: Sequence[dict[str, Any]], plant: str) -> Listing:
    """Return the table of one plant: each estimator's median over the seeds, worse contact."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    usual = first_damping(rows)
    for row in sorted(rows, key=lambda row: KINDS.index(row['kind'])):
        if row['plant'] == plant:
            kind, rate = row['kind'], row['damping_rate']
            groups.setdefault((kind if rate == usual or kind == CAUSE else
                               f'{kind}, K_2 = {rate:g} 1/s', row['label']), []).append(row)
    lines: list[Line] = []
    for (kind, label), group in groups.items():
        keys = ' '.join(row['key'] for row in group)
        lines.append(Line(
            _cells(label, group), all(row['stable'] for row in group), kind,
            f'class="choice{"" if lines else " first"}" data-keys="{keys}"'))
    return Listing(COLUMNS, lines, caption=CAPTION)


def _cells(label: str, group: Sequence[dict[str, Any]]) -> list[str]:
    """Return the cells of one line of the table."""
    def cell(name: str, digits: int, scale: float = 1.0) -> str:
        return format_number(middle_known(row[name] for row in group), digits, scale)

    return [
        label, f'{_stable(group)}/{len(group)}', _failure_times(group),
        cell('rest_rms_n', 3), cell('moving_rms_n', 2), cell('moving_lost', 2, 100.0),
        cell('rest_variance_n2', 2), cell('moving_variance_n2', 1), _push(group, False),
        _push(group, True), cell('torque_max_fraction', 0, 100.0)]


def _stable(rows: Sequence[dict[str, Any]]) -> int:
    return sum(row['stable'] for row in rows)


def _failure_times(group: Sequence[dict[str, Any]]) -> str:
    """Return the smallest and the largest time from the start of the motion to a failure."""
    values = [row['unstable_after_motion_s'] for row in group
              if row['unstable_after_motion_s'] is not None]
    known = [value for value in values if value >= 0.0]
    texts = ['rest'] if len(known) < len(values) else []
    if known:
        texts += dict.fromkeys(f'{value:.1f}' for value in (min(known), max(known)))
    return '-'.join(texts)


def _push(group: Sequence[dict[str, Any]], lasting: bool) -> str:
    times = [push['recovery_s'] for row in group for push in row['pushes']
             if not push['moving'] and (push['duration_s'] >= LASTING) == lasting]
    value = middle(times)
    return ('never' if value is None else f'{value:.3f}') if times else '-'


def first_damping(rows: Sequence[dict[str, Any]]) -> float | None:
    """Return the K_2 of the matrix, without what is varied beside it [1/s]."""
    return rows[0]['damping_rate'] if rows else None


def findings(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return in sentences the counts and figures that the paper's claims rest on."""
    found = []
    for plant, claims in comparison_claims(rows).items():
        if len(claims) > 1:
            depends = [next(iter(each.verdicts.values())).claim
                       for each in judge_over_damping(claims) if each.depends]
            found.append(
                f'Plant {plant}: over K_2 = {", ".join(f"{rate:g}" for rate in claims)} 1/s, '
                f'which the paper leaves open, {len(depends)} of its claims change their verdict'
                + (f': {"; ".join(depends)}' if depends else '') + '.')
    usual = first_damping(rows)
    for plant, drives in {row['plant']: row['evidence']['drives'] for row in rows}.items():
        groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
        for row in rows:
            if row['plant'] == plant and (row['damping_rate'] == usual or row['kind'] == CAUSE):
                groups.setdefault((row['kind'], row['label']), []).append(row)
        counts = [f'{label}: {_stability(groups[AOB, label])}'
                  for label in (FIXED, PAPER_ESTIMATOR) if (AOB, label) in groups]
        counts += [f'{label}: {_stability(group)}'
                   for (kind, label), group in groups.items() if kind == CAUSE]
        if (PLAIN, FIXED) in groups:
            counts.append(f'{FIXED}, {PLAIN}: {_stability(groups[PLAIN, FIXED])}')
        if counts:
            found.append(f'Plant {plant}, {drives} drives: {"; ".join(counts)}.')
        plain, whole = (groups.get((kind, PAPER_ESTIMATOR), []) for kind in (PLAIN, AOB))
        if plain and whole:
            rest = [format_number(middle(row['rest_rms_n'] for row in group), 2)
                    for group in (plain, whole)]
            found.append(
                f'Plant {plant}, {PAPER_ESTIMATOR}, {PLAIN}: error at rest {rest[0]} N rms '
                f'against {rest[1]} N with it; recovery from a lasting push '
                f'{_push(plain, True)} s against {_push(whole, True)} s.')
    return found


def _stability(rows: Sequence[dict[str, Any]]) -> str:
    """Return how many runs are unstable, from when on, and how fast they oscillate."""
    text = f'unstable in {len(rows) - _stable(rows)} of {len(rows)} runs'
    times, tone = _failure_times(rows), middle_known(row['oscillation_hz'] for row in rows)
    if times:
        text += f', {times} s after the motion began' if times != 'rest' else ', at rest'
    return text + (f', with an oscillation at {tone:.0f} Hz' if tone is not None else '')
