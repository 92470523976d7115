"""Watchdog and gate in plain numpy: what the compiled ones must equal."""

from multicontact_control.supervision.gate import GateResult
from multicontact_control.supervision.validation import Watchdog
import numpy as np

SPEED_GAIN, LONGEST, STILL = 50.0, 0.1, 1e-4


def all_finite(values):
    return bool(np.isfinite(values).all())


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


class PlainWatchdog(Watchdog):
    """Stamps, names and times are looked at as the compiled one does; the numbers are not."""

    def reset(self):
        super().reset()
        self._last_joints = self._last_wrench = None
        self._joint_repeats = self._wrench_repeats = self._distrust = 0

    def _judge_readings(self, inputs, time):
        problems = {}
        self._blind_ticks += 1
        stamp = self._take_joints(inputs.joints, time, problems)
        if stamp is not None:
            self._judge_joints(self._new_q.copy(), self._new_qd.copy(), stamp, problems)
        if inputs.wrench is not None:
            stamp = self._take_numbers(
                'wrench', *inputs.wrench, self._new_wrench, time, problems)
            if stamp is not None:
                self._judge_wrench(self._new_wrench.copy(), stamp, problems)
        if inputs.variance is not None:
            stamp = self._take_numbers(
                'variance', *inputs.variance, self._new_variance, time, problems)
            if stamp is not None:
                self._judge_variance(self._new_variance.copy(), stamp, problems)
        return problems

    def _judge_joints(self, q, qd, stamp, problems):
        problem = self._joint_problem(q, qd, stamp)
        if not problem:
            self._q, self._qd = q, qd
            self._stamps['joints'], self._blind_ticks = stamp, 0
            return
        problems['joints'] = problem
        if problem == 'frozen':  # the reading is as old as its value
            self._stamps['joints'] = stamp - self._joint_repeats * self._config.period

    def _joint_problem(self, q, qd, stamp):
        if not (all_finite(q) and all_finite(qd)):
            return 'invalid'
        if np.abs(q).max() > 1e3 or (np.abs(qd) > 3.0 * self._joints['speed_limit']).any():
            return 'implausible'
        before, self._last_joints = self._last_joints, (q, qd)
        if self._jumped(q, qd, before, stamp):
            self._distrust = round(self._watch.recovery_time * self._config.rate)
            return 'jump'
        if self._distrust > 0:
            self._distrust -= 1
            return 'jump'
        same = before is not None and np.abs(qd).max() > STILL and bool(
            (q == before[0]).all() or (qd == before[1]).all())
        self._joint_repeats = self._joint_repeats + 1 if same else 0
        limit = self._watch.frozen_samples
        return 'frozen' if limit and self._joint_repeats >= limit else ''

    def _jumped(self, q, qd, before, stamp):
        origin = before if self._distrust else (
            None if self._q is None or self._qd is None else (self._q, self._qd))
        if origin is None:
            return False
        believed, h = self._stamps['joints'], self._config.period
        elapsed = h if self._distrust or believed is None else stamp - believed
        change = q - origin[0] - 0.5 * (qd + origin[1]) * min(elapsed, LONGEST)
        return bool(np.abs(change).max() > self._watch.position_jump * max(1.0, elapsed / h / 5.0))

    def _judge_wrench(self, wrench, stamp, problems):
        if not all_finite(wrench) or np.abs(wrench).max() > 1e6:
            problems['wrench'] = 'invalid'
            return
        same = self._last_wrench is not None and bool((wrench == self._last_wrench).all())
        self._wrench_repeats = self._wrench_repeats + 1 if same else 0
        self._last_wrench = wrench
        limit = self._watch.frozen_samples
        if (np.abs(wrench) >= self._axes['full_scale']).any():
            problems['wrench'] = 'saturated'
        elif limit and self._wrench_repeats >= limit:
            problems['wrench'] = 'frozen'
            # Its first repetitions were not fresh either: the reading is as old as its value.
            self._stamps['wrench'] = stamp - self._wrench_repeats * self._config.period
        else:
            self._wrench, self._stamps['wrench'] = wrench, stamp

    def _judge_variance(self, variance, stamp, problems):
        if not all_finite(variance) or not (variance > 0.0).all():
            problems['variance'] = 'invalid'
        else:
            self._valid_variance[:] = np.clip(
                variance, self._watch.variance_floor, self._watch.variance_ceiling)
            self._stamps['variance'], self._inflation = stamp, 1.0
