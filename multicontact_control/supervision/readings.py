"""
What makes an input valid, compiled: its time, its age, its numbers.

Inputs are joints, wrench and R, in this order. In every function `memory` is a record of
`READING_MEMORY`, changed, and `settings` one of `READING_SETTINGS`; `joints` are records of
`JOINT_READING`, shape (n,), and `variances` of `VARIANCE_READING`, shape (r,), both changed. What
checks something returns what is wrong with it: FINE, if nothing is.
"""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import copy_vector
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np

JOINTS, WRENCH, VARIANCE = range(3)
# What is wrong with a reading; ABSENT: none has come, FINE: nothing.
ABSENT = -1
FINE, INVALID, IMPLAUSIBLE, JUMP, FROZEN, SATURATED, STAMP, ORDER, LATE = range(9)
# What is wrong with the time of a tick.
CLOCK_FINE, CLOCK_INVALID, CLOCK_BACKWARDS, CLOCK_RATE, CLOCK_FROZEN, CLOCK_STILL = range(6)
LATEST = 1e12  # s, of a time that makes sense
VARIANCE_GROWTH = 1.1  # per period, of an R that is not renewed
VARIANCE_FLOOR = 0.1  # N^2; a smaller R makes the observer faster than the drives
VARIANCE_CEILING = 1e3  # N^2, the largest R that is used
INFLATED = 1e12  # times R, at most
STILL = 1e-4  # rad/s; below it a joint reading may repeat itself
FARTHEST, HARDEST = 1e3, 1e6  # rad and N or N m; beyond them no reading makes sense
LARGEST = np.finfo(np.float64).max  # finite numbers are within it
LONGEST = 0.1  # s, that speeds are extrapolated over
# Periods: without a wrench below full scale, which is no gap to be bridged; and between a wrench
# and its tick, for it to be what is measured then.
SATURATED_AGE = WRENCH_AGE = 1.5


@compiled
def has_jumped(joints: Any, from_valid: bool, elapsed: float, settings: Any) -> bool:
    """
    Return whether a joint has moved as its speeds do not say.

    The newest joint state is compared with the newest valid one, or with the one before; either
    is `elapsed` old [s].
    """
    h = settings.period
    limit = settings.position_jump * max(1.0, elapsed / h / 5.0)
    for j in range(joints.shape[0]):
        joint = joints[j]
        q = joint.valid_q if from_valid else joint.last_q
        qd = joint.valid_qd if from_valid else joint.last_qd
        change = joint.q - q - 0.5 * (joint.qd + qd) * min(elapsed, LONGEST)
        if abs(change) > limit:
            return True
    return False


@compiled
def check_joints(joints: Any, elapsed: float, memory: Any, settings: Any) -> int:
    """Check a joint state, `elapsed` after the newest valid one [s]; keep it if it is fine."""
    plausible, still = True, True
    same_q, same_qd = True, True
    for j in range(joints.shape[0]):
        joint = joints[j]
        if not (abs(joint.q) <= LARGEST and abs(joint.qd) <= LARGEST):
            return INVALID
        plausible = plausible and (
            abs(joint.q) <= FARTHEST and abs(joint.qd) <= 3.0 * joint.speed_limit)
        still = still and abs(joint.qd) <= STILL
        same_q = same_q and joint.q == joint.last_q
        same_qd = same_qd and joint.qd == joint.last_qd
    if not plausible:
        return IMPLAUSIBLE
    jumped = False
    if memory.distrust > 0:
        jumped = memory.joints_before and has_jumped(joints, False, settings.period, settings)
    elif memory.joints_known:
        jumped = has_jumped(joints, True, elapsed, settings)
    same = memory.joints_before and not still and (same_q or same_qd)
    for j in range(joints.shape[0]):
        joints[j].last_q = joints[j].q
        joints[j].last_qd = joints[j].qd
    memory.joints_before = True
    if jumped:
        memory.distrust = settings.recovery_samples
        return JUMP
    if memory.distrust > 0:
        memory.distrust -= 1
        return JUMP
    memory.joint_repeats = memory.joint_repeats + 1 if same else 0
    if 0 < settings.frozen_joint_samples <= memory.joint_repeats:
        return FROZEN
    for j in range(joints.shape[0]):
        joints[j].valid_q = joints[j].q
        joints[j].valid_qd = joints[j].qd
    memory.joints_known = True
    return FINE


