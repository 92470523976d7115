"""
The input stage: what has come in at a tick, made valid, by one compiled call.

A reading of joints, wrench or R is checked for its stamp, its shape, its numbers and the reading
before it; a wrench is low-passed, too. A reading that fails counts as not received: the newest
valid one stands in for it, and calls for a reaction (`checks.reactions_of`) once it is too old.

What is wrong is called ``<part>_<problem>``, the part `joints`, `wrench`, `variance` or `clock`:

- `invalid`: no number, not finite, of another shape, or an R that is not positive;
- `implausible`: a joint position or speed that no arm has;
- `jump`: a joint is not where its speeds have taken it;
- `frozen`: identical readings in a row, or a clock that stands still while samples come;
- `saturated`: an axis of the wrist sensor is at full scale;
- `stamp`: no time, or in the future; `order`: before an earlier one; `late`: of a wrench, more
  than a period old when it comes;
- `stale`: too old, and nothing newer has come;
- `backwards`, `rate`: of the clock; a wrong rate is one twice in a row.

A live wrist sensor repeats itself by chance: two readings of all six axes of a 14-bit JR3 with
0.047 N and 0.004 N m of noise are equal with a probability of 6e-8, three in a row with 4e-15.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from multicontact_control.algebra import copy_vector
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.records import INPUT_STAGE, JOINT_INPUT, Records, VARIANCE_INPUT
import numpy as np

JOINTS, WRENCH, VARIANCE = range(3)
NAMES = ('joints', 'wrench', 'variance')
# What is wrong with a reading; ABSENT: none has come, FINE: nothing.
ABSENT = -1
FINE, INVALID, IMPLAUSIBLE, JUMP, FROZEN, SATURATED, STAMP, ORDER, LATE = range(9)
PROBLEMS = ('', 'invalid', 'implausible', 'jump', 'frozen', 'saturated', 'stamp', 'order', 'late')
# What is wrong with the time of a tick.
CLOCK_FINE, CLOCK_INVALID, CLOCK_BACKWARDS, CLOCK_RATE, CLOCK_FROZEN, CLOCK_STILL = range(6)
CLOCK = ('', 'invalid', 'backwards', 'rate', 'frozen')

KEPT = 100  # wrenches, for a tare
LONGEST_GAP = 0.1  # s between two wrenches; after it the low-pass and the tare begin anew
SATURATED_SHARE = 0.99  # of full scale, from which on a reading is saturated
FAULTS = 2  # frozen or saturated wrenches in a row, from which on they are not bridged
WRENCH_AGE = 1.5  # periods, up to which a wrench is that of its tick
HARDEST = 1e6  # N or N m; no wrench is beyond it
FARTHEST = 1e3  # rad; no joint is beyond it
SPEED_EXCESS = 3.0  # times the speed limit of a joint; no joint is faster
STILL = 1e-4  # rad/s; below it a joint state may repeat itself
POSITION_JUMP = 0.01  # rad between a joint position and the one its speeds lead to
LONGEST_STEP = 0.1  # s, over which speeds are extrapolated
VARIANCE_FLOOR = 0.1  # N^2; a smaller R makes the observer faster than the drives
VARIANCE_CEILING = 1e3  # N^2
VARIANCE_GROWTH = 1.1  # per period, of an R that is not renewed
INFLATED = 1e12  # times R, at most
LATEST = 1e12  # s; no time is beyond it
LARGEST = np.finfo(np.float64).max  # finite numbers are within it
AGE_TOLERANCE = 1e-3  # periods


class JointInput(NamedTuple):
    """
    A joint state as it came in, sampled at `stamp` [s], in the order of `robot.joint_names`.

    Positions q [rad], velocities qd [rad/s], and the measured torques over the period that ends
    here [N m], None where the robot measures none.
    """

    stamp: float
    q: Any
    qd: Any
    effort: Any = None


class WrenchInput(NamedTuple):
    """A wrench as the sensor gave it [N, N m], sampled at `stamp` [s]."""

    stamp: float
    wrench: Any


class VarianceInput(NamedTuple):
    """An R per contact as it came in [N^2]; `stamp` is that of the newest sample in it [s]."""

    stamp: float
    variance: Any


class TickInputs(NamedTuple):
    """The newest of each input, however old, at a tick; `time` is on the stamps' clock [s]."""

    time: float
    joints: JointInput | None = None
    wrench: WrenchInput | None = None
    variance: VarianceInput | None = None


