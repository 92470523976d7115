"""How a run answers what disturbs it: recovery from pushes, time to instability."""

from __future__ import annotations

from dataclasses import asdict, dataclass
import math
from typing import Any

from multicontact_control.arrays import Mask, Vector
from multicontact_control.experiment.judge import findings
from multicontact_control.experiment.metrics import windows
from multicontact_control.experiment.oscillation import spectrum
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.scenario import Setup
import numpy as np

BAND_OF_COMMAND = 0.05  # recovered: the error is within this share of the command ...
BAND_OF_NOISE = 3.0  # ... or this many standard deviations of the error before the push,
BAND_HELD = 0.1  # s, for this long
LOOK_BACK = 1.0  # s, before a push, from which its noise is taken
LASTING = 0.5  # s; a push this long is to be controlled out while it lasts
GROWTH = 0.5  # s before instability in which its oscillation is looked for
SETTLE_AFTER_PUSH = 1.0  # s, left out of `rest` and `moving`


@dataclass(frozen=True)
class Recovery:
    """
    The answer of one contact to one push.

    Attributes
    ----------
    start, duration
        Of the push [s].
    moving
        Whether it comes in motion.
    peak
        Largest error of the true force from the push's start until the next event [N].
    band
        Error that counts as recovered [N].
    recovery
        Time until the error is within the band and stays there for 0.1 s [s]: from the end of a
        short push, from the start of a lasting one (0.5 s or more). 0 if it never left the band,
        None if it did not come back before the next event, or the run was unstable by then.

    """

    start: float
    duration: float
    moving: bool
    peak: float
    band: float
    recovery: float | None


def recoveries(data: RunData, setup: Setup, contact: int) -> list[Recovery]:
    """Return the answers of one contact to the pushes of the plant."""
    plant = setup.plant
    unstable = instability_time(data, setup)
    found = []
    for start, duration in zip(plant.push_start, plant.push_duration):
        from_time = start if duration >= LASTING else start + duration
        until = min(_next_event(setup, start), float(data.time[-1]) + 1.0 / data.rate)
        until = min(until, start + duration) if duration >= LASTING else until
        before = _between(data.time, start - LOOK_BACK, start)
        judged = _between(data.time, from_time, until)
        whole = _between(data.time, start, until)
        if not (before.any() and judged.any()):
            continue
        error = data.alpha_true[:, contact] - data.alpha_des[:, contact]
        band = max(BAND_OF_COMMAND * float(data.alpha_des[judged, contact][0]),
                   BAND_OF_NOISE * float(np.std(error[before])))
        after = _settled(np.abs(error[judged]) <= band, round(BAND_HELD * data.rate))
        lost = unstable is not None and unstable < until
        found.append(Recovery(
            start=start, duration=duration, moving=_in_motion(setup, start),
            peak=float(np.nanmax(np.abs(error[whole]))), band=band,
            recovery=None if after is None or lost else after / data.rate))
    return found


def _between(time: Vector, start: float, end: float) -> Mask:
    return (time >= start - 1e-9) & (time < end - 1e-9)


def _in_motion(setup: Setup, time: float) -> bool:
    motion = setup.scenario.reference.motion
    return motion is not None and time >= motion.start_time


def _next_event(setup: Setup, time: float) -> float:
    """Return when the next push, force step or motion begins."""
    reference = setup.scenario.reference
    events = [*setup.plant.push_start, *(step.time for step in reference.force_steps)]
    if reference.motion is not None:
        events.append(reference.motion.start_time)
    return min((event for event in events if event > time + 1e-9), default=math.inf)


def _settled(inside: Mask, held: int) -> int | None:
    """Return the first sample from which the next `held` are inside; None if there is none."""
    if len(inside) < held:
        return None
    counts = np.convolve(inside.astype(int), np.ones(held, dtype=int), 'valid')
    first = np.flatnonzero(counts == held)
    return int(first[0]) if first.size else None


def instability_time(data: RunData, setup: Setup, ended_early: bool = False) -> float | None:
    """Return when the first of the limits of `findings` was passed [s], None if none was."""
    found = findings(data, setup, ended_early='ended early' if ended_early else '')
    return min((finding.time for finding in found if finding.time is not None), default=None)


def oscillation(data: RunData, unstable_at: float) -> float | None:
    """Return the strongest frequency of the true forces over the 0.5 s before that [Hz]."""
    window = _between(data.time, unstable_at - GROWTH, unstable_at)
    forces = data.alpha_true[window]
    if forces.shape[0] < GROWTH * data.rate - 1 or not np.isfinite(forces).all():
        return None
    frequencies, power = spectrum(forces.T, data.rate, padding=8)
    return float(frequencies[int(np.argmax(power.sum(axis=0)))])


def quiet_windows(data: RunData, setup: Setup) -> tuple[Mask, Mask]:
    """Return the windows `rest` and `moving` without the pushes and 1 s after each."""
    judged = windows(setup.scenario.reference, data.time)
    quiet = np.ones(data.ticks, dtype=bool)
    for start, duration in zip(setup.plant.push_start, setup.plant.push_duration):
        quiet &= ~_between(data.time, start, start + duration + SETTLE_AFTER_PUSH)
    return judged.rest & quiet, judged.moving & quiet


def disturbance_summary(data: RunData, setup: Setup, ended_early: bool = False) -> dict[str, Any]:
    """
    Return what `compare` needs beyond ``summary.json``, as JSON values.

    Parameters
    ----------
    data, setup
        The run.
    ended_early
        Whether it ended before its time.

    """
    rest, moving = quiet_windows(data, setup)
    unstable = instability_time(data, setup, ended_early)
    motion = setup.scenario.reference.motion
    contacts = {}
    for i, name in enumerate(data.contact_names):
        contacts[name] = {
            'rest': _errors(data, i, rest), 'moving': _errors(data, i, moving),
            'recoveries': [asdict(answer) for answer in recoveries(data, setup, i)]}
    return {
        'contacts': contacts, 'unstable_at_s': unstable,
        'oscillation_hz': None if unstable is None else oscillation(data, unstable),
        'unstable_after_motion_s':
            None if unstable is None or motion is None else unstable - motion.start_time}


def _errors(data: RunData, contact: int, window: Mask) -> dict[str, float | None]:
    if not window.any():
        return {'rms_n': None, 'mean_n': None, 'std_n': None, 'lost': None, 'variance_n2': None}
    true = data.alpha_true[window, contact]
    error = true - data.alpha_des[window, contact]
    return {'rms_n': float(np.sqrt(np.mean(error * error))), 'mean_n': float(np.mean(error)),
            'std_n': float(np.std(error)), 'lost': float(np.mean(true <= 0.0)),
            'variance_n2': float(np.median(data.noise_variance[window, contact]))}
