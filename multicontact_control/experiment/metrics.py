"""What is read off a run: errors, answers to steps and pushes, losses, oscillation, torque."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
import math
from typing import Any

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.control.tasks import ReferenceConfig
from multicontact_control.experiment.oscillation import (
    bridged,
    Oscillation,
    oscillations,
    spectrum,
    stretches,
)
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.scenario import Setup
from multicontact_control.supervision.contacts import LOSS_TIME
import numpy as np

SETTLE_AFTER_STEP = 1.0  # s, the start of the window `rest` after the last force step
SETTLE_AFTER_START = 2.0  # s, the start of the window `moving` after the motion's start
MOVING = 1e-3  # m/s, from which on a commanded pose moves
LEAST_TRUTH = 0.9  # share of the time under load, that a true force is known for
NO_TRUTH = 'no ground truth'
ALL_OF_IT = 1.0 - 1e-6  # of a normal force, that presses at one end of its contact
BAND_OF_COMMAND = 0.05  # recovered: the error is within this share of the command ...
BAND_OF_NOISE = 3.0  # ... or this many standard deviations of the error before the push,
BAND_HELD = 0.1  # s, for this long
LOOK_BACK = 1.0  # s, before a push, from which its noise is taken
LASTING = 0.5  # s; a push this long is to be controlled out while it lasts
GROWTH = 0.5  # s before instability in which its oscillation is looked for
SETTLE_AFTER_PUSH = 1.0  # s, left out of `rest` and `moving`


@dataclass(frozen=True)
class Windows:
    """The stretches of a run that are judged: masks of samples, shape (m,)."""

    rest: Mask  # under the last force step
    moving: Mask
    loaded: Mask  # from the first force step on


def windows(reference: ReferenceConfig, time: Vector) -> Windows:
    """Return the judged stretches of a scenario at the times of samples, shape (m,) [s]."""
    steps = reference.force_steps
    start = reference.motion.start_time if reference.motion else math.inf
    first = steps[0].time if steps else math.inf
    before_motion = [step.time for step in steps if step.time < start]
    rest_from = before_motion[-1] + SETTLE_AFTER_STEP if before_motion else math.inf
    return Windows(
        rest=(time >= rest_from) & (time < start), moving=time >= start + SETTLE_AFTER_START,
        loaded=time >= first)


def judged_windows(data: RunData, setup: Setup) -> Windows:
    """
    Return the judged stretches of a run: of its scenario, or of the forces commanded over topics.

    Of the latter `loaded` is while a force is asked for, `moving` while the pose asked for moves,
    and `rest` what is 1 s away from that and from every change of a command.
    """
    if not setup.commanded_by_topic:
        return windows(setup.scenario.reference, data.time)
    command = np.nan_to_num(data.command)
    loaded = np.asarray((command > 0.0).any(axis=1))
    moving = np.zeros(data.ticks, dtype=bool)
    moving[1:] = np.linalg.norm(np.diff(data.position_des, axis=0), axis=1) * data.rate > MOVING
    changed = np.ones(data.ticks, dtype=bool)
    changed[1:] = (np.diff(command, axis=0) != 0.0).any(axis=1)
    places = np.arange(data.ticks)
    last = np.maximum.accumulate(np.where(changed | moving, places, 0))
    calm = places - last >= SETTLE_AFTER_STEP * data.rate
    return Windows(rest=loaded & calm, moving=loaded & moving, loaded=loaded)


def commanded(data: RunData, setup: Setup) -> Matrix:
    """Return the forces asked for by the scenario or over topics, shape (m, r) [N]."""
    return data.command if setup.commanded_by_topic else setup.commanded(data.time)


def under_load(data: RunData, setup: Setup, contact: int) -> Mask:
    """Return when a contact is pressed under load; of one that never is, all of the run."""
    loaded = judged_windows(data, setup).loaded & (pressing(data, setup, contact) > 0.0)
    return loaded if loaded.any() else np.ones(data.ticks, dtype=bool)


def known_share(data: RunData, force: Vector, window: Mask) -> float:
    """Return for what share of a window a force is known, but for gaps of up to 10 ms."""
    return float(np.isfinite(bridged(force, data.rate))[window].mean())


def has_truth(data: RunData, setup: Setup) -> Mask:
    """Return of which contacts the true forces are known for 0.9 of the load, shape (r,)."""
    truth = data.alpha_true
    return np.array([
        bool(np.isfinite(truth[:, i]).any()) and known_share(
            data, truth[:, i], under_load(data, setup, i)) >= LEAST_TRUTH
        for i in range(truth.shape[1])], dtype=bool)


def truth_lacking(without: Sequence[str], names: Collection[str]) -> str:
    """Return in words that of these of all contacts no true force is known; '' if of all."""
    if names and not without:
        return ''
    return NO_TRUTH + (
        f' of {", ".join(without)}' if len(without) < len(names) else '')


def without_truth(data: RunData, setup: Setup) -> list[str]:
    """Return the contacts whose true forces are not known."""
    return [name for name, known in zip(data.contact_names, has_truth(data, setup)) if not known]


def judged_force(data: RunData, setup: Setup) -> Matrix:
    """Return the forces that errors are taken of: true ones, or else those measured."""
    return np.where(has_truth(data, setup), data.alpha_true, data.alpha_meas)


@dataclass(frozen=True)
class StepResponse:
    """The answer of one contact to one commanded step."""

    time: float  # s
    size: float  # N
    rise_63: float | None  # from command to true force beyond 63 % of the step [s]; None: never
    overshoot_percent: float  # of the step


def step_responses(data: RunData, setup: Setup, contact: int) -> list[StepResponse]:
    """Return the answers of one contact to the force steps at rest, until the next event each."""
    steps = _steps(data, setup, contact)
    ends = [time for time, _, _ in steps[1:]] + [float(data.time[-1])]
    force = judged_force(data, setup)[:, contact]
    responses = []
    for (start, before, after), end in zip(steps, ends):
        window = (data.time >= start - 1e-9) & (data.time < min(end, next_event(setup, start)))
        size = after - before
        if size == 0.0 or not window.any():
            continue
        travelled = (force[window] - before) / size
        if not np.isfinite(travelled).any():
            continue
        beyond = np.flatnonzero(travelled > 0.63)
        rise = float(data.time[window][beyond[0]] - start) if beyond.size else None
        responses.append(StepResponse(
            start, size, rise, 100.0 * max(float(np.nanmax(travelled)) - 1.0, 0.0)))
    return responses


def next_event(setup: Setup, time: float) -> float:
    """Return when the next push, or force step or motion of the scenario, begins [s]."""
    events = [*setup.plant.push_start, *setup.plant.tool_push_start] if setup.simulated else []
    if not setup.commanded_by_topic:
        events += [*(step.time for step in setup.scenario.reference.force_steps),
                   motion_start(setup)]
    return min((event for event in events if event > time + 1e-9), default=math.inf)


def motion_start(setup: Setup) -> float:
    """Return when the motion of the scenario begins, infinite if there is none [s]."""
    motion = setup.scenario.reference.motion
    return motion.start_time if motion else math.inf


def _steps(data: RunData, setup: Setup, contact: int) -> list[tuple[float, float, float]]:
    """Return when what force was asked of a contact at rest [s], from what to what [N]."""
    if setup.commanded_by_topic:
        asked = np.nan_to_num(data.command[:, contact])
        # From the preload, where a contact was made: until then nothing counts as asked for.
        desired = np.where(np.isnan(data.alpha_des[:, contact]), asked, data.alpha_des[:, contact])
        changes = np.concatenate([[False], np.diff(asked) != 0.0, [False]])
        # What a desired force passes on its way is no step.
        places = np.flatnonzero(changes[1:-1] & ~changes[:-2] & ~changes[2:]) + 1
        return [(float(data.time[k]), float(desired[k - 1]), float(asked[k])) for k in places
                if k < 2 or desired[k - 1] == desired[k - 2]]
    reference = setup.scenario.reference
    name = data.contact_names[contact]
    steps = [(step.time, step.forces[name]) for step in reference.force_steps
             if name in step.forces and step.time < min(motion_start(setup), data.time[-1])]
    first = 0.0 if is_couple(setup, contact) else reference.approach.preload
    before = [first, *(force for _, force in steps)]
    return [(time, was, force) for was, (time, force) in zip(before, steps)]


def losses(
    data: RunData, setup: Setup, contact: int, judged: Mask,
) -> tuple[list[int], list[int]]:
    """
    Return the first samples of every loss of a contact, and those after its last.

    A loss is a force of 0 N for `LOSS_TIME`, among the samples `judged`. A couple is lost while it
    is as large as the normal force of its contact: one end of an edge, or one side of a plane,
    has left the surface.
    """
    leader = setup.controller.leader_of[contact]
    forces = judged_force(data, setup)
    force = bridged(forces[:, leader], data.rate)
    gone = force <= 0.0
    if leader != contact:
        couple = bridged(forces[:, contact], data.rate)
        # What is lost as a whole is told once, of the normal force.
        gone = ~gone & (np.abs(couple) >= ALL_OF_IT * force)
    least = LOSS_TIME * data.rate - 1e-9
    found = [(begin, end) for begin, end in zip(*stretches(judged & gone))
             if end - begin >= least]
    return [begin for begin, _ in found], [end for _, end in found]


def lost_share(data: RunData, setup: Setup, contact: int, window: Mask) -> float | None:
    """Return in what share of a window a contact's force was 0 N; None for a couple."""
    if is_couple(setup, contact):
        return None
    force = judged_force(data, setup)[:, contact]
    return mean_in(window & np.isfinite(force), force <= 0.0)