class Seen(NamedTuple):
    """
    What is valid at a tick; the numbers are in `Inputs`.

    Attributes
    ----------
    causes
        What calls for a reaction.
    rejected
        What is wrong with the readings of this tick, whether it calls for a reaction yet or not.
    joints, wrench
        Whether any joint state and any wrench were ever valid.
    repeated
        Whether this is the tick before once more.
    blind
        Whether the joint state is neither of this tick nor of the one before.
    measured
        Whether the wrench is of this tick.

    """

    causes: tuple[str, ...] = ()
    rejected: tuple[str, ...] = ()
    joints: bool = True
    wrench: bool = True
    repeated: bool = False
    blind: bool = False
    measured: bool = True


@compiled
def check_clock(time: float, state: Any, settings: Any) -> int:
    """Check and keep the time of a tick [s]; one that is not finite is a period after the last."""
    before = state.time
    if not abs(time) <= LATEST:
        state.time = 0.0 if np.isnan(before) else before + settings.period
        return CLOCK_INVALID
    state.time = time
    if np.isnan(before):
        return CLOCK_FINE
    step = time - before
    if step == 0.0:
        state.same_times += 1
        return CLOCK_STILL
    state.same_times = 0
    if step < 0.0:
        for i in range(3):
            state.seen[i] = np.nan
            state.valid[i] = np.nan
        state.odd_periods = 0
        return CLOCK_BACKWARDS
    odd = not settings.shortest <= step <= settings.longest
    state.odd_periods = state.odd_periods + 1 if odd else 0
    return CLOCK_RATE if state.odd_periods >= 2 else CLOCK_FINE


@compiled
def check_stamp(which: int, stamp: float, content: int, state: Any, settings: Any) -> int:
    """Check the stamp of a reading [s]; return its content if that is in order and new."""
    before = state.seen[which]
    if content == ABSENT:
        return ABSENT
    if not -np.inf < stamp <= state.time + 0.5 * settings.period:
        return STAMP
    if stamp <= before:
        return ORDER if stamp < before else ABSENT
    state.seen[which] = stamp
    if which == WRENCH:
        if not stamp - before <= LONGEST_GAP:
            state.kept = 0
            state.memory[0, 0] = np.nan
        if content == FINE and state.time - stamp > (WRENCH_AGE + AGE_TOLERANCE) * settings.period:
            return LATE
    return content


@compiled
def check_joints(joints: Any, elapsed: float, state: Any, settings: Any) -> int:
    """
    Check a joint state, `elapsed` after the newest valid one [s]; keep it if it is fine.

    After a jump each is compared with the one before it, and refused for the recovery time.
    """
    distrusted = state.distrust > 0
    span = settings.period if distrusted else elapsed
    limit = POSITION_JUMP * max(1.0, span / settings.period / 5.0)
    plausible, still, jumped, same_q, same_qd = True, True, False, True, True
    for j in range(joints.shape[0]):
        joint = joints[j]
        if not (abs(joint.q) <= LARGEST and abs(joint.qd) <= LARGEST):
            return INVALID
        plausible = plausible and (
            abs(joint.q) <= FARTHEST and abs(joint.qd) <= SPEED_EXCESS * joint.speed_limit)
        still = still and abs(joint.qd) <= STILL
        same_q = same_q and joint.q == joint.last_q
        same_qd = same_qd and joint.qd == joint.last_qd
        q = joint.last_q if distrusted else joint.valid_q
        qd = joint.last_qd if distrusted else joint.valid_qd
        change = joint.q - q - 0.5 * (joint.qd + qd) * min(span, LONGEST_STEP)
        jumped = jumped or abs(change) > limit  # NaN, of a first one, is no jump
    if not plausible:
        return IMPLAUSIBLE
    for j in range(joints.shape[0]):
        joints[j].last_q, joints[j].last_qd = joints[j].q, joints[j].qd
    if jumped:
        state.distrust = settings.recovery_ticks
        return JUMP
    if distrusted:
        state.distrust -= 1
        return JUMP
    same = not still and (same_q or same_qd)
    state.equal_joints = state.equal_joints + 1 if same else 1
    if 0 < settings.frozen_joint_ticks <= state.equal_joints:
        return FROZEN
    for j in range(joints.shape[0]):
        joints[j].valid_q, joints[j].valid_qd = joints[j].q, joints[j].qd
    return FINE


