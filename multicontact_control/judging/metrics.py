"""What is read off a run: errors, answers to steps and pushes, losses, oscillation, torque."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import cached_property
import math
from typing import Any, NamedTuple

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import ForceConfig
from multicontact_control.judging import oscillation
from multicontact_control.runs.recording import LONGEST_GAP, Missing, RunData
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision.contacts import LOSS_TIME
import numpy as np
from scipy.optimize import brentq
from scipy.special import exprel

SETTLE_AFTER_STEP = 1.0  # s, the start of the window `rest` after the last force step
SETTLE_AFTER_START = 2.0  # s, the start of the window `moving` after the motion's start
SETTLE_AFTER_PUSH = 1.0  # s, left out of the quiet windows
MOVING = 1e-3  # m/s, from which on a commanded pose moves
LEAST_TRUTH = 0.9  # share of the time under load, that a true force is known for
NO_TRUTH = 'no ground truth'
ALL_OF_IT = 1.0 - 1e-6  # of a normal force, that presses at one end of its contact
# Settled: the error is within this share of the command, after a push, or of the step ...
BAND_OF_COMMAND = 0.05
BAND_OF_NOISE = (
    3.0  # ... or this many standard deviations of the error before, if that is more,
)
BAND_HELD = 0.1  # s, for this long
MEDIAN_TO_DEVIATION = (
    1.0484  # of the size of differences of normal white noise to its own
)
LOOK_BACK = 1.0  # s, before a push or a step, from which its noise is taken
LASTING = 0.5  # s; a push this long is to be controlled out while it lasts


class Windows(NamedTuple):
    """The stretches of a run that are judged: masks of samples, shape (m,)."""

    rest: Mask  # under the last force step
    moving: Mask
    loaded: Mask  # from the first force step on


class StepResponse(NamedTuple):
    """The answer of one contact to one commanded step."""

    time_s: float
    size_n: float
    rise_63_s: (
        float | None
    )  # from command to force beyond 63 % of the step; None: never
    overshoot_percent: float  # of the step
    # From command until the force stays within a band around the command; None: not in its time.
    settling_s: float | None
    # Mean of force less command from 1 s after the step on; None if it has no such time.
    steady_error_n: float | None


class RunMetrics:
    """A run with what is judged of it: forces, the task's commands, windows."""

    def __init__(
        self,
        data: RunData,
        setup: Setup,
        missing: Sequence[Missing] = (),
    ) -> None:
        self.data, self.setup = data, setup
        self.recorded = data.recorded()
        end = data.ticks / data.rate
        # A recording that lost its end has no say in what came of the last step.
        self.lost_from = end if any(each.end > end for each in missing) else math.inf
        self.leaders = list(
            setup.controller.leader_of
        )  # of each column the contact's force
        self.couples = [leader != i for i, leader in enumerate(self.leaders)]
        motion = setup.scenario.reference.motion
        self.motion_start = motion.start_time if motion else math.inf  # s

    @cached_property
    def windows(self) -> Windows:
        """Return the judged stretches, as far as they were recorded."""
        return Windows(*(window & self.recorded for window in self._planned_windows()))

    def _planned_windows(self) -> Windows:
        """
        Return the stretches that the scenario has, or the forces commanded over topics.

        Of the latter `loaded` is while a force is asked for, `moving` while the pose asked for
        moves, and `rest` what is 1 s away from that and from every change of a command.
        """
        data, start = self.data, self.motion_start
        if not self.setup.commanded_by_topic:
            steps = [step.time for step in self.setup.scenario.reference.force_steps]
            last_step = max((time for time in steps if time < start), default=math.inf)
            return Windows(
                rest=(data.time >= last_step + SETTLE_AFTER_STEP) & (data.time < start),
                moving=data.time >= start + SETTLE_AFTER_START,
                loaded=data.time >= min(steps, default=math.inf),
            )
        command = np.nan_to_num(data.command)
        loaded = np.asarray((command > 0.0).any(axis=1))
        change = np.diff(data.position_des, axis=0, prepend=data.position_des[:1])
        moving = np.linalg.norm(change, axis=1) * data.rate > MOVING
        changed = (np.diff(command, axis=0, prepend=np.nan) != 0.0).any(
            axis=1
        )  # at first, too
        places = np.arange(data.ticks)
        last = np.maximum.accumulate(np.where(changed | moving, places, 0))
        calm = places - last >= SETTLE_AFTER_STEP * data.rate
        return Windows(rest=loaded & calm, moving=loaded & moving, loaded=loaded)

    @cached_property
    def quiet(self) -> tuple[Mask, Mask]:
        """Return the windows `rest` and `moving` without the pushes and 1 s after each."""
        quiet = np.ones(self.data.ticks, dtype=bool)
        for start, duration in self.pushes:
            quiet &= ~self.between(start, start + duration + SETTLE_AFTER_PUSH)
        return self.windows.rest & quiet, self.windows.moving & quiet

    @property
    def pushes(self) -> list[tuple[float, float]]:
        """Return start and duration of each push of the simulated plant [s]."""
        return list(zip(self.setup.plant.push_start, self.setup.plant.push_duration))

    @cached_property
    def command(self) -> Matrix:
        """Return the forces asked for by the scenario or over topics, shape (m, r) [N]."""
        return (
            self.data.command
            if self.setup.commanded_by_topic
            else (self.setup.commanded(self.data.time))
        )

    @cached_property
    def pressing(self) -> Matrix:
        """Return the normal force asked for at a contact, for a couple at its own [N]."""
        return self.command[:, self.leaders]

    @cached_property
    def truth(self) -> Mask:
        """Return of which contacts the true force is known for 0.9 of the load."""
        return np.array(
            [
                self.known_share(i, self.data.alpha_true) >= LEAST_TRUTH
                for i in range(len(self.leaders))
            ],
            dtype=bool,
        )

    @cached_property
    def force(self) -> Matrix:
        """Return the true forces where they are known, else those measured, shape (m, r) [N]."""
        return np.where(self.truth, self.data.alpha_true, self.data.alpha_meas)

    @cached_property
    def error(self) -> Matrix:
        """Return the forces less the commands, shape (m, r) [N]."""
        error: Matrix = self.force - self.command
        return error

    def known_share(self, i: int, forces: Matrix) -> float:
        """Return for what share of the load, or else of the run, a force is known."""
        loaded = self.windows.loaded & (self.pressing[:, i] > 0.0)
        known = np.isfinite(oscillation.bridged(forces[:, i], self.data.rate))
        return float(known[loaded if loaded.any() else slice(None)].mean())

    def without_truth(self) -> list[str]:
        """Return the contacts whose true forces are not known."""
        return [
            name
            for name, known in zip(self.data.contact_names, self.truth)
            if not known
        ]

    def between(self, start: float, end: float) -> Mask:
        """Return the samples from one time to another [s]."""
        return (self.data.time >= start - 1e-9) & (self.data.time < end - 1e-9)

    def unknown(self, i: int) -> Mask:
        """Return where the force of a contact is not known for more than 0.1 s."""
        longest = LONGEST_GAP * self.data.rate
        unknown = np.zeros(self.data.ticks, dtype=bool)
        for begin, end in oscillation.find_true_stretches(np.isnan(self.force[:, i])):
            unknown[begin:end] = end - begin > longest
        return unknown

    def next_unknown(self, i: int, time: float) -> float:
        """Return from when after a time on a contact's force is not known [s], or infinity."""
        unknown = self.unknown(i) & (self.data.time > time)
        return (
            float(self.data.time[np.argmax(unknown)])
            if unknown.any()
            else self.lost_from
        )

    def next_event(self, time: float) -> float:
        """Return when the next push, or force step or motion of the scenario, begins [s]."""
        events = list(self.setup.plant.push_start) if self.setup.simulated else []
        if not self.setup.commanded_by_topic:
            events += [
                self.motion_start,
                *(step.time for step in self.setup.scenario.reference.force_steps),
            ]
        return min((event for event in events if event > time + 1e-9), default=math.inf)

    def step_responses(self, i: int) -> list[StepResponse]:
        """
        Return the answers of a contact to the steps at rest, until the next event each.

        An answer ends where the force is not known any more. One that is not known for 1 s before
        the next event tells nothing.
        """
        time, steps = self.data.time, self._steps(i)
        ends = [start for start, _, _ in steps[1:]] + [float(time[-1])]
        responses = []
        for (start, before, after), end in zip(steps, ends):
            until = min(end, self.next_event(start))
            known_until = self.next_unknown(i, start)
            if known_until < min(until, start + SETTLE_AFTER_STEP):
                continue
            window = (time >= start - 1e-9) & (time < min(until, known_until))
            travelled = (self.force[window, i] - before) / (
                (after - before) or math.nan
            )
            if not np.isfinite(travelled).any():
                continue
            beyond = np.flatnonzero(travelled > 0.63)
            responses.append(
                StepResponse(
                    start,
                    after - before,
                    float(time[window][beyond[0]] - start) if beyond.size else None,
                    100.0 * max(float(np.nanmax(travelled)) - 1.0, 0.0),
                    self._settling(i, window, after, abs(after - before)),
                    self._steady_error(i, window, after),
                )
            )
        return responses

    def _settling(
        self, i: int, window: Mask, command: float, size: float
    ) -> float | None:
        """Return after what time in the window of a step [N] a force stays near its command."""
        band = BAND_OF_COMMAND * size
        if not self.truth[i]:
            noise = self._sensor_noise(i, float(self.data.time[window][0]))
            band = max(band, BAND_OF_NOISE * noise)
        return self._time_until_within(self.force[window, i] - command, band)

    def _sensor_noise(self, i: int, time: float) -> float:
        """Return the standard deviation of a measured force's noise before a time [N]."""
        before = self.between(time - LOOK_BACK, time)
        changes = np.abs(np.diff(self.force[before, i]))
        # By the median of successive differences: a touch just before is no noise.
        known = changes[np.isfinite(changes)]
        return float(MEDIAN_TO_DEVIATION * np.median(known)) if known.size else 0.0

    def _steady_error(self, i: int, window: Mask, command: float) -> float | None:
        """Return the mean error of a force in a step's window, when it should have settled."""
        start = float(self.data.time[window][0])
        late = (
            window
            & self.between(start + SETTLE_AFTER_STEP, math.inf)
            & ~self.windows.moving
        )
        return value_in(late, self.force[:, i] - command)

    def _time_until_within(self, error: Vector, band: float) -> float | None:
        """Return from when on an error [N] stays within a band for 0.1 s [s], None if never."""
        least = round(BAND_HELD * self.data.rate)
        for begin, end in oscillation.find_true_stretches(np.abs(error) <= band):
            if end - begin >= least:
                return begin / self.data.rate
        return None

    def rise_over_design(self, i: int, step: StepResponse | None) -> float | None:
        """Return the rise of a contact's step over the designed one, if both are known."""
        config = self.setup.controller
        if step is None or step.rise_63_s is None or not config.robot.urdf:
            return None  # without a URDF it is a recording, which tells no gains
        if config.law_of(self.data.contact_names[self.leaders[i]]) != 'aob':
            return None
        return step.rise_63_s / designed_rise(config.force)

    def timed_steps(self, i: int) -> list[StepResponse]:
        """
        Return the answers of a contact whose rise is judged: to steps up.

        Of a run that obeys commands it is that to the largest: a slider makes steps as small as
        the noise.
        """
        steps = [step for step in self.step_responses(i) if step.size_n > 0.0]
        if self.setup.commanded_by_topic:
            steps = sorted(steps, key=lambda step: step.size_n)[-1:]
        return steps

    def largest_step(self, i: int) -> StepResponse | None:
        """Return the answer of a contact to its largest step up, None without any."""
        return max(
            self.step_responses(i), key=lambda response: response.size_n, default=None
        )

    def _steps(self, i: int) -> list[tuple[float, float, float]]:
        """Return when what force was asked of a contact at rest [s], from what to what [N]."""
        data = self.data
        if self.setup.commanded_by_topic:
            asked = np.nan_to_num(data.command[:, i])
            # From the preload, where a contact was made: until then nothing counts as asked for.
            desired = np.where(
                np.isnan(data.alpha_des[:, i]), asked, data.alpha_des[:, i]
            )
            changes = np.concatenate([[False], np.diff(asked) != 0.0, [False]])
            # What a desired force passes on its way is no step.
            places = np.flatnonzero(changes[1:-1] & ~changes[:-2] & ~changes[2:]) + 1
            known = self.recorded[places - 1] & self.recorded[places]
            return [
                (float(data.time[k]), float(desired[k - 1]), float(asked[k]))
                for k in places[known]
                if k < 2 or desired[k - 1] == desired[k - 2]
            ]
        reference, name = self.setup.scenario.reference, data.contact_names[i]
        steps = [
            (step.time, step.forces[name])
            for step in reference.force_steps
            if name in step.forces and step.time < min(self.motion_start, data.time[-1])
        ]
        before = [
            0.0 if self.couples[i] else reference.approach.preload,
            *(force for _, force in steps),
        ]
        return [(time, was, force) for was, (time, force) in zip(before, steps)]

    def losses(self, i: int, judged: Mask) -> list[tuple[int, int]]:
        """
        Return the first sample of every loss of a contact, and that after its last.

        A loss is a force of 0 N for `LOSS_TIME`, among the samples `judged`. A couple is lost
        while it is as large as the normal force of its contact: one end of an edge, or one side
        of a plane, has left the surface.
        """
        force = oscillation.bridged(self.force[:, self.leaders[i]], self.data.rate)
        gone = force <= 0.0
        if self.couples[i]:
            couple = oscillation.bridged(self.force[:, i], self.data.rate)
            # The loss of the whole contact is that of the normal force.
            gone = ~gone & (np.abs(couple) >= ALL_OF_IT * force)
        least = LOSS_TIME * self.data.rate - 1e-9
        return [
            (begin, end)
            for begin, end in oscillation.find_true_stretches(judged & gone)
            if end - begin >= least
        ]

    def lost_share(self, i: int, window: Mask) -> float | None:
        """Return in what share of a window a contact's force was 0 N; None for a couple."""
        force = self.force[:, i]
        return (
            None
            if self.couples[i]
            else value_in(window & np.isfinite(force), force <= 0.0)
        )

    def oscillations(self, i: int, judged: Mask) -> list[oscillation.Oscillation]:
        """Return where the force of a contact oscillates, among the samples `judged`."""
        # A couple, which may well be 0, is judged while its contact is pressed, and by how hard.
        found = []
        for begin, end in oscillation.find_true_stretches(~self.unknown(i)):
            between = np.zeros(self.data.ticks, dtype=bool)
            between[begin:end] = True
            found += oscillation.oscillations(
                self.error[:, i], self.pressing[:, i], judged & between, self.data.rate
            )
        return found

    def contact_summary(self, i: int) -> dict[str, Any]:
        """Return the numbers of one contact; of the steps those of the largest one up."""
        judged, asked = self.windows, ~(self.pressing[:, i] == 0.0)
        largest = self.largest_step(i)
        return {
            'step_rise_63_s': largest.rise_63_s if largest else None,
            'step_rise_over_design': self.rise_over_design(i, largest),
            'step_overshoot_percent': largest.overshoot_percent if largest else None,
            'step_settling_s': largest.settling_s if largest else None,
            'step_steady_error_n': largest.steady_error_n if largest else None,
            **self._losses_summary(i),
            'steps': [response._asdict() for response in self.step_responses(i)],
            **{
                name: self._window_summary(i, window & asked)
                for name, window in (('rest', judged.rest), ('moving', judged.moving))
            },
        }

    def _losses_summary(self, i: int) -> dict[str, int | None]:
        """Return how often the force of a contact was 0 N under load, true or measured."""
        count = None
        if not self.couples[i]:
            count = len(
                self.losses(i, self.windows.loaded & (self.pressing[:, i] > 0.0))
            )
        return {
            'true_losses': count if self.truth[i] else None,
            'measured_losses': None if self.truth[i] else count,
        }

    def _window_summary(self, i: int, window: Mask) -> dict[str, float | None]:
        error, known = rms_in(window, self.error[:, i]), self.truth[i]
        return {
            'true_error_rms_n': error if known else None,
            'estimate_error_rms_n': rms_in(
                window, self.data.alpha_est[:, i] - self.force[:, i]
            )
            if known
            else None,
            'measured_error_rms_n': None if known else error,
            'noise_variance_median_n2': value_in(
                window, self.data.noise_variance[:, i], np.median
            ),
            'contact_loss_fraction': self.lost_share(i, window),
        }

    def motion_summary(self) -> dict[str, float | None]:
        """
        Return how well the commanded motion was followed: position in `moving`, turn under load.

        The position error counts along the directions that no contact constrains, by the normals
        of simulated surfaces, or those of the controller.
        """
        data, judged, config = self.data, self.windows, self.setup.controller
        if not (
            judged.loaded.any() and config.robot.urdf
        ):  # a recording tells no normals
            return dict.fromkeys(
                ('position_rms_m', 'moving_position_rms_m', 'orientation_max_rad')
            )
        plant = self.setup.plant
        normals = np.array(
            [
                each.normal_world
                for each in (
                    (plant.surfaces[name] for name in plant.touched)
                    if self.setup.simulated
                    else (config.contacts[name] for name in config.contact_names)
                )
            ]
        )
        free = np.eye(3) - np.linalg.pinv(normals) @ normals
        error = np.linalg.norm((data.position - data.position_des) @ free, axis=1)
        cosine = np.abs((data.quaternion * data.quaternion_des).sum(axis=1))
        return {
            'position_rms_m': rms_in(judged.loaded, error),
            'moving_position_rms_m': rms_in(judged.moving, error),
            'orientation_max_rad': value_in(
                judged.loaded, 2.0 * np.arccos(np.minimum(cosine, 1.0)), np.max
            ),
        }

    @cached_property
    def least_torque_limit(self) -> Vector:
        """Return the smaller of controller's and drives' limits, shape (n,) [N m], or inf."""
        drives = self.setup.plant.torque_limit if self.setup.simulated else math.inf
        return np.minimum(torque_limit(self.setup), drives)

    def torque_summary(self) -> dict[str, float | None]:
        """Return how much of the torque limits was used, None without any."""
        fraction: Matrix = np.abs(self.data.torque) / self.least_torque_limit
        return {
            'max_fraction_of_limit': value_in(
                np.isfinite(fraction) & np.isfinite(self.least_torque_limit),
                fraction,
                np.max,
            )
        }

    def recoveries(self, i: int, unstable_at: float | None) -> list[dict[str, Any]]:
        """
        Return the answers of one contact to the pushes of the plant.

        Each has `duration` of the push [s], whether it comes `moving`, and until the next event
        `peak`, the largest error of the force [N], and `recovery`, the time from its end, or from
        the start of a lasting push, until the error stays within a band for 0.1 s [s]; None if it
        did not, or the run was unstable by then.
        """
        last = float(self.data.time[-1])
        error, command = self.error[:, i], self.command[:, i]
        answers = []
        for start, duration in self.pushes:
            lasting = duration >= LASTING
            from_time = start if lasting else start + duration
            until = min(
                self.next_event(start),
                last + 1.0 / self.data.rate,
                start + duration if lasting else math.inf,
            )
            before = self.between(start - LOOK_BACK, start)
            judged = self.between(from_time, until)
            if not (before.any() and judged.any()):
                continue
            if self.next_unknown(i, start - LOOK_BACK) < until:
                continue
            band = max(
                BAND_OF_COMMAND * float(command[judged][0]),
                BAND_OF_NOISE * float(np.std(error[before])),
            )
            settled = self._time_until_within(error[judged], band)
            # The end of a run that ended before its time takes no recovery back.
            lost = unstable_at is not None and unstable_at < min(until, last)
            answers.append(
                {
                    'duration': duration,
                    'moving': start >= self.motion_start,
                    'peak': float(np.nanmax(np.abs(error[self.between(start, until)]))),
                    'recovery': None if lost else settled,
                }
            )
        return answers


