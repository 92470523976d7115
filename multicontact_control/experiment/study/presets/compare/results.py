"""What came of a comparison: its rows, the claims they speak of, its table, and its findings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.claims import (
    Claim,
    judge_claims,
    judge_over_damping,
    PAPER_ESTIMATOR,
    Row,
)
from multicontact_control.experiment.study.jobs import JobResult
from multicontact_control.experiment.study.presets.compare.matrix import (
    AOB,
    CAUSE,
    Entry,
    KINDS,
    PLAIN,
)
from multicontact_control.experiment.study.table import Column, Line, Listing
from multicontact_control.files import read_json

COMPARISON_FILE = 'comparison.json'
INSTABILITY = ('unstable_at_s', 'unstable_after_motion_s', 'oscillation_hz')
WORST = (  # of the contacts: window and number
    ('rest', 'rms_n'), ('moving', 'rms_n'), ('moving', 'lost'), ('rest', 'variance_n2'),
    ('moving', 'variance_n2'))
CLEAN = 'fixed, no roughness, no sensor noise'
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


def row_of(entry: Entry, key: str, result: JobResult) -> dict[str, Any]:
    """Return one row of ``comparison.json``."""
    metrics = result.metrics
    summary, answers = metrics['summary'], metrics['disturbances']['contacts']
    return {
        'label': entry.label, 'kind': entry.kind, 'plant': entry.job.plant,
        'seed': entry.job.seed, 'damping_rate': metrics['evidence']['damping_rate'], 'key': key,
        'stable': summary['stable'], 'verdict': summary['verdict'],
        'instabilities': summary['instabilities'],
        **{name: metrics['disturbances'][name] for name in INSTABILITY},
        **{f'{window}_{name}': _worst(answers, window, name) for window, name in WORST},
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
    if not isinstance(content, dict) or content.get('schema') != 2:
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
    stable = sum(row['stable'] for row in group)
    unstable = [row['unstable_after_motion_s'] for row in group
                if row['unstable_after_motion_s'] is not None]
    return [
        label, f'{stable}/{len(group)}', _range(unstable),
        _middle(group, 'rest_rms_n', 3), _middle(group, 'moving_rms_n', 2),
        _middle(group, 'moving_lost', 2, 100.0), _middle(group, 'rest_variance_n2', 2),
        _middle(group, 'moving_variance_n2', 1), _push(group, False), _push(group, True),
        _middle(group, 'torque_max_fraction', 0, 100.0)]


def _range(values: Sequence[float]) -> str:
    """Return the smallest and the largest of some times after the start of the motion."""
    if not values:
        return ''
    known = [value for value in values if value >= 0.0]
    texts = ['rest'] if len(known) < len(values) else []
    texts += list(dict.fromkeys(f'{value:.1f}' for value in (min(known), max(known)))
                  ) if known else []
    return '-'.join(texts)


def _middle(group: Sequence[dict[str, Any]], name: str, digits: int, factor: float = 1.0) -> str:
    values = [row[name] for row in group if row[name] is not None]
    return f'{factor * median(values):.{digits}f}' if values else '-'


def _push(group: Sequence[dict[str, Any]], lasting: bool) -> str:
    times = [push['recovery_s'] for row in group for push in row['pushes']
             if not push['moving'] and (push['duration_s'] >= 0.5) == lasting]
    if not times:
        return '-'
    middle = median(float('inf') if value is None else value for value in times)
    return 'never' if middle == float('inf') else f'{middle:.3f}'


def first_damping(rows: Sequence[dict[str, Any]]) -> float | None:
    """Return the K_2 of the matrix, without what is varied beside it [1/s]."""
    rates: list[float] = [row['damping_rate'] for row in rows]
    return rates[0] if rates else None


def findings(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return in plain sentences what was found about the paper's main claim, with the numbers."""
    said = []
    several = len({row['damping_rate'] for row in rows}) > 1
    for plant, claims in (comparison_claims(rows) if several else {}).items():
        if len(claims) > 1:
            open_ones = [each for each in judge_over_damping(claims) if each.depends]
            rates = ', '.join(f'{rate:g}' for rate in claims)
            said.append(f'Over K_2 = {rates} 1/s, which the paper leaves open, on plant {plant} '
                        + (f'{len(open_ones)} of its claims hold only for some: ' + '; '.join(
                            next(iter(each.verdicts.values())).claim for each in open_ones)
                           if open_ones else 'no claim changes its verdict') + '.')
    usual = first_damping(rows)
    rows = [row for row in rows if row['damping_rate'] == usual or row['kind'] == CAUSE]
    for plant, drives in {row['plant']: row['evidence']['drives'] for row in rows}.items():
        here = [row for row in rows if row['plant'] == plant]
        said += _fixed(here, plant, drives) + _causes(here) + _plain(here, plant)
    return said


