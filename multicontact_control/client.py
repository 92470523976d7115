"""
The controller from a Python program.

>>> from multicontact_control.client import MultiContactClient
>>> with MultiContactClient() as arm:  # doctest: +SKIP
...     arm.set_forces({'table': 10.0, 'board': 5.0})
...     state = arm.wait_until_reached(force_tolerance=1.0, timeout=20.0)
...     arm.move(state.position_world + [0.05, 0.0, 0.0], duration=2.0)
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
import math
import re
import time
from typing import Any, NamedTuple
import warnings

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from multicontact_control.arrays import Vector
from multicontact_control.errors import RunError
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.link import ControllerLink
from multicontact_control.quintic import quintic
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

OPTIONAL_WAIT = 1.0
STATE_TOPICS = (
    topics.MEASURED_FORCES, topics.ESTIMATED_FORCES, topics.DESIRED_FORCES, topics.POSE,
    topics.POSE_DESIRED)
SENT_KEPT = 32  # commands, for refusals that are late
# A refusal of one force, or couple, as it was sent; others name none, or what contacts share.
OF_ONE_FORCE = re.compile(r': (?:force on|couple) (\S+): expected (?!.*share).*, found (\S+) N$')


class NotReachedError(RunError):
    """The contact forces did not come near their commands in time."""


class CommandRefusedError(RunError):
    """The controller does not obey a command, and says why."""


class CommandRefusedWarning(UserWarning):
    """The controller has refused a command that nobody has waited for."""


@dataclass(frozen=True, slots=True)
class ControllerStatus:
    """
    What the controller says of itself.

    Attributes
    ----------
    event
        Why it says it: ``refused`` a command, or told its ``state``.
    text
        What it does, ``ok`` if that is what it is asked for.
    life_cycle
        ``active`` or ``inactive``.
    reaction, causes
        ``none``, or what it does instead of control, and why.
    contacts
        State of each contact in words.
    refused, last_refusal
        How many commands it has refused so far, and the last of them.
    held
        Whether it holds pose and forces on command.
    push_test
        What the push test asks for; empty if it asks for nothing.
    forces
        What is obeyed by contact, and couple [N]; empty if it follows a scenario.

    """

    event: str
    text: str
    life_cycle: str
    reaction: str
    causes: str
    contacts: str
    refused: int
    last_refusal: str
    held: bool
    push_test: str
    forces: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, message: DiagnosticStatus) -> ControllerStatus:
        """Return what a message on ``~/status`` says."""
        values = {x.key: x.value for x in message.values}
        forces = [each.rsplit(' ', 1) for each in values.get('forces', '').split(', ') if each]
        return cls(
            values['event'], message.message, values['life_cycle'], values['reaction'],
            values['causes'], values['contacts'], int(values['refused']),
            values['last_refusal'], values['held'] == str(True), values['push_test'],
            {name: float(force) for name, force in forces})

    def refuses(self, topic: topics.Topic, before: ControllerStatus | None) -> bool:
        """Return whether it says that a command on a topic was refused since `before`."""
        # Of those that come close after each other only the count tells.
        more = before is not None and self.refused > before.refused
        return self.last_refusal.startswith(topic.name) and (self.event == 'refused' or more)

    def obeys(self, forces: Mapping[str, float]) -> bool:
        """Return whether it says that all these forces [N] are obeyed."""
        return bool(self.forces) and all(
            math.isclose(force, self.forces.get(name, math.nan), rel_tol=1e-6, abs_tol=1e-9)
            for name, force in forces.items())


@dataclass(frozen=True, slots=True)
class ArmState:
    """
    What the controller says of one sample.

    Attributes
    ----------
    time
        Stamp of the sample [s].
    forces, forces_estimated, forces_desired
        Contact forces by contact name [N]; estimated and desired are 0 where none is controlled.
    noise_variance
        R by contact name [N^2], the newest; empty if no estimator runs.
    position_world, quaternion_xyzw
        Pose of the operational point [m].
    position_desired, quaternion_desired
        Where it should be.

    """

    time: float
    forces: dict[str, float]
    forces_estimated: dict[str, float]
    forces_desired: dict[str, float]
    noise_variance: dict[str, float]
    position_world: Vector
    quaternion_xyzw: Vector
    position_desired: Vector
    quaternion_desired: Vector


class _Sent(NamedTuple):
    """Forces that were sent, NaN for centres of pressure, and what was commanded before [N]."""

    forces: dict[str, float]
    before: dict[str, float]

    def holds(self, name: str, force: str) -> bool:
        """Return whether a refusal of a force, as it is written, is of this command."""
        return name in self.forces and f'{self.forces[name]:g}' == force


class MultiContactClient:
    """
    Commands a running controller and reads its state; to be used in a with statement.

    The clock of everything is that of the samples, so a simulation in lockstep or with a pause
    is no different from a robot. Only timeouts look at the wall clock. Not for use by several
    threads at once.

    Parameters
    ----------
    namespace
        Namespace of the controller.
    domain_id
        ROS domain; that of the environment by default.
    timeout
        Longest wait for an answer or a sample [s].

    """

    def __init__(
        self, namespace: str = '', *, domain_id: int | None = None, timeout: float = 10.0,
    ) -> None:
        self._link = ControllerLink(
            (*STATE_TOPICS, topics.NOISE_VARIANCE), queued=(topics.STATUS,),
            namespace=namespace, domain_id=domain_id, timeout=timeout)
        self._force_publisher = self._link.publisher(topics.FORCE_COMMAND)
        self._motion_publisher = self._link.publisher(topics.MOTION_COMMAND)
        self._commanded: dict[str, float] = {}
        self._sent: deque[_Sent] = deque(maxlen=SENT_KEPT)
        self._status: ControllerStatus | None = None
        self._refusals: dict[topics.Topic, str] = {}

    def __enter__(self) -> MultiContactClient:
        """Return the client itself."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Leave the graph; the controller goes on with its last commands."""
        self.close()

    def close(self) -> None:
        """Leave the graph; the controller goes on with its last commands."""
        self._link.close()

    def activate(self) -> None:
        """
        Configure and activate estimator and controller, as far as they are not.

        A controller that is activated knows of no command from before.

        Raises
        ------
        RunError
            If the controller has no lifecycle, does not answer or refuses.

        """
        if self._link.has_lifecycle(topics.ESTIMATOR, OPTIONAL_WAIT):
            self._link.bring_up(topics.ESTIMATOR)
        if self._link.bring_up(topics.CONTROLLER):
            self._forget()

    def deactivate(self) -> None:
        """
        Let the controller command its safe behaviour and obey no more.

        Raises
        ------
        RunError
            If the controller has no lifecycle, does not answer or refuses.

        """
        self._link.take_down(topics.CONTROLLER)
        self._forget()

    def _forget(self) -> None:
        """Forget what was commanded, as the controller does."""
        self._commanded.clear()
        self._sent.clear()
        self._refusals.pop(topics.FORCE_COMMAND, None)

    def status(self) -> ControllerStatus | None:
        """Return what the controller has said of itself last, None if nothing so far."""
        for message in self._link.queue(topics.STATUS):
            status, before = ControllerStatus.of(message), self._status
            for topic in (topics.FORCE_COMMAND, topics.MOTION_COMMAND):
                # Of motions, which go on coming, the next one tells.
                if status.refuses(topic, before if topic is topics.FORCE_COMMAND else None) and (
                        topic is topics.MOTION_COMMAND or self._may_be_mine(status, before)):
                    self._refusals[topic] = f'{topics.CONTROLLER}: refused: {status.last_refusal}'
            self._status = status
        return self._status

    def _may_be_mine(self, status: ControllerStatus, before: ControllerStatus | None) -> bool:
        """Return whether the forces that were refused may be those of this client."""
        if not self._sent:
            return False
        told = OF_ONE_FORCE.search(status.last_refusal)
        several = before is not None and status.refused > before.refused + 1
        if told and not several and not any(sent.holds(*told.groups()) for sent in self._sent):
            return False
        return not self._is_obeyed(status)

    def _is_obeyed(self, status: ControllerStatus | None) -> bool:
        """Return whether all that this client commanded is known to be obeyed."""
        centred = any(math.isnan(force) for sent in list(self._sent)[-1:]
                      for force in sent.forces.values())
        return status is not None and not centred and status.obeys(self._commanded)

    def _refusal(self, topic: topics.Topic) -> str:
        """Return the newest refusal on a topic that nobody was told of, empty without any."""
        status = self.status()
        told = self._refusals.pop(topic, '')
        if not told or topic is not topics.FORCE_COMMAND:
            return told
        if self._is_obeyed(status):
            return ''  # somebody else's, before this client's came
        self._undo(told, status)
        return told

    def _undo(self, refusal: str, status: ControllerStatus | None) -> None:
        """Take back what was refused: the command with that force, or all that is not obeyed."""
        told = OF_ONE_FORCE.search(refusal)
        named = [sent for sent in self._sent if told and sent.holds(*told.groups())][-1:]
        known = {} if status is None else status.forces
        for sent in named or reversed(list(self._sent)[0 if known else -1:]):
            for name, force in sent.forces.items():
                if self._commanded.get(name, math.nan) != force and not math.isnan(force):
                    continue  # another command has taken its place
                if status is not None and status.obeys({name: force}):
                    continue
                if name in sent.before:
                    self._commanded[name] = known.get(name, sent.before[name])
                else:
                    self._commanded.pop(name, None)

    def _raise_refusal(self, topic: topics.Topic) -> None:
        """Raise if the controller has refused a command on a topic."""
        told = self._refusal(topic)
        if told:
            raise CommandRefusedError(told)

    def hold(self, on: bool = True) -> None:
        """
        Hold the arm where it is and obey no motion, or let go of it again.

        Raises
        ------
        RunError
            If the controller does not answer or refuses.

        """
        self._ask('hold', SetBool, SetBool.Request(data=on))

    def tare(self) -> None:
        """
        Take what the wrist sensor reads now for its zero; nothing may touch the tool.

        Raises
        ------
        RunError
            If the controller does not answer or refuses.

        """
        self._ask('tare', Trigger, Trigger.Request())

    def retry(self) -> None:
        """
        Resume control that waits for an operator, and seek contacts that were given up.

        Raises
        ------
        RunError
            If the controller does not answer, or there is nothing of that.

        """
        self._ask('retry', Trigger, Trigger.Request())

    def _ask(self, what: str, service: Any, request: Any) -> None:
        answer = self._link.require(topics.CONTROLLER, service, what, request)
        if not answer.success:
            raise RunError(f'{topics.CONTROLLER}: {what} refused: {answer.message}')

    def set_forces(
        self, forces: Mapping[str, float], centres: Mapping[str, float] | None = None,
    ) -> None:
        """
        Command contact forces; contacts that are not named keep theirs.

        If the controller refuses them, `wait_until_reached` raises that; the next command warns
        of it if that was not called.

        Parameters
        ----------
        forces
            Desired force by contact name [N]; 0 gives the contact back to motion control. The
            couples of an edge or plane have names of their own, e.g. ``blade/along``.
        centres
            Where the centre of pressure is to be instead, by the couple's name: how far from the
            middle of the contact [m].

        Raises
        ------
        CommandRefusedError
            If the controller has no such contact.
        RunError
            If no controller runs or listens.
        MessageError
            If a force is not finite.

        """
        # A command from before the first sample would be forgotten by it.
        desired, = self._link.fresh(topics.DESIRED_FORCES)
        unknown = sorted({*forces, *(centres or {})} - set(desired.name))
        if unknown:
            raise CommandRefusedError(
                f'{topics.FORCE_COMMAND.name}: expected contacts among {", ".join(desired.name)}, '
                f'found {", ".join(unknown)}')
        self._link.is_heard(topics.STATUS, OPTIONAL_WAIT)
        told = self._refusal(topics.FORCE_COMMAND)
        if told:
            warnings.warn(told, CommandRefusedWarning, stacklevel=2)
        self._sent.append(_Sent(
            {**forces, **dict.fromkeys(centres or {}, math.nan)}, dict(self._commanded)))
        if forces:
            self._link.publish(self._force_publisher, messages.joint_state_message(
                0, list(forces), effort=list(forces.values())))
        if centres:
            self._link.publish(self._force_publisher, messages.joint_state_message(
                0, list(centres), position=list(centres.values())))
        self._commanded.update(forces)
        for name in centres or {}:
            self._commanded.pop(name, None)

    def move(
        self, position_world: ArrayLike, duration: float, *,
        quaternion_xyzw: ArrayLike | None = None,
    ) -> None:
        """
        Move the operational point, and return when the command has got there.

        From where it should be now to the goal along a straight line, with a quintic in time:
        at rest and without acceleration at both ends. Controlled contacts keep their force;
        along their normals the motion has no effect.

        Parameters
        ----------
        position_world
            Goal, shape (3,) [m].
        duration
            Time to get there [s].
        quaternion_xyzw
            Orientation to turn to; the present one if not given.

        Raises
        ------
        RunError
            If no controller listens or answers, or samples stop coming or begin anew.
        CommandRefusedError
            If the controller does not obey; the arm stays where it got to.
        MessageError
            If a number is not finite, or the duration is not above 0.

        """
        if not 0.0 < duration < math.inf:
            raise messages.MessageError('duration', 'above 0 s', f'{duration:g} s')
        goal = messages.finite_array(position_world, 3, 'position_world')
        # All that takes time comes first: the motion runs from the sample that it starts at.
        self._link.is_heard(topics.STATUS, OPTIONAL_WAIT)
        self._link.wait_for_controller(self._motion_publisher)
        # Once it answers, the controller has refused what it will of the motions before.
        self._link.state(topics.CONTROLLER)
        self._refusal(topics.MOTION_COMMAND)
        start, = self._link.fresh(topics.POSE_DESIRED)
        position, turn = _pose_of(start)
        last = turn if quaternion_xyzw is None else Rotation.from_quat(
            messages.finite_array(quaternion_xyzw, 4, 'quaternion_xyzw'))
        rotation_vector = (last * turn.inv()).as_rotvec()
        first_stamp, elapsed = messages.stamp_to_ns(start.header.stamp), 0.0
        while elapsed < duration:
            self._raise_refusal(topics.MOTION_COMMAND)
            sample, = self._link.fresh(topics.POSE_DESIRED)
            before = elapsed
            elapsed = (messages.stamp_to_ns(sample.header.stamp) - first_stamp) * 1e-9
            if elapsed < before:
                raise RunError(f'{topics.POSE_DESIRED.name}: expected stamps that go on, found '
                               f'one {before - elapsed:.3g} s before the last: samples begin anew')
            s, ds, dds = quintic(min(elapsed, duration), duration)
            change = np.concatenate([goal - position, rotation_vector])
            self._link.publish(self._motion_publisher, messages.motion_message(
                position + s * change[:3],
                (Rotation.from_rotvec(s * rotation_vector) * turn).as_quat(),
                ds * change, dds * change))
        self._link.fresh(topics.POSE_DESIRED)
        self._raise_refusal(topics.MOTION_COMMAND)

    def read(self) -> ArmState:
        """
        Return the state of a sample that comes from now on.

        Raises
        ------
        RunError
            If none comes.

        """
        forces, estimated, desired, pose, pose_desired = self._link.fresh_sample(
            *STATE_TOPICS)
        variance = self._link.newest(topics.NOISE_VARIANCE)
        position, rotation = _pose_of(pose)
        position_desired, rotation_desired = _pose_of(pose_desired)
        return ArmState(
            time=messages.stamp_to_ns(forces.header.stamp) * 1e-9, forces=_by_name(forces),
            forces_estimated=_by_name(estimated),
            forces_desired=_by_name(desired),
            noise_variance={} if variance is None else _by_name(variance),
            position_world=position, quaternion_xyzw=rotation.as_quat(),
            position_desired=position_desired, quaternion_desired=rotation_desired.as_quat())

    def wait_until_reached(
        self, force_tolerance: float = 0.5, timeout: float = 20.0, *, settle_time: float = 0.2,
    ) -> ArmState:
        """
        Wait until the measured forces are what this client commanded.

        Parameters
        ----------
        force_tolerance
            Largest difference between a command and the mean measured force [N].
        timeout
            Longest wait [s].
        settle_time
            Time that mean is taken over, in the time of the samples [s].

        Returns
        -------
        ArmState
            The state then.

        Raises
        ------
        NotReachedError
            Naming the contacts that are still off, and what the controller does instead.
        CommandRefusedError
            If it does not obey a command.
        RunError
            If samples stop coming.

        """
        wanted = np.array(list(self._commanded.values()))
        seen: deque[tuple[float, Vector]] = deque()
        give_up = time.monotonic() + timeout
        while True:
            message, = self._link.fresh(topics.MEASURED_FORCES)
            self._raise_refusal(topics.FORCE_COMMAND)
            now, forces = messages.stamp_to_ns(message.header.stamp) * 1e-9, _by_name(message)
            missing = set(self._commanded) - set(forces)
            if missing:
                raise RunError(f'contact_forces/measured: expected {", ".join(sorted(missing))}, '
                               f'found {", ".join(forces)}')
            if seen and now < seen[-1][0]:
                seen.clear()  # their clock was set back
            seen.append((now, np.array([forces[name] for name in self._commanded])))
            settled = now - seen[0][0] >= settle_time
            while len(seen) > 1 and now - seen[1][0] >= settle_time:
                seen.popleft()
            off = np.abs(np.mean([values for _, values in seen], axis=0) - wanted)
            if settled and (off <= force_tolerance).all():
                return self.read()
            if time.monotonic() > give_up:
                raise NotReachedError(f'not within {force_tolerance:g} N after {timeout:g} s: ' + (
                    ', '.join(f'{name} is off by {value:.3g} N' for name, value
                              in zip(self._commanded, off) if value > force_tolerance)
                    or 'too few samples') + self._doing())

    def _doing(self) -> str:
        """Say what the controller does instead of pressing, if it is known."""
        status = self.status()
        if status is None:
            return ''
        return f'; the controller: {status.text} (contacts: {status.contacts or "unknown"})'


def _by_name(message: JointState) -> dict[str, float]:
    return dict(zip(message.name, message.effort))


def _pose_of(message: PoseStamped) -> tuple[Vector, Rotation]:
    p, q = message.pose.position, message.pose.orientation
    return np.array([p.x, p.y, p.z]), Rotation.from_quat([q.x, q.y, q.z, q.w])
