"""The verdict on a run: against limits, with what help of the supervisor, and how well."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
import math
from typing import Any, NamedTuple

from multicontact_control.arrays import find_true_stretches, Mask
from multicontact_control.judging.metrics import (
    RunMetrics,
    torque_limit,
    truth_lacking,
)
from multicontact_control.runs.recording import (
    describe_missing,
    Missing,
    RunData,
)
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision import contacts
from multicontact_control.supervision.gate import LIMIT_NAMES
from multicontact_control.supervision.reactions import INFLATE, NONE
from multicontact_control.supervision.report import CAPACITY
import numpy as np

STABLE, POOR, HELD, NOT_STABLE, SILENT, UNJUDGED = (
    'stable',
    'poor',
    'held by the supervisor',
    'not stable',
    'ended: robot silent',
    'not judged',
)
LOOP_IS_STABLE = {
    STABLE: True,
    POOR: True,
    HELD: False,
    NOT_STABLE: False,
}  # None of the others
INTERRUPTED = 'interrupted by a signal'  # no failure of the run
BY_MEASUREMENT = 'by the measured forces'

LONGEST_LOSS = (
    0.1  # s, of contact or to saturation: five time constants of the designed loop
)
LARGEST_GAP = 0.1  # share of samples without an answer that still lets a run be judged
# A force is too large beyond 5 times its command and beyond half the force ceiling, at which the
# supervisor leaves a contact. The second, an absolute one, is for touches: they go with speed,
# stiffness and mass (12 N at 20 mm/s and 60 000 N/m), and not with the preload that follows.
LARGEST_FORCE = 5.0
IMPACT_SHARE = 0.5  # 30 N of 60 N
# A contact is lost, or the supervisor steps in, again and again if it happens more than 5 times
# within 10 s. One surface that goes away makes one loss, and a bounce or two when it is back.
AGAIN = 5
AGAIN_TIME = 10.0  # s
# A run beyond these is stable, and poor: a force that goes twice as far as its largest step, and a
# motion that is off by twice what the paper's may be (`claims`), a tenth of its 0.1 m.
LARGEST_OVERSHOOT = 100.0  # %
LARGEST_MOTION_ERROR = 0.01  # m rms, while the commanded pose moves
# A run within these is as designed: the paper's claims, and a designed loop without overshoot.
SHORTEST_RISE, LONGEST_RISE = 0.6, 1.4  # of the design, of every step up
DESIGNED_OVERSHOOT = 10.0  # %
DESIGNED_ERROR = 0.02  # of the step, in the steady state
DESIGNED_MOTION_ERROR = 0.005  # m rms
LARGEST_HELD_SHARE = (
    0.05  # of the time under load, in which reactions replace the control law
)
LEAST_JUDGED = (
    0.5  # of the time under load, for which every force is known in a stable run
)

# Modes of a run: the simulator waits; it does not; a robot of others; a recording.
LOCKSTEP, REAL_TIME, EXTERNAL_RUN, RECORDED = (
    'lockstep',
    'free_running',
    'external',
    'recorded',
)
WHOLE = tuple(contacts.NAMES[i] for i in (contacts.IMPACT, contacts.HOLDING))
GONE = tuple(
    contacts.NAMES[i] for i in (contacts.LOST, contacts.RETRACTING, contacts.GIVEN_UP)
)
LIMITS = tuple(LIMIT_NAMES.values())


class Event(NamedTuple):
    """A line of the supervisor's log: its time [s], and the fields of `SupervisorStatus`."""

    time: float
    reaction: str
    causes: tuple[str, ...]
    limits: tuple[str, ...]
    contact_states: tuple[str, ...]


def read_event(time: float, what: str) -> Event:
    """Return what a line of the log says."""
    # After these three come what contacts read before they touch, in words of their own.
    reaction, reasons, states, *_ = what.split(' | ')
    names = reasons.split()
    return Event(
        time,
        reaction,
        tuple(name for name in names if name not in LIMITS),
        tuple(name for name in names if name in LIMITS),
        tuple(states.split(', ')),
    )


class Finding(NamedTuple):
    """A limit that was passed: which one, and by how much."""

    text: str
    time: float | None = None  # when [s]; None for what was missed throughout the run


class Verdict(NamedTuple):
    """What a run is called, and why."""

    name: str  # `STABLE`, `POOR`, `HELD`, `NOT_STABLE`, `SILENT` or `UNJUDGED`
    reasons: tuple[str, ...]  # of a run that is not judged, what was seen all the same
    judged: str  # which forces, over what time
    quality: str  # how good the answers to steps and the motion are
    unstable_at: (
        float | None
    )  # of limits that were passed: the first that has a time [s], if any
    unjudged: str = ''  # why it is not judged, if it is not