@compiled
def check_wrench(wrench: Any, memory: Any, settings: Any) -> int:
    """Check a wrench, a record of `WRENCH_READING`; keep it if it is fine."""
    same, saturated = memory.wrench_before, False
    for i in range(6):
        if not abs(wrench.new[i]) <= HARDEST:
            return INVALID
        same = same and wrench.new[i] == wrench.last[i]
        saturated = saturated or abs(wrench.new[i]) >= wrench.full_scale[i]
    memory.wrench_repeats = memory.wrench_repeats + 1 if same else 0
    memory.wrench_before = True
    copy_vector(wrench.new, wrench.last)
    if saturated:
        return SATURATED
    if 0 < settings.frozen_samples <= memory.wrench_repeats:
        return FROZEN
    copy_vector(wrench.new, wrench.valid)
    memory.wrench_known = True
    return FINE


@compiled
def check_variances(variances: Any) -> int:
    """Check an R; keep it within its limits if it is fine."""
    for i in range(variances.shape[0]):
        if not 0.0 < variances[i].new < np.inf:
            return INVALID
    for i in range(variances.shape[0]):
        variances[i].valid = min(max(variances[i].new, VARIANCE_FLOOR), VARIANCE_CEILING)
    return FINE


@compiled
def check_clock(time: float, memory: Any, settings: Any) -> int:
    """
    Check the time of a tick [s]: CLOCK_STILL if it is that of the tick before.

    It is kept, or one period more than the last if it is not finite.
    """
    before = memory.time
    if not abs(time) <= LATEST:
        memory.time = 0.0 if np.isnan(before) else before + settings.period
        return CLOCK_INVALID
    memory.time = time
    if np.isnan(before):
        return CLOCK_FINE
    step = time - before
    if step == 0.0:
        memory.same_times += 1
        return CLOCK_STILL
    memory.same_times = 0
    if step < 0.0:
        for i in range(3):
            memory.seen[i] = np.nan
            memory.valid[i] = np.nan
        memory.odd_periods = 0
        return CLOCK_BACKWARDS
    odd = not settings.shortest <= step <= settings.longest
    memory.odd_periods = memory.odd_periods + 1 if odd else 0
    return CLOCK_RATE if memory.odd_periods >= 2 else CLOCK_FINE


@compiled
def check_arrival(which: int, arrival: Any, memory: Any, settings: Any) -> int:
    """Check the stamp of a reading: FINE if its numbers are to be looked at, ABSENT if not new."""
    stamp, before = arrival.stamp[which], memory.seen[which]
    if arrival.content[which] == ABSENT:
        return ABSENT
    if not -np.inf < stamp <= memory.time + 0.5 * settings.period:
        return STAMP
    if stamp <= before:
        return ORDER if stamp < before else ABSENT
    memory.seen[which] = stamp
    if which == WRENCH and memory.time - stamp > (WRENCH_AGE + 1e-3) * settings.period:
        return LATE
    return int(arrival.content[which])


@compiled
def check_contents(watch: Any, joints: Any, variances: Any) -> None:
    """
    Check the numbers of the readings that are new; see `check_inputs`.

    A frozen reading is as old as its value.
    """
    memory, settings = watch.memory, watch.settings
    h, stamp, valid, problem = (
        settings.period, watch.arrival.stamp, memory.valid, watch.verdict.problem)
    memory.blind_ticks += 1
    if problem[JOINTS] == FINE:
        # Before a clock went wrong its stamps say nothing: ticks do.
        elapsed = stamp[JOINTS] - valid[JOINTS]
        if np.isnan(elapsed):
            elapsed = h * memory.blind_ticks
        problem[JOINTS] = check_joints(joints, elapsed, memory, settings)
        if problem[JOINTS] == FINE:
            valid[JOINTS] = stamp[JOINTS]
            memory.blind_ticks = 0
        elif problem[JOINTS] == FROZEN:
            valid[JOINTS] = stamp[JOINTS] - h * memory.joint_repeats
    if problem[WRENCH] == FINE:
        problem[WRENCH] = check_wrench(watch.wrench, memory, settings)
        if problem[WRENCH] == FINE:
            valid[WRENCH] = stamp[WRENCH]
        elif problem[WRENCH] == FROZEN:
            valid[WRENCH] = stamp[WRENCH] - h * memory.wrench_repeats
    if problem[VARIANCE] == FINE:
        problem[VARIANCE] = check_variances(variances)
        if problem[VARIANCE] == FINE:
            valid[VARIANCE] = stamp[VARIANCE]
            memory.inflation = 1.0


@compiled
def check_ages(watch: Any, variances: Any) -> None:
    """Find readings that are too old, and inflate R while it is; see `check_inputs`."""
    memory, settings, verdict = watch.memory, watch.settings, watch.verdict
    for i in range(3):
        age, limit = memory.time - memory.valid[i], settings.max_age[i]
        if i == WRENCH and verdict.problem[i] == SATURATED:
            limit = min(limit, SATURATED_AGE * settings.period)
        verdict.stale[i] = age > limit or (np.isnan(age) and i != VARIANCE)
    if verdict.stale[VARIANCE]:
        memory.inflation *= VARIANCE_GROWTH
    for i in range(variances.shape[0]):
        variance = variances[i]
        variance.used = variance.valid
        if memory.inflation != 1.0:
            variance.used = min(variance.valid * memory.inflation, VARIANCE_CEILING)
    memory.inflation = min(memory.inflation, INFLATED)


