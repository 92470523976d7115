"""
The input stage: what has come in at a tick, made valid, by one compiled call.

A reading of joints, wrench or R is checked for its stamp, its shape, its numbers and the reading
before it; a wrench is low-passed, too. A reading that fails counts as not received: the newest
valid one stands in for it, and calls for a reaction (`checks.reactions_of`) once it is too old.

A fault is called ``<part>_<problem>``; the parts are `joints`, `wrench`, `variance` and `clock`:
`invalid` (no number, or one that no arm, sensor or estimator gives), `jump` (a joint is not where
its speeds have taken it), `velocity` (positions contradict it, and make up for it, see
`velocities`), `frozen` (identical readings in a row), `saturated` (at full scale), `stamp` (none,
or in the future), `order` (before an earlier one), `late` (a wrench more than a period old when it
comes), `stale` (too old, and nothing newer has come), and of the clock `backwards` and `rate` (a
wrong period twice).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.records import INPUT_STAGE, Records
from multicontact_control.supervision import velocities
import numpy as np

PARTS = ('joints', 'wrench', 'variance', 'clock')
JOINTS, WRENCH, VARIANCE, CLOCK, TORQUES = range(5)
# What is wrong; FINE: nothing, ABSENT: no reading has come.
PROBLEMS = (
    '', 'invalid', 'jump', 'frozen', 'saturated', 'stamp', 'order', 'late', 'backwards', 'rate',
    'velocity')
FINE, INVALID, JUMP, FROZEN, SATURATED, STAMP, ORDER, LATE, BACKWARDS, RATE, VELOCITY = range(11)
ABSENT = -1

LONGEST_GAP = 0.1  # s between two wrenches, after which the low-pass begins anew
SATURATED_SHARE = 0.99  # of full scale, from which on a reading is saturated
FAULTS = 2  # wrong velocities, or frozen or saturated wrenches, in a row that are not bridged
WRENCH_AGE = 1.501  # periods, up to which a wrench is that of its tick
HARDEST = 1e6  # N or N m; no wrench is beyond it
FARTHEST = 1e3  # rad; no joint is beyond it
SPEED_EXCESS = 3.0  # times the speed limit of a joint; no joint is faster
STILL = 1e-4  # rad/s; below it a joint state may repeat itself
POSITION_JUMP = 0.01  # rad between a joint position and the one its speeds lead to
LONGEST_STEP = 0.1  # s, over which speeds are extrapolated
VARIANCE_FLOOR, VARIANCE_CEILING = 0.1, 1e3  # N^2; with less the observer outruns the drives
VARIANCE_GROWTH = 1.1  # per period, of an R that is not renewed
LATEST = 1e12  # s; no time is beyond it
LONGEST_SKIP = 0.1  # s; the task's time does not follow a clock that has been set
FORGOTTEN = 1.0  # s without known torques, after which a collision is forgotten
UNEVEN = 0.5  # periods that a sample may be early or late and still be the next one
AGE_TOLERANCE = 1e-3  # periods


class JointInput(NamedTuple):
    """
    A joint state as it came in, in the order of `robot.joint_names`.

    Sampled at `stamp`: [s] at a tick, whole [ns] before. q [rad], qd [rad/s], and the torques
    measured over the period before [N m]. qd and torques are None where there are none.
    """

    stamp: float
    q: Any
    qd: Any
    effort: Any = None


class WrenchInput(NamedTuple):
    """A wrench as the sensor gave it [N, N m], sampled at `stamp`: [s] at a tick, [ns] before."""

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
    """What is valid at a tick; the numbers are in `Inputs`."""

    causes: tuple[str, ...] = ()  # of a reaction
    rejected: tuple[str, ...] = ()  # what is wrong with the readings of this tick
    joints: bool = True  # whether any joint state was ever valid
    wrench: bool = True  # whether any wrench was
    blind: bool = False  # whether the joint state is neither of this tick nor of the one before
    measured: bool = True  # whether the wrench is of this tick
    skipped: int = 0  # samples that are missing before this tick


@compiled
def _check_clock(time: float, state: Any, settings: Any) -> int:
    """Check and keep the time of a tick [s]; one that is not finite is a period after the last."""
    before, state.skipped = state.time, 0
    if not abs(time) <= LATEST:
        state.time = 0.0 if np.isnan(before) else before + settings.period
        return INVALID
    state.time = time
    if time < before:
        state.seen[:] = state.valid[:] = np.nan
        state.odd_periods = 0
        return BACKWARDS
    skipped = time - before - settings.period
    if 0.5 * settings.period < skipped <= LONGEST_SKIP:
        state.skipped = round(skipped / settings.period)
    odd = time - before < settings.shortest or time - before > settings.longest
    state.odd_periods = state.odd_periods + 1 if odd else 0
    return RATE if state.odd_periods >= 2 else FINE


@compiled
def _check_stamp(part: int, stamp: float, content: int, state: Any, settings: Any) -> int:
    """Check the stamp of a reading [s]; return its content if that is in order and new."""
    before = state.seen[part]
    if content == ABSENT:
        return ABSENT
    if not -np.inf < stamp <= state.time + 0.5 * settings.period:
        return STAMP
    if stamp <= before:
        return ORDER if stamp < before else ABSENT
    state.seen[part] = stamp
    if part == WRENCH:
        if not stamp - before <= LONGEST_GAP:
            state.memory[0, 0] = np.nan
        if content == FINE and state.time - stamp > WRENCH_AGE * settings.period:
            return LATE
    return content


@compiled
def _check_joints(
    joints: Matrix, motion: Matrix, history: Matrix, elapsed: float, state: Any, settings: Any,
) -> int:
    """Check a joint state, `elapsed` after the newest valid one [s]; keep it if it is fine."""
    # After a jump states are compared with the reading before, and refused for the recovery time.
    distrusted = state.distrust > 0
    span = settings.period if distrusted else elapsed
    limit = POSITION_JUMP * max(1.0, span / settings.period / 5.0)
    still, moves, jumped, same = True, False, False, True
    for j in range(motion.shape[1]):
        if not abs(joints[0, j]) <= FARTHEST:
            return INVALID
        if joints[5, j] > 0.0 and state.known[JOINTS]:  # an angle that wraps goes on
            joints[0, j] += joints[5, j] * np.round((joints[2, j] - joints[0, j]) / joints[5, j])
        q, qd = joints[0, j], joints[1, j]
        still, same = still and abs(qd) <= STILL, same and q == joints[2, j]
        moves = moves or abs(qd) > velocities.OFFSET
        before, speed = motion[0, j], motion[1, j]
        if distrusted:
            before, speed = joints[2, j], joints[3, j]
        way, step = q - before, min(span, LONGEST_STEP)
        change = abs(way - joints[velocities.V_TRACKED, j] * step)
        if abs(qd) <= joints[4, j]:
            change = min(change, abs(way - 0.5 * (qd + speed) * step))
        jumped = jumped or change > limit
    known, jumped = state.known[JOINTS], jumped and state.known[JOINTS]
    contradicted = velocities.check_velocities(
        joints, history, span, known and not jumped, state, settings.period)
    joints[2:4] = joints[:2]
    if distrusted or jumped:
        state.distrust = settings.recovery_ticks if jumped else state.distrust - 1
        return JUMP
    believed = state.states > velocities.PROOF and not state.doubted
    state.equal_joints = state.equal_joints + 1 if same and believed and not still else 1
    if 0 < settings.frozen_joint_ticks <= state.equal_joints:
        return FROZEN
    state.contradicted = state.contradicted + 1 if contradicted else 0
    if contradicted:
        state.agreeing = 0
    unproven = state.doubted and state.agreeing <= velocities.PROOF
    state.doubted = state.contradicted >= FAULTS or unproven
    state.begins = moves and state.states <= velocities.PROOF
    estimated = state.silent or state.doubted or contradicted or state.begins
    source = velocities.V_TRACKED if estimated else 1
    motion[0], motion[1] = joints[0], joints[source]
    return VELOCITY if contradicted else FINE


@compiled
def _take_wrench(state: Any, settings: Any) -> int:
    """Check a wrench, and low-pass it: transposed direct form II, settled on its first wrench."""
    equal, saturated, possible = True, False, True
    for i in range(6):
        equal = equal and state.raw[i] == state.last[i]
        saturated = saturated or abs(state.raw[i]) >= settings.full_scale[i]
        possible = possible and abs(state.raw[i]) <= HARDEST
    state.fault = SATURATED if saturated else FINE
    if not possible:
        state.faults += int(saturated)
        state.filtered[:] = state.raw  # without guards the law finds it
        return SATURATED if saturated else INVALID
    a, b, memory = settings.a, settings.b, state.memory
    begins = np.isnan(memory[0, 0])
    for i in range(6):
        raw = filtered = state.raw[i]
        state.last[i] = raw
        if settings.order > 0:
            if begins:
                memory[0, i] = raw * ((b[1] + b[2]) - (a[1] + a[2]))
                memory[1, i] = raw * (b[2] - a[2])
            filtered = b[0] * raw + memory[0, i]
            memory[0, i] = b[1] * raw - a[1] * filtered + memory[1, i]
            memory[1, i] = b[2] * raw - a[2] * filtered
        state.filtered[i] = filtered
    state.equal_wrenches = state.equal_wrenches + 1 if equal else 1
    if 0 < settings.frozen_ticks <= state.equal_wrenches and not saturated:
        state.fault = FROZEN
    state.faults = state.faults + 1 if state.fault != FINE else 0
    return int(state.fault)


@compiled
def _supply_torques(
    joints: Any, momentum: Any, commands: Matrix, acts: bool, elapsed: float, measured: bool,
    state: Any, settings: Any,
) -> None:
    """Give the momentum observer the torques, measured or commanded, that acted in a period."""
    by_command, needed = settings.by_command, commands.shape[0]
    known = acts or (by_command and state.commands >= needed)
    for j in range(joints.shape[0]):
        joint = joints[j]
        if by_command:
            joint.doubt = 0.0
        if acts:
            if settings.adds_gravity:
                joint.effort += joint.added
        elif known:
            before = commands[state.commands % needed, j]
            last = commands[(state.commands + 1) % needed, j]
            after = commands[(state.commands + min(2, needed - 1)) % needed, j]
            joint.doubt = max(abs(last - before), abs(after - last))  # a period early or late
            joint.effort = last
    late = state.doubted or state.begins or (state.silent and not momentum.is_input)
    known = known and measured and not late and (
        abs(elapsed - settings.period) < UNEVEN * settings.period)
    momentum.elapsed = elapsed if known else 0.0
    state.unknown = 0 if known else state.unknown + 1
    if state.unknown * settings.period > FORGOTTEN and momentum.collided:
        momentum.collided = False  # it would block the arm for good
        for j in range(joints.shape[0]):
            joints[j].residual = joints[j].slack = 0.0


@compiled
def check_inputs(
    stages: Any, readings: Matrix, history: Matrix, new_variance: Vector,
    commands: Matrix, motion: Matrix, wrench: Vector, noise_variance: Vector, joints: Any,
    momenta: Any, last: Vector, commanded: bool, stamps: Any, contents: Any,
) -> bool:
    """
    Check the inputs of a tick, and keep what is valid in its places; return whether all is well.

    Arguments are what `Inputs` has; `readings` are rows as in `velocities`. Stamps [s] and
    contents (FINE, INVALID if it cannot be read, ABSENT) are of joints, wrench, R, the tick and
    torques.
    """
    stage = stages[0]
    settings, state, verdict = stage.settings, stage.state, stage.verdict
    valid, problem, h = state.valid, verdict.problem, settings.period
    joint_stamp = valid[JOINTS]
    if commanded:
        commands[state.commands % commands.shape[0]] = last
        state.commands += 1
    problem[CLOCK] = _check_clock(stamps[CLOCK], state, settings)
    for i in range(3):
        problem[i] = _check_stamp(i, stamps[i], contents[i], state, settings)
    state.blind_ticks += 1
    if problem[JOINTS] == FINE:
        # The stamps before a fault of the clock are of no use: ticks are counted then.
        elapsed = stamps[JOINTS] - valid[JOINTS]
        if np.isnan(elapsed):
            elapsed = h * state.blind_ticks
        problem[JOINTS] = _check_joints(readings, motion, history, elapsed, state, settings)
        if problem[JOINTS] == FINE or problem[JOINTS] == VELOCITY:
            valid[JOINTS], state.blind_ticks, state.known[JOINTS] = stamps[JOINTS], 0, True
        elif problem[JOINTS] == FROZEN:  # as old as its value
            valid[JOINTS] = stamps[JOINTS] - h * (state.equal_joints - 1)
    verdict.fresh = problem[WRENCH] == FINE or problem[WRENCH] == LATE
    if verdict.fresh:
        fault = _take_wrench(state, settings)
        if fault != FINE:
            problem[WRENCH] = fault
        if problem[WRENCH] == FINE:
            wrench[:] = state.filtered
            valid[WRENCH], state.known[WRENCH] = stamps[WRENCH], True
        elif problem[WRENCH] == FROZEN:
            valid[WRENCH] = stamps[WRENCH] - h * (state.equal_wrenches - 1)
    if problem[VARIANCE] == FINE:
        for i in range(new_variance.shape[0]):
            if not 0.0 < new_variance[i] < np.inf:
                problem[VARIANCE] = INVALID
    if problem[VARIANCE] == FINE:
        valid[VARIANCE] = stamps[VARIANCE]
        noise_variance[:] = np.minimum(np.maximum(new_variance, VARIANCE_FLOOR), VARIANCE_CEILING)
    for i in range(3):
        age = state.time - valid[i]
        verdict.stale[i] = age > settings.max_age[i] or (np.isnan(age) and i != VARIANCE)
    contradicted = problem[JOINTS] == VELOCITY and state.contradicted >= FAULTS
    verdict.stale[JOINTS] = verdict.stale[JOINTS] or contradicted
    verdict.stale[WRENCH] = verdict.stale[WRENCH] or state.faults >= FAULTS
    verdict.stale[CLOCK] = problem[CLOCK] != FINE
    if verdict.stale[VARIANCE]:
        noise_variance[:] = np.minimum(noise_variance * VARIANCE_GROWTH, VARIANCE_CEILING)
    moved, total = False, 0.0  # a driver that measures no torque may say 0, or NaN
    for j in range(joints.shape[0]):
        moved = moved or joints[j].effort != 0.0
        total += joints[j].effort
    verdict.acts = contents[TORQUES] == FINE and moved and np.isfinite(total)
    _supply_torques(joints, momenta[0], commands, verdict.acts, valid[JOINTS] - joint_stamp,
                    problem[WRENCH] == FINE or momenta[0].is_input, state, settings)
    verdict.blind = state.blind_ticks > 1
    well = not verdict.blind and problem[WRENCH] == FINE and state.skipped == 0
    for i in range(4):
        well = well and not verdict.stale[i] and problem[i] <= FINE
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
        and R, shape (r,) [N^2].
    joints, momenta
        Records of `JOINT`, shape (n,), and one of `MOMENTUM`, for the torques that acted.
    turning
        Which joints turn, so that their angles may wrap, shape (n,).

    Attributes
    ----------
    raw, filtered
        The newest wrench before and behind the low-pass, shape (6,) [N, N m].

    """

    def __init__(
        self, config: ControllerConfig, places: tuple[Matrix, Vector, Vector], joints: Any,
        momenta: Any, turning: Any = False,
    ) -> None:
        _, self._wrench, self._variance = places
        n, r = len(joints), len(self._variance)
        self._estimated = config.wrench_input == 'momentum'
        readings = np.zeros((velocities.ROWS, n))
        readings[2:4] = math.nan
        readings[4] = np.minimum(
            SPEED_EXCESS * np.array(config.limits.joint_speed or np.inf), np.finfo(float).max)
        readings[5] = np.where(turning, 2.0 * math.pi, 0.0)
        variance = np.clip(config.initial_noise_variance, VARIANCE_FLOOR, VARIANCE_CEILING)
        self._initial: Any = _stage_record(config), readings, variance
        self._stage: Any = np.zeros(1, dtype=INPUT_STAGE)
        self._readings, self._new_variance = readings.copy(), np.zeros(r)
        self._history: Matrix = np.zeros((velocities.HISTORY, 2 * n))
        self._effort: Vector = joints['effort']
        self._commands: Matrix = np.zeros((max(config.collision.command_delay, 0) + 2, n))
        self._arguments = (self._stage, self._readings, self._history, self._new_variance,
                           self._commands, *places, joints, momenta)
        self._momenta, self._joints = momenta, joints
        self._state, self._verdict = self._stage['state'], self._stage['verdict']
        self.raw: Vector = self._state['raw'][0]
        self.filtered: Vector = self._state['filtered'][0]
        self._places = (
            tuple(self._readings[:2]), (self.raw,), (self._new_variance,), (), (self._effort,))
        self._no_command, self._all_well = np.zeros(n), Seen()
        self.reset()
        self.validate(TickInputs(0.0))  # no tick is to wait for numba
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next tick is the first."""
        self._stage[:], self._readings[:], self._variance[:] = self._initial
        self._joints['residual'] = self._joints['slack'] = self._joints['doubt'] = 0.0
        self._momenta['elapsed'], self._momenta['collided'] = 0.0, False

    @property
    def effort(self) -> Vector | None:
        """Return the torques of the newest joint state, if they say anything [N m]."""
        return self._effort if self._verdict['acts'][0] else None

    @property
    def fresh(self) -> bool:
        """Whether a wrench came with this tick, valid or not."""
        return bool(self._verdict['fresh'][0])

    @property
    def sensor_fault(self) -> str:
        """``frozen`` or ``saturated`` if the newest wrench is, otherwise empty."""
        return PROBLEMS[self._state['fault'][0]]

    @property
    def estimates(self) -> bool:
        """Whether joints move but no velocities come, which positions make up for."""
        return bool(self._state['silent'][0])

    @property
    def history(self) -> tuple[Matrix, Vector]:
        """Return the newest joint states, shape (k, 2 n) [rad, rad/s], and the row `DOUBT`."""
        count = int(self._state['states'][0])
        states = np.roll(self._history, -count, axis=0)[-min(count, velocities.HISTORY):]
        return states, self._readings[velocities.DOUBT]

    def validate(self, inputs: TickInputs, command: Vector | None = None) -> Seen:
        """Take in what came at a tick, and the command before it [N m]; say what is valid."""
        time, joints, wrench, variance = inputs
        if self._estimated:  # by the momentum observer, which takes some samples to begin
            known = self._state['unknown'][0] <= len(self._commands) + 1
            wrench = WrenchInput(joints.stamp, self._wrench) if joints and known else None
        effort = None if joints is None or joints.effort is None else (0.0, joints.effort)
        if joints is not None and joints.qd is None:
            joints = joints._replace(qd=self._no_command)
            self._state['silent'] = True
        stamps, contents = [math.nan] * 5, [ABSENT] * 5
        for part, reading in enumerate((joints, wrench, variance, (time,), effort)):
            if reading is None:
                continue
            try:
                stamps[part] = float(reading[0])
                for values, place in zip(reading[1:], self._places[part]):
                    numbers = np.asarray(values)
                    if numbers.shape != place.shape:
                        raise ValueError('shape')
                    place[:] = numbers
                contents[part] = FINE
            except (TypeError, ValueError, OverflowError):
                contents[part] = INVALID
        if check_inputs(
                *self._arguments, self._no_command if command is None else command,
                command is not None, tuple(stamps), tuple(contents)):
            return self._all_well
        verdict, state = self._verdict[0], self._state[0]
        problems = list(zip(PARTS, map(PROBLEMS.__getitem__, verdict['problem'].clip(FINE)),
                            verdict['stale']))
        causes = [f"{part}_{problem or 'stale'}" for part, problem, stale in problems if stale]
        rejected = [f'{part}_{problem}' for part, problem, _ in problems[:CLOCK] if problem]
        known = state['known'].astype(bool).tolist()
        return Seen(tuple(causes), tuple(rejected), known[JOINTS], known[WRENCH],
                    bool(verdict['blind']), bool(verdict['problem'][WRENCH] == FINE),
                    int(state['skipped']))


def _stage_record(config: ControllerConfig) -> Records:
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
    settings['by_command'] = config.collision.command_delay >= 0
    settings['adds_gravity'] = config.robot.adds_gravity
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
    for name in ('time', 'seen', 'valid', 'last', 'memory'):
        state[name] = math.nan
    return record