def verdict_text(summary: Mapping[str, Any]) -> str:
    """Return the verdict of a run and its reasons, as its summary has them."""
    name: str = summary['verdict']
    reasons = '; '.join(summary['instabilities'])
    if name == UNJUDGED:
        return f'{name}: {summary["unjudged"]}' + (
            f'; seen: {reasons}' if reasons else ''
        )
    if summary['without_truth'] and name != SILENT:
        return f'{name} {BY_MEASUREMENT}: {reasons}'
    return f'{name}: {reasons}' if reasons else name


def judge(
    data: RunData,
    setup: Setup,
    *,
    mode: str = 'in_process',
    ended_early: str = '',
    events: Sequence[tuple[float, str]] = (),
    missing: Sequence[Missing] = (),
) -> Verdict:
    """
    Judge a run; `mode` is that of ``summary.json``.

    `ended_early` is why it ended before its time; `INTERRUPTED` speaks neither for nor against it.
    `events` are the lines of the supervisor's log with their times [s]; `missing` is what the
    recording lacks.
    """
    run = RunMetrics(data, setup, missing)
    passed, helped = (
        _findings(run, mode, ended_early, missing),
        _interventions(run, events),
    )
    overshoots = {
        contact: step.overshoot_percent
        for i, contact in enumerate(data.contact_names)
        if (step := run.largest_step(i))
    }
    error = run.motion_summary()['moving_position_rms_m']
    far = [
        f'{contact}: overshoots its largest step by {percent:.0f} %'
        for contact, percent in overshoots.items()
        if percent > LARGEST_OVERSHOOT
    ]
    if error is not None and error > LARGEST_MOTION_ERROR:
        far.append(f'motion error of {1e3 * error:.0f} mm rms')
    silent = mode == EXTERNAL_RUN and ended_early not in ('', INTERRUPTED)
    name = SILENT if silent else HELD if helped else POOR if far else STABLE
    if len(passed) > silent:  # the first one says that the robot is silent
        name = NOT_STABLE
    unjudged = _doubt(run, ended_early, missing) if name in (STABLE, POOR) else ''
    times = [finding.time for finding in passed if finding.time is not None]
    return Verdict(
        UNJUDGED if unjudged else name,
        (*(finding.text for finding in passed), *helped, *far),
        _judged(run),
        _quality(run, error),
        min(times, default=None),
        unjudged,
    )


def _judged(run: RunMetrics) -> str:
    """Return what a verdict is about: forces, and their time under load."""
    names: dict[str, list[str]] = {'true': [], 'measured': []}
    for name, known, forces in zip(run.data.contact_names, run.truth, run.pressing.T):
        if (forces > 0.0).any():
            names['true' if known else 'measured'].append(name)
    parts = [
        f'{run.windows.loaded.sum() / run.data.rate:.3g} s under load',
        *(
            f'{kind} force of {" and ".join(some)}'
            for kind, some in names.items()
            if some
        ),
    ]
    return ', '.join(parts)


def _quality(run: RunMetrics, error: float | None) -> str:
    """Return how good a run is: the answers to its steps, and the motion's error [m]."""
    good: list[str] = []
    bad: list[str] = []
    for text, is_good in (*_step_qualities(run), *_motion_quality(error)):
        (good if is_good else bad).append(text)
    parts = []
    if bad:
        parts.append(f'not as designed: {", ".join(bad)}')
    if good:
        parts.append(f'as designed: {", ".join(good)}')
    return '; '.join(parts)


def _step_qualities(run: RunMetrics) -> Iterator[tuple[str, bool]]:
    """Yield what the answers to steps of all contacts are, and whether as designed."""
    columns = range(len(run.leaders))
    steps = [step for i in columns if (step := run.largest_step(i))]
    if not steps:
        return
    yield from _rise_quality(run)
    overshoot = max(step.overshoot_percent for step in steps)
    yield f'overshoot at most {overshoot:.0f} %', overshoot <= DESIGNED_OVERSHOOT
    settling = [step.settling_s for step in steps if step.settling_s is not None]
    if len(settling) < len(steps):
        yield 'a step never settled', False
    else:
        yield f'settled within {max(settling):.2f} s', True
    errors = [
        (abs(step.steady_error_n), abs(step.size_n))
        for step in steps
        if step.steady_error_n is not None
    ]
    if errors:
        is_good = all(error <= DESIGNED_ERROR * size for error, size in errors)
        yield f'steady-state error at most {max(errors)[0]:.2f} N', is_good


