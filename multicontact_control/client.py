"""The controller from a Python program."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
import time

from multicontact_control.arrays import Vector
from multicontact_control.config import LimitsConfig
from multicontact_control.contact.geometry import project_on_contacts
from multicontact_control.control.trajectory import shortest_motion_duration
from multicontact_control.control.trajectory_checks import check_position, TimedPoses
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import CommandError, RunError
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.link import (
    CommandRefusedError,
    ControllerLink,
    DEACTIVATE,
)
from multicontact_control.nodes.messages import ControllerStatus, new_identifier
from multicontact_control.supervision.causes import INFLATE, LATCHED, NAMES, NONE
from multicontact_control.supervision.contacts import HOLDING, STATE_NAMES
import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

__all__ = [
    'ArmState',
    'CommandRefusedError',
    'ControllerStatus',
    'MultiContactClient',
    'NotReachedError',
]

STATE_TOPICS = (
    topics.MEASURED_FORCES,
    topics.ESTIMATED_FORCES,
    topics.DESIRED_FORCES,
    topics.POSE,
    topics.POSE_DESIRED,
)
# s of the samples, after which a motion ends: control resumes by itself within 2 s, or never.
LONGEST_INTERRUPTION = 5.0
# m or rad from the goal, within which the reference is there: the controller leads it on after a
# late program.
REFERENCE_TOLERANCE = 2e-5
PROGRESS_PERIOD = 0.1  # s, between two looks at the progress of a path
TRAJECTORY = topics.TRAJECTORY_COMMAND.name


def ignore_progress(_status: ControllerStatus) -> None:
    """Do nothing with the progress of a path."""


class NotReachedError(RunError):
    """The contact forces or the arm did not come near what was commanded in time."""


@dataclass(frozen=True, slots=True)
class ArmState:
    """
    The arm at one sample: forces by contact name, and poses in world axes.

    A pose is that of the operational frame: its position, and its axes as a quaternion.
    """

    time: float  # its stamp [s]
    forces: dict[str, float]  # N
    forces_estimated: dict[str, float]  # 0 where none is controlled
    forces_desired: dict[str, float]  # the same
    noise_variance: dict[str, float]  # the newest R [N^2], empty if no estimator runs
    position_world: Vector  # m
    quaternion_xyzw: Vector
    position_desired: Vector
    quaternion_desired: Vector

    @property
    def pose(self) -> Pose:
        """Return where the operational frame is, measured by the joints."""
        return Pose.from_quaternion(self.position_world, self.quaternion_xyzw)

    @property
    def pose_desired(self) -> Pose:
        """Return where the operational frame should be, by what is commanded and allowed."""
        return Pose.from_quaternion(self.position_desired, self.quaternion_desired)


class MultiContactClient(ControllerLink):
    """
    Commands a running controller and reads its state, in a with statement and one thread.

    The clock is that of the samples; only timeouts look at the wall clock. Every method raises
    `RunError` if what it waits for does not come, and where the controller refuses. At the end,
    or by `close`, the client leaves; the controller goes on with its last commands.

    `namespace` and `domain_id` are those of the controller, by default the domain of the
    environment; `timeout` is the longest wait for an answer or a sample [s].
    """

    def __init__(
        self,
        namespace: str = '',
        *,
        domain_id: int | None = None,
        timeout: float = 10.0,
    ) -> None:
        messages.require_positive('timeout', timeout, 's')
        super().__init__(
            (*STATE_TOPICS, topics.NOISE_VARIANCE),
            namespace=namespace,
            domain_id=domain_id,
            timeout=timeout,
        )

    def activate(self) -> None:
        """Configure and activate estimator and controller; they know of no command from before."""
        if self.has_lifecycle(topics.ESTIMATOR, wait=1.0):
            self.configure_and_activate(topics.ESTIMATOR)
        self.configure_and_activate(topics.CONTROLLER)

    def deactivate(self) -> None:
        """Let the controller command its safe behaviour and obey no more."""
        if self.get_state(topics.CONTROLLER) == 'active':
            self.change_state(topics.CONTROLLER, DEACTIVATE)

    def status(self) -> ControllerStatus | None:
        """Return the newest status of the controller, None if it has sent none so far."""
        self.take_statuses()
        return self.last_status

    def hold(self, on: bool = True) -> None:
        """Hold the arm where it is and obey no motion, or let go of it again."""
        if not isinstance(on, bool):
            raise messages.MessageError('on', 'true or false', repr(on))
        self.request_service('hold', SetBool, SetBool.Request(data=on))

    def tare(self) -> None:
        """Take what the wrist sensor reads now for its zero; nothing may touch the tool."""
        self.request_service('tare', Trigger, Trigger.Request())

    def retry(self) -> None:
        """Resume control that waits for an operator, and seek contacts that were given up."""
        self.request_service('retry', Trigger, Trigger.Request())

    def set_forces(
        self,
        forces: Mapping[str, float],
        centres: Mapping[str, float] | None = None,
    ) -> None:
        """
        Command forces by contact or couple, e.g. ``blade/along`` [N], then centres of pressure.

        Returns when they are accepted. A force of 0 gives the contact back to motion control;
        contacts that are not named keep theirs. Centres are by couple, from the middle of the
        contact [m]. CommandRefusedError if the controller refuses: then nothing changes.
        """
        messages.require_named_numbers('forces', forces, 'N')
        if centres is not None:
            messages.require_named_numbers('centres', centres, 'm')
        self.receive_fresh(topics.DESIRED_FORCES)  # before its first sample it refuses
        if forces:
            self.command_until_answered(
                topics.FORCE_COMMAND,
                messages.joint_state_message(
                    0, list(forces), effort=list(forces.values())
                ),
            )
        if centres:
            self.command_until_answered(
                topics.FORCE_COMMAND,
                messages.joint_state_message(
                    0, list(centres), position=list(centres.values())
                ),
            )

    def move(
        self,
        position_world: ArrayLike,
        duration: float,
        *,
        quaternion_xyzw: ArrayLike | None = None,
        position_tolerance: float = 0.005,
        rotation_tolerance: float = 0.05,
    ) -> None:
        """
        Move the operational point to a goal, and return when it is there.

        Along a straight line to a position, shape (3,) [m], with a quintic in time over a duration
        [s], at rest at both ends; the orientation is the present one by default. It is a
        trajectory that the controller follows, so that a late program does not disturb it. There
        means within tolerances [m], [rad]. Contacts that are sought or held place the tool along
        their normals, edges and planes also about their couples' axes: there the goal may differ
        by the tolerances from where the tool is, and where it ends does not count. While the arm
        is held, a reaction takes the place of control, or a contact is lost, the motion waits, for
        up to 5 s. A motion that this raises out of ends.

        CommandRefusedError if the goal is out of the workspace, or if contacts or the limits of
        speed and acceleration do not allow the way. NotReachedError, with the place and the cause,
        if the motion waits longer or for an operator, and if the arm is not there 5 s after its
        end.
        """
        messages.require_positive('duration', duration, 's')
        messages.require_positive('position_tolerance', position_tolerance, 'm')
        messages.require_positive('rotation_tolerance', rotation_tolerance, 'rad')
        goal = messages.finite_array(position_world, 3, 'position_world')
        limits = self._limits()
        try:
            check_position(goal, limits)
        except CommandError as error:
            raise CommandRefusedError(f'{TRAJECTORY}: {error}') from None
        start = self.read()
        quaternion = start.quaternion_desired
        if quaternion_xyzw is not None:
            quaternion = messages.quaternion_array(quaternion_xyzw, 'quaternion_xyzw')
        goal_pose = Pose.from_quaternion(goal, quaternion)
        way = start.pose_desired.displacement_to(goal_pose)
        _require_time(duration, way, limits)
        status = self.end_path()
        _require_free(way, status, position_tolerance, rotation_tolerance)
        _require_passing(status, start, goal_pose, 0.0)
        points = TimedPoses(
            np.array([float(duration)]), goal[np.newaxis], quaternion[np.newaxis]
        )
        self._command_path(points)
        try:
            self._watch_path(goal_pose, ignore_progress, LONGEST_INTERRUPTION)
            self._arrive(goal_pose, position_tolerance, rotation_tolerance)
        except BaseException:
            self._abandon_path()
            raise

    def follow(
        self,
        positions_world: ArrayLike,
        *,
        speed: float = 0.05,
        times: ArrayLike | None = None,
        quaternions_xyzw: ArrayLike | None = None,
        on_progress: Callable[[ControllerStatus], None] | None = None,
    ) -> None:
        """
        Lead the operational point through positions, and return once it has come to rest.

        The controller follows the path, a cubic spline, by itself: it goes on if this program
        ends. It begins straight to the first point, and is slowed down as a whole where the limits
        ask for it. A hold pauses it, until it is released. While a reaction takes the place of
        control or a contact is lost, it waits, for up to 5 s; then NotReachedError, and it ends.

        Parameters
        ----------
        positions_world
            Points of the path, shape (k, 3) [m].
        speed
            Between them [m/s], where no times are given.
        times
            When each is to be passed, rising from 0 s or later, shape (k,) [s].
        quaternions_xyzw
            Orientations at the points, shape (k, 4); by default the present one.
        on_progress
            Called about ten times a second with the newest status: `trajectory_share`,
            `remaining_time`.

        Raises
        ------
        CommandRefusedError
            With the reason, and the index of the point; nothing moves then.
        NotReachedError
            With the place and the cause.

        """
        messages.require_positive('speed', speed, 'm/s')
        positions = np.asarray(positions_world, dtype=float)
        if positions.ndim != 2 or positions.shape[1:] != (3,) or not len(positions):
            raise messages.MessageError(
                'positions_world', 'shape (k, 3)', positions.shape
            )
        if times is None:
            ways = np.linalg.norm(np.diff(positions, axis=0), axis=1)
            times = np.concatenate([[0.0], np.cumsum(ways / speed)])
        passed = messages.finite_array(times, len(positions), 'times')
        if quaternions_xyzw is None:
            present = self.read().quaternion_desired
            quaternions = np.tile(present, (len(positions), 1))
        else:
            quaternions = np.asarray(quaternions_xyzw, dtype=float)
            if quaternions.shape != (len(positions), 4):
                raise messages.MessageError(
                    'quaternions_xyzw',
                    f'shape ({len(positions)}, 4)',
                    quaternions.shape,
                )
        self._command_path(TimedPoses(passed, positions, quaternions))
        self.await_path(on_progress)

    def await_path(
        self, on_progress: Callable[[ControllerStatus], None] | None = None
    ) -> None:
        """
        Wait until the controller has followed the path that it follows; see `follow`.

        It may be that of another program. Returns at once if there is none.
        """
        goal = self.read().pose_desired
        try:
            self._watch_path(goal, on_progress or ignore_progress, math.inf)
        except NotReachedError:
            self._abandon_path()
            raise

    def end_path(self) -> ControllerStatus:
        """Let the controller end the path that it follows, if any; return what it says then."""
        none = TimedPoses(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))
        return self._command_path(none)

    def _command_path(self, points: TimedPoses) -> ControllerStatus:
        """Command a path until it is accepted; return what the controller says then."""
        message = messages.trajectory_message(points)
        return self.command_until_answered(topics.TRAJECTORY_COMMAND, message)

    def _abandon_path(self) -> None:
        """End a path without waiting for an answer."""
        none = TimedPoses(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))
        self.publish_command(
            topics.TRAJECTORY_COMMAND,
            messages.trajectory_message(none),
            new_identifier(),
        )

    def _watch_path(
        self,
        goal: Pose,
        on_progress: Callable[[ControllerStatus], None],
        longest_hold: float,
    ) -> None:
        """Wait for the end of a path, which may be held for so long [s]; NotReachedError."""
        interrupted = 0.0
        told_at = -math.inf
        state = self.read()
        self.take_statuses()
        status = self._known_status()
        while status.trajectory:
            last_time = state.time
            state = self.read()
            self.take_statuses()
            status = self._known_status()
            waits = status.trajectory.startswith('waiting') or not _is_controlled(
                status
            )
            is_held = status.held and longest_hold < math.inf
            if waits or is_held:
                interrupted += state.time - last_time
                if not status.held or is_held:
                    _require_passing(status, state, goal, interrupted)
            else:
                interrupted = 0.0
            if time.monotonic() >= told_at + PROGRESS_PERIOD:
                told_at = time.monotonic()
                on_progress(status)
        on_progress(status)

    def _arrive(
        self,
        goal: Pose,
        position_tolerance: float,
        rotation_tolerance: float,
    ) -> None:
        """Wait until the arm is at a goal, as far as contacts leave that free; NotReachedError."""
        waited = 0.0
        state = self.read()
        while True:
            self.take_statuses()
            status = self._known_status()
            distance, angle = _free_distance(state.pose.displacement_to(goal), status)
            arrived = distance <= position_tolerance and angle <= rotation_tolerance
            reference_way = state.pose_desired.displacement_to(goal)
            reference_distance = max(_free_distance(reference_way, status))
            reference_arrived = reference_distance <= REFERENCE_TOLERANCE
            if arrived and reference_arrived and _is_controlled(status):
                return
            _require_passing(status, state, goal, waited)
            last_time = state.time
            state = self.read()
            waited += state.time - last_time

    def _known_status(self) -> ControllerStatus:
        """Return the status that was looked at last; RunError if the controller sends none."""
        status = self.last_status
        if status is None:
            status = self._await_value(
                self.status, f'{topics.STATUS.name}: expected a message'
            )
        return status

    def _limits(self) -> LimitsConfig:
        """Return the controller's limits of the operational point."""
        fields = [
            name
            for name in LimitsConfig.model_fields
            if name.startswith(('operational_', 'workspace_'))
        ]
        parameters = [f'limits.{name}' for name in fields]
        values = self.get_parameters(topics.CONTROLLER, *parameters)
        return LimitsConfig(**dict(zip(fields, values)))

    def read(self) -> ArmState:
        """
        Return the state of a sample that comes from now on.

        RunError if none comes within the timeout.
        """
        forces, estimated, desired, pose, pose_desired = self.receive_fresh(
            *STATE_TOPICS, one_stamp=True
        )
        return ArmState(
            _time_of(forces),
            _efforts_by_name(forces),
            _efforts_by_name(estimated),
            _efforts_by_name(desired),
            _efforts_by_name(self.get_newest(topics.NOISE_VARIANCE) or JointState()),
            *messages.pose_arrays(pose.pose),
            *messages.pose_arrays(pose_desired.pose),
        )

    def wait_until_reached(
        self,
        force_tolerance: float = 0.5,
        timeout: float = 20.0,
        *,
        settle_time: float = 0.2,
    ) -> ArmState:
        """
        Wait until the controller holds the commanded forces; return the state then.

        The mean measured forces of all pressed contacts, over a `settle_time` of the samples [s],
        are within a tolerance [N] of their commands, these contacts are held, and no reaction
        takes the place of control. NotReachedError after a timeout [s] names what is still off.
        """
        messages.require_not_negative('force_tolerance', force_tolerance, 'N')
        messages.require_not_negative('timeout', timeout, 's')
        messages.require_not_negative('settle_time', settle_time, 's')
        deadline = time.monotonic() + timeout
        while True:
            obstacles = self._find_obstacles(force_tolerance, settle_time)
            if not obstacles:
                return self.read()
            if time.monotonic() > deadline:
                raise NotReachedError(
                    f'not within {force_tolerance:g} N after {timeout:g} s: '
                    f'{", ".join(obstacles)}'
                )

    def _find_obstacles(self, tolerance: float, settle_time: float) -> list[str]:
        """Return what keeps the commanded forces from being held in the next samples."""
        samples: list[JointState] = []
        while not samples or 0.0 <= _stamp_difference(samples) < settle_time:
            samples += self.receive_fresh(topics.MEASURED_FORCES)
        means = np.mean([sample.effort for sample in samples], axis=0)
        measured = dict(zip(samples[0].name, means))
        status = self._await_value(
            self.status, f'{topics.STATUS.name}: expected a message'
        )
        obstacles = []
        if not _is_controlled(status):
            obstacles.append(status.text)
        held = STATE_NAMES[HOLDING]
        for name, force in status.forces.items():
            contact = name.partition('/')[0]
            if status.forces[contact] == 0.0:
                continue  # a couple acts while its contact does
            error = abs(measured[name] - force)
            if error > tolerance:
                obstacles.append(f'{name} is off by {error:.3g} N')
            state = status.contact_states.get(name, held)
            if state != held:
                obstacles.append(f'{name} is {state}')
        return obstacles


