"""What the numbers of a reading must be like to be believed, compiled."""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import copy_matrix, copy_vector
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np

# What is wrong with a reading; the first is nothing. `judge_readings` returns one per input.
FINE, INVALID, IMPLAUSIBLE, JUMP, FROZEN, SATURATED = range(6)
VERDICTS = 6  # how many there are
# Rows of the arrays of readings: the one that came in, the one before, the newest believed one.
NEW, LAST, BELIEVED = READINGS = range(3)
Q, QD = range(2)  # rows of a joint state
STILL = 1e-4  # rad/s; below it a joint reading may repeat itself
FARTHEST, HARDEST = 1e3, 1e6  # rad and N or N m; beyond them no reading makes sense
LARGEST = np.finfo(np.float64).max  # finite numbers are within it
LONGEST = 0.1  # s, that speeds are extrapolated over

# Whether there was a reading before, whether a joint state was ever believed, readings that
# repeated the one before, samples for which joints are not believed after a jump.
WATCH_MEMORY = np.dtype([
    ('joints_before', np.bool_), ('joints_known', np.bool_), ('joint_repeats', np.int64),
    ('distrust', np.int64), ('wrench_before', np.bool_), ('wrench_repeats', np.int64)])
# Fields of `WatchdogConfig`; `recovery_samples` are those in `recovery_time`.
WATCH_SETTINGS = np.dtype([
    ('period', np.float64), ('position_jump', np.float64), ('frozen_samples', np.int64),
    ('recovery_samples', np.int64), ('variance_floor', np.float64),
    ('variance_ceiling', np.float64)])


@compiled
def within(values: Vector, limit: float) -> bool:
    """Return whether all magnitudes are at most a limit; what is not a number is not."""
    for i in range(values.shape[0]):
        if not abs(values[i]) <= limit:
            return False
    return True


@compiled
def repeats(values: Vector, before: Vector) -> bool:
    """Return whether two readings are equal, bit by bit but for the sign of 0."""
    for i in range(values.shape[0]):
        if values[i] != before[i]:
            return False
    return True


@compiled
def has_jumped(new: Matrix, origin: Matrix, elapsed: float, memory: Any, settings: Any) -> bool:
    """
    Return whether a joint has moved as its speeds do not say.

    Parameters
    ----------
    new, origin
        Joint states, rows Q and QD, shape (2, n).
    elapsed
        Time between them if both are believed [s]; samples not believed follow each other.
    memory, settings
        Records of `WATCH_MEMORY` and `WATCH_SETTINGS`.

    """
    h = settings.period
    if memory.distrust > 0:
        elapsed = h
    limit = settings.position_jump * max(1.0, elapsed / h / 5.0)
    for j in range(new.shape[1]):
        change = new[Q, j] - origin[Q, j] - 0.5 * (new[QD, j] + origin[QD, j]) * min(
            elapsed, LONGEST)
        if abs(change) > limit:
            return True
    return False


@compiled
def judge_joints(
    joints: Matrix, speed_limit: Vector, elapsed: float, memory: Any, settings: Any,
) -> int:
    """
    Judge a joint state, and believe it if nothing is wrong with it.

    Parameters
    ----------
    joints
        Joint states; rows LAST and BELIEVED are changed, shape (3, 2, n).
    speed_limit
        Of each joint, shape (n,) [rad/s].
    elapsed
        Since the newest believed one [s].
    memory, settings
        Records of `WATCH_MEMORY`, changed, and `WATCH_SETTINGS`.

    Returns
    -------
    int
        A verdict.

    """
    new, last, believed = joints[NEW], joints[LAST], joints[BELIEVED]
    n = speed_limit.shape[0]
    if not (within(new[Q], LARGEST) and within(new[QD], LARGEST)):
        return INVALID
    plausible = within(new[Q], FARTHEST)
    for j in range(n):
        plausible = plausible and abs(new[QD, j]) <= 3.0 * speed_limit[j]
    if not plausible:
        return IMPLAUSIBLE
    jumped = False
    if memory.distrust > 0:
        jumped = memory.joints_before and has_jumped(new, last, elapsed, memory, settings)
    elif memory.joints_known:
        jumped = has_jumped(new, believed, elapsed, memory, settings)
    same = memory.joints_before and not within(new[QD], STILL) and (
        repeats(new[Q], last[Q]) or repeats(new[QD], last[QD]))
    copy_matrix(new, last)
    memory.joints_before = True
    if jumped:
        memory.distrust = settings.recovery_samples
        return JUMP
    if memory.distrust > 0:
        memory.distrust -= 1
        return JUMP
    memory.joint_repeats = memory.joint_repeats + 1 if same else 0
    if 0 < settings.frozen_samples <= memory.joint_repeats:
        return FROZEN
    copy_matrix(new, believed)
    memory.joints_known = True
    return FINE


