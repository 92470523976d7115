"""The limits that a run has passed, each with the time at which it did: what is not stable."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math
from typing import NamedTuple

from multicontact_control.arrays import find_true_stretches, Mask
from multicontact_control.judging.contact_metrics import ContactMetrics
from multicontact_control.judging.metrics import RunMetrics, torque_limit
from multicontact_control.judging.run_modes import (
    IN_PROCESS,
    INTERRUPTED,
    LOCKSTEP,
    REAL_TIME,
)
from multicontact_control.judging.supervisor_events import find_repetition
from multicontact_control.runs.recording import RunData
import numpy as np

# Of contact, or in saturation: five time constants of the designed loop.
LONGEST_LOSS = 0.1  # s
LARGEST_UNANSWERED = 0.1  # share of samples without an answer that a run may have
# A force is too large beyond 5 times its command and beyond half the force ceiling, at which the
# supervisor leaves a contact. The second, an absolute one, is for touches: they go with speed,
# stiffness and mass (12 N at 20 mm/s and 60 000 N/m), and not with the preload that follows.
LARGEST_FORCE_RATIO = 5.0
IMPACT_SHARE = 0.5  # of the ceiling: 30 N of 60 N
SATURATED_SHARE = 0.999999  # of a torque limit, from which on a torque is at it


class Finding(NamedTuple):
    """
    A limit that was passed: which one, by how much, and when.

    Each is a reason of the verdict `not stable`; the text stands in `instabilities` of the
    summary.
    """

    text: str
    time: float | None = None  # s; None for what was missed throughout the run


def list_findings(run: RunMetrics, mode: str, ended_early: str) -> list[Finding]:
    """
    Return the limits that a run has passed, those of couples while their contact is pressed.

    They come in the order of the verdict's reasons: an end before its time, numbers that are not
    finite, saturated torques, then each contact's. `mode` and `ended_early` are as for
    `judge_run`.
    """
    findings = []
    interrupted = ended_early == INTERRUPTED
    if ended_early and not interrupted:
        findings.append(Finding(ended_early, float(run.data.time[-1])))
    findings += _find_infinite_numbers(run.data)
    findings += _find_saturation(run)
    # Before the load a contact may still be sought.
    made_by_now = run.windows.loaded.any() and not (interrupted or run.missing)
    for contact in run.contacts:
        if _is_made(contact):
            for text, time in _find_contact_limits(contact):
                findings.append(Finding(f'{contact.name}: {text}', time))
        elif made_by_now:
            findings.append(Finding(f'{contact.name}: no contact was made'))
    if mode in (IN_PROCESS, LOCKSTEP, REAL_TIME):
        findings += _find_unanswered_samples(run)
    return findings


def _is_made(contact: ContactMetrics) -> bool:
    """Return whether a contact was made, need not be, or is of unknown desired force."""
    desired = contact.run.data.alpha_des[:, contact.column]
    by_topic = contact.run.setup.commanded_by_topic
    never_asked_for = by_topic and not contact.pressed.any()
    was_desired = (desired > 0.0).any() or not np.isfinite(desired).any()
    return bool(contact.is_couple or never_asked_for or was_desired)


def _find_infinite_numbers(data: RunData) -> Iterator[Finding]:
    """Yield the first time of a number that is not finite, of all series that must be."""
    infinite = np.zeros(data.ticks, dtype=bool)
    for series in (data.q, data.qd, data.torque, data.alpha_true, data.alpha_meas):
        infinite |= np.isinf(series).any(axis=1)
    if infinite.any():
        yield Finding('a number is not finite', _find_first_time(data, infinite))


def _find_saturation(run: RunMetrics) -> Iterator[Finding]:
    """Yield the torques at their limit for too long, and whether drives set the limit."""
    limit = run.least_torque_limit
    saturated = np.abs(run.data.torque) >= SATURATED_SHARE * limit
    by_drives = saturated & (limit < torque_limit(run.setup))
    text = 'torque saturated'
    if by_drives.any():
        text += ' at the limit of the simulated drives'
    when = find_true_stretches(np.asarray(saturated.any(axis=1)))
    yield from _find_lasting(run.data, text, when)


def _find_unanswered_samples(run: RunMetrics) -> Iterator[Finding]:
    """Yield the share of the samples without the numbers of one series, if it is too large."""
    data = run.data
    unanswered = 0.0
    for series in (data.q, data.qd, data.torque, data.alpha_true, data.alpha_meas):
        lacking = np.isnan(series[run.recorded]).any(axis=1)
        unanswered = max(unanswered, float(lacking.mean()))
    if unanswered > LARGEST_UNANSWERED:
        yield Finding(f'{100.0 * unanswered:.1f} % of the samples were not answered')


def _find_contact_limits(contact: ContactMetrics) -> Iterator[Finding]:
    """Yield the losses, the oscillation and the excessive force of one contact."""
    data = contact.run.data
    if contact.is_couple:
        # An end is near being lost wherever the centre of pressure is asked to be: noise makes
        # short losses of it, which are not counted.
        yield from _find_lasting(data, 'contact lost at one end', contact.losses)
    else:
        yield from _find_lasting(data, 'contact lost', contact.losses)
        count = len(contact.losses)
        begins = [begin for begin, _ in contact.losses]
        repeated = find_repetition(data.time[begins].tolist())
        if repeated is not None:
            yield Finding(f'contact lost {count} times', repeated)
    yield from _find_oscillation(contact)
    yield from _find_excessive_force(contact)


def _find_oscillation(contact: ContactMetrics) -> Iterator[Finding]:
    episodes = contact.oscillations
    if episodes:
        worst = max(episodes, key=lambda episode: episode.rms)
        total = sum(episode.duration for episode in episodes)
        yield Finding(
            f'oscillates at {worst.frequency:.0f} Hz with {worst.rms:.2g} N rms '
            f'for {total:.1f} s',
            episodes[0].recognised_at,
        )


def _find_excessive_force(contact: ContactMetrics) -> Iterator[Finding]:
    """Yield the largest of the forces that are too large; a pull is none of them."""
    size = contact.force
    asked = contact.command
    kind = 'force'
    if contact.is_couple:  # of either sign
        size = np.abs(size)
        asked = np.abs(asked)
        kind = 'couple'
    ceiling = contact.run.setup.controller.contact_state.force_ceiling
    largest = np.maximum(LARGEST_FORCE_RATIO * asked, IMPACT_SHARE * ceiling)
    beyond = size > largest
    if beyond.any():
        worst = int(np.argmax(np.where(beyond, size, 0.0)))
        yield Finding(
            f'{kind} of {contact.force[worst]:.0f} N at a command of '
            f'{contact.command[worst]:.3g} N',
            _find_first_time(contact.run.data, beyond),
        )


def _find_first_time(data: RunData, mask: Mask) -> float:
    return float(data.time[np.argmax(mask)])


def _find_lasting(
    data: RunData, text: str, when: Sequence[tuple[int, int]]
) -> Iterator[Finding]:
    """Yield what lasted for more than 0.1 s, with its longest time, and when it first had."""
    least = math.floor(LONGEST_LOSS * data.rate) + 1
    lasting = [stretch for stretch in when if stretch[1] - stretch[0] >= least]
    if lasting:
        begins, ends = np.transpose(lasting)
        longest = np.max(ends - begins) / data.rate
        recognised = begins[0] + least - 1
        yield Finding(f'{text} for {longest:.2f} s', float(data.time[recognised]))
