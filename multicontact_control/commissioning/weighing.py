"""Weighing the tool of a robot at rest in several poses, from a recording or by tilting it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
from pathlib import Path
import time
from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.commissioning.resting_poses import (
    AVERAGE_TIME,
    list_quiet_poses,
    SensedArm,
    SETTLE_TIME,
    SPEED_TIME,
    Tell,
)
from multicontact_control.config import ControllerConfig
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
from multicontact_control.supervision.causes import INFLATE, NONE
import numpy as np
from scipy.spatial.transform import Rotation

TOOL_FILE = 'tool.yaml'
JOINT_TOPIC = 'joint_states'
REST_TIME = SETTLE_TIME + AVERAGE_TIME + 0.5  # s, of a rest that is made for it
# A pose is reached within these: a weight that is not known pulls the tool down.
TURN_TOLERANCE = 0.1  # rad
POSITION_TOLERANCE = 0.1  # m
ATTEMPTS = 3  # motions to a pose, and rests in it
ROUNDS = 2  # of the poses that have not been weighed
CLEARANCE = 0.02  # m, of a tilted contact to where its surface may begin
TIMEOUT = 10.0  # s, for an answer or a sample of the controller
QUINTIC_PEAK = 1.875  # largest speed of a quintic, relative to the mean
SPEED_SHARE = 0.6  # of the limits of the speed, that a motion takes
# Axes of the tilts in world x and y; the first pose has none.
TILTS = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))


def identify_from_rests(
    poses: Sequence[tool.PoseReading], controller: ControllerConfig, lacking: str = ''
) -> tool.Identification:
    """
    Identify a tool from rests: its mass, its centre of mass and the sensor's bias.

    `lacking` says which poses gave no rest, and why; the CalibrationError for too few repeats it.
    """
    if len(poses) < tool.MIN_POSES:
        found = str(len(poses))
        if lacking:
            found = f'{found}; {lacking}'
        raise CalibrationError(
            f'calibrate: expected at least {tool.MIN_POSES} quiet rests of '
            f'{SETTLE_TIME + AVERAGE_TIME:g} s, got {found}'
        )
    return tool.identify_tool(poses, np.array(controller.robot.gravity_world))


def _read_arm(files: Sequence[Path]) -> SensedArm:
    """Return the arm of a controller's parameter files; ConfigError without a wrist sensor."""
    read = read_controller_files(files)
    controller = read.config()
    if controller.wrench_input == 'momentum':
        raise ConfigError(
            'wrench_input',
            'raw or filtered: a wrist sensor that is calibrated',
            controller.wrench_input,
        )
    return SensedArm(controller, RobotModel(controller.robot, read.urdf_dir))