def is_couple(setup: Setup, contact: int) -> bool:
    """Return whether what is counted as a contact is a couple of one, not a normal force."""
    return contact not in setup.controller.leaders


def force_error(data: RunData, setup: Setup, contact: int) -> Vector:
    """
    Return the force of a contact, true or else measured, less the command, shape (m,) [N].

    The task's command counts, and not what a supervisor makes of it.
    """
    error: Vector = judged_force(data, setup)[:, contact] - commanded(data, setup)[:, contact]
    return error


def force_oscillations(
    data: RunData, setup: Setup, contact: int, judged: Mask,
) -> list[Oscillation]:
    """Return where the force of a contact oscillates, among the samples `judged`."""
    # A couple, which may well be 0, is judged while its contact is pressed, and by how hard.
    return oscillations(force_error(data, setup, contact), pressing(data, setup, contact),
                        judged, data.rate)


def pressing(data: RunData, setup: Setup, contact: int) -> Vector:
    """Return the normal force asked for at a contact, for a couple that of its contact [N]."""
    return commanded(data, setup)[:, setup.controller.leader_of[contact]]


def saturation(data: RunData, setup: Setup) -> Mask:
    """Return which commanded torques were at their limits, shape (m, n)."""
    return np.asarray(np.abs(data.torque) >= 0.999999 * least_torque_limit(setup))


