"""The controller from a Python program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import time

from multicontact_control.arrays import Vector
from multicontact_control.config import LimitsConfig
from multicontact_control.control.tasks import quintic
from multicontact_control.errors import CommandError, RunError
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.link import CommandRefusedError, ControllerLink, DEACTIVATE
from multicontact_control.nodes.messages import ControllerStatus, new_identifier
from multicontact_control.supervision.command_limits import check_position
from multicontact_control.supervision.contacts import HOLDING, NAMES
from multicontact_control.supervision.reactions import INFLATE, NONE
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

__all__ = [
    'ArmState', 'CommandRefusedError', 'ControllerStatus', 'MultiContactClient', 'NotReachedError']

STATE_TOPICS = (
    topics.MEASURED_FORCES, topics.ESTIMATED_FORCES, topics.DESIRED_FORCES, topics.POSE,
    topics.POSE_DESIRED)
WORKSPACE = ('limits.workspace_lower', 'limits.workspace_upper')


class NotReachedError(RunError):
    """The contact forces did not come near their commands in time."""


@dataclass(frozen=True, slots=True)
class ArmState:
    """One sample: forces by contact name, and poses in world axes."""

    time: float  # its stamp [s]
    forces: dict[str, float]  # N
    forces_estimated: dict[str, float]  # 0 where none is controlled
    forces_desired: dict[str, float]  # the same
    noise_variance: dict[str, float]  # the newest R [N^2], empty if no estimator runs
    position_world: Vector  # m
    quaternion_xyzw: Vector
    position_desired: Vector
    quaternion_desired: Vector


class MultiContactClient(ControllerLink):
    """
    Commands a running controller and reads its state, in a with statement and one thread.

    The clock is that of the samples; only timeouts look at the wall clock. Every method raises
    `RunError` if what it waits for does not come, and where the controller refuses. At the end,
    or by `close`, the client leaves; the controller goes on with its last commands.

    Parameters
    ----------
    namespace, domain_id
        Of the controller; by default the domain of the environment.
    timeout
        Longest wait for an answer or a sample [s].

    """

    def __init__(
        self, namespace: str = '', *, domain_id: int | None = None, timeout: float = 10.0,
    ) -> None:
        super().__init__((*STATE_TOPICS, topics.NOISE_VARIANCE), namespace=namespace,
                         domain_id=domain_id, timeout=timeout)
        self._commanded: dict[str, float] = {}

    def activate(self) -> None:
        """Configure and activate estimator and controller; they know of no command from before."""
        if self.has_lifecycle(topics.ESTIMATOR, wait=1.0):
            self.bring_up(topics.ESTIMATOR)
        if self.bring_up(topics.CONTROLLER):
            self._commanded.clear()

    def deactivate(self) -> None:
        """Let the controller command its safe behaviour and obey no more."""
        if self.state(topics.CONTROLLER) == 'active':
            self.change(topics.CONTROLLER, DEACTIVATE)
        self._commanded.clear()

    def status(self) -> ControllerStatus | None:
        """Return what the controller has said of itself last, None if nothing so far."""
        self.look()
        return self.last_status

    def hold(self, on: bool = True) -> None:
        """Hold the arm where it is and obey no motion, or let go of it again."""
        self.ask('hold', SetBool, SetBool.Request(data=on))

    def tare(self) -> None:
        """Take what the wrist sensor reads now for its zero; nothing may touch the tool."""
        self.ask('tare', Trigger, Trigger.Request())

    def retry(self) -> None:
        """Resume control that waits for an operator, and seek contacts that were given up."""
        self.ask('retry', Trigger, Trigger.Request())

    def set_forces(
        self, forces: Mapping[str, float], centres: Mapping[str, float] | None = None,
    ) -> None:
        """
        Command contact forces, and return when they are accepted; other contacts keep theirs.

        Parameters
        ----------
        forces
            Desired force by contact name, or couple, e.g. ``blade/along`` [N, N m]; 0 gives the
            contact back to motion control.
        centres
            Centre of pressure by the couple's name, from the middle of the contact [m].

        Raises
        ------
        CommandRefusedError
            If the controller refuses: nothing changes; centres are commanded after the forces.
        MessageError
            If a force is not finite.

        """
        self.fresh(topics.DESIRED_FORCES)  # before its first sample it refuses
        if forces:
            self.command(topics.FORCE_COMMAND, messages.joint_state_message(
                0, list(forces), effort=list(forces.values())))
            self._commanded.update(forces)
        if centres:  # couples that follow the forces of their contacts
            self.command(topics.FORCE_COMMAND, messages.joint_state_message(
                0, list(centres), position=list(centres.values())))
            self._commanded = {name: force for name, force in self._commanded.items()
                               if name not in centres}

    def move(
        self, position_world: ArrayLike, duration: float, *,
        quaternion_xyzw: ArrayLike | None = None,
    ) -> None:
        """
        Move the desired operational point to a goal, and return when it has got there.

        Along a straight line with a quintic in time, at rest at both ends; without effect along
        the normals of controlled contacts.

        Parameters
        ----------
        position_world, quaternion_xyzw
            Goal, shape (3,) [m], and orientation to turn to, the present one by default.
        duration
            Time to get there [s].

        Raises
        ------
        CommandRefusedError
            If the goal is out of the workspace or not obeyed; the arm stays where it got to.
        MessageError
            If a number is not finite, or the duration is not above 0.

        """
        if not 0.0 < duration < np.inf:
            raise messages.MessageError('duration', 'above 0 s', f'{duration:g} s')
        goal = messages.finite_array(position_world, 3, 'position_world')
        lower, upper = self.parameters(topics.CONTROLLER, *WORKSPACE)
        try:
            check_position(goal, LimitsConfig(workspace_lower=lower, workspace_upper=upper))
        except CommandError as error:
            raise CommandRefusedError(f'{topics.MOTION_COMMAND.name}: {error}') from None
        # All that takes time comes first: the motion runs from the sample that it starts at.
        start = self.read()
        self.command(topics.MOTION_COMMAND, messages.motion_message(
            start.position_desired, start.quaternion_desired, np.zeros(6), np.zeros(6)))
        start = self.read()
        turn = Rotation.from_quat(start.quaternion_desired)
        last = turn if quaternion_xyzw is None else Rotation.from_quat(
            messages.finite_array(quaternion_xyzw, 4, 'quaternion_xyzw'))
        rotation_vector = (last * turn.inv()).as_rotvec()
        change = np.concatenate([goal - start.position_desired, rotation_vector])
        elapsed, identifier = 0.0, new_identifier()
        while elapsed < duration:
            before, elapsed = elapsed, self.read().time - start.time
            if elapsed < before:
                raise RunError(f'samples begin anew, {before - elapsed:.3g} s before the last')
            s, ds, dds = quintic(min(elapsed, duration), duration)
            point = messages.motion_message(
                start.position_desired + s * change[:3],
                (Rotation.from_rotvec(s * rotation_vector) * turn).as_quat(),
                ds * change, dds * change)
            self.accepted(identifier)  # what it refuses of the way ends the motion
            if elapsed < duration:
                self.send(topics.MOTION_COMMAND, point, identifier)
        self.command(topics.MOTION_COMMAND, point)
        self.read()

    def read(self) -> ArmState:
        """Return the state of a sample that comes from now on."""
        forces, estimated, desired, pose, pose_desired = self.fresh(
            *STATE_TOPICS, one_stamp=True)
        return ArmState(
            messages.stamp_to_ns(forces.header.stamp) * 1e-9, _by_name(forces),
            _by_name(estimated), _by_name(desired),
            _by_name(self.newest(topics.NOISE_VARIANCE) or JointState()),
            *messages.pose_arrays(pose.pose), *messages.pose_arrays(pose_desired.pose))

    def wait_until_reached(
        self, force_tolerance: float = 0.5, timeout: float = 20.0, *, settle_time: float = 0.2,
    ) -> ArmState:
        """
        Wait until the controller holds what this client commanded; return the state then.

        The mean of the measured forces is near the commands, the pressed contacts are held, and
        no reaction takes the place of control.

        Parameters
        ----------
        force_tolerance
            Largest difference between a command and the mean measured force [N].
        timeout, settle_time
            Longest wait, and the time of the samples that the mean is taken over [s].

        Raises
        ------
        NotReachedError
            Naming the contacts that are still off, and what the controller does instead.

        """
        commanded = np.array(list(self._commanded.values()))
        seen: list[Vector] = []
        start, give_up = 0.0, time.monotonic() + timeout
        while True:
            message, = self.fresh(topics.MEASURED_FORCES)
            now, forces = messages.stamp_to_ns(message.header.stamp) * 1e-9, _by_name(message)
            if not seen or now < start:  # or their clock was set back
                start, seen = now, []
            seen.append(np.array([forces[name] for name in self._commanded]))
            off = np.abs(np.mean(seen, axis=0) - commanded)
            obstacle = self._obstacle()
            if obstacle:
                seen = []
            elif now - start >= settle_time:
                if (off <= force_tolerance).all():
                    return self.read()
                seen = []
            if time.monotonic() > give_up:
                far = [f'{name} is off by {value:.3g} N' for name, value
                       in zip(self._commanded, off) if value > force_tolerance]
                raise NotReachedError(
                    f'not within {force_tolerance:g} N after {timeout:g} s: '
                    f'{", ".join([*far, *filter(None, [obstacle])]) or "too few samples"}')

    def _obstacle(self) -> str:
        """Return what keeps the commanded forces from being controlled, empty for nothing."""
        status = self.status()
        if status is None or not self._commanded:
            return ''
        if status.reaction not in (NONE, INFLATE):  # control goes on with a larger R
            return status.text
        return ', '.join(f'{name} is {state}' for name, state in status.contact_states.items()
                         if self._commanded.get(name, 0.0) > 0.0 and state != NAMES[HOLDING])


def _by_name(message: JointState) -> dict[str, float]:
    return dict(zip(message.name, message.effort))