@compiled
def take_effort(came: Vector, effort: Vector) -> bool:
    """Keep torques [N m] if they say anything: a driver that measures none may say 0, or NaN."""
    moved, total = False, 0.0
    for j in range(came.shape[0]):
        moved = moved or came[j] != 0.0
        total += came[j]
    if not (moved and np.isfinite(total)):
        return False
    copy_vector(came, effort)
    return True


@compiled
def hand_over(
    watch: Any, joints: Any, variances: Any, motion: Matrix, wrench: Vector,
    noise_variance: Vector,
) -> None:
    """Fill in the newest that was valid; see `check_inputs`."""
    for j in range(joints.shape[0]):
        motion[0, j] = joints[j].valid_q
        motion[1, j] = joints[j].valid_qd
    copy_vector(watch.wrench.valid, wrench)
    for i in range(variances.shape[0]):
        noise_variance[i] = variances[i].used


@compiled
def check_inputs(
    watches: Any, joints: Any, variances: Any, places: Any, time: float, joint_reading: Any,
    wrench_reading: Any, variance_reading: Any,
) -> bool:
    """
    Check the inputs of a tick, keep what is valid of them, and hand it over.

    A reading is its stamp, NaN if that is no number [s]; what is wrong with it before its numbers
    are looked at, FINE if nothing is; and these numbers, of no use unless it is.

    Parameters
    ----------
    watches
        One record of `WATCH`; memory and wrench are changed, the verdict is filled.
    joints, variances
        Records of `JOINT_READING`, shape (n,), and `VARIANCE_READING`, shape (r,), changed.
    places
        Filled with what is valid: q and v, shape (2, n) [rad, rad/s], wrench, shape (6,)
        [N, N m], and R, shape (r,) [N^2]; and with the torques that came with the joints, valid
        or not, if they say anything, shape (n,) [N m].
    time
        Now, NaN if it is no number [s].
    joint_reading
        With q and v, whether torques came with them, and which, shape (n,).
    wrench_reading, variance_reading
        With the wrench, shape (6,), and R, shape (r,).

    Returns
    -------
    bool
        Whether all is well: every input is known and valid, or young enough to go on with, and
        the wrench is new.

    """
    motion, wrench, noise_variance, effort = places
    joint_stamp, joint_content, q, qd, with_effort, new_effort = joint_reading
    wrench_stamp, wrench_content, new_wrench = wrench_reading
    variance_stamp, variance_content, new_variance = variance_reading
    watch = watches[0]
    arrival, memory, verdict = watch.arrival, watch.memory, watch.verdict
    arrival.time = time
    arrival.stamp[JOINTS], arrival.content[JOINTS] = joint_stamp, joint_content
    arrival.stamp[WRENCH], arrival.content[WRENCH] = wrench_stamp, wrench_content
    arrival.stamp[VARIANCE], arrival.content[VARIANCE] = variance_stamp, variance_content
    clock = check_clock(arrival.time, memory, watch.settings)
    verdict.repeated = False
    if clock == CLOCK_STILL:
        stamp, seen = arrival.stamp[JOINTS], memory.seen[JOINTS]
        same = arrival.content[JOINTS] == ABSENT or stamp == seen or (
            np.isnan(seen) and not np.isfinite(stamp))
        verdict.repeated = same and memory.same_times < 2
        if verdict.repeated:
            return False
        clock = CLOCK_FROZEN
    verdict.clock = clock
    for i in range(3):
        verdict.problem[i] = check_arrival(i, arrival, memory, watch.settings)
    if joint_content == FINE:
        for j in range(joints.shape[0]):
            joints[j].q, joints[j].qd = q[j], qd[j]
    if wrench_content == FINE:
        copy_vector(new_wrench, watch.wrench.new)
    if variance_content == FINE:
        for i in range(variances.shape[0]):
            variances[i].new = new_variance[i]
    check_contents(watch, joints, variances)
    check_ages(watch, variances)
    verdict.acted = with_effort and take_effort(new_effort, effort)
    hand_over(watch, joints, variances, motion, wrench, noise_variance)
    verdict.blind = memory.blind_ticks > 1
    well = clock == CLOCK_FINE and not verdict.blind and verdict.problem[WRENCH] == FINE
    for i in range(3):
        well = well and not verdict.stale[i] and verdict.problem[i] <= FINE
    return bool(well)
