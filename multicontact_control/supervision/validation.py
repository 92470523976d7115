"""Which inputs can be believed: ages, names, shapes, numbers, repetitions, jumps."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.records import (
    AXIS_READING,
    JOINT_READING,
    READING_MEMORY,
    READING_SETTINGS,
    Records,
    VARIANCE_READING,
)
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
from multicontact_control.supervision.readings import (
    check_readings,
    FINE,
    FROZEN,
    IMPLAUSIBLE,
    INVALID,
    JUMP,
    SATURATED,
    VERDICTS,
)
import numpy as np

__all__ = [
    'JointInput', 'TickInputs', 'ValidatedInputs', 'VarianceInput', 'Watchdog', 'WrenchInput']

FLOAT = np.dtype(float)
PROBLEMS = {INVALID: 'invalid', IMPLAUSIBLE: 'implausible', JUMP: 'jump', FROZEN: 'frozen',
            SATURATED: 'saturated'}
LATEST = 1e12  # s, of a time that makes sense
INPUTS = ('joints', 'wrench', 'variance')


class ValidatedInputs(NamedTuple):
    """
    The inputs of one tick as far as they are believed.

    Attributes
    ----------
    q, qd, wrench
        The newest that were believed, None if there never were any. These arrays and R may be
        overwritten by the next tick.
    variance
        R, inflated if it is not renewed, shape (r,) [N^2].
    causes
        What calls for a reaction.
    rejected
        What was wrong with readings in this tick, whether it calls for a reaction yet or not.
    repeated
        Whether this is the tick before once more.
    blind
        Whether the joint state is not that of this tick or the one before.

    """

    q: Vector | None
    qd: Vector | None
    wrench: Vector | None
    variance: Vector
    causes: tuple[str, ...]
    rejected: tuple[str, ...]
    repeated: bool = False
    blind: bool = False


def copy_numbers(values: Any, buffer: Vector) -> bool:
    """Copy values, whatever they are; return whether they are as many numbers as the buffer."""
    if type(values) is np.ndarray and values.dtype is FLOAT and values.shape == buffer.shape:
        buffer[:] = values
        return True
    try:
        vector = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return False
    if vector.shape != buffer.shape:
        return False
    buffer[:] = vector
    return True


def finite_number(value: Any) -> float | None:
    """Return a finite number, None if it is not one."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


