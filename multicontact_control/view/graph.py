"""A graph that runs, joined from outside: its topics are listened to, its commands are used."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import math
import time
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.errors import MulticontactError, RunError
from multicontact_control.judging.supervisor_events import LogLine, SupervisorEvent
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.controller_topics import MARKER_NAMESPACE
from multicontact_control.nodes.link import CommandRefusedError, ControllerLink
from multicontact_control.nodes.messages import ControllerStatus, REFUSED
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision.causes import NONE
from multicontact_control.view import source
from multicontact_control.view.steering import GraphSteering
from multicontact_control.view.streams import BLOCK_TIME, CurveStreams
from multicontact_control.view.surfaces import SimulatedSurfaces
import numpy as np
from sim_bridge.config import PUSH_TIME
from sim_bridge.robots import find_robot, robot_names
from visualization_msgs.msg import Marker

PATIENCE = 10.0  # s; until a process has found the others may take three
SILENCE = 1.0  # s without a sample, after which that is shown
PACE_TIME = 2.0  # s, over which the real-time factor is taken
LISTENED = (
    topics.JOINT_STATES,
    topics.MEASURED_FORCES,
    topics.POSE,
    topics.POSE_DESIRED,
    topics.SURFACE_MARKERS,
    topics.CONTACT_MARKERS,
    topics.DIAGNOSTICS,
    topics.PUSH,
)
LOOP = f'{topics.CONTROLLER}: loop'  # name of its diagnostics
FORCE_CEILING = 'command.force_ceiling'
JOINT_NAMES = 'robot.joint_names'
# Stands in for the status of a controller that has not sent one so far.
UNKNOWN_STATUS = ControllerStatus(
    event='state',
    command='',
    text='',
    life_cycle='',
    reaction=NONE,
    causes='',
    contacts='',
    held=False,
    refused=0,
    readers=0,
    push_test='',
    forces={},
)


class GraphSource:
    """
    Listens to a controller and commands it.

    It is a `source.SnapshotSource` that never waits for a sample: the page draws the newest one,
    and curves with the extremes of all.

    Parameters
    ----------
    setup
        What is known of controller and arm.
    title
        What is shown, in a few words.
    namespace, domain_id
        Where the controller is.
    check
        Called at every poll; raises RunError if the graph has ended.

    Attributes
    ----------
    scene
        What stays the same: the configuration, the surfaces and the force ceiling.

    Raises
    ------
    RunError
        If no controller is active there, or it is another one.

    """

    def __init__(
        self,
        setup: Setup,
        title: str = 'graph, as it runs',
        *,
        namespace: str = '',
        domain_id: int | None = None,
        check: Callable[[], object] = lambda: None,
    ) -> None:
        config = setup.controller
        self._config = config
        self._check = check
        self._link = ControllerLink(
            LISTENED,
            namespace=namespace,
            domain_id=domain_id,
            timeout=PATIENCE,
            on_status=self._note_status,
        )
        self._curves = CurveStreams(self._link.node, config)
        self._pushed_links = {'': config.robot.operational_frame}  # by frame of a push
        if setup.simulated:
            self._pushed_links['tool'] = setup.plant.tool_push_link
        self._push: source.DrawnPush | None = None
        self._push_end = 0.0  # time of the samples [s]
        self._statuses = StatusDescriber(config.contact_names)
        self._timing = source.LoopTiming()
        self._events: list[LogLine] = []
        self._normals = {
            name: np.array(config.contacts[name].normal_world)
            for name in config.contact_names
        }
        # Stamps of the first sample and the newest [ns].
        self._start = -1
        self._stamp = -1
        # Whether the next snapshot is the first since samples began.
        self._begins_anew = True
        # Times of the clock [s].
        self._sample_heard = time.monotonic()
        self._next_point = 0.0
        self._next_snapshot = 0.0
        # Times of the clock [s] and stamps [ns] of the last snapshots.
        self._stamps: deque[tuple[float, int]] = deque(
            maxlen=round(PACE_TIME * source.RATE)
        )
        try:
            gains, force_ceiling = self._meet_controller()
            self._surfaces = SimulatedSurfaces(self._link)
            self._steering = GraphSteering(
                self._link, config.limits, self._surfaces, gains
            )
        except BaseException:
            self._link.close()
            raise
        self._curves.take_messages()
        true_forces = self._curves.get_newest(topics.TRUE_FORCES)
        surfaces = self._surfaces.drawn
        if not surfaces:
            surfaces = source.list_felt_surfaces(config)
        self.scene = source.Scene(
            title,
            config,
            setup.urdf_dir,
            surfaces,
            simulated=dict(self._surfaces.states),
            largest_force=force_ceiling,
            true_forces=bool(np.isfinite(true_forces).any()),
        )

    def _meet_controller(self) -> tuple[dict[str, float], float]:
        """Check that the controller is the expected one; return its gains and force ceiling."""
        (message,) = self._link.receive_fresh(topics.MEASURED_FORCES)
        *gains, force_ceiling, joint_names = self._link.get_parameters(
            topics.CONTROLLER, *source.GAIN_NAMES, FORCE_CEILING, JOINT_NAMES
        )
        _require_joints(self._config.robot.joint_names, tuple(joint_names))
        expected = self._config.column_names
        if tuple(message.name) != expected:
            raise RunError(
                f'contact_forces/measured: expected {", ".join(expected)}, got '
                f'{", ".join(message.name)}; name its --scenario and --plant'
            )
        return dict(zip(source.GAIN_NAMES, gains)), force_ceiling

    def take_snapshots(self) -> list[source.Snapshot]:
        """
        Return a snapshot if it is time for one, and command the next pose of a motion.

        See `SnapshotSource.take_snapshots`. There is none before the first pose, and then
        `source.RATE` of them in a second.

        Raises
        ------
        RunError
            If the graph has ended, as the `check` of the constructor says.

        """
        self._check()
        now = time.monotonic()
        self._curves.take_messages()
        self._take_sample(now)
        self._link.take_statuses()
        if now < self._next_snapshot:
            return []
        self._next_snapshot = now + 1.0 / source.RATE
        pose = self._link.get_newest(topics.POSE)
        desired_pose = self._link.get_newest(topics.POSE_DESIRED)
        if pose is None or desired_pose is None:
            return []
        self._take_timing(now)
        self._take_normals()
        self._take_pushes()
        return [self._make_snapshot(now, pose, desired_pose)]

    def give_command(self, name: str, /, **values: Any) -> str:
        """
        Give a command, and return what comes of it; see `SnapshotSource.give_command`.

        A refusal is an event of the next snapshot: by the page here, by the controller in its
        status.
        """
        try:
            return self._steering.give_command(name, **values)
        except CommandRefusedError:
            raise
        except MulticontactError as error:
            self._add_event(f'refused: {error}')
            raise

    def close(self) -> None:
        """Leave the graph, which goes on."""
        self._link.close()

    @property
    def _time(self) -> float:
        """Time of the newest sample [s] since the first that was heard."""
        return 1e-9 * (self._stamp - self._start)

    def _add_event(self, text: str) -> None:
        self._events.append((self._time, text))

    def _take_sample(self, now: float) -> None:
        """Go on with motion and curves if a sample has come."""
        message = self._link.get_newest(topics.MEASURED_FORCES)
        if message is None:
            return
        before = self._stamp
        self._stamp = messages.stamp_to_ns(message.header.stamp)
        if self._stamp == before:
            return
        samples_begin = before < 0 or self._stamp < before
        if samples_begin:
            self._start = self._stamp
            self._begins_anew = True
            self._curves.begin_anew()
        self._sample_heard = now
        self._steering.advance_motion(1e-9 * (self._stamp - before))
        if now >= self._next_point:
            self._next_point = now + BLOCK_TIME
            self._curves.add_points(self._time)

    def _note_status(self, status: ControllerStatus) -> None:
        """Tell what a status changes or refuses, and end a motion that is not obeyed."""
        refuses_motion = self._steering.refuses_motion(status)
        for text in self._statuses.describe_changes(status, refuses_motion):
            self._add_event(text)
        reason = self._steering.end_disobeyed_motion(status)
        if reason:
            self._add_event(f'motion stopped: {reason}')

    def _take_timing(self, now: float) -> None:
        """Take the loop's timing from its diagnostics, and the pace from stamps and clock."""
        self._stamps.append((now, self._stamp))
        earlier, earlier_stamp = self._stamps[0]
        pace = 1.0
        if now > earlier:
            pace = 1e-9 * (self._stamp - earlier_stamp) / (now - earlier)
        self._timing = self._timing._replace(pace=pace)
        for report in self._link.take_queued(topics.DIAGNOSTICS):
            for part in report.status:
                _, _, name = part.name.rpartition('/')
                if name == LOOP:
                    self._timing = _read_loop_timing(part, self._timing)

    def _take_normals(self) -> None:
        """Take the normals, which a controller may find on-line, from the arrows of the forces."""
        message = self._link.get_newest(topics.CONTACT_MARKERS)
        if message is None:
            return
        for marker in message.markers:
            name = marker.ns.removeprefix(f'{MARKER_NAMESPACE}/')
            if name in self._normals and marker.action == Marker.ADD:
                tail, tip = map(_read_point, marker.points)
                self._normals[name] = (tip - tail) / np.linalg.norm(tip - tail)

    def _take_pushes(self) -> None:
        """Take the pushes that are asked for, from here or elsewhere, for as long as they last."""
        for message in self._link.take_queued(topics.PUSH):
            frame = message.header.frame_id
            force = (message.vector.x, message.vector.y, message.vector.z)
            link = self._pushed_links.get(frame, self._pushed_links[''])
            self._push = source.DrawnPush(force, link)
            self._push_end = self._time + PUSH_TIME
            place = f' on the {frame}' if frame else ''
            components = []
            for axis, component in zip('xyz', force):
                if component:
                    components.append(f'{component:+g} N along {axis}')
            self._add_event(f'push{place}: {", ".join(components)}')

    def _read_joint_positions(self) -> Vector:
        """Return the joint positions, shape (n,) [rad]; NaN for joints that are not heard."""
        positions: dict[str, float] = {}
        message = self._link.get_newest(topics.JOINT_STATES)
        if message is not None:
            positions.update(zip(message.name, message.position))
        joint_names = self._config.robot.joint_names
        return np.array([positions.get(name, np.nan) for name in joint_names])

    def _find_commanded_forces(
        self, status: ControllerStatus, desired: Vector
    ) -> dict[str, float]:
        """Return the forces that are obeyed [N]: commanded ones, or those of a scenario."""
        if status.forces:
            return dict(status.forces)
        commanded = {}
        for name, force in zip(self._config.column_names, desired.tolist()):
            if np.isfinite(force):
                commanded[name] = force
        return commanded

    def _make_snapshot(
        self, now: float, pose: Any, desired_pose: Any
    ) -> source.Snapshot:
        """Return the state at a time of the clock [s], with the messages of the poses."""
        status = self._link.last_status
        if status is None:
            status = UNKNOWN_STATUS
        states = tuple(status.contact_states.values())
        if not states:
            states = ('free',) * len(self._config.contact_names)
        reaction = status.reaction
        if now - self._sample_heard > SILENCE:
            reaction = 'no samples'
        push = None
        if self._time < self._push_end:
            push = self._push
        desired = self._curves.get_newest(topics.DESIRED_FORCES)
        position, quaternion = messages.pose_arrays(pose.pose)
        position_des, _ = messages.pose_arrays(desired_pose.pose)
        snapshot = source.Snapshot(
            time=self._time,
            q=self._read_joint_positions(),
            position=position,
            quaternion=quaternion,
            position_des=position_des,
            measured=self._curves.get_newest(topics.MEASURED_FORCES),
            estimated=self._curves.get_newest(topics.ESTIMATED_FORCES),
            desired=desired,
            true=self._curves.get_newest(topics.TRUE_FORCES),
            normals_world=np.array(list(self._normals.values())),
            states=states,
            reaction=reaction,
            reasons=tuple(status.causes.split()),
            points=self._curves.take_points(),
            commanded=self._find_commanded_forces(status, desired),
            goal=self._steering.motion.goal,
            events=tuple(self._events),
            timing=self._timing,
            held=status.held,
            moving=self._steering.motion.name,
            push_test=status.push_test,
            gains=self._steering.gains,
            push=push,
            surfaces=dict(self._surfaces.states),
            anew=self._begins_anew,
            places_world=self._surfaces.locate_surfaces(),
        )
        self._events.clear()
        self._begins_anew = False
        return snapshot


