"""Weighing the tool of a robot: from a recording of it at rest, or with the running controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
from pathlib import Path
import time
from typing import Any, NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import Config, ControllerConfig, parameter, Real
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CalibrationError, ConfigError, RunError
from multicontact_control.experiment.bag import (
    BagColumns,
    describe_others,
    JOINT_STATE,
    read_messages,
    WRENCH,
)
from multicontact_control.experiment.external import read_controller_files
from multicontact_control.experiment.oscillation import stretches
from multicontact_control.sensor.tool import (
    Identification,
    IdentificationConfig,
    identify_tool,
    MIN_POSES,
    MIN_SAMPLES,
    PoseReading,
    TareConfig,
)
from multicontact_control.supervision.reactions import INFLATE, NONE
import numpy as np
from scipy.spatial.transform import Rotation

JOINTS = 'joint_states'
GRID = 0.02  # s, in which a recording is looked at for rests
LOOK = 0.1  # s, over which the speed of a joint is taken
REACHED = 0.1  # rad, of a tilt
ATTEMPTS = 3  # motions to it
PEAK = 1.875  # largest speed of a quintic, relative to the mean
SHARE = 0.6  # of the largest angular speed
TILTS = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))  # about world x and y

Tell = Callable[[str], None]


class RestConfig(Config):
    """What counts as a rest of a robot that somebody leads from pose to pose."""

    speed: Real = parameter(0.02, 'Largest speed of any joint.', unit='rad/s', gt=0.0)
    settle_time: Real = parameter(0.5, 'Beginning of a rest that is left out.', unit='s', ge=0.0)
    average_time: Real = parameter(
        1.0, 'Least time after it, over which readings are averaged.', unit='s', gt=0.0)
    quiet: TareConfig = TareConfig()
    identification: IdentificationConfig = IdentificationConfig()


class Sample(NamedTuple):
    """What a running robot says: time [s], angles, shape (n,) [rad], and wrench, shape (6,)."""

    time: float
    q: Vector
    wrench_sensor: Vector


class Weighed(NamedTuple):
    """What was found, and what was done for it in words."""

    found: Identification
    remarks: tuple[str, ...]


def weigh_recording(
    path: Path, files: Sequence[Path], namespace: str | None = None,
    config: RestConfig | None = None,
) -> Weighed:
    """
    Identify a tool from a recording of an arm that is at rest in at least four poses.

    Joint states and wrenches may have clocks of their own; a rest whose readings vary is left out.
    `files` are the parameter files of the controller, for the arm and the sensor's frame;
    `namespace` is that of the topics; if not given, the only one in the recording. Raises
    ConfigError or RunError if a file or the recording lacks something, CalibrationError if there
    are too few rests, or the readings do not tell.
    """
    config = config or RestConfig()
    controller, robot = _arm(files)
    wrench = f'ft_sensor/{controller.wrench_series}'
    types = {JOINTS: JOINT_STATE, wrench: WRENCH}
    found = read_messages(path, types, namespace)
    for topic in types:
        if topic not in found.by_topic:
            text = '; '.join((f'found {describe_others(found)}', *found.unreadable))
            raise RunError(f'{path}: expected messages on {topic}, {text}')
    joints, felt = found.by_topic[JOINTS], found.by_topic[wrench]
    q = _joints(path, joints, controller.robot.joint_names)
    wrenches = felt.values('wrench')
    q_time, f_time = (1e-9 * x.stamps.astype(np.float64) for x in (joints, felt))
    if f_time[0] > q_time[-1] or q_time[0] > f_time[-1]:  # clocks of their own
        q_time, f_time = (1e-9 * x.published.astype(np.float64) for x in (joints, felt))
    readings, remarks = [], []
    for begin, end in find_rests(q_time, q, config):
        chosen = wrenches[(f_time >= begin) & (f_time <= end)]
        when = f'rest from {begin - q_time[0]:.1f} to {end - q_time[0]:.1f} s'
        restless = _restless(chosen, config.quiet)
        if restless:
            remarks.append(f'{when} left out: {restless}')
            continue
        readings.append(_mean_reading(robot, q[(q_time >= begin) & (q_time <= end)], chosen))
        remarks.append(f'{when}: {len(chosen)} readings')
    if len(readings) < MIN_POSES:
        raise CalibrationError('; '.join((
            f'{path}: expected at least {MIN_POSES} rests of '
            f'{config.settle_time + config.average_time:g} s, found {len(readings)}', *remarks)))
    gravity = np.array(controller.robot.gravity_world)
    return Weighed(identify_tool(readings, gravity, config.identification), tuple(remarks))


def _arm(files: Sequence[Path]) -> tuple[ControllerConfig, RobotModel]:
    if not files:
        raise ConfigError('--controller', 'the parameter file of your controller', 'none')
    read = read_controller_files(files)
    controller = read.config()
    if controller.wrench_input == 'momentum':
        raise ConfigError('wrench_input', 'raw or filtered: without a wrist sensor there is '
                          'nothing to calibrate', controller.wrench_input)
    return controller, RobotModel(controller.robot, read.urdf_dir)


def _joints(path: Path, messages: BagColumns, names: Sequence[str]) -> Matrix:
    """Return the angles of the joints, shape (m, n) [rad]."""
    q = messages.values('position', names)
    if not np.isfinite(q).all():
        known = ', '.join(messages.names) or 'none'
        raise RunError(f'{path}: joint_states: expected positions of the joints '
                       f'{", ".join(names)}, found {known}')
    return q


def find_rests(time: Vector, q: Matrix, config: RestConfig) -> list[tuple[float, float]]:
    """
    Return from when to when an arm was at rest, without the time to settle [s].

    `time` has shape (m,) [s], `q` the angles of the joints, shape (m, n) [rad].
    """
    order = np.argsort(time, kind='stable')
    time, q = time[order], q[order]
    grid = np.arange(time[0], time[-1], GRID)
    width = round(LOOK / GRID)
    if len(grid) <= width:
        return []
    angles = np.column_stack([np.interp(grid, time, column) for column in q.T])
    speed = np.abs(angles[width:] - angles[:-width]).max(axis=1) / LOOK
    # A gap in the joint states says nothing of what the arm did in it.
    gaps = np.interp(grid, time[1:], np.diff(time)) if len(time) > 1 else np.zeros(len(grid))
    still = (speed <= config.speed) & (gaps[width:] <= LOOK)
    rests = []
    for begin, end in zip(*stretches(still)):
        start, stop = grid[begin] + config.settle_time, grid[end - 1]
        if stop - start >= config.average_time:
            rests.append((float(start), float(stop)))
    return rests


def _restless(wrenches: Matrix, quiet: TareConfig) -> str:
    """Return why readings cannot be averaged; empty if they can."""
    if len(wrenches) < MIN_SAMPLES:
        return f'{len(wrenches)} readings'
    if not np.isfinite(wrenches).all():
        return 'readings that are not finite'
    force, torque = wrenches.std(axis=0).reshape(2, 3).max(axis=1)
    if force > quiet.max_force_std or torque > quiet.max_torque_std:
        return f'readings with standard deviations of {force:.3g} N and {torque:.3g} N m'
    return ''


def weigh_running(
    files: Sequence[Path], *, namespace: str = '', domain_id: int | None = None,
    tilt: float = np.deg2rad(25.0), move_time: float = 3.0, timeout: float = 10.0,
    config: RestConfig | None = None, tell: Tell = lambda text: None,
) -> Weighed:
    """
    Identify the tool of a robot by a controller that runs: it tilts the tool, and turns it back.

    The operational point stays where it is. No contact may be pressed meanwhile, and the bias of
    the running controller is that of the first pose afterwards. `files` are the controller's
    parameter files; `tilt` is the angle about world x and y, to either side [rad]; `move_time` the
    least time from pose to pose [s]; `timeout` the longest wait for an answer or a sample [s];
    `tell` is called with what is being done. Raises ConfigError if a parameter file is not
    acceptable, RunError if no controller answers, a contact is pressed, or a pose is not reached,
    CalibrationError if the readings do not tell.
    """
    from multicontact_control.client import MultiContactClient
    from multicontact_control.nodes import topics
    from multicontact_control.nodes.link import ControllerLink

    config = config or RestConfig()
    controller, robot = _arm(files)
    wrench = topics.WRENCHES[controller.wrench_input]
    readings: list[PoseReading] = []
    with MultiContactClient(namespace, domain_id=domain_id, timeout=timeout) as arm, (
            ControllerLink((topics.JOINT_STATES, wrench), namespace=namespace,
                           domain_id=domain_id, timeout=timeout)) as link:
        def weigh() -> PoseReading:
            return weigh_at_rest(lambda: _sample(
                link.fresh(topics.JOINT_STATES, wrench), controller.robot.joint_names,
            ), robot, config, timeout)

        start = arm.read()
        pressed = [name for name, force in start.forces_desired.items() if force > 0.0]
        if pressed:
            raise RunError(f'calibrate: expected free space, found {", ".join(pressed)} pressed')
        # A weight that is not known is a pull that no surface explains: control waits for us.
        tell('tare, so that the weight is not taken for a contact')
        _tare(arm, 2 * MIN_SAMPLES, timeout)
        with contextlib.suppress(RunError):  # if it does not wait
            arm.retry()
        _await_control(arm, timeout)
        # From one side to the other, well within the limit of the angular speed.
        slowest = max(move_time, PEAK * 2.0 * tilt / (SHARE * controller.limits.operational_turn))
        before = Rotation.from_quat(start.quaternion_desired)
        poses = [Rotation.from_rotvec([tilt * x, tilt * y, 0.0]) * before for x, y in TILTS]
        for number, pose in enumerate(poses, 1):
            tell(f'pose {number} of {len(poses)}')
            readings.append(_tilt(arm, start.position_desired, pose, slowest, weigh, tell))
        tell('back to the first pose')
        arm.move(start.position_desired, slowest, quaternion_xyzw=before.as_quat())
        tell('the running controller keeps its tare; what is found is for the next run')
    gravity = np.array(controller.robot.gravity_world)
    return Weighed(identify_tool(readings, gravity, config.identification), ())


def _tare(arm: Any, samples: int, timeout: float) -> None:
    """Tare as soon as the arm stands still; RunError if it does not."""
    give_up = time.monotonic() + timeout
    while True:
        for _ in range(samples):  # of a controller that has just begun, or moves
            arm.read()
        try:
            return arm.tare()
        except RunError:
            if time.monotonic() > give_up:
                raise


def _await_control(arm: Any, timeout: float) -> None:
    """Wait until the arm is controlled, and obeys; RunError if it is not."""
    give_up = time.monotonic() + timeout
    while (status := arm.status()) is None or status.reaction not in (NONE, INFLATE):
        if time.monotonic() > give_up:
            raise RunError('calibrate: expected control to begin once the weight is tared away, '
                           f'found {"nothing said" if status is None else status.text}')
        arm.read()


def _tilt(
    arm: Any, position: Vector, pose: Rotation, duration: float,
    weigh: Callable[[], PoseReading], tell: Tell,
) -> PoseReading:
    """Turn the tool, again if the supervisor has held it meanwhile; RunError if it stays off."""
    for attempt in range(1, ATTEMPTS + 1):
        arm.move(position, duration, quaternion_xyzw=pose.as_quat())
        reading = weigh()
        off = (Rotation.from_quat(arm.read().quaternion_xyzw) * pose.inv()).magnitude()
        if off <= REACHED:
            return reading
        tell(f'{np.rad2deg(off):.0f} deg off after motion {attempt} of {ATTEMPTS}')
        with contextlib.suppress(RunError):  # if it does not wait
            arm.retry()
    raise RunError(
        f'calibrate: expected a tilted tool, found it {np.rad2deg(off):.0f} deg off; it may be '
        'beyond a limit, or too heavy not to be known at all: start from another pose, tilt '
        'less, or weigh it --from-bag')


def _sample(messages: Sequence[Any], names: Sequence[str]) -> Sample:
    """Return joint state and wrench as numbers; RunError if a joint is not there."""
    joints, felt = messages
    angles, w = dict(zip(joints.name, joints.position)), felt.wrench
    lacking = [name for name in names if name not in angles]
    if lacking:
        raise RunError(f'joint_states: expected the joints {", ".join(lacking)}, found '
                       f'{", ".join(joints.name) or "none"}')
    stamp = joints.header.stamp
    return Sample(
        stamp.sec + 1e-9 * stamp.nanosec, np.array([angles[name] for name in names]),
        np.array([w.force.x, w.force.y, w.force.z, w.torque.x, w.torque.y, w.torque.z]))


def weigh_at_rest(
    sample: Callable[[], Sample], robot: RobotModel, config: RestConfig, timeout: float,
) -> PoseReading:
    """
    Return the mean of the first rest from now on, in the robot's time.

    `sample` returns one that comes from now on; the rest begins within `timeout` [s]. Raises
    RunError if the robot's time does not go on, CalibrationError without a quiet rest.
    """
    samples, look_at, length = [sample()], -np.inf, config.settle_time + config.average_time
    rests: list[tuple[float, float]] = []
    while not rests:
        now, last = sample(), samples[-1].time
        if now.time < last:
            raise RunError(f'joint_states: expected stamps that go on, found one '
                           f'{last - now.time:.3g} s before the last: samples begin anew')
        samples.append(now)
        if now.time < look_at:
            continue
        look_at = now.time + LOOK
        time, q = (np.array([getattr(x, name) for x in samples]) for name in ('time', 'q'))
        rests = find_rests(time, q, config)
        if not rests and now.time - samples[0].time > timeout + length:
            raise CalibrationError(
                f'calibrate: expected an arm at rest (no joint faster than {config.speed:g} '
                f'rad/s) for {length:g} s within {timeout:g} s, found none')
    begin, end = rests[0]
    chosen = [x for x in samples if begin <= x.time <= end]
    wrenches = np.array([x.wrench_sensor for x in chosen])
    restless = _restless(wrenches, config.quiet)
    if restless:
        raise CalibrationError(f'calibrate: expected readings at rest, found {restless}')
    return _mean_reading(robot, np.array([x.q for x in chosen]), wrenches)


def _mean_reading(robot: RobotModel, q: Matrix, wrenches: Matrix) -> PoseReading:
    pose = robot.update(q.mean(axis=0), np.zeros(robot.joint_count)).sensor_pose
    return PoseReading(pose.rotation_world, wrenches.mean(axis=0))