@compiled
def take_wrench(joints: Any, kept: Matrix, state: Any, settings: Any) -> int:
    """
    Check a wrench, low-pass it, and keep it with the posture as a row of a ring for a tare.

    The low-pass (transposed direct form II, gain 1 at rest) begins settled on its first wrench.
    """
    equal, saturated, possible = True, False, True
    for i in range(6):
        equal = equal and state.raw[i] == state.last[i]
        saturated = saturated or abs(state.raw[i]) >= settings.full_scale[i]
        possible = possible and abs(state.raw[i]) <= HARDEST
    state.fault = SATURATED if saturated else FINE
    if not possible:
        state.faults += int(saturated)
        copy_vector(state.raw, state.filtered)  # without supervision the law finds it
        return SATURATED if saturated else INVALID
    a, b, memory, row = settings.a, settings.b, state.memory, kept[state.kept % kept.shape[0]]
    begins = np.isnan(memory[0, 0])
    for i in range(6):
        raw = filtered = state.raw[i]
        row[i] = state.last[i] = raw
        if settings.order > 0:
            if begins:
                memory[0, i] = raw * ((b[1] + b[2]) - (a[1] + a[2]))
                memory[1, i] = raw * (b[2] - a[2])
            filtered = b[0] * raw + memory[0, i]
            memory[0, i] = b[1] * raw - a[1] * filtered + memory[1, i]
            memory[1, i] = b[2] * raw - a[2] * filtered
        state.filtered[i] = filtered
    for j in range(joints.shape[0]):
        row[6 + j] = joints[j].q
    state.kept += 1
    state.equal_wrenches = state.equal_wrenches + 1 if equal else 1
    if 0 < settings.frozen_ticks <= state.equal_wrenches and not saturated:
        state.fault = FROZEN
    state.faults = state.faults + 1 if state.fault != FINE else 0
    return int(state.fault)


@compiled
def check_readings(
    stage: Any, joints: Any, variances: Any, kept: Matrix, stamps: Any,
) -> None:
    """Check the numbers of new readings; keep valid ones. A frozen one is as old as its value."""
    settings, state, problem = stage.settings, stage.state, stage.verdict.problem
    valid, h = state.valid, settings.period
    state.blind_ticks += 1
    if problem[JOINTS] == FINE:
        # The stamps before a fault of the clock are of no use: ticks are counted then.
        elapsed = stamps[JOINTS] - valid[JOINTS]
        if np.isnan(elapsed):
            elapsed = h * state.blind_ticks
        problem[JOINTS] = check_joints(joints, elapsed, state, settings)
        if problem[JOINTS] == FINE:
            valid[JOINTS] = stamps[JOINTS]
            state.blind_ticks = 0
        elif problem[JOINTS] == FROZEN:
            valid[JOINTS] = stamps[JOINTS] - h * (state.equal_joints - 1)
    stage.verdict.fresh = problem[WRENCH] == FINE or problem[WRENCH] == LATE
    if stage.verdict.fresh:
        fault = take_wrench(joints, kept, state, settings)
        if fault != FINE:
            problem[WRENCH] = fault
        if problem[WRENCH] == FINE:
            copy_vector(state.filtered, state.wrench)
            valid[WRENCH] = stamps[WRENCH]
        elif problem[WRENCH] == FROZEN:
            valid[WRENCH] = stamps[WRENCH] - h * (state.equal_wrenches - 1)
    if problem[VARIANCE] == FINE:
        for i in range(variances.shape[0]):
            if not 0.0 < variances[i].new < np.inf:
                problem[VARIANCE] = INVALID
    if problem[VARIANCE] == FINE:
        valid[VARIANCE], state.inflation = stamps[VARIANCE], 1.0
        for i in range(variances.shape[0]):
            variances[i].valid = min(max(variances[i].new, VARIANCE_FLOOR), VARIANCE_CEILING)