def least_torque_limit(setup: Setup) -> Vector:
    """Return the smaller of controller's and drives' torque limits, shape (n,) [N m], or inf."""
    own = torque_limit(setup)
    return np.minimum(own, setup.drive_limit) if setup.drive_limit else own


def torque_limit(setup: Setup) -> Vector:
    """Return the controller's limits, shape (n,) [N m], infinite where there is none."""
    limit = setup.controller.torque_limit
    return np.array(limit) if limit else np.full(len(setup.controller.robot.joint_names), np.inf)


def contact_summary(data: RunData, setup: Setup, contact: int) -> dict[str, Any]:
    """Return the numbers of one contact; of the step answers those to the largest step up."""
    judged = judged_windows(data, setup)
    asked = ~(pressing(data, setup, contact) == 0.0)
    responses = step_responses(data, setup, contact)
    largest = max(responses, key=lambda response: response.size, default=None)
    return {
        'step_rise_63_s': largest.rise_63 if largest else None,
        'step_overshoot_percent': largest.overshoot_percent if largest else None,
        'steps': [{'time_s': response.time, 'size_n': response.size,
                   'rise_63_s': response.rise_63,
                   'overshoot_percent': response.overshoot_percent} for response in responses],
        **_hold_summary(data, setup, contact, judged.loaded & asked),
        'rest': _window_summary(data, setup, contact, judged.rest & asked),
        'moving': _window_summary(data, setup, contact, judged.moving & asked)}


def _hold_summary(
    data: RunData, setup: Setup, contact: int, loaded: Mask,
) -> dict[str, float | None]:
    """Return how well a contact was held under load, and its longest oscillation."""
    begins, ends = losses(data, setup, contact, loaded)
    longest = max((end - begin for begin, end in zip(begins, ends)), default=0)
    found = max(force_oscillations(data, setup, contact, loaded),
                key=lambda oscillation: oscillation.duration, default=None)
    return {
        'loss_rate_hz': len(begins) * data.rate / int(loaded.sum()) if loaded.any() else None,
        'longest_loss_s': longest / data.rate,
        'oscillation_hz': found.frequency if found else None,
        'oscillation_rms_n': found.rms if found else None,
        'oscillation_s': found.duration if found else None}


