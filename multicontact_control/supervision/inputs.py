"""
The input stage: what has come in at a tick, made valid, by one compiled call.

A reading of joints, wrench or R is checked for its stamp, its shape, its numbers and the reading
before it; a wrench is low-passed, too. A reading that fails counts as not received: the newest
valid one stands in for it, and calls for a reaction (`checks.reaction_to`) once it is too old.

A fault is called ``<part>_<problem>``; the parts are `joints`, `wrench`, `variance` and `clock`:
`invalid` (no number, or an impossible one), `jump` (a joint is not where its speed has taken it),
`velocity` (positions contradict it, and make up for it, see `velocities`), `frozen` (identical
readings in a row), `saturated` (at full scale), `outlier` (a wrench far from the one before, and
the only one: two in a row are a change), `stamp` (none, in the future, before an earlier
one, or of a wrench that comes more than a period late), `stale` (too old, and nothing newer has
come), and of the clock `backwards` and `rate` (a wrong period twice).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import Controller
from multicontact_control.records import INPUT_STAGE, Records
from multicontact_control.supervision import velocities
import numpy as np

PARTS = ('joints', 'wrench', 'variance', 'clock')
JOINTS, WRENCH, VARIANCE, CLOCK, TORQUES = range(5)
# What is wrong; FINE: nothing, ABSENT: no reading has come.
PROBLEMS = (
    '', 'invalid', 'jump', 'frozen', 'saturated', 'stamp', 'backwards', 'rate', 'velocity',
    'outlier')
FINE, INVALID, JUMP, FROZEN, SATURATED, STAMP, BACKWARDS, RATE, VELOCITY, OUTLIER = range(10)
ABSENT = -1

SATURATED_SHARE = 0.99  # of full scale, from which on a reading is saturated
FAULTS = 2  # wrong velocities, or frozen or saturated wrenches, in a row that are not bridged
WRENCH_AGE = 1.501  # periods, up to which a wrench is that of its tick
HARDEST = 1e6  # N or N m; no wrench is beyond it
# The innovation of a wrench that is an outlier: against the wrench before, in each axis. Sliding
# over roughness at 0.12 m/s changes a force by 6 N and a torque by 0.8 N m in a period.
FORCE_OUTLIER, TORQUE_OUTLIER = 6.5, 1.0  # N, N m, at least
OUTLIER_FACTOR = 6.0  # and times the root mean square of what usually changes
USUAL_TIME = 0.5  # s, over which that is averaged
LEARNT_WRENCHES, UNLEARNT = 50, 20.0  # from which on it is known; N, N m, at least until then
CHANGE_TIME = 0.02  # s after a change, in which wrenches are taken as they come
OUTLIER_TIME, MOST_OUTLIERS = 2.0, 16.0  # s, and how many in that are a fault of the sensor
FARTHEST = 1e3  # rad; no joint is beyond it
SPEED_EXCESS = 3.0  # times the speed limit of a joint; no joint is faster
STILL = 1e-4  # rad/s; below it a joint state may repeat itself
POSITION_JUMP = 0.01  # rad between a joint position and the one its speed leads to
VARIANCE_GROWTH = 1.1  # per period, of an R that is not renewed
LONGEST_SKIP = 0.1  # s; the task's time does not follow a clock that has been set
FORGOTTEN = 1.0  # s without known torques, after which a collision is forgotten
UNEVEN = 0.5  # periods that a sample may be early or late and still be the next one
AGE_TOLERANCE = 1e-3  # periods
# Why the measured torque of a joint is of no use, and what that is called.
HEARD, UNHEARD, NOT_A_NUMBER, SILENT = range(4)
EFFORT_FAULTS = ('', 'missing', 'not finite', 'constantly 0')
NEAR_ZERO = 1.0  # N m; a torque that was larger does not become 0 exactly
SILENCE = 0.1  # s of exactly 0 N m, from which on a joint seems to measure no torque
REPORTED = 5  # samples in a row without a usable torque, from which on that is said


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
    """
    The newest of each input, however old, at a tick; `time` is on the stamps' clock [s].

    `ahead` is by how much `time` is beyond the newest sample's stamp less the first [s]: what was
    counted on while no sample came.
    """

    time: float
    joints: JointInput | None = None
    wrench: WrenchInput | None = None
    variance: VarianceInput | None = None
    ahead: float = 0.0


class Seen(NamedTuple):
    """What is valid at a tick; the numbers are in the controller's records."""

    causes: tuple[str, ...] = ()  # of a reaction
    rejected: tuple[str, ...] = ()  # what is wrong with the readings of this tick
    joints: bool = True  # whether any joint state was ever valid
    blind: bool = False  # whether the joint state is neither of this tick nor of the one before
    measured: bool = True  # whether the wrench is of this tick
    skipped: int = 0  # samples that are missing before this tick
    refuted: bool = False  # whether velocities were refuted, and not proven in motion since
    unheard: bool = False  # whether the torques of some joints are of no use for a while


