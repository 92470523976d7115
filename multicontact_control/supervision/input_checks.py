"""
What is wrong with the readings of a tick, found by compiled code, and what of them is handed over.

`check_inputs` works on one record of `INPUT_STAGE`: what came in, what is set, what is remembered
of the ticks before, and what is found. `supervision.inputs` says what the faults mean.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Protocol

from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.records import (
    Contact,
    Control,
    Input,
    Joint,
    MAX_JOINTS,
    Momentum,
    Record,
    record_dtype,
    Records,
)
from multicontact_control.supervision.velocities import (
    check_velocities,
    count_velocity_proof,
    JointTrack,
    OFFSET_TOLERANCE,
    PROOF_STATES,
    VelocityState,
)
import numpy as np

READINGS = ('joints', 'wrench', 'variance')
# What is wrong with a reading. FINE: nothing; ABSENT: no new reading has come.
FINE, INVALID, JUMP, FROZEN, SATURATED, STAMP, BACKWARDS, RATE, VELOCITY, OUTLIER = (
    range(10)
)
ABSENT = -1

SATURATED_SHARE = 0.99  # of full scale, from which on a reading is saturated
# Wrong velocities, or frozen or saturated wrenches, in a row that are no longer bridged.
FAULTS = 2
WRENCH_AGE = 1.501  # periods, up to which a wrench is that of its tick
HARDEST = 1e6  # N or N m; no wrench is beyond it
# Difference of an outlier to the wrench before, in any axis, at least. Sliding over roughness at
# 0.12 m/s changes a force by 6 N and a torque by 0.8 N m in a period.
FORCE_OUTLIER = 6.5  # N
TORQUE_OUTLIER = 1.0  # N m
OUTLIER_FACTOR = 6.0  # and times the root mean square of what usually changes
USUAL_TIME = 0.5  # s, over which that is averaged
LEARNT_WRENCHES = 50  # from which on it is known
UNLEARNT = 20.0  # N or N m, least difference of an outlier until then
CHANGE_TIME = 0.02  # s after a change, in which wrenches are taken as they come
OUTLIER_TIME = 2.0  # s, within which an outlier is forgotten
MOST_OUTLIERS = 16.0  # in that time; more are a fault of the sensor
FARTHEST = 1e3  # rad; no joint is beyond it
IMPOSSIBLE_SPEED_FACTOR = 3.0  # times the speed limit of a joint; no joint is faster
STILL = 1e-4  # rad/s; below it a joint state may repeat itself
POSITION_JUMP = 0.01  # rad between a joint position and the one its speed leads to
# between two joint states, from which on that grows with their number.
JUMP_PERIODS = 5.0
VARIANCE_GROWTH = 1.1  # per period, of an R that is not renewed
LONGEST_SKIP = 0.1  # s; the task's time does not follow a clock that has been set
FORGOTTEN = 1.0  # s without known torques, after which a collision is forgotten
UNEVEN = 0.5  # periods that a sample may be early or late and still be the next one
AGE_TOLERANCE = 1e-3  # periods
# Why the measured torque of a joint is of no use.
EFFORT_USABLE, EFFORT_MISSING, EFFORT_NOT_FINITE, EFFORT_ALWAYS_ZERO = range(4)
NEAR_ZERO = 1.0  # N m; a torque that was larger does not become 0 exactly
SILENCE = 0.1  # s of exactly 0 N m, from which on a joint seems to measure no torque
REPORTED = 5  # samples in a row without a usable torque, from which on that is said
RECENT_WRENCHES = 100  # that are kept, for a tare
MOST_COMMANDS = 12  # that are kept: two more than the longest `collision.command_delay`


class InputSettings(Record, Protocol):
    """
    What the input stage is set to; one.

    Ages and periods in which readings are in order, numbers that are possible, bounds of R, and
    the low-pass of the wrench, all in the units that the checks compare.
    """

    guarded: bool  # whether only what is valid is handed over, or all as it came
    period: float  # [s]

    # Periods that are in order [s].
    shortest: float
    longest: float

    # [s].
    joints_max_age: float
    wrench_max_age: float
    variance_max_age: float

    # Speed beyond which a velocity is no possible number [rad/s].
    fastest: Annotated[Vector, MAX_JOINTS]

    # After which an angle may begin again, 0 if it does not [rad].
    turn: Annotated[Vector, MAX_JOINTS]

    # Equal readings that are frozen, 0 for never.
    frozen_joint_ticks: int
    frozen_ticks: int

    # Bounds of R [N^2].
    smallest_variance: float
    largest_variance: float

    initial_variance: float  # R before one comes, without guards [N^2]
    adds_gravity: bool  # see `robot`

    # That are kept: 2 more than periods from a sample to the torque it leads to.
    commands: int

    full_scale: Annotated[Vector, 6]  # from where on an axis is saturated [N, N m]
    leaves_out: bool  # whether a single wrench far from the others is left out
    order: int  # of the low-pass, 0 for none

    # Its coefficients, highest power of z first.
    b: Annotated[Vector, 3]
    a: Annotated[Vector, 3]


class ReadingStamps(Record, Protocol):
    """What is known of the stamps of one reading, NaN for none."""

    seen: float  # the newest [s]
    valid: float  # of the newest valid reading [s]


class WrenchState(Record, Protocol):
    """
    What the wrenches before have been like; one.

    A wrench is compared with these: equal ones are frozen, one that is far from the last, by what
    usually changes from one to the next, is an outlier. The memory of the low-pass is here, too.
    """

    newest: Annotated[Vector, 6]  # that was no outlier [N, N m]
    last: Annotated[Vector, 6]  # that was taken, NaN before the first [N, N m]
    equal_samples: int  # to that in a row, itself counted
    faulty_samples: int  # frozen or saturated wrenches in a row
    left_out_before: bool  # whether the wrench before was left out as an outlier
    left_out_wrench: Annotated[Vector, 6]  # the newest that was [N, N m]

    # For how long still wrenches are taken as they come, after a change [s].
    trust_time: float

    outlier_count: float  # count of those that were left out, which fades
    learnt_wrenches: int  # wrenches that `mean_square` knows

    # Of what changes from one to the next [N^2, N^2 m^2].
    mean_square: Annotated[Vector, 6]

    filtered: Annotated[Vector, 6]  # behind the low-pass [N, N m]

    # Its memory: what of this wrench is still to come out one and two periods later;
    # NaN before the first [N, N m].
    next_output: Annotated[Vector, 6]
    output_after: Annotated[Vector, 6]


class TorqueState(Record, Protocol):
    """
    The measured and commanded torques of one joint.

    Where none is measured, the command of `collision.command_delay` periods ago has acted.
    """

    last: float  # measured one that was not 0, inf before the first [N m]

    # Samples in a row of exactly 0 N m, and without a usable one.
    zero_samples: int
    unusable_samples: int

    # Ring of what was commanded, NaN before [N m].
    commanded: Annotated[Vector, MOST_COMMANDS]


class RecentWrench(Record, Protocol):
    """A wrench that came with a tick, and how fast the joints were."""

    time: float  # of that tick, -inf before [s]
    wrench: Annotated[Vector, 6]  # [N, N m]
    velocity: Annotated[Vector, MAX_JOINTS]  # [rad/s]


class InputState(Record, Protocol):
    """
    What the input stage remembers from tick to tick; one.

    Stamps tell whether a reading is new, tracks whether positions and velocities agree, torques
    which of the measured and commanded ones acted in the period before.
    """

    time: float  # of the newest tick, NaN before the first [s]
    odd_periods: int  # in a row that are too long or too short
    joints: ReadingStamps
    wrench: ReadingStamps
    variance: ReadingStamps
    known: bool  # whether any joints were valid

    # In a row without valid joints; without their torques.
    blind_ticks: int
    unknown: int

    equal_joints: int  # joint states in a row, the newest counted
    tracks: Annotated[Records[JointTrack], MAX_JOINTS]
    velocities: VelocityState
    torques: Annotated[Records[TorqueState], MAX_JOINTS]
    commands: int  # that have been given
    wrenches: WrenchState

    # Ring of the newest.
    recent: Annotated[Records[RecentWrench], RECENT_WRENCHES]
    next_recent: int


class ReadingFinding(Record, Protocol):
    """What was found of one reading, or of the time."""

    problem: int  # what is wrong with it, see `PROBLEMS` of `inputs`
    stale: bool  # whether the newest valid one is too old, or the time is wrong


class InputFindings(Record, Protocol):
    """What the input stage finds at a tick; one."""

    joints: ReadingFinding
    wrench: ReadingFinding
    variance: ReadingFinding
    clock: ReadingFinding
    skipped: int  # samples missing before this tick
    blind: bool  # whether joints were valid neither in this tick nor in the one before


class InputStage(Record, Protocol):
    """
    All that the input stage works on; one.

    Python writes `sample`, and reads `found` where something is not as it should be.
    """

    sample: Input
    settings: InputSettings
    state: InputState
    found: InputFindings


INPUT_STAGE = record_dtype(InputStage)


@compiled
def _check_tick_time(stage: InputStage) -> None:
    """Check and keep the time of a tick: it may neither go back nor run at a wrong rate."""
    settings, state, found = stage.settings, stage.state, stage.found
    h = settings.period
    elapsed = stage.sample.time - state.time
    state.time = stage.sample.time
    found.skipped = 0
    found.clock.problem = FINE
    odd = False
    if elapsed < 0.0:
        for stamps in (state.joints, state.wrench, state.variance):
            stamps.seen = np.nan
            stamps.valid = np.nan
        found.clock.problem = BACKWARDS
    else:
        odd = elapsed < settings.shortest or elapsed > settings.longest
        if 1.5 * h < elapsed <= LONGEST_SKIP + h:
            found.skipped = round(elapsed / h) - 1
    state.odd_periods += 1
    if not odd:
        state.odd_periods = 0
    if state.odd_periods >= 2:
        found.clock.problem = RATE
    found.clock.stale = found.clock.problem != FINE


@compiled
def _check_reading_stamp(
    came: int, stamp: float, stamps: ReadingStamps, latest: float
) -> int:
    """Return what is wrong with a reading so far; its stamp is `latest` at most [s]."""
    if came != FINE:
        return came
    if stamp == stamps.seen:
        return ABSENT
    if not stamp <= latest or stamp < stamps.seen:
        return STAMP
    stamps.seen = stamp
    return FINE


@compiled
def _check_joint_state(
    stage: InputStage, tracks: Records[JointTrack], span: float
) -> int:
    """Track a joint state, `span` after the one before [s]; return what is wrong with it."""
    inputs, settings, state = stage.sample, stage.settings, stage.state
    velocities = state.velocities
    for j in range(tracks.shape[0]):
        if not abs(inputs.q[j]) <= FARTHEST:
            return INVALID
    limit = POSITION_JUMP * max(1.0, span / settings.period / JUMP_PERIODS)
    still = True
    same = True
    early = False
    jumped = False
    for j in range(tracks.shape[0]):
        track, turn = tracks[j], settings.turn[j]
        track.last_q = track.q
        track.last_velocity = track.velocity
        track.q = inputs.q[j]
        track.velocity = 0.0
        if inputs.velocity_came == FINE:
            track.velocity = inputs.velocity[j]
        if turn > 0.0 and state.known:  # an angle that wraps goes on
            track.q += turn * np.round((track.last_q - track.q) / turn)
        way = track.q - track.last_q
        speed = abs(track.velocity)
        still = still and speed <= STILL
        same = same and way == 0.0
        early = early or (speed > OFFSET_TOLERANCE and velocities.states < PROOF_STATES)
        jumped = jumped or (state.known and abs(way - track.v_tracked * span) > limit)
    contradicted = check_velocities(
        tracks,
        velocities,
        settings.fastest,
        span,
        state.known and not jumped,
        settings.period,
    )
    if jumped:
        return JUMP
    state.equal_joints += 1
    if not same or still or velocities.on_probation:  # it may stand, as far as is known
        state.equal_joints = 1
    if 0 < settings.frozen_joint_ticks <= state.equal_joints:
        return FROZEN
    velocities.contradicted += 1
    if not contradicted:
        velocities.contradicted = 0
    velocities.on_probation = count_velocity_proof(
        tracks, velocities.contradicted >= FAULTS
    )
    velocities.estimated = (
        velocities.silent or contradicted or early or velocities.on_probation
    )
    if contradicted:
        return VELOCITY
    return FINE


@compiled
def _validate_joints(
    stage: InputStage,
    tracks: Records[JointTrack],
    q: Vector,
    velocity: Vector,
) -> None:
    """Check a joint state, and hand over what is valid: its positions, and its velocities."""
    inputs, state, finding = stage.sample, stage.state, stage.found.joints
    stamps, velocities, h = state.joints, state.velocities, stage.settings.period
    seen_before = stamps.seen
    came = inputs.joints_came
    if inputs.velocity_came == INVALID:
        came = INVALID
    if came != ABSENT and inputs.velocity_came == ABSENT:
        velocities.silent = True
    problem = _check_reading_stamp(
        came, inputs.joints_stamp, stamps, state.time + 0.5 * h
    )
    state.blind_ticks += 1
    if problem == FINE:
        span = inputs.joints_stamp - seen_before
        if np.isnan(span):  # after a fault of the clock
            span = h * state.blind_ticks
        problem = _check_joint_state(stage, tracks, span)
        if problem == FINE or problem == VELOCITY:
            stamps.valid = inputs.joints_stamp
            state.known = True
            state.blind_ticks = 0
            for j in range(tracks.shape[0]):
                q[j] = tracks[j].q
                velocity[j] = tracks[j].velocity
                if velocities.estimated:
                    velocity[j] = tracks[j].v_tracked
        elif problem != JUMP:  # it says nothing of where the joints are now
            stamps.seen = seen_before
    contradicted = problem == VELOCITY and velocities.contradicted >= FAULTS
    too_old = not state.time - stamps.valid <= stage.settings.joints_max_age
    finding.problem = problem
    finding.stale = too_old or contradicted or problem == JUMP or problem == FROZEN
    stage.found.blind = state.blind_ticks > 1


@compiled
def _is_wrench_outlier(
    raw: Vector, before: WrenchState, settings: InputSettings, span: float
) -> bool:
    """
    Return whether a wrench, `span` after the valid one before [s], is to be left out.

    It is far from the one before in any axis, and the first such one: a second in a row shows a
    change. What usually changes from one wrench to the next is learnt from those that are taken.
    """
    h = settings.period
    before.outlier_count *= np.exp(-h / OUTLIER_TIME)
    before.trust_time = max(0.0, before.trust_time - h)
    longest = 1.5 * h
    if before.left_out_before:
        longest = 2.5 * h
    if not settings.leaves_out or np.isnan(before.last[0]) or not span <= longest:
        return False
    far = False
    for i in range(6):
        least = UNLEARNT
        if before.learnt_wrenches >= LEARNT_WRENCHES:
            least = TORQUE_OUTLIER
            if i < 3:
                least = FORCE_OUTLIER
        usual = OUTLIER_FACTOR * np.sqrt(before.mean_square[i])
        if not abs(raw[i]) < min(settings.full_scale[i], HARDEST):
            return False  # that is a fault of its own
        far = far or abs(raw[i] - before.last[i]) > max(least, usual)
    if far and before.trust_time == 0.0:
        if not before.left_out_before:
            return True
        # The wrench before was no outlier, and what follows is compared with it.
        before.outlier_count -= 1.0
        before.trust_time = CHANGE_TIME
        before.last[:] = before.left_out_wrench
        before.equal_samples = 1
    if before.trust_time == 0.0:
        before.learnt_wrenches += 1
        share = max(h / USUAL_TIME, 1.0 / before.learnt_wrenches)
        for i in range(6):
            change = raw[i] - before.last[i]
            before.mean_square[i] += share * (change * change - before.mean_square[i])
    return False


@compiled
def _filter_wrench(raw: Vector, before: WrenchState, settings: InputSettings) -> int:
    """
    Low-pass a wrench, and return what is wrong with it.

    The filter is in transposed direct form II, settled on its first wrench.
    """
    equal = True
    saturated = False
    for i in range(6):
        if not abs(raw[i]) <= HARDEST:
            before.filtered[:] = raw  # without guards the law finds it
            return INVALID
        equal = equal and raw[i] == before.last[i]
        saturated = saturated or abs(raw[i]) >= settings.full_scale[i]
    a, b = settings.a, settings.b
    begins = np.isnan(before.next_output[0])
    for i in range(6):
        before.last[i] = raw[i]
        before.filtered[i] = raw[i]
        if settings.order == 0:
            continue
        if begins:
            before.next_output[i] = raw[i] * ((b[1] + b[2]) - (a[1] + a[2]))
            before.output_after[i] = raw[i] * (b[2] - a[2])
        filtered = b[0] * raw[i] + before.next_output[i]
        before.next_output[i] = b[1] * raw[i] - a[1] * filtered + before.output_after[i]
        before.output_after[i] = b[2] * raw[i] - a[2] * filtered
        before.filtered[i] = filtered
    before.left_out_before = False
    before.equal_samples += 1
    if not equal:
        before.equal_samples = 1
    before.faulty_samples += 1
    if saturated:
        return SATURATED
    if 0 < settings.frozen_ticks <= before.equal_samples:
        return FROZEN
    before.faulty_samples = 0
    return FINE


@compiled
def _validate_wrench(stage: InputStage, wrench: Vector) -> None:
    """Check a wrench and hand it over behind the low-pass, if it is valid."""
    inputs, settings, state = stage.sample, stage.settings, stage.state
    stamps, before, finding = state.wrench, state.wrenches, stage.found.wrench
    h, raw = settings.period, inputs.wrench
    problem = _check_reading_stamp(
        inputs.wrench_came, inputs.wrench_stamp, stamps, state.time + 0.5 * h
    )
    if problem == FINE and state.time - inputs.wrench_stamp > WRENCH_AGE * h:
        problem = STAMP
    if inputs.wrench_came == FINE:
        before.newest[:] = raw
    if problem == FINE:
        span = inputs.wrench_stamp - stamps.valid
        if _is_wrench_outlier(raw, before, settings, span):
            problem = OUTLIER
            before.left_out_before = True
            before.outlier_count += 1.0
            before.left_out_wrench[:] = raw
            before.newest[:] = before.last
        else:
            problem = _filter_wrench(raw, before, settings)
    if problem == FINE:
        wrench[:] = before.filtered
        stamps.valid = inputs.wrench_stamp
    flooded = problem == OUTLIER and before.outlier_count > MOST_OUTLIERS
    too_old = not state.time - stamps.valid <= settings.wrench_max_age
    finding.problem = problem
    finding.stale = too_old or flooded or before.faulty_samples >= FAULTS


@compiled
def _validate_variance(stage: InputStage, contacts: Records[Contact]) -> None:
    """Check an R and hand it over within its bounds, if it is valid; let an old one grow."""
    inputs, settings, state = stage.sample, stage.settings, stage.state
    stamps, finding = state.variance, stage.found.variance
    problem = _check_reading_stamp(
        inputs.variance_came,
        inputs.variance_stamp,
        stamps,
        state.time + 0.5 * settings.period,
    )
    if problem == FINE:
        for i in range(contacts.shape[0]):
            if not 0.0 < inputs.variance[i] < np.inf:
                problem = INVALID
    if problem == FINE:
        stamps.valid = inputs.variance_stamp
    finding.problem = problem
    finding.stale = state.time - stamps.valid > settings.variance_max_age
    for i in range(contacts.shape[0]):
        variance = contacts[i].noise_variance
        if finding.stale:
            variance *= VARIANCE_GROWTH
        if problem == FINE:
            variance = inputs.variance[i]
        contacts[i].noise_variance = min(
            max(variance, settings.smallest_variance), settings.largest_variance
        )


@compiled
def _classify_efforts(
    inputs: Input,
    torques: Records[TorqueState],
    joints: Records[Joint],
    period: float,
) -> int:
    """
    Find which measured torques are of use, and why the others are not; return how many are.

    A driver that measures no torque may say 0, or NaN, in one joint or in all: from the start on,
    or from a moment when there was a torque. A 0 that may be one counts for a while. The joint is
    heard again from the first other number on.
    """
    any_torque = False
    usable = 0
    for j in range(joints.shape[0]):
        any_torque = any_torque or inputs.effort[j] != 0.0
    for j in range(joints.shape[0]):
        torque, effort, fault = torques[j], inputs.effort[j], EFFORT_USABLE
        if inputs.effort_came != FINE:
            fault = EFFORT_MISSING
        elif not np.isfinite(effort):
            fault = EFFORT_NOT_FINITE
        elif effort != 0.0:
            torque.last = effort
            torque.zero_samples = 0
        else:
            torque.zero_samples += 1
            silent = torque.zero_samples * period > SILENCE
            if silent or not any_torque or abs(torque.last) > NEAR_ZERO:
                fault = EFFORT_ALWAYS_ZERO
        joints[j].watch.effort_fault = fault
        if fault == EFFORT_USABLE:
            torque.unusable_samples = 0
            usable += 1
        elif inputs.joints_came != ABSENT:  # a missing joint state says nothing of it
            torque.unusable_samples += 1
    return usable


@compiled
def _supply_momentum_observer(
    stage: InputStage,
    joints: Records[Joint],
    momentum: Momentum,
    elapsed: float,
) -> None:
    """
    Give the momentum observer the torques, measured or commanded, that acted in a period.

    The period is that of two valid joint states, `elapsed` apart [s].
    """
    inputs, settings, state = stage.sample, stage.settings, stage.state
    n, h, commands = joints.shape[0], settings.period, settings.commands
    torques, velocities = state.torques[:n], state.velocities
    if inputs.command_came:
        for j in range(n):
            torques[j].commanded[state.commands % commands] = inputs.command[j]
        state.commands += 1
    oldest = state.commands % commands
    next_oldest = (oldest + 1) % commands
    third_oldest = (oldest + min(2, commands - 1)) % commands
    by_command = np.isfinite(torques[0].commanded[oldest])
    usable = _classify_efforts(inputs, torques, joints, h)
    for j in range(n):
        watch, torque = joints[j].watch, torques[j]
        measured = watch.effort_fault == EFFORT_USABLE
        watch.effort_uncertainty = 0.0
        watch.unwatched = not (measured or by_command)
        if watch.unwatched and torque.unusable_samples * h > FORGOTTEN:
            # A residual that nothing renews would block the arm for good.
            watch.residual = 0.0
            watch.dynamic_threshold = 0.0
        if measured:
            watch.effort = inputs.effort[j]
            if settings.adds_gravity:
                watch.effort += joints[j].drive_gravity_torque
        elif by_command:  # the command may have acted a period early or late
            acted = torque.commanded[next_oldest]
            earlier = abs(acted - torque.commanded[oldest])
            later = abs(torque.commanded[third_oldest] - acted)
            watch.effort = acted
            watch.effort_uncertainty = max(earlier, later)
    is_input = momentum.config.is_input
    needed = 1
    if is_input:  # each joint is a part of the wrench
        needed = n
    estimated = velocities.estimated and not (velocities.silent and is_input)
    known = (
        (by_command or usable >= needed)
        and (is_input or stage.found.wrench.problem == FINE)
        and not estimated
        and abs(elapsed - h) < UNEVEN * h
    )
    momentum.elapsed = 0.0
    state.unknown += 1
    if known:
        momentum.elapsed = elapsed
        state.unknown = 0
    if state.unknown * h > FORGOTTEN:
        momentum.collided = False  # it would block the arm for good


@compiled
def _hand_over_unchecked(
    stage: InputStage,
    q: Vector,
    velocity: Vector,
    wrench: Vector,
    contacts: Records[Contact],
) -> None:
    """Hand over joints, wrench and R, valid or not; the wrench behind the low-pass."""
    inputs, settings = stage.sample, stage.settings
    for j in range(q.shape[0]):
        if inputs.joints_came != ABSENT:
            q[j] = inputs.q[j]
        if inputs.velocity_came != ABSENT:
            velocity[j] = inputs.velocity[j]
    if inputs.wrench_came != ABSENT:
        wrench[:] = stage.state.wrenches.filtered
    for i in range(contacts.shape[0]):
        variance = settings.initial_variance
        if inputs.variance_came != ABSENT:
            variance = inputs.variance[i]
        contacts[i].noise_variance = min(
            max(variance, settings.smallest_variance), settings.largest_variance
        )


@compiled
def check_inputs(
    stages: Records[InputStage],
    q: Vector,
    velocity: Vector,
    joints: Records[Joint],
    controls: Records[Control],
    contacts: Records[Contact],
) -> bool:
    """
    Check what has come in at a tick, and hand over what is valid.

    Parameters
    ----------
    stages
        One record of `INPUT_STAGE`, its `sample` filled in; `state` and `found` are changed.
    q, velocity
        Where joint positions [rad] and velocities [rad/s] go, shape (n,).
    joints, controls, contacts
        Records of `JOINT`, shape (n,), one of `CONTROL`, and records of `CONTACT`, shape (r,), to
        which torques, wrench and R go.

    Returns
    -------
    bool
        Whether all is well; without guards it always is.

    """
    stage, control = stages[0], controls[0]
    inputs, state, found = stage.sample, stage.state, stage.found
    _check_tick_time(stage)
    valid_before = state.joints.valid
    _validate_joints(stage, state.tracks[: joints.shape[0]], q, velocity)
    _validate_wrench(stage, control.wrench)
    _validate_variance(stage, contacts)
    elapsed = state.joints.valid - valid_before
    _supply_momentum_observer(stage, joints, control.momentum, elapsed)
    if inputs.wrench_came == FINE and inputs.wrench_stamp == inputs.time:
        recent = state.recent[state.next_recent]
        recent.time = state.time
        recent.wrench[:] = state.wrenches.newest
        recent.velocity[: joints.shape[0]] = velocity
        state.next_recent = (state.next_recent + 1) % RECENT_WRENCHES
    if not stage.settings.guarded:
        _hand_over_unchecked(stage, q, velocity, control.wrench, contacts)
        return True
    if found.blind or found.skipped > 0 or state.velocities.on_probation:
        return False
    if found.wrench.problem != FINE:  # the other readings may be of an earlier tick
        return False
    for finding in (found.joints, found.wrench, found.variance, found.clock):
        if finding.stale or finding.problem > FINE:
            return False
    for j in range(joints.shape[0]):
        if state.torques[j].unusable_samples >= REPORTED:
            return False
    return True


def make_input_stage(
    config: ControllerConfig, turning: Any, *, guarded: bool
) -> Records[InputStage]:
    """
    Return one record of `INPUT_STAGE` as configured, before the first tick.

    `turning` says which joints turn without end, shape (n,) or for all. Without guards, and where
    the momentum observer gives the wrench, no wrench is an outlier.
    """
    sensor, watchdog, h = config.sensor, config.watchdog, config.period
    record = np.zeros(1, dtype=INPUT_STAGE)
    n = len(config.robot.joint_names)
    fastest = IMPOSSIBLE_SPEED_FACTOR * np.array(config.limits.joint_speed or np.inf)
    settings: InputSettings = record['settings'][0]
    settings['guarded'] = guarded
    settings['period'] = h
    settings['shortest'] = h / watchdog.rate_band
    settings['longest'] = h * watchdog.rate_band
    settings['joints_max_age'] = h * (AGE_TOLERANCE + watchdog.joint_max_age)
    settings['wrench_max_age'] = h * (AGE_TOLERANCE + watchdog.wrench_max_age)
    settings['variance_max_age'] = h * (AGE_TOLERANCE + watchdog.variance_max_age)
    settings['fastest'][:n] = np.minimum(fastest, np.finfo(float).max)
    settings['turn'][:n] = np.where(turning, 2.0 * math.pi, 0.0)
    settings['smallest_variance'] = config.noise_variance.smallest
    settings['largest_variance'] = config.noise_variance.largest
    settings['initial_variance'] = config.initial_noise_variance
    settings['frozen_joint_ticks'] = watchdog.frozen_joint_ticks
    settings['adds_gravity'] = config.robot.adds_gravity
    settings['commands'] = max(config.collision.command_delay, 0) + 2
    settings['full_scale'] = np.inf
    if config.wrench_input != 'momentum':
        settings['leaves_out'] = guarded
        settings['frozen_ticks'] = sensor.frozen_ticks
        if sensor.full_scale:
            settings['full_scale'] = SATURATED_SHARE * np.array(sensor.full_scale)
        settings['order'] = sensor.filter_order
        if sensor.filter_order:
            from scipy.signal import butter  # 0.5 s, only where there is a filter

            b, a = butter(sensor.filter_order, sensor.filter_cutoff, fs=config.rate)
            settings['b'][: len(b)] = b
            settings['a'][: len(a)] = a
    _clear_input_state(record['state'][0])
    return record


def _clear_input_state(state: InputState) -> None:
    """Set what nothing is known of before the first tick."""
    state['time'] = math.nan
    for reading in READINGS:
        state[reading]['seen'] = math.nan
        state[reading]['valid'] = math.nan
    for name in ('last', 'next_output', 'output_after'):
        state['wrenches'][name] = math.nan
    for name in ('q', 'velocity'):
        state['tracks'][name] = math.nan
    state['recent']['time'] = -math.inf
    state['torques']['commanded'] = math.nan
    state['torques']['last'] = math.inf
