"""When control resumes after a reaction, and which of two reactions stays that take turns."""

from __future__ import annotations

from typing import Protocol

from multicontact_control.compiled import compiled
from multicontact_control.records import Record, record_dtype
from multicontact_control.supervision.causes import (
    LATCHED,
    PHYSICAL,
    RECOVERING,
    WRENCH_STRAY,
)
import numpy as np

# Two reactions that take turns: so many changes, each forgotten within FLICKER_TIME [s], and the
# severer one stays until nothing has called for it over CALM_TIME [s].
FLICKERS = 3.5
FLICKER_TIME = 1.0
CALM_TIME = 0.5
NOTHING = -1  # less severe than any reaction

RELAPSE_TIME = 5.0  # s after control has resumed, in which a reaction is a relapse
SOON = 1.0  # s, the same where readings are missing, which come and go by chance
# In a row, of what the arm does or meets, after which control waits for an operator.
RELAPSES = 3
LONGEST_RECOVERY = 2.0  # s that all must be well, at most
GROWTH = 3.0  # of the time that all must be well, from relapse to relapse
LONG_AGO = -(10**12)  # tick, before any


class Hysteresis(Record, Protocol):
    """Keeps to the severer of two reactions that take turns, as with joints that come and go."""

    period: float  # h [s]
    before: int  # reaction of the tick before
    severer: int  # that stays
    changes: float  # count of them, which fades
    calm_ticks: int  # since anything has called for the severer one


class Recovery(Record, Protocol):
    """
    Counts relapses, so that holding and resuming do not alternate for ever.

    A reaction soon after control has resumed is a relapse, as is a law that cannot resume: each
    makes the time that all must be well three times as long. After three in a row of what the arm
    does or meets control is `latched`: the posture is held until an operator resumes it.
    """

    period: float  # h [s]
    shortest: float  # time that all must be well, without relapses [s]
    wait: float  # that time now [s]
    resumed_at: int  # tick of control's own count
    relapses: int  # in a row
    latched: bool


HYSTERESIS = record_dtype(Hysteresis)
RECOVERY = record_dtype(Recovery)


@compiled
def reset_hysteresis(hysteresis: Hysteresis) -> None:
    """Forget the past."""
    hysteresis.before = NOTHING
    hysteresis.severer = NOTHING
    hysteresis.changes = 0.0
    hysteresis.calm_ticks = 0


@compiled
def steady_reaction(hysteresis: Hysteresis, reaction: int) -> int:
    """Return what answers a tick for which a reaction is called for, the law aside."""
    hysteresis.changes *= np.exp(-hysteresis.period / FLICKER_TIME)
    before = hysteresis.before
    if before != NOTHING and reaction != before:
        hysteresis.changes += 1.0
        if hysteresis.changes > FLICKERS:
            hysteresis.severer = max(reaction, before, hysteresis.severer)
    hysteresis.before = reaction
    hysteresis.calm_ticks += 1
    if reaction >= hysteresis.severer:
        hysteresis.calm_ticks = 0
    if hysteresis.calm_ticks * hysteresis.period > CALM_TIME:
        hysteresis.severer = NOTHING
    return max(reaction, hysteresis.severer)


@compiled
def reset_recovery(recovery: Recovery) -> None:
    """Forget the past."""
    recovery.wait = recovery.shortest
    recovery.resumed_at = LONG_AGO
    unlatch_control(recovery)


@compiled
def unlatch_control(recovery: Recovery) -> None:
    """Let control resume although it is latched; the next relapse is the first."""
    recovery.latched = False
    recovery.relapses = 0


@compiled
def note_reaction(recovery: Recovery, causes: int, tick: int) -> bool:
    """Take note of a reaction that begins at a tick of control; return if it is new."""
    if causes & WRENCH_STRAY:  # it presses on what is there
        recovery.latched = True
    soon = SOON
    if causes & PHYSICAL:
        soon = RELAPSE_TIME
    if (tick - recovery.resumed_at) * recovery.period > soon:
        recovery.relapses = 0
        recovery.wait = recovery.shortest
        return True
    note_relapse(recovery, causes)
    return False


@compiled
def note_relapse(recovery: Recovery, causes: int) -> None:
    """Take note that control has stopped too soon, or could not even resume."""
    longest = max(LONGEST_RECOVERY, recovery.shortest)
    recovery.wait = min(GROWTH * recovery.wait, longest)
    if causes & PHYSICAL:
        recovery.relapses += 1
        recovery.latched = recovery.relapses >= RELAPSES


@compiled
def find_waiting_cause(recovery: Recovery, good_ticks: int) -> int:
    """Return what control still waits for after so many good ticks, 0 for nothing."""
    if recovery.latched:
        return LATCHED
    if good_ticks * recovery.period < recovery.wait:
        return RECOVERING
    return 0
