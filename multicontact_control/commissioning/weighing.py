"""Weighing the tool of a robot at rest in several poses, from a recording or by tilting it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
from pathlib import Path
import time
from typing import Any

from multicontact_control.arrays import find_true_stretches, Matrix, Vector
from multicontact_control.config import ControllerConfig, ToolConfig
from multicontact_control.config.contact import ContactConfig
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CalibrationError, ConfigError, RunError
from multicontact_control.runs.bag import (
    BagColumns,
    JOINT_STATE,
    read_messages,
    WRENCH,
)
from multicontact_control.runs.parameter_file import write_parameters
from multicontact_control.runs.scenario import read_controller_files
from multicontact_control.sensor import tool
from multicontact_control.supervision.reactions import INFLATE, NONE
import numpy as np
from scipy.spatial.transform import Rotation

TOOL_FILE = 'tool.yaml'
JOINTS = 'joint_states'
# A rest: largest speed of any joint [rad/s]; its beginning that is left out, and the least time
# over which readings are averaged [s].
SPEED, SETTLE_TIME, AVERAGE_TIME = 0.02, 0.5, 1.0
REST_TIME = SETTLE_TIME + AVERAGE_TIME + 0.5  # s, of a rest that is made for it
LOOK = 0.1  # s, over which the speed of a joint is taken
REACHED, SAG = (
    0.1,
    0.1,
)  # rad and m off a tilt: a weight that is not known pulls the tool down
ATTEMPTS = 3  # motions to it, and rests in it
ROUNDS = 2  # of the poses that have not been weighed
CLEARANCE = 0.02  # m, of a tilted contact to where its surface may begin
TIMEOUT = 10.0  # s, for an answer or a sample of the controller
PEAK = 1.875  # largest speed of a quintic, relative to the mean
SHARE = 0.6  # of the largest angular speed
TILTS = (
    (0.0, 0.0),
    (1.0, 0.0),
    (-1.0, 0.0),
    (0.0, 1.0),
    (0.0, -1.0),
)  # about world x and y

Tell = Callable[[str], None]


def quiet_rests(
    source: object,
    joints: BagColumns,
    felt: BagColumns,
    controller: ControllerConfig,
    robot: RobotModel,
    tell: Tell,
) -> list[tool.PoseReading]:
    """
    Return the rests of an arm, from its messages.

    `tell` is called with each rest; one whose readings vary is left out. Raises RunError, naming
    the `source`, if a joint is missing.
    """
    names, gravity = (
        controller.robot.joint_names,
        np.array(controller.robot.gravity_world),
    )
    q, readings = joints.values('position', names), felt.values('wrench')
    if not np.isfinite(q).all():
        raise RunError(
            f'{source}: joint_states: expected positions of the joints '
            f'{", ".join(names)}, got {", ".join(joints.names) or "none"}'
        )
    q_time, f_time = (1e-9 * x.stamps.astype(np.float64) for x in (joints, felt))
    if f_time[0] > q_time[-1] or q_time[0] > f_time[-1]:  # clocks of their own
        q_time, f_time = (1e-9 * x.published.astype(np.float64) for x in (joints, felt))
    poses = []
    for begin, end in find_rests(q_time, q):
        mean = q[(q_time >= begin) & (q_time <= end)].mean(axis=0)
        rotation = robot.update(
            mean, np.zeros(robot.joint_count)
        ).sensor_pose.rotation_world
        rest = f'rest from {begin - q_time[0]:.1f} to {end - q_time[0]:.1f} s'
        try:
            reading = tool.compute_tare_bias(
                readings[(f_time >= begin) & (f_time <= end)],
                rotation,
                ToolConfig(),
                gravity,
            )
        except CalibrationError as error:
            tell(f'{rest} left out: {error}')
            continue
        tell(rest)
        poses.append(tool.PoseReading(rotation, reading))
    return poses


def identify(
    poses: Sequence[tool.PoseReading],
    controller: ControllerConfig,
    lacking: str = '',
) -> tool.Identification:
    """Identify a tool from rests; CalibrationError if there are too few, saying what lacks."""
    if len(poses) < tool.MIN_POSES:
        what = f'; {lacking}' if lacking else ''
        raise CalibrationError(
            f'calibrate: expected at least {tool.MIN_POSES} quiet rests of '
            f'{SETTLE_TIME + AVERAGE_TIME:g} s, got {len(poses)}{what}'
        )
    return tool.identify_tool(poses, np.array(controller.robot.gravity_world))


def find_rests(time: Vector, q: Matrix) -> list[tuple[float, float]]:
    """Return from when to when an arm was at rest [s], of joint angles of shape (m, n) [rad]."""
    order = np.argsort(time, kind='stable')
    time, q = time[order], q[order]
    before = np.column_stack([np.interp(time - LOOK, time, column) for column in q.T])
    speed = np.abs(q - before).max(axis=1) / LOOK
    # In a gap of the joint states the arm may have moved.
    still = (speed <= SPEED) & (np.diff(time, prepend=time[0]) <= LOOK)
    rests = [
        (float(time[begin]) + SETTLE_TIME, float(time[end - 1]))
        for begin, end in find_true_stretches(still)
    ]
    return [(start, stop) for start, stop in rests if stop - start >= AVERAGE_TIME]


def _arm(files: Sequence[Path]) -> tuple[ControllerConfig, RobotModel]:
    read = read_controller_files(files)
    controller = read.config()
    if controller.wrench_input == 'momentum':
        raise ConfigError(
            'wrench_input',
            'raw or filtered: a wrist sensor that is calibrated',
            controller.wrench_input,
        )
    return controller, RobotModel(controller.robot, read.urdf_dir)


def weigh_recording(
    path: Path,
    files: Sequence[Path],
    namespace: str | None = None,
    tell: Tell = lambda text: None,
) -> tool.Identification:
    """
    Identify a tool from a recording, whose joint states and wrenches may have clocks of their own.

    `files` are the controller's; `namespace` is that of the topics, the only one by default. As
    `weigh`, and raises ConfigError or RunError if a file or the recording lacks something.
    """
    controller, robot = _arm(files)
    wrench = f'ft_sensor/{controller.wrench_series}'
    messages = read_messages(path, {JOINTS: JOINT_STATE, wrench: WRENCH}, namespace)
    for topic in (JOINTS, wrench):
        if topic not in messages.by_topic:
            raise RunError(f'{path}: expected messages on {topic}, got {messages}')
    joints, felt = messages.by_topic[JOINTS], messages.by_topic[wrench]
    return identify(
        quiet_rests(path, joints, felt, controller, robot, tell), controller
    )


def weigh_running(
    files: Sequence[Path],
    *,
    namespace: str,
    domain_id: int | None,
    tilt: float,
    move_time: float,
    tell: Tell,
) -> tool.Identification:
    """
    Identify the tool of a robot by a controller that runs: it lifts, tilts and puts back the tool.

    The operational point is lifted off the contacts, as far as a tilt would lead into them, and
    stays there. `tilt` is the angle about world x and y, to either side [rad]; `move_time` the
    least time from pose to pose [s]. A pose without a quiet rest is tried once more, and then
    goes without: the others count. As `weigh_recording`, and raises RunError if no controller
    answers, or a contact is pressed.
    """
    from multicontact_control.client import MultiContactClient
    from multicontact_control.nodes import topics
    from multicontact_control.nodes.link import ControllerLink

    controller, robot = _arm(files)
    where: dict[str, Any] = {
        'namespace': namespace,
        'domain_id': domain_id,
        'timeout': TIMEOUT,
    }
    heard = (topics.JOINT_STATES, topics.WRENCHES[controller.wrench_input])
    with MultiContactClient(**where) as arm, ControllerLink(heard, **where) as link:
        start = arm.read()
        if pressed := [
            name for name, force in start.forces_desired.items() if force > 0.0
        ]:
            raise RunError(
                f'calibrate: expected free space, got {", ".join(pressed)} pressed'
            )
        # A weight that is not known is a pull that no surface explains: control waits for this.
        tell('tare, so that the weight is not taken for a contact')
        _await_control(arm)
        # From one side to the other, well within the limit of the angular speed.
        duration = max(
            move_time, PEAK * 2.0 * tilt / (SHARE * controller.limits.operational_turn)
        )
        home = Rotation.from_quat(start.quaternion_desired)
        tilts = [Rotation.from_rotvec([tilt * x, tilt * y, 0.0]) for x, y in TILTS]
        wanted = start.position_desired + way_off(controller, home, tilts)
        place = _within_workspace(controller, wanted)
        height = float(np.linalg.norm(place - start.position_desired))
        lift_time = max(
            move_time, PEAK * height / (SHARE * controller.limits.operational_speed)
        )
        if height > 0.0:
            tell(f'lift by {1e3 * height:.0f} mm, off the contacts')
            arm.move(
                place, lift_time, position_tolerance=SAG, rotation_tolerance=REACHED
            )
        if short := float(np.linalg.norm(wanted - place)):
            tell(
                f'limits.workspace_* end {1e3 * short:.0f} mm before the tool is clear of the '
                'contacts wherever it is tilted: watch it'
            )

        def rest_at(number: int) -> tool.PoseReading:
            _turn(arm, place, duration, tilts[number] * home)
            return _rest(link, heard, arm.read().time, controller, robot)

        found, lacking = visit_poses(len(tilts), rest_at, tell)
        tell('back to the first pose')
        tolerances = {'position_tolerance': SAG, 'rotation_tolerance': REACHED}
        try:
            arm.move(
                place, duration, quaternion_xyzw=start.quaternion_desired, **tolerances
            )
            arm.move(start.position_desired, lift_time, **tolerances)
        except RunError as error:  # what is weighed is weighed
            tell(f'not back in the first pose: {error}')
        tell('the running controller keeps its tare; the result is for the next run')
    return identify(found, controller, lacking)


def visit_poses(
    count: int,
    rest_at: Callable[[int], tool.PoseReading],
    tell: Tell,
) -> tuple[list[tool.PoseReading], str]:
    """Return the rests at poses 0 to `count` - 1, and in words which gave none, and why."""
    found: dict[int, tool.PoseReading] = {}
    lacking: dict[int, str] = {}
    for _ in range(ROUNDS):
        for number in range(count):
            if number in found:
                continue
            tell(f'pose {number + 1} of {count}')
            try:
                found[number] = rest_at(number)
                lacking.pop(number, None)
            except (CalibrationError, RunError) as error:
                lacking[number] = str(error)
                tell(f'pose {number + 1} left out: {error}')
    texts = [f'pose {number + 1}: {why}' for number, why in lacking.items()]
    if texts:
        tell(f'{len(found)} of {count} poses count')
    return list(found.values()), '; '.join(texts)


def _rest(
    link: Any,
    heard: Sequence[Any],
    since: float,
    controller: ControllerConfig,
    robot: RobotModel,
) -> tool.PoseReading:
    """Return a rest from samples after a time [s]; CalibrationError without one in time."""
    joints, felt = BagColumns(JOINT_STATE), BagColumns(WRENCH)
    said: list[str] = []
    for rests in range(
        1, ATTEMPTS + 1
    ):  # where samples are lost, more of them are needed
        while not len(joints) or 1e-9 * joints.stamps[-1] < since + rests * REST_TIME:
            for columns, message in zip((joints, felt), link.receive_fresh(*heard)):
                columns.add_message(message, time.time_ns())
        poses = quiet_rests('calibrate', joints, felt, controller, robot, said.append)
        if poses:
            return poses[-1]
    why = (
        said[-1]
        if said
        else f'{len(joints)} samples, with gaps of more than {LOOK:g} s'
    )
    raise CalibrationError(f'no quiet rest in {ATTEMPTS * REST_TIME:g} s: {why}')


def way_off(
    controller: ControllerConfig,
    home: Rotation,
    tilts: Sequence[Rotation],
) -> Vector:
    """
    Return the way that keeps tilted contacts off every surface, shape (3,) [m].

    The surfaces are taken to begin where the contacts are now; zero without contacts.
    """
    contacts = [controller.contacts[name] for name in controller.contact_names]
    if not contacts:
        return np.zeros(3)
    now = np.concatenate([_corners(contact, home) for contact in contacts])
    normals = np.array([contact.normal_world for contact in contacts])
    into = np.max([(tilt.apply(now) - now) @ normals.T for tilt in tilts], axis=(0, 1))
    way: Vector = np.linalg.lstsq(
        normals, -(np.maximum(into, 0.0) + CLEARANCE), rcond=None
    )[0]
    return way


def _corners(contact: ContactConfig, home: Rotation) -> Matrix:
    """Return where a contact ends, from the operational point, world axes, shape (k, 3)."""
    point, along = (
        home.apply(values)
        for values in (contact.point_operational, contact.direction_operational)
    )
    across = np.cross(contact.normal_world, along)
    sides = {
        'point': [np.zeros(3)],
        'edge': [contact.half_length * along],
        'plane': [
            contact.half_length * along + contact.half_width * across,
            contact.half_length * along - contact.half_width * across,
        ],
    }
    return np.array(
        [point + sign * side for side in sides[contact.type] for sign in (1.0, -1.0)]
    )


def _within_workspace(controller: ControllerConfig, position: Vector) -> Vector:
    """Return a position of the operational point, or that next to it in its box, shape (3,)."""
    limits = controller.limits
    if not len(limits.workspace_lower):
        return position
    return np.clip(position, limits.workspace_lower, limits.workspace_upper)


def _await_control(arm: Any) -> None:
    """Tare once the arm stands still, then wait until it obeys; RunError if it does not."""
    give_up, tared = time.monotonic() + TIMEOUT, False
    while True:
        for _ in range(
            2 * tool.MIN_SAMPLES
        ):  # of a controller that has just begun, or moves
            arm.read()
        with contextlib.suppress(
            RunError
        ):  # as long as it moves, or if control does not wait
            if not tared:
                arm.tare()
                tared = True
            arm.retry()
        status = arm.status()
        if tared and status is not None and status.reaction in (NONE, INFLATE):
            return
        if time.monotonic() > give_up:
            raise RunError(
                'calibrate: expected control to begin once the weight is tared away, '
                f'got {"no status" if status is None else status.text}'
            )


def _turn(arm: Any, position: Vector, duration: float, pose: Rotation) -> None:
    """Turn the tool, again if the supervisor has held it meanwhile; RunError if it stays off."""
    from multicontact_control.client import NotReachedError

    for _ in range(ATTEMPTS):
        with contextlib.suppress(NotReachedError):  # what is reached is looked at below
            arm.move(
                position,
                duration,
                quaternion_xyzw=pose.as_quat(),
                position_tolerance=SAG,
                rotation_tolerance=REACHED,
            )
        for _ in range(2 * tool.MIN_SAMPLES):  # until it has come to rest
            off = (
                Rotation.from_quat(arm.read().quaternion_xyzw) * pose.inv()
            ).magnitude()
        if off <= REACHED:
            return
        with contextlib.suppress(RunError):  # if control does not wait
            arm.retry()
    raise RunError(
        f'calibrate: expected a tilted tool, got one {np.rad2deg(off):.0f} deg off; it may be '
        'beyond a limit, or too heavy to lift unknown: start from another pose, tilt less, or '
        'weigh it --from-bag'
    )


def describe(result: tool.Identification) -> list[str]:
    """Return what was identified, with the standard errors, in lines of text."""
    centre = ', '.join(
        f'{1e3 * value:.2f} +- {1e3 * error:.2f}'
        for value, error in zip(result.com_sensor, result.com_std)
    )
    force, torque = (
        ', '.join(f'{value:.4f}' for value in part)
        for part in np.split(result.bias_sensor, 2)
    )
    return [
        f'mass: {result.mass:.4f} +- {result.mass_std:.4f} kg',
        f'centre of mass: {centre} mm',
        f'bias: {force} N, {torque} N m',
        f'{result.poses} poses, condition {result.condition:.3g}, residual '
        f'{result.force_residual:.3g} N and {result.torque_residual:.3g} N m rms',
    ]


def write_tool(folder: Path, result: tool.Identification) -> Path:
    """Write a tool as a parameter file to lay over the controller's, and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / TOOL_FILE
    head = [
        *describe(result),
        'Give it to the controller after its own parameter file.',
    ]
    write_parameters(
        path,
        {'/**': {'tool': result.tool().model_dump(mode='json')}},
        ''.join(f'# {line}\n' for line in head),
    )
    return path
