"""The poses at which a recorded arm was at rest, and what its wrist sensor read there."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from multicontact_control.arrays import find_true_stretches, Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CalibrationError, RunError
from multicontact_control.runs.bag import BagColumns
from multicontact_control.sensor.tool import (
    average_rest_readings,
    MAX_REST_SPEED,
    PoseReading,
)
import numpy as np

SPEED_TIME = 0.1  # s, over which the speed of a joint is taken
SETTLE_TIME = 0.5  # s, of the beginning of a rest that is left out
AVERAGE_TIME = 1.0  # s, the least over which readings are averaged

Tell = Callable[[str], None]  # shows a line to the user


class SensedArm(NamedTuple):
    """
    An arm with a wrist sensor: its controller's configuration, and its model.

    The model turns joint angles into the sensor's orientation, on which the weight that it feels
    depends.
    """

    controller: ControllerConfig
    robot: RobotModel


def list_quiet_poses(
    source: object, arm: SensedArm, joints: BagColumns, wrenches: BagColumns, tell: Tell
) -> list[PoseReading]:
    """
    Return the rests of an arm, from its messages.

    Parameters
    ----------
    source
        Where the messages are from, for errors.
    arm
        The arm that they are of.
    joints, wrenches
        Messages of joint states and of the wrist sensor, which may have clocks of their own.
    tell
        Is called with each rest; one whose readings vary is left out.

    Raises
    ------
    RunError
        If a joint is missing.

    """
    names = arm.controller.robot.joint_names
    q = joints.values('position', names)
    readings = wrenches.values('wrench')
    if not np.isfinite(q).all():
        raise RunError(
            f'{source}: joint_states: expected positions of the joints '
            f'{", ".join(names)}, got {", ".join(joints.names) or "none"}'
        )
    q_time = 1e-9 * joints.stamps.astype(np.float64)
    wrench_time = 1e-9 * wrenches.stamps.astype(np.float64)
    if wrench_time[0] > q_time[-1] or q_time[0] > wrench_time[-1]:
        # Clocks of their own.
        q_time = 1e-9 * joints.published.astype(np.float64)
        wrench_time = 1e-9 * wrenches.published.astype(np.float64)
    poses = []
    for begin, end in find_rests(q_time, q):
        at_rest = (q_time >= begin) & (q_time <= end)
        felt = readings[(wrench_time >= begin) & (wrench_time <= end)]
        angles = q[at_rest].mean(axis=0)
        state = arm.robot.update(angles, np.zeros(arm.robot.joint_count))
        rest = f'rest from {begin - q_time[0]:.1f} to {end - q_time[0]:.1f} s'
        try:
            reading = average_rest_readings(felt)
        except CalibrationError as error:
            tell(f'{rest} left out: {error}')
            continue
        tell(rest)
        poses.append(PoseReading(state.sensor_pose.rotation_world, reading))
    return poses


def find_rests(time: Vector, q: Matrix) -> list[tuple[float, float]]:
    """
    Return from when to when an arm was at rest [s], without the beginning of each rest.

    `time` are the stamps of m joint states, in any order, shape (m,) [s], and `q` the joint
    angles, shape (m, n) [rad].
    """
    order = np.argsort(time, kind='stable')
    time = time[order]
    q = q[order]
    earlier = time - SPEED_TIME
    before = np.column_stack([np.interp(earlier, time, column) for column in q.T])
    speed = np.abs(q - before).max(axis=1) / SPEED_TIME
    # In a gap of the joint states the arm may have moved.
    known = np.diff(time, prepend=time[0]) <= SPEED_TIME
    rests = []
    for begin, end in find_true_stretches((speed <= MAX_REST_SPEED) & known):
        start = float(time[begin]) + SETTLE_TIME
        stop = float(time[end - 1])
        if stop - start >= AVERAGE_TIME:
            rests.append((start, stop))
    return rests