def _window_summary(
    data: RunData, setup: Setup, contact: int, window: Mask,
) -> dict[str, float | None]:
    force, error = judged_force(data, setup)[:, contact], force_error(data, setup, contact)
    known: dict[str, float | None] = {
        'true_error_rms_n': rms_in(window, error),
        'estimate_error_rms_n': rms_in(window, data.alpha_est[:, contact] - force)}
    truth = has_truth(data, setup)
    if not truth[contact]:
        known = dict.fromkeys(known)
    if not truth.all():
        known['measured_error_rms_n'] = None if truth[contact] else rms_in(window, error)
    return {
        **known, 'noise_variance_median_n2': median_in(window, data.noise_variance[:, contact]),
        'contact_loss_fraction': lost_share(data, setup, contact, window)}


def value_in(window: Mask, values: Any, statistic: Callable[[Any], Any]) -> float | None:
    """Return a statistic of a series within a window, None where nothing is known of it."""
    chosen = values[window]
    known = chosen[~np.isnan(chosen)]
    return float(statistic(known)) if known.size else None


def mean_in(window: Mask, values: Any) -> float | None:
    """Return the mean of a series, of a mask the share, within a window."""
    return value_in(window, values, np.mean)


def median_in(window: Mask, values: Vector) -> float | None:
    """Return the median of a series within a window."""
    return value_in(window, values, np.median)


def rms_in(window: Mask, values: Vector) -> float | None:
    """Return the root mean square of a series within a window."""
    square = mean_in(window, values * values)
    return None if square is None else math.sqrt(square)


def motion_summary(data: RunData, setup: Setup) -> dict[str, float | None]:
    """
    Return how well the commanded motion was followed.

    The position error counts along the directions that no contact constrains, the orientation
    error in full, from the first force step on; `moving_position_rms_m` in the window `moving`.
    """
    judged = judged_windows(data, setup)
    if not (judged.loaded.any() and setup.controller.robot.urdf):  # a recording tells no normals
        return dict.fromkeys(('position_rms_m', 'moving_position_rms_m', 'orientation_max_rad'))
    normals = np.array([setup.controller.contacts[name].normal_world
                        for name in setup.controller.contact_names])
    free = np.eye(3) - np.linalg.pinv(normals) @ normals
    error = np.linalg.norm((data.position - data.position_des) @ free, axis=1)
    known = np.isfinite(error)
    return {'position_rms_m': rms_in(judged.loaded & known, error),
            'moving_position_rms_m': rms_in(judged.moving & known, error),
            'orientation_max_rad': value_in(judged.loaded, orientation_error(data), np.max)}


def orientation_error(data: RunData) -> Vector:
    """Return the angle between the orientation and its command, shape (m,) [rad]."""
    cosine = np.abs((data.quaternion * data.quaternion_des).sum(axis=1))
    angle: Vector = 2.0 * np.arccos(np.minimum(cosine, 1.0))
    return angle


def torque_summary(data: RunData, setup: Setup) -> dict[str, float | None]:
    """Return how much of the torque limits was used, None without any."""
    limit = least_torque_limit(setup)
    fraction: Matrix = np.abs(data.torque) / limit
    return {'max_fraction_of_limit': value_in(
                np.isfinite(fraction) & np.isfinite(limit), fraction, np.max),
            'saturated_fraction': float(saturation(data, setup).any(axis=1).mean())}


def percentiles(values: Vector) -> dict[str, float]:
    """Return p50, p99, p99.9 and the largest of some times."""
    if not len(values):
        return {'p50': 0.0, 'p99': 0.0, 'p999': 0.0, 'max': 0.0}
    p50, p99, p999 = np.percentile(values, [50.0, 99.0, 99.9])
    return {'p50': float(p50), 'p99': float(p99), 'p999': float(p999),
            'max': float(np.max(values))}


def after_motion(setup: Setup, unstable_at: float | None) -> float | None:
    """Return the time from the start of the motion until a run became unstable [s]."""
    start = motion_start(setup)
    return None if unstable_at is None or start == math.inf else unstable_at - start