ALL_WELL = Seen()


@compiled
def _check_clock(time: float, state: Any, settings: Any) -> int:
    """Check and keep the time of a tick [s]."""
    elapsed, h = time - state.time, settings.period
    state.time, state.skipped = time, 0
    if elapsed < 0.0:
        state.seen[:] = state.valid[:] = np.nan
        state.odd_periods = 0
        return BACKWARDS
    if 1.5 * h < elapsed <= LONGEST_SKIP + h:
        state.skipped = round(elapsed / h) - 1
    odd = elapsed < settings.shortest or elapsed > settings.longest
    state.odd_periods = state.odd_periods + 1 if odd else 0
    return RATE if state.odd_periods >= 2 else FINE


@compiled
def _check_stamp(part: int, state: Any, settings: Any) -> int:
    """Check the stamp of a reading; return its content if that is in order and new."""
    stamp, before = state.stamp[part], state.seen[part]
    if state.content[part] != FINE:
        return int(state.content[part])
    if stamp == before:
        return ABSENT
    if not stamp <= state.time + 0.5 * settings.period or stamp < before:
        return STAMP
    state.seen[part] = stamp
    late = part == WRENCH and state.time - stamp > WRENCH_AGE * settings.period
    return STAMP if late else FINE


@compiled
def _check_joints(
    joints: Matrix, motion: Matrix, history: Matrix, span: float, state: Any, settings: Any,
) -> int:
    """Check a joint state, `span` after the one before [s]; keep it if it is fine."""
    known = state.known
    limit = POSITION_JUMP * max(1.0, span / settings.period / 5.0)
    still, same, early, jumped = True, True, False, False
    for j in range(motion.shape[1]):
        if not abs(joints[0, j]) <= FARTHEST:
            return INVALID
        if joints[5, j] > 0.0 and known:  # an angle that wraps goes on
            joints[0, j] += joints[5, j] * np.round((joints[2, j] - joints[0, j]) / joints[5, j])
        way = joints[0, j] - joints[2, j]
        speed, tracked = abs(joints[1, j]), joints[velocities.V_TRACKED, j]
        still, same = still and speed <= STILL, same and way == 0.0
        early = early or (speed > velocities.OFFSET and state.states < velocities.PROOF)
        jumped = jumped or (known and abs(way - tracked * span) > limit)
    contradicted = velocities.check_velocities(
        joints, history, span, known and not jumped, state, settings.period)
    joints[2:4] = joints[:2]
    if jumped:
        return JUMP
    stopped = same and not still and not state.unproven  # as far as velocities can tell
    state.equal_joints = state.equal_joints + 1 if stopped else 1
    if 0 < settings.frozen_joint_ticks <= state.equal_joints:
        return FROZEN
    state.contradicted = state.contradicted + 1 if contradicted else 0
    state.unproven = velocities.count_proof(joints, state.contradicted >= FAULTS)
    state.estimated = state.silent or contradicted or early or state.unproven
    motion[0], motion[1] = joints[0], joints[velocities.V_TRACKED if state.estimated else 1]
    return VELOCITY if contradicted else FINE