def _chosen(rows: Sequence[dict[str, Any]], kind: str, label: str) -> list[dict[str, Any]]:
    return [row for row in rows if row['kind'] == kind and row['label'] == label]


def _stable(rows: Sequence[dict[str, Any]]) -> int:
    return sum(row['stable'] for row in rows)


def _fixed(rows: Sequence[dict[str, Any]], plant: str, drives: str) -> list[str]:
    fixed, lead = _chosen(rows, AOB, 'fixed'), _chosen(rows, AOB, 'lead_window')
    if not fixed:
        return []
    text = f'With {drives} drives (plant {plant}) R fixed at 0.6 N² is '
    unstable = len(fixed) - _stable(fixed)
    if not unstable:
        text += f'NOT unstable in motion: {len(fixed)} of {len(fixed)} runs are stable'
        text += ', against the claim of the paper.'
    else:
        text += f'unstable in {unstable} of {len(fixed)} runs, {_when(fixed)}{_tone(fixed)}.'
    if lead:
        text += f" With the paper's on-line estimate {_stable(lead)} of {len(lead)} are stable."
    return [text]


def _when(rows: Sequence[dict[str, Any]]) -> str:
    times = [row['unstable_after_motion_s'] for row in rows
             if row['unstable_after_motion_s'] is not None]
    if not times or min(times) < 0.0:
        return 'before any motion in some'
    texts = dict.fromkeys(f'{time:.2f}' for time in (min(times), max(times)))
    return f"{' to '.join(texts)} s after the motion began"


def _tone(rows: Sequence[dict[str, Any]]) -> str:
    tones = [row['oscillation_hz'] for row in rows if row['oscillation_hz'] is not None]
    return f', with an oscillation at {median(tones):.0f} Hz' if tones else ''


def _causes(rows: Sequence[dict[str, Any]]) -> list[str]:
    fixed = _chosen(rows, AOB, 'fixed')
    if fixed and _stable(fixed) == len(fixed):
        return []  # there is nothing to find the cause of
    said = []
    clean = _chosen(rows, CAUSE, CLEAN)
    if clean:
        unstable = len(clean) - _stable(clean)
        if unstable:
            said.append(
                'The noise is not the cause: with a smooth surface and a sensor without noise it '
                f'is unstable too, in {unstable} of {len(clean)} runs, {_when(clean)}'
                f'{_tone(clean)}. What is too fast is the observer, against a mode of the '
                'flexible drives; stiction hides it at rest, and a larger R, from wherever it '
                'comes, slows the observer down.')
        else:
            said.append('Without roughness and sensor noise it is stable: here the noise is '
                        'the cause.')
    others: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        if row['kind'] == CAUSE and row['label'] != CLEAN:
            others.setdefault(row['label'], []).append(row)
    if others:
        said.append('Beside it: ' + '; '.join(
            f'{label}: {_stable(group)} of {len(group)} stable'
            for label, group in others.items()) + '.')
    return said


def _plain(rows: Sequence[dict[str, Any]], plant: str) -> list[str]:
    plain, whole = _chosen(rows, PLAIN, 'lead_window'), _chosen(rows, AOB, 'lead_window')
    if not plain or not whole or any(row['rest_rms_n'] is None for row in [*plain, *whole]):
        return []
    errors = [median(row['rest_rms_n'] for row in group) for group in (plain, whole)]
    fixed = _chosen(rows, PLAIN, 'fixed')
    text = (f'Without the active state (plant {plant}) the force error at rest is '
            f'{errors[0]:.2f} N rms instead of {errors[1]:.2f} N, and a lasting push is ')
    lasting = [push['recovery_s'] for row in plain for push in row['pushes']
               if push['duration_s'] >= 0.5]
    text += 'not controlled out.' if lasting and None in lasting else 'controlled out too.'
    if fixed:
        text += f' R fixed at 0.6 N² is then stable in {_stable(fixed)} of {len(fixed)} runs.'
    return [text]