def truth_lacking(without: Sequence[str], names: Collection[str]) -> str:
    """Return in words that of these of all contacts no true force is known; '' if of all."""
    if names and not without:
        return ''
    return NO_TRUTH + (f' of {", ".join(without)}' if len(without) < len(names) else '')


def designed_rise(force: ForceConfig) -> float:
    """
    Return the time in which the designed loop reaches 63 % of a step of the true force [s].

    T_d of the input plus the time at which the response of the two poles reaches 1 - 1/e.
    """
    excess = 1.0 - force.second_pole_ratio

    def missing(t: float) -> float:
        return float(math.exp(-t) * (1.0 + t * exprel(excess * t)) - math.exp(-1.0))

    return float(force.input_delay + force.time_constant * brentq(missing, 0.0, 10.0))


def torque_limit(setup: Setup) -> Vector:
    """Return the controller's limits, shape (n,) [N m], infinite where there is none."""
    config = setup.controller
    return np.array(config.torque_limit or [math.inf] * len(config.robot.joint_names))


def value_in(
    window: Mask,
    values: Any,
    statistic: Callable[[Any], Any] = np.mean,
) -> float | None:
    """Return a statistic of a series within a window, None where nothing is known of it."""
    chosen = values[window]
    known = chosen[~np.isnan(chosen)]
    return float(statistic(known)) if known.size else None


def rms_in(window: Mask, values: Vector) -> float | None:
    """Return the root mean square of a series within a window."""
    return value_in(window, values, lambda known: math.sqrt((known * known).mean()))