@compiled
def _is_outlier(state: Any, settings: Any, span: float) -> bool:
    """
    Return whether a wrench, `span` after the valid one before [s], is to be left out.

    It is far from the one before in any axis, and the first such one. What usually changes from
    one wrench to the next is learnt from those that are taken.
    """
    h = settings.period
    state.outliers *= np.exp(-h / OUTLIER_TIME)
    state.trusted = max(0.0, state.trusted - h)
    apart = span > (2.5 if state.suspect else 1.5) * h
    if not settings.leaves_out or apart or np.isnan(span) or np.isnan(state.last[0]):
        return False
    known, far = state.learnt >= LEARNT_WRENCHES, False
    for i in range(6):
        least = UNLEARNT
        if known:
            least = FORCE_OUTLIER if i < 3 else TORQUE_OUTLIER
        usual = OUTLIER_FACTOR * np.sqrt(state.mean_square[i])
        if not abs(state.raw[i]) < min(settings.full_scale[i], HARDEST):
            return False  # that is a fault of its own
        far = far or abs(state.raw[i] - state.last[i]) > max(least, usual)
    if far and state.trusted == 0.0:
        if not state.suspect:
            return True
        state.trusted = CHANGE_TIME
        state.outliers -= 1.0  # the one before was none, and counts for what follows
        state.last[:], state.equal_wrenches = state.suspected, 1
    if state.trusted == 0.0:
        state.learnt += 1
        share = max(h / USUAL_TIME, 1.0 / state.learnt)
        for i in range(6):
            change = state.raw[i] - state.last[i]
            state.mean_square[i] += share * (change * change - state.mean_square[i])
    return False


@compiled
def _take_wrench(state: Any, settings: Any) -> int:
    """Check a wrench, and low-pass it: transposed direct form II, settled on its first wrench."""
    equal, saturated = True, False
    for i in range(6):
        if not abs(state.raw[i]) <= HARDEST:
            state.filtered[:] = state.raw  # without guards the law finds it
            return INVALID
        equal = equal and state.raw[i] == state.last[i]
        saturated = saturated or abs(state.raw[i]) >= settings.full_scale[i]
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
    state.suspect = False
    frozen = 0 < settings.frozen_ticks <= state.equal_wrenches
    state.faults = state.faults + 1 if saturated or frozen else 0
    return SATURATED if saturated else FROZEN if frozen else FINE


@compiled
def _hear_torques(joints: Any, state: Any, period: float) -> int:
    """
    Find which measured torques are of use, and why the others are not; return how many are.

    A driver that measures no torque may say 0, or NaN, in one joint or in all: from the start on,
    or from a moment when there was a torque. A 0 that may be one counts for a while. The joint is
    heard again from the first other number on.
    """
    moved, heard = False, 0
    for j in range(joints.shape[0]):
        moved = moved or joints[j].effort != 0.0
    for j in range(joints.shape[0]):
        joint, fault = joints[j], HEARD
        if state.content[TORQUES] != FINE:
            fault = UNHEARD
        elif not np.isfinite(joint.effort):
            fault = NOT_A_NUMBER
        elif joint.effort != 0.0:
            joint.said, joint.zeros = joint.effort, 0
        else:
            joint.zeros += 1
            if not moved or abs(joint.said) > NEAR_ZERO or joint.zeros * period > SILENCE:
                fault = SILENT
        joint.effort_fault = fault
        if fault == HEARD:
            joint.unheard = 0
            heard += 1
        elif state.content[JOINTS] != ABSENT:  # a joint state that is missing says nothing of it
            joint.unheard += 1
    return heard


