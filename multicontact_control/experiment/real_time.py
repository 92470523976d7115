"""What a machine that could not keep real time did to a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from multicontact_control.arrays import Mask
from multicontact_control.experiment.metrics import SETTLE_AFTER_STEP
from multicontact_control.experiment.oscillation import stretches
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.verdict import HOPELESS
from multicontact_control.supervision.event_log import CAPACITY, Event
from multicontact_control.supervision.fallback import INFLATE, NONE
import numpy as np

REAL_TIME = 'real_time'  # the mode with deadlines
LARGEST_MISS = 0.01  # share of deadlines missed, or samples unanswered, that is still real time
SHORTEST_GAP = 2  # samples; one that is missing is bridged, and nobody reacts to it
AFTERMATH = SETTLE_AFTER_STEP  # s after a gap; contacts are sought and loaded anew, as by a step
RECOVERING = 'recovering'
LATE = ('stale', 'order', 'stamp')  # what is wrong with a sample that is late


@dataclass(frozen=True)
class Timeliness:
    """
    How the machine kept up with a run.

    Attributes
    ----------
    kept
        Whether it did; None for a run without deadlines.
    misses, unanswered, reactions
        Deadlines missed, samples without an answer, and how often the supervisor held the arm
        because samples were late or missing.
    hopeless
        Whether so many deadlines were missed that the run cannot be judged.
    judged
        Samples that the arm answers for, shape (m,). All, if real time was kept. Otherwise not
        those from two unanswered samples in a row, or from such a reaction, until 1 s after it.

    """

    kept: bool | None
    misses: int
    unanswered: int
    reactions: int
    judged: Mask
    hopeless: bool = False


def replaces(reaction: str) -> bool:
    """Return whether a reaction is there instead of the control law; a larger R is not."""
    return reaction not in (NONE, INFLATE)


def is_late(event: Event) -> bool:
    """Return whether all that a supervisor reacted to is samples that were late or missing."""
    causes = [cause for cause in event.causes if cause != RECOVERING]
    return bool(causes) and all(
        cause.startswith('clock_') or cause.endswith(LATE) for cause in causes)


def timeliness(
    data: RunData, mode: str, timing: Mapping[str, Any], events: Sequence[Event],
) -> Timeliness:
    """
    Find out whether a run kept real time.

    It did not if more than 1 % of the deadlines were missed or of the samples not answered, or
    if the supervisor held the arm even once because samples did not come.

    Parameters
    ----------
    data
        The recording.
    mode, timing
        As in ``summary.json``.
    events
        What the supervisor did.

    """
    everything = np.ones(data.ticks, dtype=bool)
    if mode != REAL_TIME:
        return Timeliness(None, 0, 0, 0, everything)
    missing = np.asarray(np.isnan(data.torque).any(axis=1))
    held = late_reactions(events, float(data.time[-1]))
    misses, unanswered = int(timing.get('deadline_misses', 0)), int(missing.sum())
    if not held and max(misses, unanswered) <= LARGEST_MISS * data.ticks:
        return Timeliness(True, misses, unanswered, 0, everything)
    gaps = [(begin / data.rate, end / data.rate) for begin, end in zip(*stretches(missing))
            if end - begin >= SHORTEST_GAP]
    judged = everything
    for begin, end in gaps + held:
        judged &= ~((data.time >= begin) & (data.time < end + AFTERMATH))
    return Timeliness(False, misses, unanswered, len(held), judged,
                      hopeless=misses > HOPELESS * data.ticks)


def late_reactions(events: Sequence[Event], until: float) -> list[tuple[float, float]]:
    """
    Return from when to when the arm was held because samples were late or missing [s].

    As long as nothing else calls for it, and up to `until`, or the end of a log that is full.
    """
    found: list[tuple[float, float]] = []
    begin: float | None = None
    for event in events:
        held = replaces(event.reaction)
        if begin is None and held and is_late(event):
            begin = event.time
        elif begin is not None and not (
                held and (is_late(event) or event.causes == (RECOVERING,))):
            found.append((begin, event.time))
            begin = None
    if begin is None:
        return found
    return [*found, (begin, until if len(events) < CAPACITY else events[-1].time)]