@compiled
def check_inputs(
    stages: Any, joints: Any, variances: Any, kept: Matrix, motion: Matrix, wrench: Vector,
    noise_variance: Vector, effort: Vector, time: float, stamps: Any, contents: Any,
    with_effort: bool,
) -> bool:
    """
    Check the inputs of a tick, keep what is valid of them, and hand it over.

    Parameters
    ----------
    stages, joints, variances, kept
        What `Inputs` keeps: one record of `INPUT_STAGE`, records of `JOINT_INPUT`, shape (n,), and
        `VARIANCE_INPUT`, shape (r,), and wrenches and postures for a tare, shape (k, 6 + n).
    motion, wrench, noise_variance, effort
        Places of what is valid; see `Inputs`.
    time, stamps
        Of the tick, and of joints, wrench and R; NaN for no number [s].
    contents
        Of these three: FINE, INVALID if the numbers cannot be read, or ABSENT.
    with_effort
        Whether torques came with the joints.

    Returns
    -------
    bool
        Whether all is well: every input is known and valid, or young enough to go on with, and
        the wrench is new.

    """
    stage = stages[0]
    settings, state, verdict = stage.settings, stage.state, stage.verdict
    clock = check_clock(time, state, settings)
    verdict.repeated, verdict.fresh = False, False
    if clock == CLOCK_STILL:
        stamp, seen = stamps[JOINTS], state.seen[JOINTS]
        same = contents[JOINTS] == ABSENT or stamp == seen or (
            np.isnan(seen) and not np.isfinite(stamp))
        verdict.repeated = same and state.same_times < 2
        if verdict.repeated:
            return False
        clock = CLOCK_FROZEN
    verdict.clock = clock
    for i in range(3):
        verdict.problem[i] = check_stamp(i, stamps[i], contents[i], state, settings)
    check_readings(stage, joints, variances, kept, stamps)
    for i in range(3):
        age = state.time - state.valid[i]
        verdict.stale[i] = age > settings.max_age[i] or (np.isnan(age) and i != VARIANCE)
    if state.faults >= FAULTS:
        verdict.stale[WRENCH] = True
    if verdict.stale[VARIANCE]:
        state.inflation *= VARIANCE_GROWTH
    moved, total = False, 0.0  # a driver that measures no torque may say 0, or NaN
    for j in range(joints.shape[0]):
        moved = moved or joints[j].effort != 0.0
        total += joints[j].effort
    verdict.acted = with_effort and moved and np.isfinite(total)
    verdict.joints, verdict.wrench = np.isfinite(joints[0].valid_q), np.isfinite(state.wrench[0])
    for j in range(joints.shape[0]):
        if verdict.acted:
            effort[j] = joints[j].effort
        if verdict.joints:
            motion[0, j], motion[1, j] = joints[j].valid_q, joints[j].valid_qd
    if verdict.wrench:
        copy_vector(state.wrench, wrench)
    for i in range(variances.shape[0]):
        noise_variance[i] = variances[i].valid
        if state.inflation != 1.0:
            noise_variance[i] = min(variances[i].valid * state.inflation, VARIANCE_CEILING)
    state.inflation = min(state.inflation, INFLATED)
    verdict.blind = state.blind_ticks > 1
    well = clock == CLOCK_FINE and not verdict.blind and verdict.problem[WRENCH] == FINE
    for i in range(3):
        well = well and not verdict.stale[i] and verdict.problem[i] <= FINE
    return bool(well)