def quiet_windows(data: RunData, setup: Setup) -> tuple[Mask, Mask]:
    """Return the windows `rest` and `moving` without the pushes and 1 s after each."""
    judged = windows(setup.scenario.reference, data.time)
    quiet = np.ones(data.ticks, dtype=bool)
    for start, duration in zip(setup.plant.push_start, setup.plant.push_duration):
        quiet &= ~_between(data.time, start, start + duration + SETTLE_AFTER_PUSH)
    return judged.rest & quiet, judged.moving & quiet


def disturbance_summary(
    data: RunData, setup: Setup, unstable_at: float | None,
) -> dict[str, Any]:
    """Return what `compare` needs beyond ``summary.json``, as JSON values."""
    rest, moving = quiet_windows(data, setup)
    contacts = {name: {
        'rest': _errors(data, setup, i, rest), 'moving': _errors(data, setup, i, moving),
        'recoveries': recoveries(data, setup, i, unstable_at)}
        for i, name in enumerate(data.contact_names)}
    return {
        'contacts': contacts, 'unstable_at_s': unstable_at,
        'oscillation_hz': None if unstable_at is None else growing_line(data, unstable_at),
        'unstable_after_motion_s': after_motion(setup, unstable_at)}


def _errors(data: RunData, setup: Setup, contact: int, window: Mask) -> dict[str, float | None]:
    error = force_error(data, setup, contact)
    return {'rms_n': rms_in(window, error), 'mean_n': mean_in(window, error),
            'std_n': value_in(window, error, np.std),
            'lost': lost_share(data, setup, contact, window),
            'variance_n2': median_in(window, data.noise_variance[:, contact])}


def recoveries(
    data: RunData, setup: Setup, contact: int, unstable_at: float | None = None,
) -> list[dict[str, Any]]:
    """
    Return the answers of one contact to the pushes of the plant.

    Each has `start` and `duration` of the push [s], whether it comes `moving`; `peak`, the largest
    error of the true force until the next event [N]; `band`, the error that counts as recovered
    [N]; `recovery`, the time until the error stays within the band for 0.1 s [s]: from the end of
    a short push, from the start of a lasting one. 0 if it never left the band, None if it did not
    come back before the next event, or the run was unstable by then (`unstable_at` [s]).
    """
    last = float(data.time[-1])
    error, command = force_error(data, setup, contact), setup.commanded(data.time)[:, contact]
    found = []
    for start, duration in zip(setup.plant.push_start, setup.plant.push_duration):
        lasting = duration >= LASTING
        from_time = start if lasting else start + duration
        until = min(next_event(setup, start), last + 1.0 / data.rate,
                    start + duration if lasting else math.inf)
        before = _between(data.time, start - LOOK_BACK, start)
        judged = _between(data.time, from_time, until)
        if not (before.any() and judged.any()):
            continue
        band = max(BAND_OF_COMMAND * float(command[judged][0]),
                   BAND_OF_NOISE * float(np.std(error[before])))
        after = _settled(np.abs(error[judged]) <= band, round(BAND_HELD * data.rate))
        # The end of a run that ended before its time takes no recovery back.
        lost = unstable_at is not None and unstable_at < min(until, last)
        found.append({
            'start': start, 'duration': duration, 'moving': start >= motion_start(setup),
            'peak': float(np.nanmax(np.abs(error[_between(data.time, start, until)]))),
            'band': band, 'recovery': None if after is None or lost else after / data.rate})
    return found


def _between(time: Vector, start: float, end: float) -> Mask:
    return (time >= start - 1e-9) & (time < end - 1e-9)


def _settled(inside: Mask, held: int) -> int | None:
    """Return the first sample from which the next `held` are inside; None if there is none."""
    if len(inside) < held:
        return None
    counts = np.convolve(inside.astype(int), np.ones(held, dtype=int), 'valid')
    first = np.flatnonzero(counts == held)
    return int(first[0]) if first.size else None


def growing_line(data: RunData, unstable_at: float) -> float | None:
    """Return the strongest frequency of the true forces over the 0.5 s before that [Hz]."""
    window = _between(data.time, unstable_at - GROWTH, unstable_at)
    forces = data.alpha_true[window]
    if forces.shape[0] < GROWTH * data.rate - 1 or not np.isfinite(forces).all():
        return None
    frequencies, power = spectrum(forces.T, data.rate, padding=8)
    return float(frequencies[int(np.argmax(power.sum(axis=0)))])
