"""Watchdog and gate in plain numpy: what the compiled ones must equal."""

from types import SimpleNamespace

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
        return clipped, tuple(limits)

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


class PlainWatchdog:
    """Every input of a tick, one after the other."""

    def __init__(self, config):
        self._watch, self._h, self._rate = config.watchdog, config.period, config.rate
        self._fastest = 3.0 * np.array(config.limits.joint_speed)
        self._full_scale = 0.999 * np.array(config.watchdog.wrench_full_scale or np.inf)
        watch, h = config.watchdog, config.period
        slack = 1e-3 * h
        self._ages = {'joints': h * watch.joint_max_age + slack,
                      'wrench': h * watch.wrench_max_age + slack,
                      'variance': h * watch.variance_max_age + slack}
        self._valid = {'joints': None, 'wrench': None, 'variance': np.full(
            len(config.contact_names), config.initial_noise_variance)}
        self._stamps, self._seen = dict.fromkeys(self._ages), dict.fromkeys(self._ages)
        self._last, self._repeats = {}, {'joints': 0, 'wrench': 0}
        self._time = None
        self._odd = self._same = self._blind = self._distrust = 0
        self._inflation = 1.0

    def validate(self, inputs):
        causes, problems = [], {}
        if not self._take_time(inputs, causes):
            return self._result((), (), repeated=True)
        self._blind += 1
        self._measured = False
        for key in self._ages:
            reading = getattr(inputs, key)
            if reading is not None and self._is_new(key, reading.stamp, problems):
                numbers = (reading.q, reading.qd) if key == 'joints' else tuple(reading[1:])
                self._take(key, [np.array(each) for each in numbers], reading.stamp, problems)
        for key, limit in self._ages.items():
            stamp = self._stamps[key]
            if problems.get(key) == 'saturated':
                limit = min(limit, 1.5 * self._h)
            if key != 'variance' if stamp is None else self._time - stamp > limit:
                causes.append(f"{key}_{problems.get(key, 'stale')}")
                self._inflation *= self._watch.variance_growth if key == 'variance' else 1.0
        return self._result(causes, [f'{key}_{problems[key]}' for key in self._ages
                                     if key in problems], blind=self._blind > 1,
                            measured=self._measured)

    def _result(self, causes, rejected, *, repeated=False, blind=False, measured=None):
        joints, variance = self._valid['joints'], self._valid['variance']
        if self._inflation != 1.0:
            variance = np.minimum(variance * self._inflation, self._watch.variance_ceiling)
        return SimpleNamespace(
            q=joints and joints[0], qd=joints and joints[1], wrench=self._valid['wrench'],
            variance=variance, causes=tuple(causes), rejected=tuple(rejected),
            repeated=repeated, blind=blind, measured=measured)

    def _take_time(self, inputs, causes):
        time, before = inputs.time, self._time
        if not abs(time) <= 1e12:
            causes.append('clock_invalid')
            self._time = 0.0 if before is None else before + self._h
            return True
        self._time = time
        if before is None:
            return True
        if time == before:
            self._same += 1
            stamp = np.nan if inputs.joints is None else inputs.joints.stamp
            same = (stamp if np.isfinite(stamp) else None) == self._seen['joints']
            if self._same < 2 and (inputs.joints is None or same):
                return False
            causes.append('clock_frozen')
            return True
        self._same = 0
        if time < before:
            causes.append('clock_backwards')
            self._stamps, self._seen = dict.fromkeys(self._ages), dict.fromkeys(self._ages)
            self._odd = 0
            return True
        band = self._watch.rate_band
        odd = not self._h / band <= time - before <= self._h * band
        self._odd = self._odd + 1 if odd else 0
        if self._odd >= 2:
            causes.append('clock_rate')
        return True

    def _is_new(self, key, stamp, problems):
        before = self._seen[key]
        if not np.isfinite(stamp) or stamp > self._time + 0.5 * self._h:
            problems[key] = 'stamp'
            return False
        if before is not None and stamp <= before:
            if stamp < before:
                problems[key] = 'order'
            return False
        self._seen[key] = stamp
        if key == 'wrench' and self._time - stamp > 1.501 * self._h:
            problems[key] = 'late'
            return False
        return True

    def _take(self, key, numbers, stamp, problems):
        problem = getattr(self, f'_{key}_problem')(*numbers, stamp)
        if problem:
            problems[key] = problem
            if problem == 'frozen':  # the reading is as old as its value
                self._stamps[key] = stamp - self._repeats[key] * self._h
            return
        self._stamps[key] = stamp
        if key == 'joints':
            self._valid[key], self._blind = numbers, 0
        elif key == 'wrench':
            self._valid[key], self._measured = numbers[0], True
        else:
            self._valid[key], self._inflation = np.clip(
                numbers[0], self._watch.variance_floor, self._watch.variance_ceiling), 1.0

    def _joints_problem(self, q, qd, stamp):
        if not (all_finite(q) and all_finite(qd)):
            return 'invalid'
        if np.abs(q).max() > 1e3 or (np.abs(qd) > self._fastest).any():
            return 'implausible'
        before, self._last['joints'] = self._last.get('joints'), (q, qd)
        if self._jumped(q, qd, before, stamp):
            self._distrust = round(self._watch.recovery_time * self._rate)
            return 'jump'
        if self._distrust > 0:
            self._distrust -= 1
            return 'jump'
        same = before is not None and np.abs(qd).max() > STILL and bool(
            (q == before[0]).all() or (qd == before[1]).all())
        self._repeats['joints'] = self._repeats['joints'] + 1 if same else 0
        limit = self._watch.frozen_joint_samples
        return 'frozen' if limit and self._repeats['joints'] >= limit else ''

    def _jumped(self, q, qd, before, stamp):
        origin = before if self._distrust else self._valid['joints']
        if origin is None:
            return False
        valid, h = self._stamps['joints'], self._h
        elapsed = h if self._distrust else self._blind * h if valid is None else stamp - valid
        change = q - origin[0] - 0.5 * (qd + origin[1]) * min(elapsed, LONGEST)
        return bool(np.abs(change).max() > self._watch.position_jump * max(1.0, elapsed / h / 5.0))

    def _wrench_problem(self, wrench, stamp):
        if not all_finite(wrench) or np.abs(wrench).max() > 1e6:
            return 'invalid'
        before, self._last['wrench'] = self._last.get('wrench'), wrench
        same = before is not None and bool((wrench == before).all())
        self._repeats['wrench'] = self._repeats['wrench'] + 1 if same else 0
        if (np.abs(wrench) >= self._full_scale).any():
            return 'saturated'
        limit = self._watch.frozen_samples
        return 'frozen' if limit and self._repeats['wrench'] >= limit else ''

    def _variance_problem(self, variance, stamp):
        return '' if all_finite(variance) and (variance > 0.0).all() else 'invalid'
