"""A graph that runs, joined from outside: its topics are listened to, its commands are used."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from concurrent import futures
from functools import partial
import queue
import threading
import time
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.config import Vector3
from multicontact_control.control.tasks import MotionReading
from multicontact_control.errors import CommandError, MulticontactError, RunError
from multicontact_control.experiment.scenario import Setup
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.contact_markers import NAMESPACE
from multicontact_control.nodes.link import ControllerLink
from multicontact_control.nodes.status import ControllerStatus, new_identifier, REFUSED
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.view import source
from multicontact_control.view.motion import Motion
from multicontact_control.view.source import (
    CurveLayout,
    felt_surfaces,
    no_points,
    PLAYING,
    POINTS,
    RATE,
    refuse_if_unknown,
    Scene,
    SIMULATED,
    Snapshot,
    taken,
    Timing,
)
import numpy as np
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import parameter_value_to_python
from sim_bridge.robots import find_robot, robot_names
from sim_bridge.surface_patch import Patch
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

REFUSALS = dict.fromkeys(PLAYING, 'a recording') | dict.fromkeys(
    SIMULATED, "a simulation of the page's own")
MOTION_RATE = 100.0  # Hz, of motion commands, and of looking for anything
PATIENCE = 10.0  # s; until a process has found the others may take three
SILENCE = 1.0  # s without a sample, after which it is said
KEPT = round(2.0 * RATE)
LISTENED = (
    topics.JOINT_STATES, topics.MEASURED_FORCES, topics.ESTIMATED_FORCES, topics.DESIRED_FORCES,
    topics.INNOVATION, topics.NOISE_VARIANCE, topics.EFFORT_COMMAND, topics.POSE,
    topics.POSE_DESIRED, topics.SURFACE_MARKERS, topics.CONTACT_MARKERS, topics.DIAGNOSTICS)
LOOP = f'{topics.CONTROLLER}: loop'
SIMULATOR = f'{topics.SIM}: loop'
CEILING = 'command.force_ceiling'
JOINTS = 'robot.joint_names'
GAINS = ('motion.natural_frequency', 'force.time_constant', 'force.damping_rate')


class GraphSource:
    """
    Listens to a controller and commands it, in a thread of its own.

    Parameters
    ----------
    setup
        What is known of controller and arm.
    namespace, domain_id
        Where the controller is.

    Raises
    ------
    RunError
        If no controller is active there, or it is another one.

    """

    def __init__(self, setup: Setup, *, namespace: str = '', domain_id: int | None = None) -> None:
        config = self._config = setup.controller
        self._link = ControllerLink(
            LISTENED, namespace=namespace, domain_id=domain_id, timeout=PATIENCE,
            on_status=self._note)
        try:
            message, = self._link.fresh(topics.MEASURED_FORCES)
            *gains, ceiling, joints = self._read((*GAINS, CEILING, JOINTS))
            _require_joints(config.robot.joint_names, tuple(joints))
            if tuple(message.name) != config.column_names:
                raise RunError(
                    f'contact_forces/measured: expected {", ".join(config.column_names)}, found '
                    f'{", ".join(message.name)}; name its --scenario and --plant')
            self._gains = (gains[0], gains[1], gains[2])
            self._limits = CommandLimits(force_ceiling=ceiling)
        except BaseException:
            self._link.close()
            raise
        self._layout = CurveLayout(len(config.columns), len(config.robot.joint_names))
        self._leaders = list(config.leaders)
        self._motion = Motion(config.limits, 1.0 / MOTION_RATE)
        self.refusals: Mapping[str, str] = REFUSALS
        self.scene = Scene(
            'graph, as it runs', config, setup.urdf_dir, felt_surfaces(config),
            largest_force=ceiling)
        self._commands: Mapping[str, Callable[..., str]] = {
            source.FORCES: self._set_forces, source.STOP: self._motion.stop,
            source.GO_TO: partial(self._move, self._motion.go_to),
            source.JOG: partial(self._move, self._motion.jog),
            source.PATTERN: partial(self._move, self._motion.start_pattern),
            source.HOLD: self._hold, source.RETRY: partial(self._ask, 'retry'),
            source.TARE: partial(self._ask, 'tare'),
            source.PUSH_TEST: partial(self._ask, 'push_test'), source.GAINS: self._set_gains}
        self._motion_identifier = ''
        self._timing, self._pace = Timing(), 1.0
        self._events: list[tuple[float, str]] = []
        self._points: list[Any] = []
        self._places: dict[str, Vector3] = {}
        self._patches: dict[str, Patch] = {}
        self._normals = {name: np.array(config.contacts[name].normal_world)
                         for name in config.contact_names}
        self._stamp, self._heard = -1, time.monotonic()
        self._snapshots: deque[Snapshot] = deque(maxlen=KEPT)
        self._jobs: queue.Queue[tuple[Callable[[], str], futures.Future[str]]] = queue.Queue()
        self._over, self._why = threading.Event(), ''
        self._thread = threading.Thread(target=self._work, daemon=True, name='graph')
        self._thread.start()

    def poll(self) -> list[Snapshot]:
        """Return the snapshots since the last call; RunError if the graph cannot be heard."""
        found = taken(self._snapshots)
        if not found and self._why:
            raise RunError(self._why)
        return found

    def command(self, name: str, /, **values: Any) -> str:
        """Give a command, and return what comes of it; see `Source.command`."""
        refuse_if_unknown(name, REFUSALS)
        done: futures.Future[str] = futures.Future()
        self._jobs.put((lambda: self._commands[name](**values), done))
        try:
            return done.result(2.0 * PATIENCE)
        except futures.TimeoutError:
            raise RunError(f'{name}: no answer within {2.0 * PATIENCE:g} s') from None

    def close(self) -> None:
        """Leave the graph, which goes on."""
        self._over.set()
        self._thread.join(2.0 * PATIENCE)
        self._link.close()

    # ---------------------------------------------------------------------------- its thread

    def _work(self) -> None:
        every = max(1, round(MOTION_RATE / RATE))
        turn, due = 0, time.monotonic()
        try:
            while not self._over.is_set():
                self._carry_out()
                wanted = self._motion.advance()
                if wanted is not None:
                    self._send(wanted)
                if turn % max(1, every // POINTS) == 0:
                    self._look()
                turn += 1
                if turn % every == 0:
                    self._show()
                due = max(due + 1.0 / MOTION_RATE, time.monotonic() - 0.1)
                self._over.wait(max(0.0, due - time.monotonic()))
        except Exception as error:  # whatever it is, the page is to say it
            self._why = f'the graph cannot be shown: {error}'
            raise

    def _carry_out(self) -> None:
        while not self._jobs.empty():
            job, done = self._jobs.get()
            try:
                done.set_result(job())
            except MulticontactError as error:
                done.set_exception(error)
            except (TypeError, ValueError, KeyError) as error:  # of values that no page sends
                done.set_exception(CommandError('command', 'values that it takes', error))

    def _values(self, topic: topics.Topic, names: tuple[str, ...], field: str = 'effort') -> Any:
        message = self._link.newest(topic)
        known = {} if message is None else dict(zip(message.name, getattr(message, field)))
        return np.array([known.get(name, np.nan) for name in names])

    def _look(self) -> None:
        """Take a point of the curves, and what the diagnostics say."""
        names, joints = self._config.column_names, self._config.robot.joint_names
        message = self._link.newest(topics.MEASURED_FORCES)
        stamp = messages.stamp_to_ns(message.header.stamp) if message is not None else -1
        if stamp != self._stamp:
            self._stamp, self._heard = stamp, time.monotonic()
            limit = np.array(self._config.torque_limit or [np.inf] * len(joints))
            self._points.append(np.concatenate([
                [1e-9 * stamp], *(self._values(topic, names) for topic in (
                    topics.MEASURED_FORCES, topics.ESTIMATED_FORCES, topics.DESIRED_FORCES,
                    topics.NOISE_VARIANCE)),
                np.abs(self._values(topics.INNOVATION, names)),
                np.abs(self._values(topics.EFFORT_COMMAND, joints)) / limit]))
        for report in self._link.queue(topics.DIAGNOSTICS):
            for part in report.status:
                told = {each.key: each.value for each in part.values}
                if part.name.rpartition('/')[2] == SIMULATOR:
                    self._pace = _number(told.get('realtime_factor'))
                elif part.name.rpartition('/')[2] == LOOP:
                    self._timing = Timing(
                        _number(told.get('latency_us_p50')), _number(told.get('latency_us_p99')),
                        _count(told.get('deadline_misses_in_all', '0')), self._pace)
        self._link.look()

    def _note(self, status: ControllerStatus) -> None:
        """Say what the controller refuses, and make no motion that it does not obey."""
        refused = status.event == REFUSED
        if refused:
            self._events.append((1e-9 * self._stamp, f'refused {status.text}'))
        if not self._motion.what:
            return
        why = (status.text if refused and status.command == self._motion_identifier
               else 'held' if status.held
               else '' if status.life_cycle == 'active' else status.life_cycle)
        if why:
            self._motion.halt()
            self._events.append((1e-9 * self._stamp, f'motion stopped: {why}'))

    def _look_at_surfaces(self) -> None:
        """Take from a simulator where the surfaces are, and at first what they look like."""
        message = self._link.newest(topics.SURFACE_MARKERS)
        for marker in () if message is None else message.markers:
            name, place = marker.ns.rpartition('/')[2], marker.pose.position
            self._places[name] = (place.x, place.y, place.z)
            count = len(marker.points)
            if name not in self._patches and marker.type == Marker.TRIANGLE_LIST and count:
                corners = np.array([(point.x, point.y, point.z) for point in marker.points])
                self._patches[name] = Patch(
                    corners, np.arange(count - count % 3).reshape(-1, 3))

    def _look_at_normals(self) -> None:
        """Take the normals, which a controller may find on-line, from the arrows of the forces."""
        message = self._link.newest(topics.CONTACT_MARKERS)
        for marker in () if message is None else message.markers:
            name = marker.ns.removeprefix(f'{NAMESPACE}/')
            if name in self._normals and marker.action == Marker.ADD:
                tail, tip = (np.array([point.x, point.y, point.z]) for point in marker.points)
                self._normals[name] = (tip - tail) / np.linalg.norm(tip - tail)

    def _obeyed(self, desired: Vector) -> dict[str, float]:
        """Return the forces that are obeyed: commanded ones, or those of a scenario [N]."""
        told = {} if self._link.last_status is None else self._link.last_status.forces
        return dict(told) or {
            name: force for name, force in zip(self._config.column_names, desired.tolist())
            if np.isfinite(force)}

    def _show(self) -> None:
        config, status = self._config, self._link.last_status
        pose, wanted = (self._link.newest(topic) for topic in (topics.POSE, topics.POSE_DESIRED))
        if pose is None or wanted is None:
            return
        contacts = {} if status is None else dict(
            each.split(' ', 1) for each in status.contacts.split(', ') if each)
        silent = time.monotonic() - self._heard > SILENCE
        desired = self._values(topics.DESIRED_FORCES, config.column_names)
        self._look_at_surfaces()
        self._look_at_normals()
        points, self._points = self._points, []
        events, self._events = self._events, []
        position, turn = pose.pose.position, pose.pose.orientation
        place = wanted.pose.position
        self._snapshots.append(Snapshot(
            time=1e-9 * self._stamp,
            q=self._values(topics.JOINT_STATES, config.robot.joint_names, 'position'),
            position=np.array([position.x, position.y, position.z]),
            quaternion=np.array([turn.x, turn.y, turn.z, turn.w]),
            position_des=np.array([place.x, place.y, place.z]),
            measured=self._values(topics.MEASURED_FORCES, config.column_names),
            estimated=self._values(topics.ESTIMATED_FORCES, config.column_names),
            desired=desired, normals_world=np.array(list(self._normals.values())),
            states=tuple(contacts.get(name, 'free') for name in config.contact_names),
            reaction='no samples' if silent else 'none' if status is None else status.reaction,
            reasons=() if status is None else tuple(status.causes.split()),
            points=np.array(points) if points else no_points(self._layout),
            commanded=self._obeyed(desired), goal=self._motion.goal, events=tuple(events),
            timing=self._timing, held=status is not None and status.held,
            moving=self._motion.what, push_test='' if status is None else status.push_test,
            gains=self._gains, places_world=dict(self._places), patches=self._patches,
            playing=True))

    # ------------------------------------------------------------------------------ commands

    def _set_forces(self, **forces: float) -> str:
        self._limits.check_forces(self._config, forces)
        self._link.command(topics.FORCE_COMMAND, messages.joint_state_message(
            0, list(forces), effort=list(forces.values())))
        return ', '.join(f'{name} {force:g} N' for name, force in forces.items())

    def _send(self, reading: MotionReading) -> None:
        self._link.send(topics.MOTION_COMMAND, messages.motion_message(
            reading.position_world, reading.quaternion_xyzw, reading.twist_world,
            reading.acceleration_world), self._motion_identifier)

    def _move(self, motion: Callable[..., str], /, **values: Any) -> str:
        """Begin a motion from where the point should be, or go on from the one being made."""
        if self._link.last_status is not None and self._link.last_status.held:
            raise CommandError('~/hold', 'released, to obey commands', 'held')
        if not self._motion.what:
            self._motion_identifier = new_identifier()
            wanted, = self._link.fresh(topics.POSE_DESIRED)
            p, q = wanted.pose.position, wanted.pose.orientation
            self._motion.start(np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w]))
        return motion(**values)

    def _hold(self, on: bool) -> str:
        if on and self._motion.what:
            self._send(self._motion.halt())
        return self._service(SetBool, 'hold', SetBool.Request(data=bool(on)))

    def _ask(self, name: str) -> str:
        return self._service(Trigger, name, Trigger.Request())

    def _service(self, kind: Any, name: str, request: Any) -> str:
        answer = self._link.call(topics.CONTROLLER, kind, name, request)
        if not answer.success:
            raise RunError(str(answer.message))
        return str(answer.message) or name

    def _read(self, names: tuple[str, ...]) -> list[Any]:
        answer = self._link.call(topics.CONTROLLER, GetParameters, 'get_parameters',
                                 GetParameters.Request(names=list(names)))
        found = [parameter_value_to_python(value) for value in answer.values]
        if len(found) != len(names) or None in found:
            raise RunError(f'{topics.CONTROLLER}: expected the parameters {", ".join(names)}, '
                           'found not all of them')
        return found

    def _set_gains(
        self, natural_frequency: float, time_constant: float, damping_rate: float,
    ) -> str:
        values = (natural_frequency, time_constant, damping_rate)
        request = SetParametersAtomically.Request(parameters=[
            Parameter(name=name, value=ParameterValue(
                type=ParameterType.PARAMETER_DOUBLE, double_value=float(value)))
            for name, value in zip(GAINS, values)])
        answer = self._link.call(
            topics.CONTROLLER, SetParametersAtomically, 'set_parameters_atomically', request)
        if not answer.result.successful:
            raise RunError(str(answer.result.reason))
        self._gains = values
        return 'gains are set'


def _require_joints(expected: tuple[str, ...], found: tuple[str, ...]) -> None:
    """Check that a controller is of this arm; RunError naming the right one if it is known."""
    if found == expected:
        return
    robots = map(find_robot, robot_names())
    fitting = [f'--robot {robot.name}' for robot in robots
               if found == (robot.file.joint_names or robot.arm.joint_names)]
    raise RunError(f'{JOINTS}: expected {", ".join(expected)}, found {", ".join(found)}; name '
                   f'{" or ".join(fitting) or "its --robot"}, and its --scenario')


def _number(text: str | None) -> float:
    try:
        return float(text or 'nan')
    except ValueError:
        return float('nan')


def _count(text: str) -> int:
    number = _number(text)
    return int(number) if np.isfinite(number) else 0
