"""A graph that runs, joined from outside: its topics are listened to, its commands are used."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
import time
from typing import Any

from geometry_msgs.msg import Vector3Stamped
from multicontact_control.config import Vector3
from multicontact_control.errors import CommandError, MulticontactError, RunError
from multicontact_control.judging.supervisor_events import SupervisorEvent
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.controller_topics import MARKER_NAMESPACE
from multicontact_control.nodes.graph import create_publisher
from multicontact_control.nodes.link import CommandRefusedError, ControllerLink
from multicontact_control.nodes.messages import (
    ControllerStatus,
    new_identifier,
    REFUSED,
)
from multicontact_control.runs.scenario import Setup
from multicontact_control.view import source
from multicontact_control.view.motion import CommandedMotion
from multicontact_control.view.streams import EffortStream
import numpy as np
from rcl_interfaces.srv import ListParameters
from sim_bridge.config import PUSH_TIME
from sim_bridge.robots import find_robot, robot_names
from sim_bridge.surface_patch import Patch
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

PATIENCE = 10.0  # s; until a process has found the others may take three
SIMULATOR_WAIT = 3.0  # s, until a graph without surfaces has no simulator
SILENCE = 1.0  # s without a sample, after which that is shown
BLOCK_TIME = 1.0 / (source.BLOCKS * source.RATE)  # s, of which curves have the extremes
PACE_TIME = 2.0  # s, over which the real-time factor is taken
# Of a motion: a page that was busy makes up for that in short steps, at little more speed.
LONGEST_STEP, LONGEST_DELAY, CATCH_UP = 0.012, 0.2, 1.3  # s, s
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
# Of the curves, in the order of `Snapshot.points`; the torques follow.
DRAWN = (
    topics.MEASURED_FORCES,
    topics.ESTIMATED_FORCES,
    topics.DESIRED_FORCES,
    topics.TRUE_FORCES,
    topics.NOISE_VARIANCE,
    topics.INNOVATION,
)
LOOP = f'{topics.CONTROLLER}: loop'
SHOWN = ('latency_us_p50', 'latency_us_p99', 'deadline_misses')  # of it, or `none`
CEILING, JOINTS = 'command.force_ceiling', 'robot.joint_names'


class GraphSource:
    """
    Listens to a controller and commands it.

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
        config = self._config = setup.controller
        self._check = check
        self._link = ControllerLink(
            LISTENED,
            namespace=namespace,
            domain_id=domain_id,
            timeout=PATIENCE,
            on_status=self._note,
        )
        self._streams = self._make_streams()
        self._push_publisher = create_publisher(self._link.node, topics.PUSH)
        self._last_push: tuple[float, source.DrawnPush | None] = (
            0.0,
            None,
        )  # and until when it lasts
        self._pushed = {
            '': config.robot.operational_frame,
            **({'tool': setup.plant.tool_push_link} if setup.simulated else {}),
        }
        self._motion = CommandedMotion(config.limits)
        self._motion_identifier = ''
        self._delay = 0.0  # of a motion, that is still to be made up for [s]
        self._changes = source.EventDescriber(config.contact_names)
        self._timing = source.LoopTiming()
        self._events: list[tuple[float, str]] = []
        self._points: list[Any] = []
        self._parts: dict[
            str, list[str]
        ] = {}  # surfaces that make up one that is drawn
        self._normals = {
            name: np.array(config.contacts[name].normal_world)
            for name in config.contact_names
        }
        self._start = self._stamp = -1  # of the first sample and the last [ns]
        self._answered = '', ''  # event and command of the last answer
        self._left_out_of = ''  # identifier of the motion of which that was told last
        self._anew = True  # whether the next snapshot is the first since samples began
        self._held = False
        self._heard = time.monotonic()
        self._next_point = self._next_snapshot = 0.0
        self._drawn_until = 0.0  # time of the last point [s]
        self._stamps: deque[tuple[float, int]] = deque(
            maxlen=round(PACE_TIME * source.RATE)
        )
        try:
            gains, ceiling = self._meet()
            surfaces, self._surfaces = self._find_surfaces()
        except BaseException:
            self._link.close()
            raise
        self._gains = gains
        true_forces = self._streams[topics.TRUE_FORCES]
        true_forces.take_messages()
        self.scene = source.Scene(
            title,
            config,
            setup.urdf_dir,
            surfaces or source.list_felt_surfaces(config),
            simulated=dict(self._surfaces),
            largest_force=ceiling,
            true_forces=bool(np.isfinite(true_forces.newest).any()),
        )

    def _make_streams(self) -> dict[topics.Topic, EffortStream]:
        node, config = self._link.node, self._config
        limit = np.array(
            config.torque_limit or [np.inf] * len(config.robot.joint_names)
        )
        streams = {
            topic: EffortStream(node, topic, config.column_names) for topic in DRAWN
        }
        streams[topics.EFFORT_COMMAND] = EffortStream(
            node,
            topics.EFFORT_COMMAND,
            config.robot.joint_names,
            lambda torques: np.abs(torques) / limit,
        )
        return streams

    def _meet(self) -> tuple[dict[str, float], float]:
        """Check that the controller is the expected one; return its gains and force ceiling."""
        config = self._config
        message = self._link.receive_fresh(topics.MEASURED_FORCES)[0]
        *gains, ceiling, joints = self._link.get_parameters(
            topics.CONTROLLER, *source.GAIN_NAMES, CEILING, JOINTS
        )
        _require_joints(config.robot.joint_names, tuple(joints))
        if tuple(message.name) != config.column_names:
            raise RunError(
                f'contact_forces/measured: expected {", ".join(config.column_names)}, got '
                f'{", ".join(message.name)}; name its --scenario and --plant'
            )
        return dict(zip(source.GAIN_NAMES, gains)), ceiling

    def _find_surfaces(
        self,
    ) -> tuple[tuple[source.DrawnSurface, ...], dict[str, source.SurfaceState]]:
        """Return what a simulator has to be touched, and can change; nothing without one."""
        give_up = time.monotonic() + SIMULATOR_WAIT
        while (message := self._link.get_newest(topics.SURFACE_MARKERS)) is None:
            if time.monotonic() > give_up:
                return (), {}
            time.sleep(0.01)
        drawn = tuple(_surface_of(marker) for marker in message.markers)
        listed = self._link.call_service(
            topics.SIM,
            ListParameters,
            'list_parameters',
            ListParameters.Request(prefixes=['surfaces']),
        ).result.names
        states = {}
        for name in (x.split('.')[1] for x in listed if x.endswith('.stiffness')):
            stiffness, friction, contact = self._link.get_parameters(
                topics.SIM,
                *(f'surfaces.{name}.{x}' for x in ('stiffness', 'friction', 'contact')),
            )
            if (whole := contact or name) in {surface.name for surface in drawn}:
                self._parts.setdefault(whole, []).append(name)
                states[whole] = source.SurfaceState(stiffness, friction)
        return drawn, states

    def take_snapshots(self) -> list[source.Snapshot]:
        """Return a snapshot if it is time for one; RunError if the graph has ended."""
        self._check()
        now = time.monotonic()
        before = self._stamp
        for stream in self._streams.values():
            stream.take_messages()
        message = self._link.get_newest(topics.MEASURED_FORCES)
        if message is not None:
            self._stamp = messages.stamp_to_ns(message.header.stamp)
        if self._stamp != before:
            if before < 0 or self._stamp < before:  # samples begin, or begin anew
                self._start, self._anew = self._stamp, True
                self._drawn_until = -BLOCK_TIME
            self._heard = now
            self._move_on(1e-9 * (self._stamp - before))
            if now >= self._next_point:
                self._next_point = now + BLOCK_TIME
                self._add_points()
        self._link.take_statuses()
        if now < self._next_snapshot:
            return []
        self._next_snapshot = now + 1.0 / source.RATE
        pose, desired = (
            self._link.get_newest(x) for x in (topics.POSE, topics.POSE_DESIRED)
        )
        return (
            []
            if pose is None or desired is None
            else [self._snapshot(now, pose, desired)]
        )

    def close(self) -> None:
        """Leave the graph, which goes on."""
        self._link.close()

    @property
    def _time(self) -> float:
        """Time of the newest sample [s] since the first that was heard."""
        return 1e-9 * (self._stamp - self._start)

    def _add_points(self) -> None:
        """Add two points to the curves: the least and the greatest since the last ones."""
        middle = 0.5 * (self._drawn_until + self._time)
        least, greatest = zip(
            *(stream.take_extremes() for stream in self._streams.values())
        )
        self._points += [
            np.concatenate([[middle], *least]),
            np.concatenate([[self._time], *greatest]),
        ]
        self._drawn_until = self._time

    def _joint_positions(self) -> Any:
        message = self._link.get_newest(topics.JOINT_STATES)
        known = {} if message is None else dict(zip(message.name, message.position))
        return np.array(
            [known.get(name, np.nan) for name in self._config.robot.joint_names]
        )

    def _note(self, status: ControllerStatus) -> None:
        """Tell what has changed and what is refused, and make no motion that is not obeyed."""
        now = self._time
        refused = status.event == REFUSED
        answer = (status.event, status.command)
        of_motion = (
            refused and self._motion.what and status.command == self._motion_identifier
        )
        texts = []
        if refused and not of_motion and answer != self._answered:
            texts.append(f'refused: {status.text}')
        if (
            status.left_out and self._left_out_of != status.command
        ):  # of every point of a motion
            self._left_out_of = status.command
            texts.append(status.left_out)
        if status.command:  # which is resent until it is answered
            self._answered = answer
        if status.held != self._held:
            self._held = status.held
            texts.append('pose and forces held' if status.held else 'hold released')
        if status.contacts:
            texts.append(
                self._changes.describe_changes(
                    SupervisorEvent(
                        now,
                        status.reaction,
                        tuple(status.causes.split()),
                        (),
                        tuple(status.contact_states.values()),
                    )
                )
            )
        if self._motion.what:
            why = ''
            if of_motion:
                why = status.text
            elif status.held:
                why = 'held'
            elif status.life_cycle != 'active':
                why = status.life_cycle
            if why:
                self._motion.halt()
                texts.append(f'motion stopped: {why}')
        self._events += [(now, text) for text in texts if text]

    def _look_at_timing(self, now: float) -> None:
        self._stamps.append((now, self._stamp))
        then, stamp = self._stamps[0]
        pace = 1e-9 * (self._stamp - stamp) / (now - then) if now > then else 1.0
        self._timing = self._timing._replace(pace=pace)
        for report in self._link.take_queued(topics.DIAGNOSTICS):
            for part in report.status:
                if part.name.rpartition('/')[2] == LOOP:
                    values = {
                        each.key: float(each.value.replace('none', 'nan'))
                        for each in part.values
                        if each.key in SHOWN
                    }
                    typical, worst, misses = (values[key] for key in SHOWN)
                    self._timing = source.LoopTiming(
                        typical, worst, self._timing.misses + int(misses), pace
                    )

    def _look_at_normals(self) -> None:
        """Take the normals, which a controller may find on-line, from the arrows of the forces."""
        message = self._link.get_newest(topics.CONTACT_MARKERS)
        for marker in () if message is None else message.markers:
            name = marker.ns.removeprefix(f'{MARKER_NAMESPACE}/')
            if name in self._normals and marker.action == Marker.ADD:
                tail, tip = (
                    np.array([point.x, point.y, point.z]) for point in marker.points
                )
                self._normals[name] = (tip - tail) / np.linalg.norm(tip - tail)

    def _look_at_pushes(self) -> None:
        """Take the pushes that are asked for, from here or elsewhere, for as long as they last."""
        for message in self._link.take_queued(topics.PUSH):
            force, where = message.vector, message.header.frame_id
            push = source.DrawnPush(
                (force.x, force.y, force.z), self._pushed.get(where, self._pushed[''])
            )
            self._last_push = self._time + PUSH_TIME, push
            forces = (
                f'{x:+g} N along {axis}'
                for axis, x in zip('xyz', push.force_world)
                if x
            )
            self._events.append(
                (self._time, f'push{where and " on the "}{where}: {", ".join(forces)}')
            )

    def _snapshot(self, now: float, pose: Any, desired: Any) -> source.Snapshot:
        config, status = self._config, self._link.last_status
        self._look_at_timing(now)
        self._look_at_normals()
        self._look_at_pushes()
        markers = self._link.get_newest(topics.SURFACE_MARKERS)
        measured, estimated, wanted, true = (
            self._streams[topic].newest for topic in DRAWN[:4]
        )
        points, self._points = self._points, []
        events, self._events = self._events, []
        anew, self._anew = self._anew, False
        position, quaternion = messages.pose_arrays(pose.pose)
        return source.Snapshot(
            time=self._time,
            q=self._joint_positions(),
            position=position,
            quaternion=quaternion,
            position_des=messages.pose_arrays(desired.pose)[0],
            measured=measured,
            estimated=estimated,
            desired=wanted,
            true=true,
            normals_world=np.array(list(self._normals.values())),
            states=tuple(status.contact_states.values() if status else ())
            or ('free',) * len(config.contact_names),
            reaction='no samples'
            if now - self._heard > SILENCE
            else 'none'
            if status is None
            else status.reaction,
            reasons=() if status is None else tuple(status.causes.split()),
            points=np.array(points).reshape(-1, source.count_point_columns(config)),
            # Forces that are obeyed: commanded ones, or those of a scenario.
            commanded=(status and dict(status.forces))
            or {
                name: force
                for name, force in zip(config.column_names, wanted.tolist())
                if np.isfinite(force)
            },
            goal=self._motion.goal,
            events=tuple(events),
            timing=self._timing,
            held=self._held,
            moving=self._motion.what,
            push_test='' if status is None else status.push_test,
            gains=self._gains,
            push=self._last_push[1] if self._time < self._last_push[0] else None,
            surfaces=dict(self._surfaces),
            anew=anew,
            places_world={}
            if markers is None
            else {_name_of(marker): _place_of(marker) for marker in markers.markers},
        )

    def give_command(self, name: str, /, **values: Any) -> str:
        """Give a command, and return what comes of it; see `SnapshotSource.give_command`."""
        try:
            return self._command(name, **values)
        except MulticontactError as error:
            if not isinstance(
                error, CommandRefusedError
            ):  # which the controller tells of
                self._events.append((self._time, f'refused: {error}'))
            raise

    def _command(self, name: str, /, **values: Any) -> str:
        motion = self._motion
        motions: Mapping[str, Callable[..., str]] = {
            source.GO_TO: motion.go_to,
            source.JOG: motion.jog,
            source.PATTERN: motion.start_sine,
        }
        commands: Mapping[str, Callable[..., str]] = {
            source.FORCES: self._set_forces,
            source.STOP: motion.stop,
            source.HOLD: self._hold,
            source.GAINS: self._set_gains,
            source.SURFACE: self._set_surface,
            source.PUSH: self._push,
            **motions,
        }
        if name in motions:
            self._start_motion()
        if name in commands:
            return commands[name](**values)
        return self._link.request_service(name, Trigger, Trigger.Request()) or name

    def _set_forces(self, **forces: float) -> str:
        self._link.command_until_answered(
            topics.FORCE_COMMAND,
            messages.joint_state_message(0, list(forces), effort=list(forces.values())),
        )
        return ', '.join(f'{name} {force:g} N' for name, force in forces.items())

    def _move_on(self, period: float) -> None:
        """Command the next pose of a motion, a time [s] of the samples after the last."""
        if not (self._motion.what and period > 0.0):
            return
        self._delay = min(self._delay + period, LONGEST_DELAY)
        step = min(self._delay, CATCH_UP * period, LONGEST_STEP)
        self._delay -= step
        if (pose := self._motion.advance(step)) is not None:
            self._link.publish_command(
                topics.MOTION_COMMAND,
                messages.motion_message(*pose),
                self._motion_identifier,
            )

    def _start_motion(self) -> None:
        """Begin a motion from where the point should be, or go on with the one under way."""
        if self._held:
            raise CommandError('~/hold', hint='the arm is held; release the hold first')
        if not self._motion.what:
            self._motion_identifier = new_identifier()
            self._delay = 0.0
            desired = self._link.receive_fresh(topics.POSE_DESIRED)[0]
            self._motion.start(*messages.pose_arrays(desired.pose))

    def _hold(self, on: bool) -> str:
        if on and self._motion.what:
            self._link.publish_command(
                topics.MOTION_COMMAND,
                messages.motion_message(*self._motion.halt()),
                self._motion_identifier,
            )
        return self._link.request_service('hold', SetBool, SetBool.Request(data=on))

    def _set_gains(self, **gains: float) -> str:
        self._link.set_parameters(topics.CONTROLLER, gains)
        self._gains = gains
        return 'gains are set'

    def _set_surface(self, name: str, stiffness: float, friction: float) -> str:
        state = source.SurfaceState(stiffness, friction)
        self._link.set_parameters(
            topics.SIM,
            {
                f'surfaces.{part}.{key}': value
                for part in self._parts[name]
                for key, value in state._asdict().items()
            },
        )
        self._surfaces[name] = state
        return f'{name}: {stiffness:g} N/m, friction {friction:g}'

    def _push(self, force: list[float], tool: bool) -> str:
        message = Vector3Stamped(header=Header(frame_id='tool' if tool else ''))
        message.vector.x, message.vector.y, message.vector.z = force
        self._push_publisher.publish(message)
        return ''  # what a push test asks for stays


def _name_of(marker: Marker) -> str:
    return str(marker.ns.rpartition('/')[2])


def _place_of(marker: Marker) -> Vector3:
    place = marker.pose.position
    return place.x, place.y, place.z


def _surface_of(marker: Marker) -> source.DrawnSurface:
    """Return a surface as a simulator has it drawn: corners of triangles."""
    corners = np.array([(point.x, point.y, point.z) for point in marker.points])
    return source.DrawnSurface(
        _name_of(marker),
        (0.0, 0.0, -1.0),
        _place_of(marker),
        Patch(corners, np.arange(len(corners)).reshape(-1, 3)),
    )


def _require_joints(expected: tuple[str, ...], joints: tuple[str, ...]) -> None:
    """Check that a controller is of this arm; RunError naming the right one if it is known."""
    if joints == expected:
        return
    robots = map(find_robot, robot_names())
    fitting = [
        f'--robot {robot.name}'
        for robot in robots
        if joints == (robot.file.joint_names or robot.arm.joint_names)
    ]
    raise RunError(
        f'{JOINTS}: expected {", ".join(expected)}, got {", ".join(joints)}; name '
        f'{" or ".join(fitting) or "its --robot"}, and its --scenario'
    )