@compiled
def _supply_torques(
    joints: Any, momentum: Any, commands: Matrix, elapsed: float, measured: bool, state: Any,
    settings: Any,
) -> None:
    """Give the momentum observer the torques, measured or commanded, that acted in a period."""
    by_command = np.isfinite(commands[0, 0])
    heard = _hear_torques(joints, state, settings.period)
    for j in range(joints.shape[0]):
        joint = joints[j]
        joint.doubt, joint.unwatched = 0.0, joint.effort_fault != HEARD and not by_command
        if joint.unwatched and joint.unheard * settings.period > FORGOTTEN:
            joint.residual = joint.slack = 0.0  # it would block the arm for good
        if joint.effort_fault == HEARD:
            if settings.adds_gravity:
                joint.effort += joint.added
        elif by_command:
            before, last = commands[0, j], commands[1, j]
            after = commands[min(2, commands.shape[0] - 1), j]
            joint.doubt = max(abs(last - before), abs(after - last))  # a period early or late
            joint.effort = last
    late = state.estimated and not (state.silent and momentum.is_input)
    needed = joints.shape[0] if momentum.is_input else 1  # of a wrench each joint is a part
    known = (heard >= needed or by_command) and measured and not late and (
        abs(elapsed - settings.period) < UNEVEN * settings.period)
    momentum.elapsed = elapsed if known else 0.0
    state.unknown = 0 if known else state.unknown + 1
    if state.unknown * settings.period > FORGOTTEN:
        momentum.collided = False  # it would block the arm for good


@compiled
def check_inputs(
    stages: Any, readings: Matrix, history: Matrix, new_variance: Vector, commands: Matrix,
    motion: Matrix, joints: Any, controls: Any, contacts: Any,
) -> bool:
    """Check a tick's inputs (`readings` as in `velocities`), keep them; return if all is well."""
    settings, state = stages[0].settings, stages[0].state
    momentum, problem, stale, h = controls[0].momentum, state.problem, state.stale, settings.period
    problem[CLOCK] = _check_clock(state.stamp[CLOCK], state, settings)
    joint_stamp, before = state.valid[JOINTS], state.seen[JOINTS]
    for i in range(3):
        problem[i] = _check_stamp(i, state, settings)
    state.blind_ticks += 1
    if problem[JOINTS] == FINE:
        span = state.stamp[JOINTS] - before
        if np.isnan(span):  # after a fault of the clock
            span = h * state.blind_ticks
        problem[JOINTS] = _check_joints(readings, motion, history, span, state, settings)
        if problem[JOINTS] == FINE or problem[JOINTS] == VELOCITY:
            state.valid[JOINTS], state.known = state.stamp[JOINTS], True
            state.blind_ticks = 0
        elif problem[JOINTS] != JUMP:  # it says nothing of where the joints are now
            state.seen[JOINTS] = before
    if problem[WRENCH] == FINE and _is_outlier(
            state, settings, state.stamp[WRENCH] - state.valid[WRENCH]):
        problem[WRENCH] = OUTLIER
        state.suspect = True
        state.outliers += 1.0
        state.suspected[:] = state.raw
        state.raw[:] = state.last
    elif problem[WRENCH] == FINE:
        problem[WRENCH] = _take_wrench(state, settings)
        if problem[WRENCH] == FINE:
            controls[0].wrench[:] = state.filtered
            state.valid[WRENCH] = state.stamp[WRENCH]
    if problem[VARIANCE] == FINE:
        for i in range(new_variance.shape[0]):
            if not 0.0 < new_variance[i] < np.inf:
                problem[VARIANCE] = INVALID
        if problem[VARIANCE] == FINE:
            state.valid[VARIANCE] = state.stamp[VARIANCE]
    for i in range(3):
        age = state.time - state.valid[i]
        stale[i] = age > settings.max_age[i] or (np.isnan(age) and i != VARIANCE)
    contradicted = problem[JOINTS] == VELOCITY and state.contradicted >= FAULTS
    stale[JOINTS] = stale[JOINTS] or contradicted or (
        problem[JOINTS] == JUMP or problem[JOINTS] == FROZEN)
    stale[WRENCH] = stale[WRENCH] or state.faults >= FAULTS or (
        problem[WRENCH] == OUTLIER and state.outliers > MOST_OUTLIERS)
    stale[CLOCK] = problem[CLOCK] != FINE
    for i in range(new_variance.shape[0]):
        variance = contacts[i].noise_variance * (VARIANCE_GROWTH if stale[VARIANCE] else 1.0)
        if problem[VARIANCE] == FINE:
            variance = new_variance[i]
        contacts[i].noise_variance = min(
            max(variance, settings.smallest_variance), settings.largest_variance)
    _supply_torques(joints, momentum, commands, state.valid[JOINTS] - joint_stamp,
                    problem[WRENCH] == FINE or momentum.is_input, state, settings)
    state.blind = state.blind_ticks > 1
    well = not state.blind and problem[WRENCH] == FINE and state.skipped == 0
    well = well and not state.unproven
    for j in range(joints.shape[0]):
        well = well and joints[j].unheard < REPORTED
    for i in range(4):
        well = well and not stale[i] and problem[i] <= FINE
    return bool(well)