def _rise_quality(run: RunMetrics) -> Iterator[tuple[str, bool]]:
    """Yield how fast steps were, those of the paper's claims, and whether as designed."""
    rises: list[float] = []
    for i in range(len(run.leaders)):
        for step in run.timed_steps(i):
            if step.rise_63_s is None:
                yield '63 % of a step never reached', False
                return
            rise = run.rise_over_design(i, step)
            if rise is not None:
                rises.append(rise)
    if rises:
        low, high = min(rises), max(rises)
        ends = dict.fromkeys((f'{low:.2f}', f'{high:.2f}'))
        is_good = SHORTEST_RISE <= low and high <= LONGEST_RISE
        yield f'rise {" to ".join(ends)} of the design', is_good


def _motion_quality(error: float | None) -> Iterator[tuple[str, bool]]:
    """Yield what the error of the motion is [m], and whether as designed."""
    if error is not None:
        yield f'motion error {1e3 * error:.2g} mm rms', error <= DESIGNED_MOTION_ERROR


def losses_seen(run: RunMetrics, log: Sequence[tuple[float, str]]) -> dict[str, int]:
    """Return how often the supervisor lost a contact under load, by the contact's name."""
    loaded, before = run.windows.loaded, None
    counts = dict.fromkeys(run.setup.controller.contact_names, 0)
    for event in (read_event(*line) for line in log):
        place = round(event.time * run.data.rate)
        if before is not None and place < run.data.ticks and loaded[place]:
            states = zip(counts, before.contact_states, event.contact_states)
            for name, was, now in states:
                counts[name] += was in WHOLE and now in GONE
        before = event
    return counts


def _doubt(run: RunMetrics, ended_early: str, missing: Sequence[Missing]) -> str:
    """Return why a run without findings is not called stable; empty if it is."""
    if ended_early == INTERRUPTED:
        return INTERRUPTED
    if missing:
        return f'{describe_missing(missing)}; what is there passed no limit'
    if not np.isfinite(run.force).any():
        return 'neither true nor measured forces'
    if not run.windows.loaded.any():
        return 'never under load'
    for i, name in enumerate(run.data.contact_names):
        felt = run.known_share(i, run.force)
        if felt < LEAST_JUDGED:
            return (
                f'{name}: its force could be judged for {100.0 * felt:.0f} % of the time '
                'under load'
            )
        lost = run.windows.loaded & (run.pressing[:, i] > 0.0) & run.unknown(i)
        if lost.any():
            gaps = [
                Missing(float(run.data.time[begin]), end / run.data.rate)
                for begin, end in find_true_stretches(lost)
            ]
            return f'{name}: {describe_missing(gaps, "force")}; what is there passed no limit'
    unknown = truth_lacking(run.without_truth(), run.data.contact_names)
    return f'{unknown}; {BY_MEASUREMENT} no limit was passed' if unknown else ''


def _findings(
    run: RunMetrics,
    mode: str,
    ended_early: str,
    missing: Sequence[Missing],
) -> list[Finding]:
    """Return the limits that a run has passed, those of couples while their contact is pressed."""
    data, setup, interrupted = run.data, run.setup, ended_early == INTERRUPTED
    passed = (
        [Finding(ended_early, float(data.time[-1]))]
        if (ended_early and not interrupted)
        else []
    )
    series = (data.q, data.qd, data.torque, data.alpha_true, data.alpha_meas)
    infinite = np.any([np.isinf(values).any(axis=1) for values in series], axis=0)
    if infinite.any():
        passed.append(Finding('a number is not finite', _first(data, infinite)))
    saturated = np.abs(data.torque) >= 0.999999 * run.least_torque_limit
    of_drives = saturated & (run.least_torque_limit < torque_limit(setup))
    passed += _lasting(
        data,
        'torque saturated'
        + (' at the limit of the simulated drives' if of_drives.any() else ''),
        find_true_stretches(np.asarray(saturated.any(axis=1))),
    )
    # Before the load a contact may still be sought.
    awaited = run.windows.loaded.any() and not (interrupted or missing)
    for i, name in enumerate(data.contact_names):
        desired, pressed = data.alpha_des[:, i], run.pressing[:, i] > 0.0
        idle = setup.commanded_by_topic and not pressed.any()
        made = (
            run.couples[i]
            or idle
            or (desired > 0.0).any()
            or not np.isfinite(desired).any()
        )
        if made:
            passed += [
                Finding(f'{name}: {text}', time)
                for text, time in _contact_findings(
                    run, i, run.windows.loaded & pressed
                )
            ]
        elif awaited:
            passed.append(Finding(f'{name}: no contact was made'))
    silent = max(
        float(np.isnan(values[run.recorded]).any(axis=1).mean()) for values in series
    )
    if mode in ('in_process', LOCKSTEP, REAL_TIME) and silent > LARGEST_GAP:
        passed.append(
            Finding(f'{100.0 * silent:.1f} % of the samples were not answered')
        )
    return passed