class StatusDescriber:
    """
    Describes in words what each status of a controller changes.

    A controller repeats its status, and a command until it is answered: each change, and each
    refusal, is told once.

    Parameters
    ----------
    contact_names
        Names of the contacts, in the order of the states in a status.

    """

    def __init__(self, contact_names: tuple[str, ...]) -> None:
        self._supervisor = source.EventDescriber(contact_names)
        self._last_answer = ('', '')  # event and identifier of a command
        # Identifier of the last command of which a part was told as not obeyed.
        self._partly_obeyed = ''
        self._held = False

    def describe_changes(
        self, status: ControllerStatus, refuses_motion: bool
    ) -> list[str]:
        """
        Return what a status says beyond the ones before it, a text for each change.

        Parameters
        ----------
        status
            The next status of the controller.
        refuses_motion
            Whether it refuses a pose of the page's motion, whose end is told elsewhere.

        Returns
        -------
        list of str
            Refusal, part of a command that is not obeyed, hold, and changes of the supervisor.

        """
        texts = []
        answer = (status.event, status.command)
        is_refusal = status.event == REFUSED and not refuses_motion
        if is_refusal and answer != self._last_answer:
            texts.append(f'refused: {status.text}')
        if status.command:
            self._last_answer = answer
        # Every pose of a motion has the identifier of the motion.
        if status.left_out and status.command != self._partly_obeyed:
            self._partly_obeyed = status.command
            texts.append(status.left_out)
        if status.held != self._held:
            self._held = status.held
            texts.append('pose and forces held' if status.held else 'hold released')
        if status.contacts:
            event = SupervisorEvent(
                math.nan,  # a difference in words has no time
                status.reaction,
                tuple(status.causes.split()),
                (),
                tuple(status.contact_states.values()),
            )
            changes = self._supervisor.describe_changes(event)
            if changes:
                texts.append(changes)
        return texts