def _is_controlled(status: ControllerStatus) -> bool:
    """Return whether no reaction takes the place of control; it goes on with a larger R."""
    return status.reaction in (NONE, INFLATE)


def _require_passing(
    status: ControllerStatus,
    state: ArmState,
    goal: Pose,
    lasted: float,
) -> None:
    """End a motion that does not go on by itself, or has not for so long [s]."""
    if lasted <= LONGEST_INTERRUPTION and NAMES[LATCHED] not in status.causes.split():
        return
    distance = np.linalg.norm(goal.position_world - state.position_world)
    place = ', '.join(f'{x:.4g}' for x in state.position_world)
    raise NotReachedError(
        f'{TRAJECTORY}: ended at [{place}] m, {1e3 * distance:.3g} mm from the '
        f'goal: {status.text}'
    )


def _free_distance(way: Vector, status: ControllerStatus) -> tuple[float, float]:
    """Return how far it is along a way that contacts leave free: distance and angle [m, rad]."""
    free = way - _placed(way, status)
    return float(np.linalg.norm(free[:3])), float(np.linalg.norm(free[3:]))


def _placed(way: Vector, status: ControllerStatus) -> Vector:
    """Return the part of a way, shape (6,) [m, rad], that contacts decide."""
    columns = np.array(list(status.placing.values())).reshape(-1, 6)
    return project_on_contacts(way, columns)


