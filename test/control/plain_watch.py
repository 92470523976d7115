"""Watchdog and gate in plain numpy: what the compiled ones must equal."""

import math

from multicontact_control.arrays import all_finite
from multicontact_control.control.gate_kernels import SPEED_GAIN
from multicontact_control.control.safety import GateResult
from multicontact_control.control.watchdog import Believed
from multicontact_control.control.watchdog_kernels import STILL
import numpy as np


class PlainGate:

    def __init__(self, config, joints):
        limits, unlimited = config.limits, np.full(joints, np.inf)
        self._limit = np.array(config.torque_limit) if config.torque_limit else unlimited
        self._step = (np.array(limits.torque_rate) * config.period if limits.torque_rate
                      else unlimited)
        margin = limits.joint_margin
        self._lower = np.array(limits.joint_lower) + margin if limits.joint_lower else -unlimited
        self._upper = np.array(limits.joint_upper) - margin if limits.joint_upper else unlimited
        self._speed = np.array(limits.joint_speed) if limits.joint_speed else unlimited
        self._braking = limits.joint_braking
        self.reset()

    def reset(self):
        self.last = None

    def apply(
        self, torque, fallback, arm,
    ):
        limits = []
        if torque.shape != self._limit.shape or not all_finite(torque):
            limits.append('not_finite')
            torque = np.where(np.isfinite(fallback), fallback, 0.0)
        if arm is not None:
            braked = self._braked(torque, arm)
            if braked is not torque:
                limits.append('joint')
                torque = np.where(np.isfinite(braked), braked, 0.0)
        clipped = np.minimum(np.maximum(torque, -self._limit), self._limit)
        if (clipped != torque).any():
            limits.append('torque')
        if self.last is not None:
            slowed = np.minimum(np.maximum(clipped, self.last - self._step),
                                self.last + self._step)
            if (slowed != clipped).any():
                limits.append('torque_rate')
            clipped = slowed
        self.last = clipped.copy()
        return GateResult(clipped, tuple(limits))

    def _braked(self, torque, arm):
        speed, q = arm.velocity, arm.q
        ahead = np.sqrt(2.0 * self._braking * np.maximum(self._upper - q, 0.0))
        behind = np.sqrt(2.0 * self._braking * np.maximum(q - self._lower, 0.0))
        fastest = np.minimum(ahead, self._speed)
        slowest = -np.minimum(behind, self._speed)
        if (speed < 0.7 * fastest).all() and (speed > 0.7 * slowest).all():
            return torque
        highest = arm.bias_torque + SPEED_GAIN * arm.inertia * (fastest - speed)
        lowest = arm.bias_torque + SPEED_GAIN * arm.inertia * (slowest - speed)
        bounded = np.minimum(np.maximum(torque, lowest), highest)
        return torque if (bounded == torque).all() else bounded


def finite_vector(values, size):
    try:
        vector = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return None
    if vector.shape != (size,) or not all_finite(vector):
        return None
    return vector


def finite_number(value):
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