@compiled
def judge_wrench(wrenches: Matrix, full_scale: Vector, memory: Any, settings: Any) -> int:
    """
    Judge a wrench, and believe it if nothing is wrong with it.

    Parameters
    ----------
    wrenches
        Rows LAST and BELIEVED are changed, shape (3, 6) [N, N m].
    full_scale
        From where on an axis counts as saturated, shape (6,).
    memory, settings
        As for `judge_joints`.

    Returns
    -------
    int
        A verdict.

    """
    new, last = wrenches[NEW], wrenches[LAST]
    if not within(new, HARDEST):
        return INVALID
    same = memory.wrench_before and repeats(new, last)
    memory.wrench_repeats = memory.wrench_repeats + 1 if same else 0
    copy_vector(new, last)
    memory.wrench_before = True
    for i in range(6):
        if abs(new[i]) >= full_scale[i]:
            return SATURATED
    if 0 < settings.frozen_samples <= memory.wrench_repeats:
        return FROZEN
    copy_vector(new, wrenches[BELIEVED])
    return FINE


@compiled
def judge_variance(variances: Matrix, settings: Any) -> int:
    """
    Judge an R, and believe it within its limits if nothing is wrong with it.

    Parameters
    ----------
    variances
        Row BELIEVED is changed, shape (3, r) [N^2].
    settings
        Record of `WATCH_SETTINGS`.

    Returns
    -------
    int
        A verdict.

    """
    new = variances[NEW]
    for i in range(new.shape[0]):
        if not 0.0 < new[i] < np.inf:
            return INVALID
    for i in range(new.shape[0]):
        variances[BELIEVED, i] = min(
            max(new[i], settings.variance_floor), settings.variance_ceiling)
    return FINE


@compiled
def judge_readings(
    fresh_joints: bool, fresh_wrench: bool, fresh_variance: bool, elapsed: float,
    joints: Matrix, wrenches: Matrix, variances: Matrix, speed_limit: Vector,
    full_scale: Vector, memory: Any, settings: Any,
) -> int:
    """
    Judge the readings of a tick that are new.

    Parameters
    ----------
    fresh_joints, fresh_wrench, fresh_variance
        Which readings are new and in order.
    elapsed, joints, wrenches, variances, speed_limit, full_scale
        As for `judge_joints`, `judge_wrench` and `judge_variance`.
    memory, settings
        One record each of `WATCH_MEMORY` and `WATCH_SETTINGS`.

    Returns
    -------
    int
        The verdicts on joints, wrench and R as digits to the base of their number, the first
        the lowest; 0 if nothing is wrong.

    """
    verdicts = 0
    if fresh_joints:
        verdicts += judge_joints(joints, speed_limit, elapsed, memory[0], settings[0])
    if fresh_wrench:
        verdicts += VERDICTS * judge_wrench(wrenches, full_scale, memory[0], settings[0])
    if fresh_variance:
        verdicts += VERDICTS ** 2 * judge_variance(variances, settings[0])
    return verdicts
