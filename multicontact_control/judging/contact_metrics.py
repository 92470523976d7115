"""What is read off the force of one contact: answers to steps and pushes, losses, oscillation."""

from __future__ import annotations

from functools import cached_property
import math
from typing import Any, NamedTuple

from multicontact_control.arrays import find_true_stretches, Mask, Vector
from multicontact_control.config import ForceConfig
from multicontact_control.judging.oscillation import (
    bridge_gaps,
    find_oscillations,
    Oscillation,
)
from multicontact_control.judging.run_series import (
    find_long_stretches,
    Push,
    rms_within,
    RunSeries,
    SETTLE_AFTER_STEP,
    statistic_within,
)
from multicontact_control.runs.recording import LONGEST_GAP
from multicontact_control.supervision.contacts import LOSS_TIME
import numpy as np
from scipy.optimize import brentq
from scipy.special import exprel

RISE_SHARE = 0.63  # of a step, at which its rise time is taken: about 1 - 1/e
# Share of the normal force from which on a couple means that one end presses alone.
SHARE_AT_ONE_END = 1.0 - 1e-6
# A force has settled once its error stays within the larger of two bands: this share of the step,
# or after a push of the command; and this many standard deviations of the error before.
BAND_OF_COMMAND = 0.05
BAND_OF_NOISE = 3.0
BAND_HELD = 0.1  # s, for which the error stays within
# Standard deviation of normal white noise over the median size of its successive differences.
MEDIAN_TO_DEVIATION = 1.0484
LOOK_BACK = 1.0  # s, before a push or a step, from which its noise is taken
LASTING_PUSH = 0.5  # s; a push this long is to be controlled out while it lasts
# Of a contact's part of the summary: what may not be known, in the order of the file.
SUMMARY_KEYS = (
    'step_rise_63_s',
    'step_rise_over_design',
    'step_overshoot_percent',
    'step_settling_s',
    'step_steady_error_n',
    'true_losses',
    'measured_losses',
)
ERROR_KEYS = ('true_error_rms_n', 'estimate_error_rms_n', 'measured_error_rms_n')


class CommandedStep(NamedTuple):
    """
    A step of the force that is asked of a contact at rest.

    Steps during a motion are none: what they are answered with cannot be told from roughness and
    friction.
    """

    time: float  # s
    before: float  # N
    after: float  # N


class StepResponse(NamedTuple):
    """The answer of one contact to one commanded step; the fields are keys of the summary."""

    time_s: float
    size_n: float
    # From the command until the force is beyond 63 % of the step; None if it never is.
    rise_63_s: float | None
    overshoot_percent: float  # of the step
    # From the command until the force stays within a band around it; None: not in its time.
    settling_s: float | None
    # Mean of force less command from 1 s after the step on; None if it has no such time.
    steady_error_n: float | None


