"""
A running graph that faults are put into: listened to, commanded, and led back to a good state.

Nodes are processes and time is real. The operator presses on every contact and slides to and fro.
"""

from collections import deque, namedtuple
from dataclasses import replace
from itertools import takewhile
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from campaign.graph_faults import Command, HALT, KILL, NodeChange
from campaign.relay import INPUTS, PREFIX
from campaign.soak import oscillating
from geometry_msgs.msg import Transform, Twist, Vector3
from multicontact_control.control.tasks import quintic
from multicontact_control.errors import RunError
from multicontact_control.experiment.faults import judge
from multicontact_control.experiment.graph import spec
from multicontact_control.experiment.graph.processes import NodeProcesses
from multicontact_control.nodes import link, messages, qos, topics
from multicontact_control.nodes.graph import create_publisher, ignore, take
from multicontact_control.nodes.topics import CONTROLLER, RECORDER, SIM
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.reactions import SEVERITY
import numpy as np
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

CHECKED = (topics.EFFORT_COMMAND, topics.DESIRED_FORCES, topics.ESTIMATED_FORCES,
           topics.NOISE_VARIANCE, topics.TRUE_FORCES)
REMEMBERED = 30_000  # messages per topic: a minute at 500 Hz
DIRECTION = np.array([1.0, 0.0, 0.0])
RETURN_TIME, AMPLITUDE, MOTION_PERIOD = 1.0, 0.03, 3.0  # s, m, s of the motion
END_TIME, NEAR = 1.0, 0.01  # s after a motion command that nothing follows; m
QUIET, FAULT_TIME = (0.0, 0.3), (0.1, 0.4)  # s before a fault, and of one
HALT_TIME, OUTAGE = (0.02, 0.2), (0.0, 0.5)  # s, of a process
# s without a command while samples come: that counts as silence, and that no controller may take.
SILENCE, STOPPED = 0.1, 0.3
POLL_PERIOD, SETTLE_TIME = 0.005, 0.2  # s, the latter to average forces
WANTED_FORCE, FORCE_TOLERANCE = 10.0, 0.25  # N at every contact, and the share that is near it
FORCES, REST_TIME = (5.0, 20.0), 3.0  # N of a soak; s, an oscillation shows within 2
RECOVERY_TIME, ATTEMPTS = 90.0, 3  # s on a busy machine, with so many attempts at contact
REPORT_TIME = 1.5  # s until the controller's diagnostics, one a second, tell of a fault
# A machine without real-time priority has hiccups of many periods: no faults to be answered here.
PATIENT = {'patience': 10.0, 'watchdog.joint_max_age': 15.0, 'watchdog.wrench_max_age': 15.0,
           'watchdog.variance_max_age': 25.0, 'watchdog.rate_band': 25.0}

Report = namedtuple('Report', 'time node values')  # diagnostics