def weigh_recording(
    path: Path, files: Sequence[Path], namespace: str | None, tell: Tell
) -> tool.Identification:
    """
    Identify a tool from a recording, whose joint states and wrenches may have clocks of their own.

    Parameters
    ----------
    path
        The folder of a bag, or an MCAP file.
    files
        Parameter files of the controller.
    namespace
        That of the topics; None takes the only one.
    tell
        Is called with each rest.

    Raises
    ------
    ConfigError, RunError
        If a file or the recording lacks something.
    CalibrationError
        If there are too few rests, or they do not determine the tool.

    """
    arm = _read_arm(files)
    wrench_topic = f'ft_sensor/{arm.controller.wrench_series}'
    kinds = {JOINT_TOPIC: JOINT_STATE, wrench_topic: WRENCH}
    messages = read_messages(path, kinds, namespace)
    for topic in kinds:
        if topic not in messages.by_topic:
            raise RunError(f'{path}: expected messages on {topic}, got {messages}')
    columns = messages.by_topic
    poses = list_quiet_poses(
        path, arm, columns[JOINT_TOPIC], columns[wrench_topic], tell
    )
    return identify_from_rests(poses, arm.controller)


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
    stays there. A pose without a quiet rest is tried once more, and then goes without: the others
    count.

    Parameters
    ----------
    files
        Parameter files of the controller.
    namespace, domain_id
        Where the controller runs.
    tilt
        Angle about world x and y, to either side [rad].
    move_time
        The least time from pose to pose [s].
    tell
        Is called with what is done.

    Raises
    ------
    RunError
        If no controller answers, or a contact is pressed; and as `weigh_recording`.

    """
    from multicontact_control.client import MultiContactClient
    from multicontact_control.nodes import topics
    from multicontact_control.nodes.link import ControllerLink

    arm = _read_arm(files)
    limits = arm.controller.limits
    where: dict[str, Any] = {
        'namespace': namespace,
        'domain_id': domain_id,
        'timeout': TIMEOUT,
    }
    streams = (topics.JOINT_STATES, topics.WRENCHES[arm.controller.wrench_input])
    with (
        MultiContactClient(**where) as client,
        ControllerLink(streams, **where) as link,
    ):
        start = client.read()
        pressed = [name for name, force in start.forces_desired.items() if force > 0.0]
        if pressed:
            raise RunError(
                f'calibrate: expected free space, got {", ".join(pressed)} pressed'
            )
        # A weight that is not known is a pull that no surface explains: control waits for this.
        tell('tare, so that the weight is not taken for a contact')
        _await_control(client)
        # From one side to the other, well within the limit of the angular speed.
        turn_time = _find_move_time(2.0 * tilt, limits.operational_turn)
        duration = max(move_time, turn_time)
        home = Rotation.from_quat(start.quaternion_desired)
        tilts = [Rotation.from_rotvec([tilt * x, tilt * y, 0.0]) for x, y in TILTS]
        clear = start.position_desired + find_clearing_way(arm.controller, home, tilts)
        place = _move_into_workspace(arm.controller, clear)
        height = float(np.linalg.norm(place - start.position_desired))
        lift_time = max(move_time, _find_move_time(height, limits.operational_speed))
        if height > 0.0:
            tell(f'lift by {1e3 * height:.0f} mm, off the contacts')
            _move_tool(client, place, lift_time)
        missing_height = float(np.linalg.norm(clear - place))
        if missing_height:
            tell(
                f'limits.workspace_* end {1e3 * missing_height:.0f} mm before the tool is '
                'clear of the contacts wherever it is tilted: watch it'
            )

        def rest_at(number: int) -> tool.PoseReading:
            _turn_tool(client, place, duration, tilts[number] * home)
            return _await_rest(link, streams, client.read().time, arm)

        poses, lacking = visit_poses(len(tilts), rest_at, tell)
        tell('back to the first pose')
        try:
            _move_tool(
                client, place, duration, quaternion_xyzw=start.quaternion_desired
            )
            _move_tool(client, start.position_desired, lift_time)
        except RunError as error:  # what is weighed is weighed
            tell(f'not back in the first pose: {error}')
        tell('the running controller keeps its tare; the result is for the next run')
    return identify_from_rests(poses, arm.controller, lacking)


def _find_move_time(way: float, limit: float) -> float:
    """Return the time in which a quintic goes a way [m or rad] well within a speed limit [s]."""
    return QUINTIC_PEAK * way / (SPEED_SHARE * limit)


def _move_tool(client: Any, position: Vector, duration: float, **pose: Vector) -> None:
    """Move the tool as near to a pose as an unknown weight lets it; RunError if it cannot."""
    client.move(
        position,
        duration,
        position_tolerance=POSITION_TOLERANCE,
        rotation_tolerance=TURN_TOLERANCE,
        **pose,
    )


def visit_poses(
    count: int, rest_at: Callable[[int], tool.PoseReading], tell: Tell
) -> tuple[list[tool.PoseReading], str]:
    """
    Return the rests at poses 0 to `count` - 1, and in words which gave none, and why.

    `rest_at` brings the arm to a pose and returns its rest; where it raises CalibrationError or
    RunError it is called once more, after the others.
    """
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
    if lacking:
        tell(f'{len(found)} of {count} poses count')
    reasons = [f'pose {number + 1}: {reason}' for number, reason in lacking.items()]
    return list(found.values()), '; '.join(reasons)


def _await_rest(
    link: Any, streams: Sequence[Any], since: float, arm: SensedArm
) -> tool.PoseReading:
    """Return a rest from samples after a time [s]; CalibrationError without one in time."""
    joints = BagColumns(JOINT_STATE)
    wrenches = BagColumns(WRENCH)
    said: list[str] = []
    # Where samples are lost, more of them are needed.
    for attempt in range(1, ATTEMPTS + 1):
        until = since + attempt * REST_TIME
        while not len(joints) or 1e-9 * joints.stamps[-1] < until:
            messages = link.receive_fresh(*streams)
            for columns, message in zip((joints, wrenches), messages):
                columns.add_message(message, time.time_ns())
        poses = list_quiet_poses('calibrate', arm, joints, wrenches, said.append)
        if poses:
            return poses[-1]
    reason = f'{len(joints)} samples, with gaps of more than {SPEED_TIME:g} s'
    if said:
        reason = said[-1]
    raise CalibrationError(f'no quiet rest in {ATTEMPTS * REST_TIME:g} s: {reason}')


def find_clearing_way(
    controller: ControllerConfig, home: Rotation, tilts: Sequence[Rotation]
) -> Vector:
    """
    Return the way that keeps tilted contacts off every surface, shape (3,) [m].

    The surfaces are taken to begin where the contacts are at the orientation `home`; it is zero
    without contacts.
    """
    if not controller.contact_names:
        return np.zeros(3)
    corners_of_contacts = []
    normals_of_contacts = []
    for name in controller.contact_names:
        contact = controller.contacts[name]
        corners_of_contacts.append(_list_corners(contact, home))
        normals_of_contacts.append(contact.normal_world)
    corners = np.concatenate(corners_of_contacts)
    normals = np.array(normals_of_contacts)
    depths = [(tilt.apply(corners) - corners) @ normals.T for tilt in tilts]
    deepest = np.maximum(np.max(depths, axis=(0, 1)), 0.0)
    way: Vector = np.linalg.lstsq(normals, -(deepest + CLEARANCE), rcond=None)[0]
    return way


def _list_corners(contact: ContactConfig, home: Rotation) -> Matrix:
    """Return where a contact ends, from the operational point, world axes, shape (k, 3)."""
    point = home.apply(contact.point_operational)
    direction = home.apply(contact.direction_operational)
    along = contact.half_length * direction
    across = contact.half_width * np.cross(contact.normal_world, direction)
    if contact.type == 'point':
        return np.array([point])
    edge = np.array([point + along, point - along])
    if contact.type == 'edge':
        return edge
    return np.concatenate([edge + across, edge - across])


def _move_into_workspace(controller: ControllerConfig, position: Vector) -> Vector:
    """Return a position of the operational point, or that next to it in its box, shape (3,)."""
    limits = controller.limits
    if not len(limits.workspace_lower):
        return position
    return np.clip(position, limits.workspace_lower, limits.workspace_upper)


def _await_control(client: Any) -> None:
    """Tare once the arm stands still, then wait until it obeys; RunError if it does not."""
    give_up = time.monotonic() + TIMEOUT
    tared = False
    while True:
        # The controller may just have begun, or the arm may move.
        for _ in range(2 * tool.MIN_SAMPLES):
            client.read()
        # It refuses as long as the arm moves, or if control does not wait.
        with contextlib.suppress(RunError):
            if not tared:
                client.tare()
                tared = True
            client.retry()
        status = client.status()
        if tared and status is not None and status.reaction in (NONE, INFLATE):
            return
        if time.monotonic() > give_up:
            text = 'no status'
            if status is not None:
                text = status.text
            raise RunError(
                'calibrate: expected control to begin once the weight is tared away, '
                f'got {text}'
            )


def _turn_tool(client: Any, position: Vector, duration: float, pose: Rotation) -> None:
    """Turn the tool, once more if the supervisor has held it; RunError if it stays off."""
    from multicontact_control.client import NotReachedError

    for _ in range(ATTEMPTS):
        with contextlib.suppress(NotReachedError):  # what is reached is looked at below
            _move_tool(client, position, duration, quaternion_xyzw=pose.as_quat())
        # Until it has come to rest.
        for _ in range(2 * tool.MIN_SAMPLES):
            reached = Rotation.from_quat(client.read().quaternion_xyzw)
        error = (reached * pose.inv()).magnitude()
        if error <= TURN_TOLERANCE:
            return
        with contextlib.suppress(RunError):  # if control does not wait
            client.retry()
    raise RunError(
        f'calibrate: expected a tilted tool, got one {np.rad2deg(error):.0f} deg off; it may be '
        'beyond a limit, or too heavy to lift unknown: start from another pose, tilt less, or '
        'weigh it --from-bag'
    )


def describe_tool(result: tool.Identification) -> list[str]:
    """
    Return what was identified, with the standard errors, in lines of text.

    Centre of mass and bias are in the sensor's axes, the centre in mm. The last line tells how
    well the poses determine the tool, and what they leave unexplained.
    """
    centre = []
    for value, error in zip(result.com_sensor, result.com_std):
        centre.append(f'{1e3 * value:.2f} +- {1e3 * error:.2f}')
    bias = [f'{value:.4f}' for value in result.bias_sensor]
    return [
        f'mass: {result.mass:.4f} +- {result.mass_std:.4f} kg',
        f'centre of mass: {", ".join(centre)} mm',
        f'bias: {", ".join(bias[:3])} N, {", ".join(bias[3:])} N m',
        f'{result.poses} poses, condition {result.condition:.3g}, residual '
        f'{result.force_residual:.3g} N and {result.torque_residual:.3g} N m rms',
    ]


def write_tool(folder: Path, result: tool.Identification) -> Path:
    """
    Write a tool as a parameter file to lay over the controller's, and return its path.

    The file is `tool.yaml` in the folder, which is made if it does not exist; comments at its head
    have the standard errors.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / TOOL_FILE
    lines = describe_tool(result)
    lines.append('Give it to the controller after its own parameter file.')
    head = ''.join(f'# {line}\n' for line in lines)
    values = result.tool().model_dump(mode='json')
    write_parameters(path, {'/**': {'tool': values}}, head)
    return path