class ContactMetrics:
    """
    The metrics of one controlled coordinate: the normal force of a contact, or a couple.

    Parameters
    ----------
    run
        The run that it is a part of.
    column
        Index of the coordinate among the r columns of the run.

    """

    def __init__(self, run: RunSeries, column: int) -> None:
        leader = run.leaders[column]
        self.run = run
        self.column = column
        self.name = run.data.contact_names[column]
        self.is_couple = leader != column
        self.has_truth = bool(run.has_truth[column])
        self.force = run.force[:, column]  # judged one, shape (m,) [N]
        self.command = run.command[:, column]  # shape (m,) [N]
        self.error: Vector = self.force - self.command
        self.noise_variance = run.data.noise_variance[:, column]  # R, shape (m,) [N^2]
        # Of the contact, whose couples are judged while it is pressed, and by how hard.
        self.normal_force = run.force[:, leader]
        self.normal_command = run.command[:, leader]
        self.pressed = run.find_pressed(column)  # samples under load, shape (m,)

    @property
    def asked_windows(self) -> dict[str, Mask]:
        """
        Return the windows `rest` and `moving` as far as the contact is to press.

        A contact that is not commanded in a part of the run has no error to be judged by there; of
        a couple its normal force decides.
        """
        windows = self.run.windows
        asked = self.normal_command != 0.0
        return {'rest': windows.rest & asked, 'moving': windows.moving & asked}

    @cached_property
    def unknown(self) -> Mask:
        """
        Where the force is not known for more than 0.1 s, shape (m,).

        Shorter gaps are late or lost messages, which every recording has.
        """
        data = self.run.data
        unknown = np.zeros(data.ticks, dtype=bool)
        for begin, end in find_true_stretches(np.isnan(self.force)):
            unknown[begin:end] = end - begin > LONGEST_GAP * data.rate
        return unknown

    def _find_next_unknown(self, time: float) -> float:
        """Return from when after a time on the force is not known [s], or infinity."""
        unknown = self.unknown & (self.run.data.time > time)
        if not unknown.any():
            return self.run.lost_from
        return float(self.run.data.time[np.argmax(unknown)])

    @cached_property
    def step_responses(self) -> list[StepResponse]:
        """
        Return the answers to the steps at rest, each until the next event.

        An answer ends where the force is not known any more. One that is not known for 1 s before
        the next event tells nothing, and is left out.
        """
        if self.run.setup.commanded_by_topic:
            steps = self._list_topic_steps()
        else:
            steps = self._list_scenario_steps()
        ends = [step.time for step in steps[1:]]
        ends.append(float(self.run.data.time[-1]))
        responses = []
        for step, end in zip(steps, ends):
            until = min(end, self.run.find_next_event(step.time))
            known_until = self._find_next_unknown(step.time)
            if known_until < min(until, step.time + SETTLE_AFTER_STEP):
                continue
            window = self.run.between(step.time, min(until, known_until))
            if step.after != step.before and np.isfinite(self.force[window]).any():
                responses.append(self._measure_response(step, window))
        return responses

    def _measure_response(self, step: CommandedStep, window: Mask) -> StepResponse:
        """Return the answer to a step from what is known of the force in its window."""
        size = step.after - step.before
        travelled = (self.force[window] - step.before) / size
        risen = travelled > RISE_SHARE
        rise = None
        if risen.any():
            rise = float(self.run.data.time[window][np.argmax(risen)] - step.time)
        late = window & self.run.between(step.time + SETTLE_AFTER_STEP, math.inf)
        still = late & ~self.run.windows.moving
        return StepResponse(
            time_s=step.time,
            size_n=size,
            rise_63_s=rise,
            overshoot_percent=100.0 * max(float(np.nanmax(travelled)) - 1.0, 0.0),
            settling_s=self._find_settling_time(step, window),
            steady_error_n=statistic_within(still, self.force - step.after),
        )

    def _find_settling_time(self, step: CommandedStep, window: Mask) -> float | None:
        """Return after what time in a step's window the force stays near its command [s]."""
        band = BAND_OF_COMMAND * abs(step.after - step.before)
        if not self.has_truth:
            noise = self._find_sensor_noise(step.time)
            band = max(band, BAND_OF_NOISE * noise)
        return self._find_time_within(self.force[window] - step.after, band)

    def _find_sensor_noise(self, time: float) -> float:
        """Return the standard deviation of the force's noise in the second before a time [N]."""
        before = self.run.between(time - LOOK_BACK, time)
        # By the median of successive differences: a touch just before is no noise.
        changes = np.abs(np.diff(self.force[before]))
        known = changes[np.isfinite(changes)]
        if not known.size:
            return 0.0
        return float(MEDIAN_TO_DEVIATION * np.median(known))

    def _find_time_within(self, error: Vector, band: float) -> float | None:
        """Return from when on an error [N] stays within a band for 0.1 s [s], None if never."""
        rate = self.run.data.rate
        held = find_long_stretches(np.abs(error) <= band, round(BAND_HELD * rate))
        if not held:
            return None
        first, _ = held[0]
        return first / rate

    def rise_over_design(self, step: StepResponse) -> float | None:
        """
        Return the rise time of a step over the designed one.

        None if it never rose, if the contact has another law than the active observer, and of a
        recording (without a URDF), which tells no gains.
        """
        config = self.run.setup.controller
        if step.rise_63_s is None or not config.robot.urdf:
            return None
        contact = self.run.data.contact_names[self.run.leaders[self.column]]
        if config.force_law_of(contact) != 'aob':
            return None
        return step.rise_63_s / designed_rise(config.force)

    @property
    def timed_steps(self) -> list[StepResponse]:
        """
        Return the answers whose rise is judged: those to steps up.

        Of a run that obeys commands it is that to the largest: a slider makes steps as small as
        the noise.
        """
        steps_up = [step for step in self.step_responses if step.size_n > 0.0]
        if not self.run.setup.commanded_by_topic:
            return steps_up
        return sorted(steps_up, key=_step_size)[-1:]

    @property
    def largest_step(self) -> StepResponse | None:
        """
        Return the answer to the largest step up, None without any step.

        It is the one that the summary's numbers are of: the noise counts least in it.
        """
        return max(self.step_responses, key=_step_size, default=None)

    def _list_topic_steps(self) -> list[CommandedStep]:
        """Return the commands over topics that found the desired force at rest."""
        data = self.run.data
        asked = np.nan_to_num(data.command[:, self.column])
        desired = data.alpha_des[:, self.column]
        # From the preload, where a contact was made: until then nothing counts as asked for.
        desired = np.where(np.isnan(desired), asked, desired)
        changes = np.concatenate([[False], np.diff(asked) != 0.0, [False]])
        # What a desired force passes on its way is no step.
        single = changes[1:-1] & ~changes[:-2] & ~changes[2:]
        steps = []
        for k in np.flatnonzero(single) + 1:
            known = self.run.recorded[k - 1] and self.run.recorded[k]
            at_rest = k < 2 or desired[k - 1] == desired[k - 2]
            if known and at_rest:
                before = float(desired[k - 1])
                after = float(asked[k])
                steps.append(CommandedStep(float(data.time[k]), before, after))
        return steps

    def _list_scenario_steps(self) -> list[CommandedStep]:
        """Return the steps of the scenario that come before its motion; the first from preload."""
        reference = self.run.setup.scenario.reference
        rest_end = min(self.run.motion_start, self.run.data.time[-1])
        before = 0.0 if self.is_couple else reference.approach.preload
        steps = []
        for step in reference.force_steps:
            if self.name in step.forces and step.time < rest_end:
                after = step.forces[self.name]
                steps.append(CommandedStep(step.time, before, after))
                before = after
        return steps

    @cached_property
    def losses(self) -> list[tuple[int, int]]:
        """
        First sample, and that after the last, of every loss of the contact under load.

        A loss is a force of 0 N for `LOSS_TIME`. A couple is lost while it is as large as the
        normal force of its contact: one end of an edge, or one side of a plane, has left the
        surface; the loss of the whole contact is that of the normal force.
        """
        rate = self.run.data.rate
        normal_force = bridge_gaps(self.normal_force, rate)
        lost = normal_force <= 0.0
        if self.is_couple:
            couple = np.abs(bridge_gaps(self.force, rate))
            lost = ~lost & (couple >= SHARE_AT_ONE_END * normal_force)
        return find_long_stretches(self.pressed & lost, LOSS_TIME * rate - 1e-9)

    def find_lost_share(self, window: Mask) -> float | None:
        """
        Return in what share of a window the force was 0 N; None for a couple.

        Samples of unknown force do not count; None also where all of them are.
        """
        if self.is_couple:
            return None
        return statistic_within(window & np.isfinite(self.force), self.force <= 0.0)

    @cached_property
    def oscillations(self) -> list[Oscillation]:
        """Where the force oscillates under load, in each stretch in which it is known."""
        found = []
        for begin, end in find_true_stretches(~self.unknown):
            judged = np.zeros(self.run.data.ticks, dtype=bool)
            judged[begin:end] = self.pressed[begin:end]
            found += find_oscillations(
                self.error, self.normal_command, judged, self.run.data.rate
            )
        return found

    def summarise(self) -> dict[str, Any]:
        """Return the contact's part of ``summary.json``; its step is the largest one up."""
        summary: dict[str, Any] = dict.fromkeys(SUMMARY_KEYS)
        summary['steps'] = [response._asdict() for response in self.step_responses]
        if not self.is_couple:
            key = 'true_losses' if self.has_truth else 'measured_losses'
            summary[key] = len(self.losses)
        for name, window in self.asked_windows.items():
            summary[name] = self._summarise_window(window)
        largest = self.largest_step
        if largest is not None:
            summary |= {
                'step_rise_63_s': largest.rise_63_s,
                'step_rise_over_design': self.rise_over_design(largest),
                'step_overshoot_percent': largest.overshoot_percent,
                'step_settling_s': largest.settling_s,
                'step_steady_error_n': largest.steady_error_n,
            }
        return summary

    def _summarise_window(self, window: Mask) -> dict[str, float | None]:
        error = rms_within(window, self.error)
        median_variance = statistic_within(window, self.noise_variance, np.median)
        summary: dict[str, float | None] = dict.fromkeys(ERROR_KEYS)
        summary['noise_variance_median_n2'] = median_variance
        summary['contact_loss_fraction'] = self.find_lost_share(window)
        if self.has_truth:
            estimate_error = self.run.data.alpha_est[:, self.column] - self.force
            summary['true_error_rms_n'] = error
            summary['estimate_error_rms_n'] = rms_within(window, estimate_error)
        else:
            summary['measured_error_rms_n'] = error
        return summary

    def measure_recoveries(self, unstable_at: float | None) -> list[dict[str, Any]]:
        """
        Return the answers to the pushes of the plant.

        Parameters
        ----------
        unstable_at
            When the run passed a limit [s]; None if it did not.

        Returns
        -------
        list
            Of each push whose answer is known `duration` [s]; `moving`, whether it comes in
            motion; `peak`, the largest error of the force until the next event [N]; and
            `recovery`, the time from the end of the push, or from the start of a lasting one,
            until the error stays within a band for 0.1 s [s]. `recovery` is None if the error did
            not, or the run was unstable by then.

        """
        answers = []
        for push in self.run.pushes:
            answer = self._measure_recovery(push, unstable_at)
            if answer is not None:
                answers.append(answer)
        return answers

    def _measure_recovery(
        self, push: Push, unstable_at: float | None
    ) -> dict[str, Any] | None:
        """Return the answer to one push, None if too little of it is known."""
        run = self.run
        last = float(run.data.time[-1])
        push_end = push.start + push.duration
        until = min(run.find_next_event(push.start), last + 1.0 / run.data.rate)
        if push.duration >= LASTING_PUSH:
            until = min(until, push_end)
            judged = run.between(push.start, until)
        else:
            judged = run.between(push_end, until)
        before = run.between(push.start - LOOK_BACK, push.start)
        if not (before.any() and judged.any()):
            return None
        if self._find_next_unknown(push.start - LOOK_BACK) < until:
            return None
        # The end of a run that ended before its time takes no recovery back.
        recovery = None
        if unstable_at is None or unstable_at >= min(until, last):
            band_of_command = BAND_OF_COMMAND * float(self.command[judged][0])
            band_of_noise = BAND_OF_NOISE * float(np.std(self.error[before]))
            band = max(band_of_command, band_of_noise)
            recovery = self._find_time_within(self.error[judged], band)
        answer = self.error[run.between(push.start, until)]
        return {
            'duration': push.duration,
            'moving': push.start >= run.motion_start,
            'peak': float(np.nanmax(np.abs(answer))),
            'recovery': recovery,
        }


def _step_size(response: StepResponse) -> float:
    return response.size_n


def designed_rise(force: ForceConfig) -> float:
    """
    Return the time in which the designed loop reaches 63 % of a step of the true force [s].

    It is T_d of the input plus the time at which the response of the loop's two poles, 1 / tau and
    `second_pole_ratio` / tau, reaches 1 - 1/e.
    """
    excess = 1.0 - force.second_pole_ratio

    def distance_left(t: float) -> float:
        return float(math.exp(-t) * (1.0 + t * exprel(excess * t)) - math.exp(-1.0))

    rise = brentq(distance_left, 0.0, 10.0)
    return float(force.input_delay + force.time_constant * rise)