class Inputs:
    """
    The input stage of a controller.

    Parameters
    ----------
    config
        Limits, ages, low-pass.
    places
        Where what is valid goes: q and v, shape (2, n) [rad, rad/s], wrench, shape (6,) [N, N m],
        R, shape (r,) [N^2], and the torques that acted, shape (n,) [N m]; its own if not given.

    Attributes
    ----------
    q, qd, wrench, variance, effort
        What is valid now, in these places.
    raw, filtered
        The newest wrench as it came in, and behind the low-pass, shape (6,) [N, N m].
    estimate_known
        Without a wrist sensor: whether the momentum observer has left the wrench of the sample
        before in its place.

    """

    def __init__(
        self, config: ControllerConfig,
        places: tuple[Matrix, Vector, Vector, Vector] | None = None,
    ) -> None:
        n, r = len(config.robot.joint_names), len(config.columns)
        places = places or (np.zeros((2, n)), np.zeros(6), np.zeros(r), np.zeros(n))
        (self.q, self.qd), self.wrench, self.variance, self.effort = places
        self._estimated = config.wrench_input == 'momentum'
        self._stage = stage_record(config)
        self._joints: Any = np.zeros(n, dtype=JOINT_INPUT)
        self._joints['speed_limit'] = config.limits.joint_speed or np.inf
        self._variances: Any = np.zeros(r, dtype=VARIANCE_INPUT)
        self._variances['valid'] = min(
            max(config.initial_noise_variance, VARIANCE_FLOOR), VARIANCE_CEILING)
        for name in ('last_q', 'last_qd', 'valid_q', 'valid_qd'):
            self._joints[name] = math.nan
        self._kept: Matrix = np.zeros((KEPT, 6 + n))
        self._records = self._stage, self._joints, self._variances
        self._fresh = [record.copy() for record in self._records]
        self._arguments = *self._records, self._kept, *places
        self._state: Any = self._stage['state']
        self._verdict: Any = self._stage['verdict']
        self.raw: Vector = self._state['raw'][0]
        self.filtered: Vector = self._state['filtered'][0]
        self._all_well = Seen()
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next tick is the first."""
        for record, fresh in zip(self._records, self._fresh):
            record[:] = fresh
        self.estimate_known = True

    @property
    def now(self) -> float:
        """Time of the newest tick [s]; NaN before the first."""
        return float(self._state['time'][0])

    @property
    def joint_stamp(self) -> float:
        """Stamp of the newest valid joint state [s]; NaN if there is none."""
        return float(self._state['valid'][0, JOINTS])

    @property
    def acted(self) -> bool:
        """Whether torques that say anything came with the newest joint state."""
        return bool(self._verdict['acted'][0])

    @property
    def fresh(self) -> bool:
        """Whether a wrench came with this tick, valid or not."""
        return bool(self._verdict['fresh'][0])

    @property
    def sensor_fault(self) -> str:
        """``frozen`` or ``saturated`` if the newest wrench is, otherwise empty."""
        return PROBLEMS[self._state['fault'][0]]

    @property
    def kept(self) -> tuple[Matrix, Matrix]:
        """
        Return the newest wrenches as they came in, at most 100, and the posture at each.

        Sensor axes, shape (k, 6) [N, N m], and shape (k, n) [rad], oldest first; none once the
        newest is 0.1 s old.
        """
        count = int(self._state['kept'][0])
        if not self.now - self._state['seen'][0, WRENCH] <= LONGEST_GAP:
            count = 0
        rows = np.roll(self._kept, -count, axis=0) if count > KEPT else self._kept[:count]
        return rows[:, :6].copy(), rows[:, 6:].copy()

    def validate(self, inputs: TickInputs) -> Seen:
        """Take in what is known at a tick and say what of it is valid."""
        time, joints, wrench, variance = inputs
        if self._estimated:
            wrench = WrenchInput(joints.stamp, self.wrench) if (
                joints is not None and self.estimate_known) else None
        with_effort = joints is not None and joints.effort is not None and _put(
            joints.effort, self._joints['effort']) == FINE
        stamps = tuple(math.nan if reading is None else _number(reading.stamp)
                       for reading in (joints, wrench, variance))
        contents = (
            ABSENT if joints is None else max(
                _put(joints.q, self._joints['q']), _put(joints.qd, self._joints['qd'])),
            ABSENT if wrench is None else _put(wrench.wrench, self.raw),
            ABSENT if variance is None else _put(variance.variance, self._variances['new']))
        return self._all_well if check_inputs(
            *self._arguments, _number(time), stamps, contents, with_effort) else self._report()

    def _report(self) -> Seen:
        """Return what is valid of a tick in which not all is well."""
        verdict = self._verdict[0]
        known = bool(verdict['joints']), bool(verdict['wrench'])
        if verdict['repeated']:
            return Seen((), (), *known, repeated=True)
        problems = [PROBLEMS[max(number, FINE)] for number in verdict['problem'].tolist()]
        causes = [f'clock_{CLOCK[verdict["clock"]]}'] if verdict['clock'] else []
        causes += [f"{name}_{problem or 'stale'}" for name, problem, stale in zip(
            NAMES, problems, verdict['stale']) if stale]
        rejected = [f'{name}_{problem}' for name, problem in zip(NAMES, problems) if problem]
        return Seen(
            tuple(causes), tuple(rejected), *known, blind=bool(verdict['blind']),
            measured=bool(verdict['problem'][WRENCH] == FINE))


def _put(values: Any, place: Vector) -> int:
    """Copy numbers to their place: FINE, or INVALID if they are none, or of another shape."""
    try:
        if np.shape(values) == place.shape:
            place[:] = values
            return FINE
    except (TypeError, ValueError, OverflowError):
        pass
    return INVALID


def _number(value: Any) -> float:
    """Return a number, NaN if it is not one."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def stage_record(config: ControllerConfig) -> Records:
    """Return one record of `INPUT_STAGE` as configured, before the first tick."""
    sensor, watch, h = config.sensor, config.watchdog, config.period
    record = np.zeros(1, dtype=INPUT_STAGE)
    settings, state = record['settings'], record['state']
    settings['period'] = h
    settings['shortest'], settings['longest'] = h / watch.rate_band, h * watch.rate_band
    settings['max_age'] = h * (AGE_TOLERANCE + np.array(
        [watch.joint_max_age, watch.wrench_max_age, watch.variance_max_age]))
    settings['recovery_ticks'] = round(watch.recovery_time * config.rate)
    settings['frozen_joint_ticks'] = watch.frozen_joint_ticks
    settings['full_scale'] = np.inf
    if config.wrench_input != 'momentum':
        settings['frozen_ticks'] = sensor.frozen_ticks
        if sensor.full_scale:
            settings['full_scale'] = SATURATED_SHARE * np.array(sensor.full_scale)
        order = settings['order'] = sensor.filter_order
        if order:
            from scipy.signal import butter  # 0.5 s, only where there is a filter
            settings['b'][0, :order + 1], settings['a'][0, :order + 1] = butter(
                order, sensor.filter_cutoff, fs=config.rate)
    for name in ('time', 'seen', 'valid', 'last', 'wrench', 'memory'):
        state[name] = math.nan
    state['inflation'] = 1.0
    return record
