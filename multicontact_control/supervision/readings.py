"""What the numbers of a reading must be like to be valid, compiled."""

from __future__ import annotations

from typing import Any

from multicontact_control.compiled import compiled
import numpy as np

# What is wrong with a reading; the first is nothing. `check_readings` returns one per input.
FINE, INVALID, IMPLAUSIBLE, JUMP, FROZEN, SATURATED = range(6)
VERDICTS = 6  # how many there are
STILL = 1e-4  # rad/s; below it a joint reading may repeat itself
FARTHEST, HARDEST = 1e3, 1e6  # rad and N or N m; beyond them no reading makes sense
LARGEST = np.finfo(np.float64).max  # finite numbers are within it
LONGEST = 0.1  # s, that speeds are extrapolated over


@compiled
def has_jumped(joints: Any, from_valid: bool, memory: Any, settings: Any) -> bool:
    """
    Return whether a joint has moved as its speeds do not say.

    Parameters
    ----------
    joints
        Records of `JOINT_READING`, shape (n,).
    from_valid
        Whether the newest joint state is compared with the newest valid one, otherwise with the
        one before; these follow each other.
    memory, settings
        Records of `READING_MEMORY` and `READING_SETTINGS`.

    """
    h = settings.period
    elapsed = memory.elapsed if from_valid else h
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
def check_joints(joints: Any, memory: Any, settings: Any) -> int:
    """
    Check a joint state, and keep it if nothing is wrong with it.

    Parameters
    ----------
    joints
        Records of `JOINT_READING`, changed, shape (n,).
    memory, settings
        Records of `READING_MEMORY`, changed, and `READING_SETTINGS`.

    Returns
    -------
    int
        A verdict.

    """
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
        jumped = memory.joints_before and has_jumped(joints, False, memory, settings)
    elif memory.joints_known:
        jumped = has_jumped(joints, True, memory, settings)
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
    if 0 < settings.frozen_samples <= memory.joint_repeats:
        return FROZEN
    for j in range(joints.shape[0]):
        joints[j].valid_q = joints[j].q
        joints[j].valid_qd = joints[j].qd
    memory.joints_known = True
    return FINE


@compiled
def check_wrench(axes: Any, memory: Any, settings: Any) -> int:
    """
    Check a wrench, and keep it if nothing is wrong with it.

    Parameters
    ----------
    axes
        Records of `AXIS_READING`, changed, shape (6,).
    memory, settings
        As for `check_joints`.

    Returns
    -------
    int
        A verdict.

    """
    same, saturated = memory.wrench_before, False
    for i in range(axes.shape[0]):
        if not abs(axes[i].new) <= HARDEST:
            return INVALID
        same = same and axes[i].new == axes[i].last
        saturated = saturated or abs(axes[i].new) >= axes[i].full_scale
    memory.wrench_repeats = memory.wrench_repeats + 1 if same else 0
    memory.wrench_before = True
    for i in range(axes.shape[0]):
        axes[i].last = axes[i].new
    if saturated:
        return SATURATED
    if 0 < settings.frozen_samples <= memory.wrench_repeats:
        return FROZEN
    for i in range(axes.shape[0]):
        axes[i].valid = axes[i].new
    return FINE


@compiled
def check_variances(variances: Any, settings: Any) -> int:
    """
    Check an R, and keep it within its limits if nothing is wrong with it.

    Parameters
    ----------
    variances
        Records of `VARIANCE_READING`, changed, shape (r,).
    settings
        Record of `READING_SETTINGS`.

    Returns
    -------
    int
        A verdict.

    """
    for i in range(variances.shape[0]):
        if not 0.0 < variances[i].new < np.inf:
            return INVALID
    for i in range(variances.shape[0]):
        variances[i].valid = min(
            max(variances[i].new, settings.variance_floor), settings.variance_ceiling)
    return FINE


@compiled
def check_readings(
    joints: Any, axes: Any, variances: Any, memories: Any, all_settings: Any,
) -> int:
    """
    Check the readings of a tick that are new.

    Parameters
    ----------
    joints, axes, variances
        As for `check_joints`, `check_wrench` and `check_variances`.
    memories, all_settings
        One record each of `READING_MEMORY`, which says what is new, and `READING_SETTINGS`.

    Returns
    -------
    int
        The verdicts on joints, wrench and R as digits to the base of their number, the first
        the lowest; 0 if nothing is wrong.

    """
    memory, settings = memories[0], all_settings[0]
    verdicts = 0
    if memory.joints_fresh:
        verdicts += check_joints(joints, memory, settings)
    if memory.wrench_fresh:
        verdicts += VERDICTS * check_wrench(axes, memory, settings)
    if memory.variance_fresh:
        verdicts += VERDICTS ** 2 * check_variances(variances, settings)
    return verdicts
