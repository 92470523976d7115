"""What a comparison found about the paper's main claim, in plain sentences with their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

from multicontact_control.experiment.study.presets.compare.matrix import AOB, CAUSE, PLAIN

CLEAN = 'fixed, no roughness, no sensor noise'


def findings(rows: Sequence[dict[str, Any]]) -> list[str]:
    """
    Return the findings.

    Parameters
    ----------
    rows
        Of ``comparison.json``.

    Returns
    -------
    list of str
        One sentence or two each; nothing is said of what was not run.

    """
    said = []
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