def _read_point(point: Any) -> Vector:
    return np.array([point.x, point.y, point.z])


def _read_loop_timing(part: Any, before: source.LoopTiming) -> source.LoopTiming:
    """Return the timing in a part of the diagnostics, whose misses are those since the last."""
    values = {each.key: each.value for each in part.values}
    return before._replace(
        typical=_read_latency(values['latency_us_p50']),
        worst=_read_latency(values['latency_us_p99']),
        misses=before.misses + int(values['deadline_misses']),
    )


def _read_latency(text: str) -> float:
    """Return a latency [us] of the diagnostics, NaN for `none`."""
    return math.nan if text == 'none' else float(text)


def _require_joints(expected: tuple[str, ...], joint_names: tuple[str, ...]) -> None:
    """Check that a controller is of this arm; RunError naming the right one if it is known."""
    if joint_names == expected:
        return
    fitting = []
    for name in robot_names():
        robot = find_robot(name)
        controlled = robot.file.joint_names
        if not controlled:
            controlled = robot.arm.joint_names
        if joint_names == controlled:
            fitting.append(f'--robot {robot.name}')
    options = 'its --robot'
    if fitting:
        options = ' or '.join(fitting)
    raise RunError(
        f'{JOINT_NAMES}: expected {", ".join(expected)}, got {", ".join(joint_names)}; '
        f'name {options}, and its --scenario'
    )