def _contact_findings(run: RunMetrics, i: int, loaded: Mask) -> list[Finding]:
    data, couple = run.data, run.couples[i]
    losses = run.losses(i, loaded)
    passed = _lasting(
        data, 'contact lost at one end' if couple else 'contact lost', losses
    )
    again = _again([float(data.time[begin]) for begin, _ in losses])
    # An end is near being lost wherever the centre of pressure is asked to be: noise will do.
    if again is not None and not couple:
        passed.append(Finding(f'contact lost {len(losses)} times', again))
    oscillating = run.oscillations(i, loaded)
    if oscillating:
        worst = max(oscillating, key=lambda oscillation: oscillation.rms)
        total = sum(oscillation.duration for oscillation in oscillating)
        passed.append(
            Finding(
                f'oscillates at {worst.frequency:.0f} Hz with {worst.rms:.2g} N rms '
                f'for {total:.1f} s',
                oscillating[0].known,
            )
        )
    force, command = run.force[:, i], run.command[:, i]
    # A couple may be of either sign; a pull is no pressure that is too large.
    size, asked = (np.abs(force), np.abs(command)) if couple else (force, command)
    ceiling = run.setup.controller.contact_state.force_ceiling
    beyond = size > np.maximum(LARGEST_FORCE * asked, IMPACT_SHARE * ceiling)
    if beyond.any():
        worst_at = int(np.argmax(np.where(beyond, size, 0.0)))
        passed.append(
            Finding(
                f'{"couple" if couple else "force"} of {force[worst_at]:.0f} N at a command of '
                f'{command[worst_at]:.3g} N',
                _first(data, beyond),
            )
        )
    return passed


def _interventions(run: RunMetrics, log: Sequence[tuple[float, str]]) -> list[str]:
    """Return how often reactions, lost contacts and limits stood in for the law under load."""
    data, loaded = run.data, run.windows.loaded
    if not loaded.any():
        return []
    events = [read_event(*line) for line in log]
    places = [round(event.time * data.rate) for event in events]
    times, held, names = [], np.zeros(data.ticks, dtype=bool), Counter[str]()
    ends = [*places[1:], data.ticks]
    for before, event, place, end in zip(events[:1] + events, events, places, ends):
        held[place:end] = _replaces(event)
        if place < data.ticks and loaded[place] and (begun := _begun(before, event)):
            times.append(event.time)
            names.update(begun)
    helped = []
    if len(events) == CAPACITY:
        helped.append(
            f'the supervisor changed something {CAPACITY} times or more: what it did '
            f'before {events[0].time:.3g} s is not known'
        )
    commonest = ', '.join(f'{name} {count}' for name, count in names.most_common(3))
    if _again(times) is not None:
        helped.append(
            f'the supervisor stepped in {len(times)} times under load ({commonest})'
        )
    share = float(held[loaded].mean())
    if share > LARGEST_HELD_SHARE:
        helped.append(
            f'the supervisor held the arm for {100.0 * share:.0f} % of the time under load'
        )
    return helped


def _begun(before: Event, event: Event) -> set[str]:
    """Return which limits, causes of a reaction and losses began between two events."""
    begun = set(event.limits) - {*before.limits, 'reference'}
    if _replaces(event) and not _replaces(before):
        begun.update(event.causes or {event.reaction})
    states = zip(before.contact_states, event.contact_states)
    return begun | {
        f'contact {now}' for was, now in states if was in WHOLE and now in GONE
    }


def _replaces(event: Event) -> bool:
    """Return whether a reaction is there instead of the control law; a larger R is not."""
    return event.reaction not in (NONE, INFLATE)


def _again(times: Sequence[float]) -> float | None:
    """Return the first of some times at which more than 5 are within 10 s, None without any."""
    return next(
        (
            late
            for early, late in zip(times, times[AGAIN:])
            if late - early <= AGAIN_TIME
        ),
        None,
    )


def _first(data: RunData, mask: Mask) -> float:
    """Return when something was first so [s]."""
    return float(data.time[np.argmax(mask)])


def _lasting(
    data: RunData, what: str, when: Sequence[tuple[int, int]]
) -> list[Finding]:
    """Return what lasted for more than 0.1 s, at most, and when it first had."""
    lasting = math.floor(LONGEST_LOSS * data.rate) + 1
    long = [(begin, end) for begin, end in when if end - begin >= lasting]
    if not long:
        return []
    longest = max(end - begin for begin, end in long) / data.rate
    return [
        Finding(
            f'{what} for {longest:.2f} s', float(data.time[long[0][0] + lasting - 1])
        )
    ]
