"""What the supervisor did in a run, by its log: reactions, limits and lost contacts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from multicontact_control.judging.run_series import RunSeries
from multicontact_control.supervision import contacts
from multicontact_control.supervision.causes import INFLATE, NONE
from multicontact_control.supervision.gate import LIMIT_NAMES
from multicontact_control.supervision.report import EVENT_CAPACITY
import numpy as np

# A contact is lost, or the supervisor steps in, too often if it happens more than 5 times within
# 10 s. One surface that goes away makes one loss, and a bounce or two when it is back.
MOST_REPETITIONS = 5
REPETITION_TIME = 10.0  # s
# Share of the time under load in which reactions may replace the control law.
LARGEST_HELD_SHARE = 0.05
REFERENCE_LIMIT = 'reference'  # a slow reference, which is no intervention

TOUCHING_STATES = (
    contacts.STATE_NAMES[contacts.IMPACT],
    contacts.STATE_NAMES[contacts.HOLDING],
)
LOST_STATES = (
    contacts.STATE_NAMES[contacts.LOST],
    contacts.STATE_NAMES[contacts.RETRACTING],
    contacts.STATE_NAMES[contacts.GIVEN_UP],
)

LogLine = tuple[float, str]  # time [s], and what changed


class SupervisorEvent(NamedTuple):
    """
    A line of the supervisor's log: its time [s], and the fields of `SupervisorStatus`.

    An event holds until the next one: the log has a line for each change, not for each tick.
    """

    time: float
    reaction: str
    causes: tuple[str, ...]
    limits: tuple[str, ...]
    contact_states: tuple[str, ...]

    @property
    def replaces_law(self) -> bool:
        """
        Whether a reaction stands instead of the control law; a larger R does not.

        Time under such a reaction counts as held: what the contacts do then is not the law's
        merit.
        """
        return self.reaction not in (NONE, INFLATE)


def read_event(time: float, line: str) -> SupervisorEvent:
    """
    Return what a line of the supervisor's log says, at a time [s].

    Its parts are the reaction, causes and limits, and contact states. What contacts read before
    they touch may follow, in words of their own, and is left out.
    """
    reaction, reasons, states, *_ = line.split(' | ')
    limit_names = LIMIT_NAMES.values()
    causes = []
    limits = []
    for name in reasons.split():
        if name in limit_names:
            limits.append(name)
        else:
            causes.append(name)
    return SupervisorEvent(
        time, reaction, tuple(causes), tuple(limits), tuple(states.split(', '))
    )


def count_losses(run: RunSeries, log: Sequence[LogLine]) -> dict[str, int]:
    """
    Return how often the supervisor lost each contact under load, by the contact's name.

    A loss is a change from impact or holding to a state in which the contact is lost, retracts or
    is given up. It is what the controller believed, whatever the true force was.
    """
    counts = dict.fromkeys(run.setup.controller.contact_names, 0)
    events = [read_event(*line) for line in log]
    for before, event in _list_changes_under_load(run, events):
        states = zip(counts, before.contact_states, event.contact_states)
        for name, was, now in states:
            if was in TOUCHING_STATES and now in LOST_STATES:
                counts[name] += 1
    return counts


def list_interventions(run: RunSeries, log: Sequence[LogLine]) -> list[str]:
    """
    Return in words how the supervisor stood in for the control law under load.

    There is a line if its log is full, if it stepped in more than 5 times within 10 s (with the
    commonest causes), and if its reactions held the arm for more than 5 % of the time.
    """
    loaded = run.windows.loaded
    if not loaded.any():
        return []
    events = [read_event(*line) for line in log]
    lines = []
    if len(events) == EVENT_CAPACITY:
        lines.append(
            f'the supervisor changed something {EVENT_CAPACITY} times or more: what it did '
            f'before {events[0].time:.3g} s is not known'
        )
    times = []
    causes = Counter[str]()
    for before, event in _list_changes_under_load(run, events):
        begun = _list_begun_interventions(before, event)
        if begun:
            times.append(event.time)
            causes.update(begun)
    if find_repetition(times) is not None:
        counts = [f'{cause} {count}' for cause, count in causes.most_common(3)]
        lines.append(
            f'the supervisor stepped in {len(times)} times under load '
            f'({", ".join(counts)})'
        )
    held = np.zeros(run.data.ticks, dtype=bool)
    for event in events:
        held[_find_sample(run, event) :] = event.replaces_law
    share = float(held[loaded].mean())
    if share > LARGEST_HELD_SHARE:
        lines.append(
            f'the supervisor held the arm for {100.0 * share:.0f} % of the time under load'
        )
    return lines


def _find_sample(run: RunSeries, event: SupervisorEvent) -> int:
    return round(event.time * run.data.rate)


def _list_changes_under_load(
    run: RunSeries, events: Sequence[SupervisorEvent]
) -> Iterator[tuple[SupervisorEvent, SupervisorEvent]]:
    """Yield each event under load after the one before it; the first one after itself."""
    for before, event in zip([*events[:1], *events], events):
        sample = _find_sample(run, event)
        if sample < run.data.ticks and run.windows.loaded[sample]:
            yield before, event


def _list_begun_interventions(
    before: SupervisorEvent, event: SupervisorEvent
) -> list[str]:
    """Return the limits, causes of a reaction and losses that began between two events."""
    begun = set(event.limits) - {*before.limits, REFERENCE_LIMIT}
    if event.replaces_law and not before.replaces_law:
        begun.update(event.causes or {event.reaction})
    for was, now in zip(before.contact_states, event.contact_states):
        if was in TOUCHING_STATES and now in LOST_STATES:
            begun.add(f'contact {now}')
    return sorted(begun)


def find_repetition(times: Sequence[float]) -> float | None:
    """
    Return the first time [s] by which something came more than 5 times within 10 s, or None.

    `times` are in their order. A supervisor that steps in so often has become a part of the loop,
    and the run is not the law's.
    """
    for early, late in zip(times, times[MOST_REPETITIONS:]):
        if late - early <= REPETITION_TIME:
            return late
    return None