class Watchdog:
    """
    Judges the inputs of every tick.

    A reading that is not believed counts as not received: the last believed one is used until it
    is older than its limit. So a sample that is lost or damaged is bridged, and two in a row
    call for a reaction. Stamps, names and sizes are looked at here, the numbers in `readings`,
    compiled.

    Parameters
    ----------
    config
        Names, limits, ages.

    """

    def __init__(self, config: ControllerConfig) -> None:
        self._config, self._watch = config, config.watchdog
        self._period = config.period
        self._names = list(config.robot.joint_names)
        watch, n, r = config.watchdog, len(self._names), len(config.contact_names)
        self._settings = reading_settings(config)
        self._joints: Any = np.zeros(n, dtype=JOINT_READING)
        self._joints['speed_limit'] = config.limits.joint_speed or np.inf
        self._axes: Any = np.zeros(6, dtype=AXIS_READING)
        self._axes['full_scale'] = 0.999 * np.array(watch.wrench_full_scale or np.inf)
        self._variances: Any = np.zeros(r, dtype=VARIANCE_READING)
        self._memory: Any = np.zeros(1, dtype=READING_MEMORY)
        self._band = config.period / watch.rate_band, config.period * watch.rate_band
        slack = 1e-3 * config.period
        self._limits = (
            ('joints', watch.joint_max_age + slack), ('wrench', watch.wrench_max_age + slack),
            ('variance', watch.variance_max_age + slack))
        self._in_order = list(range(n))
        self._new_q: Vector = self._joints['q']
        self._new_qd: Vector = self._joints['qd']
        self._valid_q: Vector = self._joints['valid_q']
        self._valid_qd: Vector = self._joints['valid_qd']
        self._new_wrench: Vector = self._axes['new']
        self._valid_wrench: Vector = self._axes['valid']
        self._new_variance: Vector = self._variances['new']
        self._valid_variance: Vector = self._variances['valid']
        self._fresh_readings = [
            self._memory[f'{name}_fresh'] for name in ('joints', 'wrench', 'variance')]
        self._elapsed: Vector = self._memory['elapsed']
        for fresh in self._fresh_readings:
            fresh[:] = True
        self._check()  # no tick is to wait for numba
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next tick is the first."""
        self._time: float | None = None
        self._odd_periods = self._same_times = self._blind_ticks = 0
        self._q: Vector | None = None
        self._qd: Vector | None = None
        self._wrench: Vector | None = None
        self._valid_variance[:] = min(
            self._config.initial_noise_variance, self._watch.variance_ceiling)
        self._inflation = 1.0
        self._stamps: dict[str, float | None] = {'joints': None, 'wrench': None, 'variance': None}
        self._seen: dict[str, float | None] = dict(self._stamps)
        self._memory[:] = np.zeros(1, dtype=READING_MEMORY)

    def validate(self, inputs: TickInputs) -> ValidatedInputs:
        """Take in what is known at a tick and say what of it is believed."""
        causes: list[str] = []
        time = self._judge_time(inputs.time, causes)
        if time is None and (self._same_times >= 2 or self._has_new(inputs)):
            causes.append('clock_frozen')
            time = self._time
        if time is None:
            return ValidatedInputs(
                self._q, self._qd, self._wrench, self._used_variance(), (), (), True)
        problems = self._judge_readings(inputs, time)
        stamps = self._stamps
        for key, limit in self._limits:
            stamp = stamps[key]
            if (stamp is None and key != 'variance') or (
                    stamp is not None and time - stamp > limit):
                causes.append(f"{key}_{problems.get(key, 'stale')}")
                if key == 'variance':
                    self._inflation *= self._watch.variance_growth
        rejected = tuple(f'{key}_{problems[key]}' for key in INPUTS if key in problems) if (
            problems) else ()
        return ValidatedInputs(
            self._q, self._qd, self._wrench, self._used_variance(), tuple(causes), rejected, False,
            self._blind_ticks > 1)

    def _has_new(self, inputs: TickInputs) -> bool:
        """Return whether a joint state has another stamp than the one before."""
        return inputs.joints is not None and (
            finite_number(inputs.joints.stamp) != self._seen['joints'])

    def _used_variance(self) -> Vector:
        if self._inflation == 1.0:
            return self._valid_variance
        used: Vector = np.minimum(
            self._valid_variance * self._inflation, self._watch.variance_ceiling)
        self._inflation = min(self._inflation, 1e12)
        return used

    def _judge_time(self, value: Any, causes: list[str]) -> float | None:
        """Return the time of this tick; None if it is that of the tick before."""
        h, before = self._period, self._time
        time = value if type(value) is float else finite_number(value)
        if time is None or not abs(time) <= LATEST:
            causes.append('clock_invalid')
            time = 0.0 if before is None else before + h
            self._time = time
            return time
        self._time = time
        if before is None:
            return time
        step = time - before
        self._same_times = self._same_times + 1 if step == 0.0 else 0
        if step == 0.0:
            return None
        if step < 0.0:
            causes.append('clock_backwards')
            self._stamps = dict.fromkeys(self._stamps)
            self._seen = dict.fromkeys(self._seen)
            self._odd_periods = 0
            return time
        odd = not self._band[0] <= step <= self._band[1]
        self._odd_periods = self._odd_periods + 1 if odd else 0
        if self._odd_periods >= 2:
            causes.append('clock_rate')
        return time

    def _fresh(self, key: str, stamp: Any, time: float, problems: dict[str, str]) -> float | None:
        """Return the stamp of a reading that is new and in order, None otherwise."""
        number = stamp if type(stamp) is float else finite_number(stamp)
        if number is None or not -math.inf < number <= time + 0.5 * self._period:
            problems[key] = 'stamp'
            return None
        before = self._seen[key]
        if before is not None and number <= before:
            if number < before:
                problems[key] = 'order'
            return None
        self._seen[key] = number
        return number

    def _take_joints(
        self, reading: JointInput | None, time: float, problems: dict[str, str],
    ) -> float | None:
        """Return the stamp of a joint state whose numbers are in place now, None otherwise."""
        if reading is None:
            return None
        stamp = self._fresh('joints', reading.stamp, time, problems)
        if stamp is None:
            return None
        q, qd = self._new_q, self._new_qd
        complete = copy_numbers(reading.q, q) and copy_numbers(reading.qd, qd)
        if reading.names is not None:
            order = self._order_of(reading.names)
            if order is None:
                problems['joints'] = 'names'
                return None
            if complete and order != self._in_order:
                q[:], qd[:] = q[order], qd[order]
        if not complete:
            problems['joints'] = 'invalid'
            return None
        return stamp

    def _take_numbers(
        self, key: str, stamp: Any, values: Any, buffer: Vector, time: float,
        problems: dict[str, str],
    ) -> float | None:
        """Return the stamp of a reading whose numbers are in place now, None otherwise."""
        fresh = self._fresh(key, stamp, time, problems)
        if fresh is not None and not copy_numbers(values, buffer):
            problems[key] = 'invalid'
            return None
        return fresh

    def _order_of(self, names: Any) -> list[int] | None:
        """Return where each joint is among names, None if these are not the joints' names."""
        try:
            found = [str(name) for name in names]
        except TypeError:
            return None
        if found == self._names:
            return self._in_order
        if sorted(found) != sorted(self._names):
            return None
        return [found.index(name) for name in self._names]

    def _judge_readings(self, inputs: TickInputs, time: float) -> dict[str, str]:
        """Take in what is new and believe what is right; return what is wrong with the rest."""
        problems: dict[str, str] = {}
        h, before = self._period, self._stamps['joints']
        joints = self._take_joints(inputs.joints, time, problems)
        wrench = None if inputs.wrench is None else self._take_numbers(
            'wrench', *inputs.wrench, self._new_wrench, time, problems)
        variance = None if inputs.variance is None else self._take_numbers(
            'variance', *inputs.variance, self._new_variance, time, problems)
        elapsed = h if joints is None or before is None else joints - before
        self._elapsed[0] = elapsed
        for fresh, stamp in zip(self._fresh_readings, (joints, wrench, variance)):
            fresh[0] = stamp is not None
        verdicts = self._check()
        on_joints = on_wrench = on_variance = FINE
        if verdicts:
            on_variance, others = divmod(verdicts, VERDICTS ** 2)
            on_wrench, on_joints = divmod(others, VERDICTS)
        self._blind_ticks += 1
        if joints is not None:
            if on_joints == FINE:
                self._stamps['joints'], self._blind_ticks = joints, 0
                self._q, self._qd = self._valid_q, self._valid_qd
            elif on_joints == FROZEN:  # the reading is as old as its value
                self._stamps['joints'] = joints - h * self._repeats('joint_repeats')
        if wrench is not None:
            if on_wrench == FINE:
                self._stamps['wrench'], self._wrench = wrench, self._valid_wrench
            elif on_wrench == FROZEN:
                self._stamps['wrench'] = wrench - h * self._repeats('wrench_repeats')
        if variance is not None and on_variance == FINE:
            self._stamps['variance'], self._inflation = variance, 1.0
        if verdicts:
            for key, verdict in zip(INPUTS, (on_joints, on_wrench, on_variance)):
                if verdict != FINE:
                    problems[key] = PROBLEMS[verdict]
        return problems

    def _check(self) -> int:
        """Check what is fresh of the numbers; see `check_readings`."""
        return int(check_readings(
            self._joints, self._axes, self._variances, self._memory, self._settings))

    def _repeats(self, name: str) -> int:
        return int(self._memory[name][0])


def reading_settings(config: ControllerConfig) -> Records:
    """Return what readings must be like as one record of `READING_SETTINGS`."""
    watch = config.watchdog
    settings = np.zeros(1, dtype=READING_SETTINGS)
    for name in ('position_jump', 'frozen_samples', 'variance_floor', 'variance_ceiling'):
        settings[name] = getattr(watch, name)
    settings['period'] = config.period
    settings['recovery_samples'] = round(watch.recovery_time * config.rate)
    return settings