class Graph(link.GuestNode):
    """One graph, which ends with its context, and the operator who presses and slides."""

    def __init__(self, setup, folder, domain_id):
        super().__init__('fault_campaign', domain_id)
        self._driver = link.GuestNode(
            'lifecycle_driver', domain_id, keep_waiting=lambda what: self.poll())
        self.setup = setup
        self.spec = spec.GraphSpec(
            out=folder, ticks=0, rate=setup.controller.rate, seed=setup.seed, free_running=True,
            domain_id=domain_id,
            parameter_files=setup.write(folder / 'config'),
            remappings={CONTROLLER: {x.name: PREFIX + x.name for x in INPUTS.values()}},
            extra_parameters={x: {'startup_peers': [], **(PATIENT if x == CONTROLLER else {})}
                              for x in spec.START_ORDER})
        self.processes = NodeProcesses(self.spec, domain_id)
        self.wanted = dict.fromkeys(setup.controller.contact_names, WANTED_FORCE)
        self._subscriptions = {
            topic: self.node.create_subscription(topic.message, topic.name, ignore, qos.STREAM)
            for topic in (*CHECKED, topics.POSE_DESIRED, topics.DIAGNOSTICS)}
        # When messages were sent [s], and their efforts by name; all until `polled` [s].
        self.heard = {topic: deque(maxlen=REMEMBERED) for topic in CHECKED}
        self.reports = deque(maxlen=1000)
        self.pose, self.polled = None, math.inf
        self._force_command = create_publisher(self.node, topics.FORCE_COMMAND)
        self._motion_command = create_publisher(self.node, topics.MOTION_COMMAND)
        self._home = self._begin = None

    def start(self):
        """Start all nodes, and bring every contact to its force."""
        self._relay = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name('relay.py'))],
            env={**os.environ, 'ROS_DOMAIN_ID': str(self.spec.domain_id),
                 'PYTHONPATH': os.pathsep.join(sys.path)},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.processes.start_all()
        self.recover()

    def close(self):
        self.processes.stop(hurry=True)
        self._relay.communicate()
        self._driver.close()
        super().close()

    def end_all(self):
        """End every node as at the end of a run; return which of them failed."""
        self.processes.stop()
        return [f'{name} ended with {process.exitcode}'
                for name, process in self.processes.running.items() if process.exitcode]

    def poll(self):
        """Take in what has come, and command the motion of now."""
        self.polled = time.time()
        for topic, subscription in self._subscriptions.items():
            while (taken := take(subscription)) is not None:
                message, sent = taken[0], taken[1]['source_timestamp'] * 1e-9
                if topic is topics.POSE_DESIRED:
                    self.pose = message
                elif topic is topics.DIAGNOSTICS:
                    node = message.status[0].name.partition(': ')[0].rsplit('/', 1)[-1]
                    self.reports.append(Report(sent, node, {
                        x.key: x.value for status in message.status for x in status.values}))
                else:
                    self.heard[topic].append((sent, dict(zip(message.name, message.effort))))
        self._command_motion()
        self.processes.check_running()

    def since(self, topic, start):
        """Return when [s] and what was sent on a topic from a time on."""
        newest = takewhile(lambda x: x[0] >= start, reversed(self.heard[topic]))
        return list(newest)[::-1]

    def spin(self, duration):
        """Let the graph run for a time [s]; RunError if a node dies."""
        end = time.monotonic() + duration
        while (remaining := end - time.monotonic()) > 0.0:
            self.poll()
            time.sleep(min(POLL_PERIOD, remaining))

    def comes(self, condition, timeout):
        """Wait for something; return whether it happens within a time [s]."""
        give_up = time.monotonic() + timeout
        while not condition() and time.monotonic() < give_up:
            self.spin(POLL_PERIOD)
        return time.monotonic() < give_up

    def wait(self, condition, what):
        if not self.comes(condition, RECOVERY_TIME):
            raise RunError(f'{what}: not within {RECOVERY_TIME:g} s')

    def start_motion(self):
        """Command the forces, and the motion from where the arm should be; True if obeyed."""
        if self.pose is None or not all(x.get_subscription_count() for x in (
                self._force_command, self._motion_command)):
            return False
        q = self.pose.pose.orientation
        position, turn = self._position(), Rotation.from_quat([q.x, q.y, q.z, q.w])
        self._home = self._home or (position, turn)
        self._begin = (messages.stamp_to_ns(self.pose.header.stamp), position - self._home[0],
                       (turn * self._home[1].inv()).as_rotvec())
        self._command_forces(self.wanted)
        return True

    def _position(self):
        """Return where the operational point should be now, shape (3,) [m]."""
        p = self.pose.pose.position
        return np.array([p.x, p.y, p.z])

    def _command_forces(self, forces):
        self._force_command.publish(JointState(name=list(forces), effort=list(forces.values())))

    def _command_motion(self):
        if self._begin is None or self.pose is None:
            return
        (begin, offset, turn_offset), (home, home_turn) = self._begin, self._home
        elapsed = (messages.stamp_to_ns(self.pose.header.stamp) - begin) * 1e-9
        s, ds, dds = quintic(elapsed, RETURN_TIME)
        w = 2.0 * math.pi / MOTION_PERIOD
        sine, cosine = AMPLITUDE * math.sin(w * elapsed), AMPLITUDE * w * math.cos(w * elapsed)
        v, a = ds * sine + s * cosine, dds * sine + 2.0 * ds * cosine - s * w * w * sine
        self._motion_command.publish(messages.motion_message(
            home + (1.0 - s) * offset + s * sine * DIRECTION,
            (Rotation.from_rotvec((1.0 - s) * turn_offset) * home_turn).as_quat(),
            np.concatenate([v * DIRECTION - ds * offset, -ds * turn_offset]),
            np.concatenate([a * DIRECTION - dds * offset, -dds * turn_offset])))

    def inject(self, fault, seed):
        """Let a fault happen; what a node was led down from is left to `recover`."""
        action, random = fault.action, fault.random(seed)
        if fault.input == CONTROLLER and action.steps != HALT:
            self._begin = None  # no motion is commanded meanwhile
        duration = float(random.uniform(*FAULT_TIME))
        if isinstance(action, Command):
            self._mislead(fault, duration)
        elif not isinstance(action, NodeChange):
            self._distort(f'{fault.input} {fault.kind} {seed}')
            self.spin(duration)
            self._distort('')
        elif action.steps == KILL:
            process = self.processes.running.pop(fault.input)
            process.kill()
            process.join()
            self.spin(float(random.uniform(*OUTAGE)))
            # What the killed one has recorded is not overwritten.
            bag = {'folder': str((self.spec.out / f'bag-{time.time_ns()}').resolve())}
            self.processes.start(fault.input, bag if fault.input == RECORDER else {})
        elif action.steps == HALT:
            os.kill(self.processes.running[fault.input].pid, signal.SIGSTOP)
            self.spin(float(random.uniform(*HALT_TIME)))
            os.kill(self.processes.running[fault.input].pid, signal.SIGCONT)
        else:
            for step in action.steps:
                self._driver.change(fault.input, step)
            self.spin(duration)

    def _mislead(self, fault, duration):
        """Publish a wrong command beside the operator's, or as the last one."""
        if fault.input.startswith('forces'):
            publisher, message = self._force_command, JointState(name=list(self.wanted))
        else:
            pose = Transform(translation=Vector3(**dict(zip('xyz', self._position()))),
                             rotation=self.pose.pose.orientation)
            publisher, message = self._motion_command, MultiDOFJointTrajectoryPoint(
                transforms=[pose], velocities=[Twist()], accelerations=[Twist()])
        fault.action.change(message)
        end = time.monotonic() + duration
        while time.monotonic() < end and not fault.action.last:
            publisher.publish(message)
            self.spin(POLL_PERIOD)
        if fault.action.last:
            self._begin, before = None, self._position()
            publisher.publish(message)
            self.spin(END_TIME)
            way = math.dist(before, self._position())
            speed = self.setup.controller.limits.operational_speed
            if way >= speed * CommandLimits().motion_timeout + NEAR:
                raise RunError(f'led on for {way:.2f} m after the last motion command')

    def _distort(self, text):
        """Let the relay begin a fault, or end it."""
        print(text, file=self._relay.stdin, flush=True)
        if self._relay.stdout.readline() != 'done\n':
            raise RunError('fault relay ended')

    def recover(self):
        """Lead the graph back to where every contact has its force; RunError if that fails."""
        self._distort('')
        for name in spec.MANAGED:
            self._driver.bring_up(name)
        start, self.pose = time.time(), None
        self.wait(lambda: self.since(topics.EFFORT_COMMAND, start), 'commands')
        self.wait(lambda: self.since(topics.NOISE_VARIANCE, start), 'noise variances')
        for _ in range(ATTEMPTS):
            self.wait(self.start_motion, 'a controller that obeys')
            if self.comes(self._in_contact, RECOVERY_TIME / ATTEMPTS):
                return
            # A contact that was given up is only looked for again once it was not wanted.
            self._command_forces(dict.fromkeys(self.wanted, 0.0))
            self.spin(SETTLE_TIME)
        raise RunError(f'back in contact: not within {RECOVERY_TIME:g} s')

    def _in_contact(self):
        """Return whether every true force has been near its command for a while."""
        found = self.since(topics.TRUE_FORCES, time.time() - SETTLE_TIME)
        if len(found) < 0.3 * SETTLE_TIME * self.spec.rate:
            return False
        forces = np.array([[values[name] for name in self.wanted] for _, values in found])
        off = np.abs(forces.mean(axis=0) / list(self.wanted.values()) - 1.0)
        return bool((forces > 0.0).all() and (off <= FORCE_TOLERANCE).all())

    def break_once(self, fault, seed, random=None):
        """Let a fault happen, recover, with a `random` press and rest; return the `FaultRow`."""
        problems, begin, largest = [], time.time(), dict(self.wanted)
        end = recovered = -1.0
        try:
            self.spin(float(fault.random(seed).uniform(*QUIET)))
            begin = time.time()
            self.inject(fault, seed)
            end = time.time()
            self.recover()
            recovered = time.time()
            self.comes(lambda: any(x.node == CONTROLLER and x.time >= end for x in self.reports),
                       REPORT_TIME)
            if random is not None:
                self.wanted.update({x: float(random.uniform(*FORCES)) for x in self.wanted})
                largest = {name: max(largest[name], force) for name, force in self.wanted.items()}
                problems += self._press_and_rest()
        except RunError as error:
            problems.append(str(error).splitlines()[0])
        seen, silences = self.observe(largest, begin, max(begin, end), problems)
        seen.limited_rate = fault.input != CONTROLLER  # its first command is what the drives do
        if fault.goes_on and any(stop - start > STOPPED for start, stop in silences):
            seen.problems.add('commands stopped')
        row = judge.judge(fault, seed, self.setup, seen)
        safe = max([row.time_to_safe_s, *(round(stop, 6) for _, stop in silences)])
        again = recovered >= 0.0 and row.time_to_safe_s >= 0.0
        return replace(row, time_to_safe_s=safe if again else -1.0)

    def _press_and_rest(self):
        """Come to the wanted forces, and let the arm rest; return which of them oscillate."""
        self.recover()
        self._begin = None
        self.spin(END_TIME)
        start, rate = time.time(), self.spec.rate
        # By samples: a machine that is too busy for real time takes longer for it.
        self.wait(lambda: len(self.since(topics.TRUE_FORCES, start)) > REST_TIME * rate, 'samples')
        found = self.since(topics.TRUE_FORCES, start)
        self.wait(self.start_motion, 'a controller that obeys')
        return oscillating(np.array([[values[name] - force for name, force in self.wanted.items()]
                                     for _, values in found]), self.wanted, rate)

    def observe(self, wanted, begin, end, problems):
        """Return what is seen of a fault from `begin` to `end` [s] and after, and its silences."""
        heard = {topic: self.since(topic, begin) for topic in CHECKED}
        problems = {*problems, *(
            f'{topic.name} not finite' for topic, found in heard.items()
            if topic is not topics.EFFORT_COMMAND  # that is for the judge
            and not all(math.isfinite(x) for _, values in found for x in values.values()))}
        if any(values.get(name, 0.0) > force + 1e-6
               for _, values in heard[topics.DESIRED_FORCES] for name, force in wanted.items()):
            problems.add('obeyed a command it should have refused')
        commands, forces = heard[topics.EFFORT_COMMAND], heard[topics.TRUE_FORCES]
        joints, rate = self.setup.controller.robot.joint_names, self.setup.controller.rate
        samples = np.array([sent for sent, _ in forces])
        # From when to when samples came, but no commands. Samples were looked for after the
        # commands, on a busy machine long after.
        edges = [begin, *(sent for sent, _ in commands), min([*samples[-1:], self.polled])]
        silences = [(start, stop) for start, stop in zip(edges, edges[1:])
                    if stop - start > SILENCE and np.count_nonzero(
                        (samples > start) & (samples < stop)) > 0.5 * (stop - start) * rate]
        return judge.Observation(
            torque=np.array([[values[name] for name in joints] for _, values in commands]).reshape(
                -1, len(joints)),
            time=samples - begin, force=np.array([max(x.values()) for _, x in forces]),
            reaction=self._reaction(begin, end, silences, rate),
            problems=problems), [(start - begin, stop - begin) for start, stop in silences]

    def _reaction(self, begin, end, silences, rate):
        """Return the reaction that was in force for longest, by the controller's counts."""
        counts = [(x.time, [int(x.values.get(f'ticks with {name}', 0)) for name in SEVERITY])
                  for x in self.reports if x.node == CONTROLLER]
        none = [0] * len(SEVERITY)
        before = next((x for sent, x in reversed(counts) if sent < begin), none)
        after = next((x for sent, x in counts if sent >= end), none)
        # Counts that have fallen are those of a new process or activation.
        ticks = [now - old * (now >= old) for old, now in zip(before, after)]
        silent = sum(x[1] - x[0] for x in silences) * rate
        return 'silent' if silent > max(ticks) else SEVERITY[int(np.argmax(ticks))]

    def busy(self):
        """Return in which share of seconds half of the commands came later than half a period."""
        latencies = [float(text) for x in self.reports if x.node == SIM
                     if (text := x.values.get('latency_us_p50', 'none')) != 'none']
        limit = 0.5e6 * self.setup.controller.period
        return float(np.mean(np.array(latencies) > limit)) if latencies else 0.0