class PlainWatchdog:

    def __init__(self, config):
        self._config, self._watch = config, config.watchdog
        self._names = config.robot.joint_names
        self._speed_limit = np.array(config.limits.joint_speed or [np.inf] * len(self._names))
        full_scale = self._watch.wrench_full_scale
        self._full_scale = 0.999 * np.array(full_scale) if full_scale else np.full(6, np.inf)
        self.reset()

    def reset(self):
        contacts = len(self._config.contact_names)
        self._time = None
        self._odd_periods = self._same_times = self._blind_ticks = 0
        self._q = None
        self._qd = None
        self._wrench = None
        self._variance = np.full(contacts, self._config.initial_noise_variance)
        self._inflation = 1.0
        self._stamps = {}
        self._seen = {}
        self._last_joints = None
        self._last_wrench = None
        self._joint_repeats = self._wrench_repeats = 0
        self._distrust = 0

    def judge(self, inputs):
        rejected = []
        causes = []
        time = self._judge_time(inputs.time, causes)
        if time is None and (self._same_times >= 2 or self._has_new(inputs)):
            causes.append('clock_frozen')
            time = self._time
        if time is None:
            return Believed(self._q, self._qd, self._wrench, self._used_variance(), (), (), True)
        h = self._config.period
        self._take_joints(inputs.joints, time, rejected)
        self._take_wrench(inputs.wrench, time, rejected)
        self._take_variance(inputs.variance, time, rejected)
        for key, limit in (('joints', self._watch.joint_max_age),
                           ('wrench', self._watch.wrench_max_age),
                           ('variance', self._watch.variance_max_age)):
            stamp = self._stamps.get(key)
            if stamp is None and key != 'variance' or (
                    stamp is not None and time - stamp > limit + 1e-3 * h):
                reasons = [reason for reason in rejected if reason.startswith(key)]
                causes.append(reasons[0] if reasons else f'{key}_stale')
        if any(cause.startswith('variance') for cause in causes):
            self._inflation *= self._watch.variance_growth
        return Believed(self._q, self._qd, self._wrench, self._used_variance(), tuple(causes),
                        tuple(rejected), blind=self._blind_ticks > 1)

    def _has_new(self, inputs):
        return inputs.joints is not None and (
            finite_number(inputs.joints.stamp) != self._seen.get('joints'))

    def _used_variance(self):
        used = np.minimum(self._variance * self._inflation, self._watch.variance_ceiling)
        self._inflation = min(self._inflation, 1e12)
        return used

    def _judge_time(self, value, causes):
        h, before = self._config.period, self._time
        time = finite_number(value)
        if time is None or abs(time) > 1e12:
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
            self._seen = {}
            self._odd_periods = 0
            return time
        odd = not h / self._watch.rate_band <= step <= h * self._watch.rate_band
        self._odd_periods = self._odd_periods + 1 if odd else 0
        if self._odd_periods >= 2:
            causes.append('clock_rate')
        return time

    def _fresh(self, key, stamp, time, rejected):
        number = finite_number(stamp)
        if number is None or number > time + 0.5 * self._config.period:
            rejected.append(f'{key}_stamp')
            return None
        before = self._seen.get(key)
        if before is not None and number <= before:
            if number < before:
                rejected.append(f'{key}_order')
            return None
        self._seen[key] = number
        return number

    def _take_joints(self, reading, time, rejected):
        self._blind_ticks += 1
        if reading is None:
            return
        stamp = self._fresh('joints', reading.stamp, time, rejected)
        if stamp is None:
            return
        problem = self._joint_problem(reading, stamp)
        if problem:
            rejected.append(f'joints_{problem}')
            if problem == 'frozen':  # the reading is as old as its value
                self._stamps['joints'] = stamp - self._joint_repeats * self._config.period
        else:
            self._stamps['joints'] = stamp
            self._blind_ticks = 0

    def _joint_problem(self, reading, stamp):
        n = len(self._names)
        q, qd = finite_vector(reading.q, n), finite_vector(reading.qd, n)
        if reading.names is not None:
            try:
                names = [str(name) for name in reading.names]
            except TypeError:
                return 'names'
            if sorted(names) != sorted(self._names):
                return 'names'
            if q is not None and qd is not None and names != list(self._names):
                order = [names.index(name) for name in self._names]
                q, qd = q[order], qd[order]
        if q is None or qd is None:
            return 'invalid'
        if np.abs(q).max() > 1e3 or (np.abs(qd) > 3.0 * self._speed_limit).any():
            return 'implausible'
        before, self._last_joints = self._last_joints, (q, qd)
        if self._jumped(q, qd, before, stamp):
            self._distrust = round(self._watch.recovery_time * self._config.rate)
            return 'jump'
        if self._distrust > 0:
            self._distrust -= 1
            return 'jump'
        if self._joints_frozen(q, qd, before):
            return 'frozen'
        self._q, self._qd = q, qd
        return ''

    def _jumped(
        self, q, qd, before, stamp,
    ):
        origin = before if self._distrust else (
            None if self._q is None or self._qd is None else (self._q, self._qd))
        if origin is None:
            return False
        believed = self._stamps.get('joints')
        h = self._config.period
        elapsed = h if self._distrust or believed is None else stamp - believed
        change = q - origin[0] - 0.5 * (qd + origin[1]) * min(elapsed, 0.1)
        return bool(np.abs(change).max() > self._watch.position_jump * max(1.0, elapsed / h / 5.0))

    def _joints_frozen(
        self, q, qd, before,
    ):
        same = before is not None and np.abs(qd).max() > STILL and bool(
            (q == before[0]).all() or (qd == before[1]).all())
        self._joint_repeats = self._joint_repeats + 1 if same else 0
        limit = self._watch.frozen_samples
        return bool(limit and self._joint_repeats >= limit)

    def _take_wrench(self, reading, time, rejected):
        if reading is None:
            return
        stamp = self._fresh('wrench', reading.stamp, time, rejected)
        if stamp is None:
            return
        wrench = finite_vector(reading.wrench, 6)
        if wrench is None or np.abs(wrench).max() > 1e6:
            rejected.append('wrench_invalid')
            return
        same = self._last_wrench is not None and bool((wrench == self._last_wrench).all())
        self._wrench_repeats = self._wrench_repeats + 1 if same else 0
        self._last_wrench = wrench
        limit = self._watch.frozen_samples
        if (np.abs(wrench) >= self._full_scale).any():
            rejected.append('wrench_saturated')
        elif limit and self._wrench_repeats >= limit:
            rejected.append('wrench_frozen')
            # Its first repetitions were not fresh either: the reading is as old as its value.
            self._stamps['wrench'] = stamp - self._wrench_repeats * self._config.period
        else:
            self._wrench, self._stamps['wrench'] = wrench, stamp

    def _take_variance(
        self, reading, time, rejected,
    ):
        if reading is None:
            return
        stamp = self._fresh('variance', reading.stamp, time, rejected)
        if stamp is None:
            return
        variance = finite_vector(reading.variance, self._variance.size)
        if variance is None or not (variance > 0.0).all():
            rejected.append('variance_invalid')
        else:
            self._variance = np.clip(
                variance, self._watch.variance_floor, self._watch.variance_ceiling)
            self._stamps['variance'], self._inflation = stamp, 1.0