def _require_free(
    way: Vector,
    status: ControllerStatus,
    position_tolerance: float,
    rotation_tolerance: float,
) -> None:
    """Refuse a way, shape (6,) [m, rad], that contacts which are sought or held do not allow."""
    placed = _placed(way, status)
    distance, angle = np.linalg.norm(placed.reshape(2, 3), axis=1).tolist()
    if distance > position_tolerance or angle > rotation_tolerance:
        raise CommandRefusedError(
            f'{TRAJECTORY}: goal: expected at most {position_tolerance:g} m and '
            f'{rotation_tolerance:g} rad (position_tolerance, rotation_tolerance) where contacts '
            f'place the tool, got {distance:.3g} m and {angle:.3g} rad; let go of '
            f'{", ".join(status.placing)} first: command 0 N'
        )


def _require_time(duration: float, way: Vector, limits: LimitsConfig) -> None:
    """Refuse to go a way, shape (6,) [m, rad], in a shorter time than the limits allow [s]."""
    shortest = shortest_motion_duration(way, limits)
    if duration < shortest:
        raise CommandRefusedError(
            f'{TRAJECTORY}: duration: expected at least {shortest:.3g} s for '
            f'{np.linalg.norm(way[:3]):.3g} m and {np.linalg.norm(way[3:]):.3g} rad '
            f'(limits.operational_*), got {duration:g} s'
        )


def _time_of(message: JointState) -> float:
    """Return the stamp of a message [s]."""
    return messages.stamp_to_ns(message.header.stamp) * 1e-9


def _stamp_difference(samples: list[JointState]) -> float:
    """Return the time from the first sample to the last [s]."""
    return _time_of(samples[-1]) - _time_of(samples[0])


def _efforts_by_name(message: JointState) -> dict[str, float]:
    """Return the efforts of a message by their names."""
    return dict(zip(message.name, message.effort))