class Inputs:
    """
    The input stage of a controller, into whose records goes what is valid.

    If not `guarded`, outliers of the wrench stay in.

    Attributes
    ----------
    raw, filtered
        The newest wrench that was no outlier before and behind the low-pass, shape (6,) [N, N m].

    """

    def __init__(
        self, config: ControllerConfig, controller: Controller, *, guarded: bool = True,
    ) -> None:
        motion, joints = controller.arm.motion, controller.arm.joints
        controls, contacts = controller.controls, controller.contacts
        n = len(joints)
        readings = np.zeros((velocities.ROWS, n))
        readings[2:4] = math.nan
        readings[4] = np.minimum(
            SPEED_EXCESS * np.array(config.limits.joint_speed or np.inf), np.finfo(float).max)
        readings[5] = np.where(controller.robot.turning, 2.0 * math.pi, 0.0)
        self._stage: Any = _stage_record(config)
        self._stage['settings']['leaves_out'] = guarded and config.wrench_input != 'momentum'
        self._initial = self._stage.copy(), readings.copy(), config.initial_noise_variance
        self._readings, self._new_variance = readings, np.zeros(len(contacts))
        self._history: Matrix = np.zeros((velocities.HISTORY, 2 * n))
        self._estimated = config.wrench_input == 'momentum'
        self._by_command = config.collision.command_delay >= 0
        self._commands: Matrix = np.zeros((max(config.collision.command_delay, 0) + 2, n))
        self._arguments = (self._stage, self._readings, self._history, self._new_variance,
                           self._commands, motion, joints, controls, contacts)
        self._joints, self._momentum = joints, controls['momentum']
        self._wrench, self._variance = controls['wrench'][0], contacts['noise_variance']
        self._state, self._none = self._stage['state'][0], np.zeros(n)
        self._stamps, self._contents = self._state['stamp'], self._state['content']
        self.raw: Vector = self._state['raw']
        self.filtered: Vector = self._state['filtered']
        self._places = (tuple(self._readings[:2]), (self.raw,), (self._new_variance,), (),
                        (joints['effort'],))
        self.reset()
        self.validate(TickInputs(0.0))  # no tick is to wait for numba
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next tick is the first."""
        self._stage[:], self._readings[:], self._variance[:] = self._initial
        self._commands[:] = math.nan
        for name in ('residual', 'slack', 'doubt', 'zeros', 'unheard'):
            self._joints[name] = 0
        self._joints['said'] = math.inf
        self._momentum['elapsed'], self._momentum['collided'] = 0.0, False

    @property
    def effort(self) -> Vector:
        """Return the torques of the newest joint state, NaN where they say nothing [N m]."""
        joints = self._joints
        heard = (joints['effort_fault'] == HEARD) & (joints['effort'] != 0.0)
        effort: Vector = np.where(heard, joints['effort'], math.nan)
        return effort

    @property
    def unheard_joints(self) -> dict[str, tuple[int, ...]]:
        """Return the joints whose torques are of no use, by what is wrong with them."""
        unheard = self._joints['unheard'] >= REPORTED
        faults = np.where(unheard, self._joints['effort_fault'], HEARD)
        return {EFFORT_FAULTS[fault]: tuple(np.flatnonzero(faults == fault).tolist())
                for fault in (UNHEARD, NOT_A_NUMBER, SILENT) if (faults == fault).any()}

    @property
    def fresh(self) -> bool:
        """Whether a wrench came with this tick, valid or not."""
        return self._state['problem'][WRENCH] not in (ABSENT, STAMP, OUTLIER)

    @property
    def sensor_fault(self) -> str:
        """Return what is wrong with the wrench of this tick, empty for nothing."""
        return PROBLEMS[max(self._state['problem'][WRENCH], FINE)]

    @property
    def refuted_joints(self) -> Mask:
        """Return whose velocities are refuted, and not proven in motion since, shape (n,)."""
        refuted: Mask = self._readings[velocities.UNPROVEN] > 0.0
        return refuted

    @property
    def refuted(self) -> bool:
        """Whether any are."""
        return bool(self._state['unproven'])

    def refute(self) -> None:
        """Take the velocity that is most in doubt for refuted: what it led to says so."""
        doubt = self._readings[velocities.DOUBT]
        worst = int(np.argmax(doubt))
        if np.isfinite(doubt[worst]):
            self._readings[velocities.UNPROVEN, worst] = velocities.PROOF
            self._state['unproven'] = True

    @property
    def rate(self) -> Vector:
        """Return the velocities that positions make up for [rad/s]."""
        rate: Vector = self._readings[velocities.V_TRACKED]
        return rate

    @property
    def history(self) -> tuple[Matrix, Vector]:
        """Return the newest joint states, shape (k, 2 n) [rad, rad/s], and the row `DOUBT`."""
        count = int(self._state['states'])
        states = np.roll(self._history, -count, axis=0)[-min(count, velocities.HISTORY):]
        return states, self._readings[velocities.DOUBT]

    def validate(self, inputs: TickInputs, command: Vector | None = None) -> Seen:
        """Take in what came at a tick, and the command before it [N m]; say what is valid."""
        time, joints, wrench, variance, _ = inputs
        state = self._state
        if self._estimated:  # by the momentum observer, which takes some samples to begin
            known = state['unknown'] <= len(self._commands) + 1
            wrench = WrenchInput(joints.stamp, self._wrench) if joints and known else None
        effort = None if joints is None or joints.effort is None else (0.0, joints.effort)
        if joints is not None and joints.qd is None:
            joints = joints._replace(qd=self._none)
            state['silent'] = True
        if self._by_command and command is not None:
            self._commands[:-1], self._commands[-1] = self._commands[1:], command
        self._stamps[:], self._contents[:] = math.nan, ABSENT
        for part, reading in enumerate((joints, wrench, variance, (time,), effort)):
            if reading is None:
                continue
            try:
                self._stamps[part] = reading[0]
                for values, place in zip(reading[1:], self._places[part]):
                    numbers = np.asarray(values)
                    if numbers.shape != place.shape:
                        raise ValueError('shape')
                    place[:] = numbers
                self._contents[part] = FINE
            except (TypeError, ValueError, OverflowError):
                self._contents[part] = INVALID
        if check_inputs(*self._arguments):
            return ALL_WELL
        problems = [(part, PROBLEMS[max(problem, FINE)], stale) for part, problem, stale in zip(
            PARTS, state['problem'], state['stale'])]
        return Seen(
            tuple(f"{part}_{problem or 'stale'}" for part, problem, stale in problems if stale),
            tuple(f'{part}_{problem}' for part, problem, _ in problems[:CLOCK] if problem),
            bool(state['known']), bool(state['blind']),
            bool(state['problem'][WRENCH] == FINE), int(state['skipped']),
            bool(state['unproven']), bool((self._joints['unheard'] >= REPORTED).any()))


def _stage_record(config: ControllerConfig) -> Records:
    """Return one record of `INPUT_STAGE` as configured, before the first tick."""
    sensor, watch, h = config.sensor, config.watchdog, config.period
    record = np.zeros(1, dtype=INPUT_STAGE)
    settings, state = record['settings'], record['state']
    settings['period'] = h
    settings['shortest'], settings['longest'] = h / watch.rate_band, h * watch.rate_band
    settings['max_age'] = h * (AGE_TOLERANCE + np.array(
        [watch.joint_max_age, watch.wrench_max_age, watch.variance_max_age]))
    settings['smallest_variance'] = config.noise_variance.smallest
    settings['largest_variance'] = config.noise_variance.largest
    settings['frozen_joint_ticks'] = watch.frozen_joint_ticks
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
