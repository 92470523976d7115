"""A run as it is judged: its forces and commands in columns, and the windows that are judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
import math
from typing import Any, NamedTuple

from multicontact_control.arrays import find_true_stretches, Mask, Matrix, Vector
from multicontact_control.judging.oscillation import bridge_gaps
from multicontact_control.runs.recording import Missing, RunData
from multicontact_control.runs.scenario import Setup
import numpy as np

SETTLE_AFTER_STEP = 1.0  # s, the start of the window `rest` after the last force step
SETTLE_AFTER_START = 2.0  # s, the start of the window `moving` after the motion's start
SETTLE_AFTER_PUSH = 1.0  # s, left out of the quiet windows
LEAST_MOVING_SPEED = 1e-3  # m/s, from which on a commanded pose moves
# Of the time under load, for which a true force has to be known.
LEAST_TRUTH_SHARE = 0.9
ROUNDING_TIME = 1e-9  # s, by which the stamp of a sample may be off by rounding


class Windows(NamedTuple):
    """
    The stretches of a run that are judged, as masks of its samples, shape (m,).

    Rest and motion are judged apart: the noise of the force, and so its variance R, differs
    between them by two orders. Samples that were not recorded are in none of the windows. Their
    exact times are in `_find_scenario_windows` and `_find_commanded_windows`.
    """

    rest: Mask  # a force is asked for and has settled, and nothing moves
    moving: Mask  # a force is asked for, in motion
    loaded: Mask  # a force is asked for


class Push(NamedTuple):
    """
    A push of the simulated plant on the tool.

    It is judged by the largest error of the contacts' forces and by the time until they are back.
    """

    start: float  # s
    duration: float  # s


class RunSeries:
    """
    A run with the forces that it is judged by, the commands, and the windows.

    Columns are the r controlled coordinates: the normal force of each contact, followed by the
    couples of an edge or a plane. Rows are the m samples. A contact is judged by its true force
    where that is known for 0.9 of the time under load, else by the measured one.

    Parameters
    ----------
    data
        The recorded series.
    setup
        What the run was made with.
    missing
        The stretches that the recording lacks.

    """

    def __init__(
        self, data: RunData, setup: Setup, missing: Sequence[Missing] = ()
    ) -> None:
        self.data = data
        self.setup = setup
        self.missing = missing
        self.recorded = data.recorded()
        # For each column, the index of the normal force of its contact.
        self.leaders = list(setup.controller.leading_columns)
        # Where a recording breaks off; an answer that lasts until then is judged up to there.
        self.lost_from = math.inf  # s
        end = data.ticks / data.rate
        for stretch in missing:
            if stretch.end > end:
                self.lost_from = end
        self.motion_start = math.inf  # s
        self.motion_end = math.inf  # s
        motion = setup.scenario.reference.motion
        if motion:
            self.motion_start = motion.start_time
            self.motion_end = setup.reference().motion_end

    @cached_property
    def windows(self) -> Windows:
        """
        Return the judged stretches, as far as they were recorded.

        Of a scenario they are known from its times; of a run that obeys commands they follow from
        what was asked for.
        """
        if self.setup.commanded_by_topic:
            planned = self._find_commanded_windows()
        else:
            planned = self._find_scenario_windows()
        recorded = [window & self.recorded for window in planned]
        return Windows(*recorded)

    def _list_step_times(self) -> list[float]:
        """Return when the force steps of the scenario come [s], in their order."""
        return [step.time for step in self.setup.scenario.reference.force_steps]

    def _find_scenario_windows(self) -> Windows:
        """
        Return the windows that force steps and motion of the scenario set.

        `loaded` is from the first force step on, `rest` from 1 s after the last one before the
        motion until the motion starts, and `moving` from 2 s after that on.
        """
        steps = self._list_step_times()
        steps_at_rest = [step for step in steps if step < self.motion_start]
        rest_start = max(steps_at_rest, default=math.inf) + SETTLE_AFTER_STEP
        moving_start = self.motion_start + SETTLE_AFTER_START
        load_start = min(steps, default=math.inf)
        return Windows(
            rest=self.between(rest_start, self.motion_start),
            moving=self.between(moving_start, math.inf),
            loaded=self.between(load_start, math.inf),
        )

    def _find_commanded_windows(self) -> Windows:
        """
        Return the windows of a run that obeys commands.

        `loaded` is while a force is asked for, `moving` while in addition the pose asked for
        moves, and `rest` while neither pose nor command has changed for 1 s.
        """
        data = self.data
        command = np.nan_to_num(data.command)
        loaded = np.asarray((command > 0.0).any(axis=1))
        displacement = np.diff(data.position_des, axis=0, prepend=data.position_des[:1])
        moving = np.linalg.norm(displacement, axis=1) * data.rate > LEAST_MOVING_SPEED
        # The first command counts as a change.
        steps = np.diff(command, axis=0, prepend=np.nan)
        changed = (steps != 0.0).any(axis=1)
        samples = np.arange(data.ticks)
        last_change = np.maximum.accumulate(np.where(changed | moving, samples, 0))
        calm = samples - last_change >= SETTLE_AFTER_STEP * data.rate
        return Windows(rest=loaded & calm, moving=loaded & moving, loaded=loaded)

    @cached_property
    def quiet_windows(self) -> dict[str, Mask]:
        """
        Return the windows `rest` and `moving` without the pushes and 1 s after each.

        Evidence of noise and steady errors is taken from them; `windows` keep the pushes, as a
        user of the arm would feel them.
        """
        quiet = np.ones(self.data.ticks, dtype=bool)
        for push in self.pushes:
            settled = push.start + push.duration + SETTLE_AFTER_PUSH
            quiet &= ~self.between(push.start, settled)
        return {
            'rest': self.windows.rest & quiet,
            'moving': self.windows.moving & quiet,
        }

    @property
    def pushes(self) -> list[Push]:
        """
        Return the pushes of the simulated plant, in the order of its configuration.

        A run of the user's own robot has none that is known.
        """
        if not self.setup.simulated:
            return []
        plant = self.setup.plant
        return list(map(Push, plant.push_start, plant.push_duration))

    @cached_property
    def command(self) -> Matrix:
        """
        Return the forces asked for by the scenario or over topics, shape (m, r) [N].

        It jumps with each step, where the desired force alpha_des of the task may ramp up; errors
        are judged against it.
        """
        if self.setup.commanded_by_topic:
            return self.data.command
        return self.setup.commanded(self.data.time)

    @cached_property
    def has_truth(self) -> Mask:
        """
        Whether the true force is known for `LEAST_TRUTH_SHARE` of the time under load, shape (r,).

        Only a simulated plant knows it. With less, a statistic over the known part would be that
        of a chosen part of the run.
        """
        forces = enumerate(self.data.alpha_true.T)
        shares = [self.find_known_share(i, true) for i, true in forces]
        return np.array(shares) >= LEAST_TRUTH_SHARE

    @cached_property
    def force(self) -> Matrix:
        """
        Return the true forces where they are known, else those measured, shape (m, r) [N].

        A column is the one or the other throughout, as `has_truth` says, and never a mixture.
        """
        return np.where(self.has_truth, self.data.alpha_true, self.data.alpha_meas)

    def find_pressed(self, i: int) -> Mask:
        """
        Return the samples under load in which the contact of column i is to press, (m,).

        The normal force decides also for a couple, whose own command may be 0 while its contact is
        pressed.
        """
        return self.windows.loaded & (self.command[:, self.leaders[i]] > 0.0)

    def find_known_share(self, i: int, force: Vector) -> float:
        """
        Return for what share of the time under load, or else of the run, a force is known.

        `force` is a series of column i, shape (m,) [N]; gaps of at most 10 ms count as known.
        """
        known = np.isfinite(bridge_gaps(force, self.data.rate))
        pressed = self.find_pressed(i)
        if pressed.any():
            known = known[pressed]
        return float(known.mean())

    def list_without_truth(self) -> list[str]:
        """
        Return the names of the contacts whose true forces are not known.

        They are in the order of the columns, couples by their own names, as for
        `describe_unknown_truth`.
        """
        names = self.data.contact_names
        return [name for name, known in zip(names, self.has_truth) if not known]

    def between(self, start: float, end: float) -> Mask:
        """
        Return the samples from one time on, until before another [s], shape (m,).

        Times may be off by 1 ns: k times a period is not always the number that a file has for it.
        """
        time = self.data.time
        return (time >= start - ROUNDING_TIME) & (time < end - ROUNDING_TIME)

    def find_next_event(self, time: float) -> float:
        """
        Return when the next push, or force step or motion of the scenario, begins [s].

        It ends the time in which an answer can be judged; infinite after the last event. Commands
        over topics are not among them.
        """
        events = [push.start for push in self.pushes]
        if not self.setup.commanded_by_topic:
            events.append(self.motion_start)
            events += self._list_step_times()
        later = [event for event in events if event > time + ROUNDING_TIME]
        return min(later, default=math.inf)


def statistic_within(
    window: Mask, values: Any, statistic: Callable[[Any], Any] = np.mean
) -> float | None:
    """
    Return a statistic of what is known of a series within a window.

    `values` and `window` have one shape; `statistic` takes the known values, shape (k,), k > 0.
    The result is None where every value of the window is NaN, or the window is empty.
    """
    chosen = values[window]
    known = chosen[~np.isnan(chosen)]
    if not known.size:
        return None
    return float(statistic(known))


def _compute_rms(values: Vector) -> float:
    """Return the root mean square of values that are all known, shape (k,)."""
    return math.sqrt((values * values).mean())


def rms_within(window: Mask, values: Vector) -> float | None:
    """
    Return the root mean square of a series within a window; None if nothing is known.

    Window and series have shape (m,); samples that are NaN do not count, and the unit is that of
    the series.
    """
    return statistic_within(window, values, _compute_rms)


def find_long_stretches(mask: Mask, least: float) -> list[tuple[int, int]]:
    """
    Return first sample and end of every stretch of True of at least `least` samples.

    The end is the sample behind the last one, as of a slice. `least` need not be whole: it is
    often a time times the rate.
    """
    stretches = []
    for begin, end in find_true_stretches(mask):
        if end - begin >= least:
            stretches.append((begin, end))
    return stretches
