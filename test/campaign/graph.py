"""
A running graph that faults are put into: listened to, commanded, and led back to a good state.

Nodes are processes and time is real. The operator presses on every contact and slides to and fro.
"""

from collections import deque
from dataclasses import replace
from itertools import pairwise
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from campaign.graph_faults import HALT, KILL, NodeChange
from campaign.relay import INPUTS, PREFIX
from multicontact_control.errors import RunError
from multicontact_control.faults import outcomes
from multicontact_control.nodes import link, messages, qos, topics
from multicontact_control.nodes.graph import (
    create_publisher,
    ignore_message,
    take_message,
)
from multicontact_control.nodes.topics import CONTROLLER, RECORDER
from multicontact_control.runs.graph import spec
from multicontact_control.runs.graph.processes import NodeProcesses
import numpy as np
from sensor_msgs.msg import JointState

CHECKED = (
    topics.EFFORT_COMMAND,
    topics.DESIRED_FORCES,
    topics.ESTIMATED_FORCES,
    topics.NOISE_VARIANCE,
    topics.TRUE_FORCES,
)
REMEMBERED = 30_000  # messages per topic: a minute at 500 Hz
AMPLITUDE = 0.03  # m, of the motion along x
MOTION_PERIOD = 3.0  # s
QUIET = (0.0, 0.3)  # s before a fault
FAULT_TIME = (0.1, 0.4)  # s of a fault
HALT_TIME = (0.02, 0.2)  # s of a process that is halted
OUTAGE = (0.0, 0.5)  # s without a process
# s without a command while samples come, from which on it counts as silence
SILENCE = 0.1
STOPPED = 0.3  # s of silence that no controller may take
POLL_PERIOD = 0.005  # s
SETTLE_TIME = 0.2  # s over which forces are averaged
WANTED_FORCE = 10.0  # N at every contact
FORCE_TOLERANCE = 0.25  # share of that which a force may be off
RECOVERY_TIME = 90.0  # s, on a busy machine
ATTEMPTS = 3  # at contact in that time
# A machine without real-time priority has hiccups of many periods: no faults to be answered here.
PATIENT = {
    'patience': 10.0,
    'watchdog.joint_max_age': 15.0,
    'watchdog.wrench_max_age': 15.0,
    'watchdog.variance_max_age': 25.0,
    'watchdog.rate_band': 25.0,
}


def as_rows(heard, names):
    """Return efforts that were heard as an array, shape (messages, names)."""
    rows = [[efforts[name] for name in names] for _, efforts in heard]
    return np.array(rows).reshape(-1, len(names))


class Graph(link.ServiceClientNode):
    """One graph, which ends with its context, and the operator who presses and slides."""

    def __init__(self, setup, folder, domain_id):
        super().__init__('fault_campaign', domain_id)
        self._driver = link.ServiceClientNode(
            'lifecycle_driver', domain_id, keep_waiting=lambda what: self.poll()
        )
        self.setup = setup
        extra_parameters = {name: {'startup_peers': []} for name in spec.START_ORDER}
        extra_parameters[CONTROLLER] |= PATIENT
        relayed = {topic.name: PREFIX + topic.name for topic in INPUTS.values()}
        graph = spec.GraphSpec(
            out=folder,
            ticks=0,
            rate=setup.controller.rate,
            seed=setup.seed,
            free_running=True,
            domain_id=domain_id,
            parameter_files=setup.write(folder / 'config'),
            remappings={CONTROLLER: relayed},
            extra_parameters=extra_parameters,
        )
        self.processes = NodeProcesses(graph, domain_id)
        self.wanted = dict.fromkeys(setup.controller.contact_names, WANTED_FORCE)
        self._subscriptions = {}
        for topic in (*CHECKED, topics.POSE_DESIRED):
            self._subscriptions[topic] = self.node.create_subscription(
                topic.message, topic.name, ignore_message, qos.STREAM
            )
        # When messages were sent [s], and their efforts by name; all until `polled` [s].
        self.heard = {topic: deque(maxlen=REMEMBERED) for topic in CHECKED}
        self.polled = math.inf
        self.pose = None
        self.home = None
        self.moves = False
        self._force_command = create_publisher(self.node, topics.FORCE_COMMAND)
        self._motion_command = create_publisher(self.node, topics.MOTION_COMMAND)
        environment = {
            **os.environ,
            'ROS_DOMAIN_ID': str(domain_id),
            'PYTHONPATH': os.pathsep.join(sys.path),
        }
        self._relay = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name('relay.py'))],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for name in self.processes.spec.nodes:
            self.processes.start(name)

    def close(self):
        self.processes.stop(abort=True)
        self._relay.communicate()
        self._driver.close()
        super().close()

    def end_all(self):
        """End every node as at the end of a run; return which of them failed."""
        self.processes.stop()
        return [
            f'{name} ended with {process.exitcode}'
            for name, process in self.processes.running.items()
            if process.exitcode
        ]

    def poll(self):
        """Take in what has come, and command the motion of now."""
        self.polled = time.time()
        for topic, subscription in self._subscriptions.items():
            while (taken := take_message(subscription)) is not None:
                message, info = taken
                if topic is topics.POSE_DESIRED:
                    self.pose = message
                else:
                    efforts = dict(zip(message.name, message.effort))
                    sent = info['source_timestamp'] * 1e-9
                    self.heard[topic].append((sent, efforts))
        if self.moves and self.pose is not None:
            self._command_motion()
        self.processes.check_running()

    def _command_motion(self):
        """Command where the sine along x is now."""
        position, quaternion = self.home
        w = 2.0 * math.pi / MOTION_PERIOD
        time_s = messages.stamp_to_ns(self.pose.header.stamp) * 1e-9
        x = AMPLITUDE * np.eye(6)[0]
        way = math.sin(w * time_s) * x
        twist = w * math.cos(w * time_s) * x
        motion = messages.motion_message(
            position + way[:3], quaternion, twist, -w * w * way
        )
        self._motion_command.publish(motion)

    def since(self, topic, start):
        """Return when [s] and what was sent on a topic from a time on."""
        found = deque()
        for sent, values in reversed(self.heard[topic]):  # of a minute, some tenths
            if sent < start:
                break
            found.appendleft((sent, values))
        return list(found)

    def comes(self, condition, timeout):
        """Let the graph run until something happens; return whether it does in time [s]."""
        give_up = time.monotonic() + timeout
        while not condition():
            if time.monotonic() >= give_up:
                return False
            self.poll()
            time.sleep(POLL_PERIOD)
        return True

    def spin(self, duration):
        self.comes(lambda: False, duration)

    def wait(self, condition, what):
        if not self.comes(condition, RECOVERY_TIME):
            raise RunError(f'{what}: not within {RECOVERY_TIME:g} s')

    def start_motion(self):
        """Command the forces and the motion; return whether there is a controller to obey."""
        if self.pose is None:
            return False
        for publisher in (self._force_command, self._motion_command):
            if not publisher.get_subscription_count():
                return False
        if self.home is None:
            p = self.pose.pose.position
            q = self.pose.pose.orientation
            self.home = np.array([p.x, p.y, p.z]), [q.x, q.y, q.z, q.w]
        self.moves = True
        self._command_forces(self.wanted)
        return True

    def _command_forces(self, forces):
        message = JointState(name=list(forces), effort=list(forces.values()))
        self._force_command.publish(message)

    def inject(self, fault, seed):
        """Let a fault happen; what a node was led down from is left to `recover`."""
        action = fault.action
        random = fault.random_source(seed)
        if fault.input == CONTROLLER and action.steps != HALT:
            self.moves = False  # no motion is commanded meanwhile
        duration = float(random.uniform(*FAULT_TIME))
        if not isinstance(action, NodeChange):
            self._distort(f'{fault.input} {fault.kind} {seed}')
            self.spin(duration)
            self._distort('')
        elif action.steps == KILL:
            process = self.processes.running.pop(fault.input)
            process.kill()
            process.join()
            self.spin(float(random.uniform(*OUTAGE)))
            parameters = {}
            if fault.input == RECORDER:  # what the killed one has recorded stays
                folder = self.processes.spec.out.resolve() / f'bag-{time.time_ns()}'
                parameters['folder'] = str(folder)
            self.processes.start(fault.input, parameters)
        elif action.steps == HALT:
            pid = self.processes.running[fault.input].pid
            os.kill(pid, signal.SIGSTOP)
            self.spin(float(random.uniform(*HALT_TIME)))
            os.kill(pid, signal.SIGCONT)
        else:
            for step in action.steps:
                self._driver.change_state(fault.input, step)
            self.spin(duration)

    def _distort(self, text):
        """Let the relay begin a fault, or end it."""
        print(text, file=self._relay.stdin, flush=True)
        if self._relay.stdout.readline() != 'done\n':
            raise RunError('fault relay ended')

    def recover(self):
        """Lead the graph back to where every contact has its force; RunError if that fails."""
        self._distort('')
        for name in spec.MANAGED:
            self._driver.configure_and_activate(name)
        self.pose = None
        start = time.time()
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
        recent = self.since(topics.TRUE_FORCES, time.time() - SETTLE_TIME)
        if len(recent) < 0.3 * SETTLE_TIME * self.setup.controller.rate:
            return False
        forces = as_rows(recent, self.wanted)
        off = np.abs(forces.mean(axis=0) / WANTED_FORCE - 1.0)
        return forces.min() > 0.0 and off.max() <= FORCE_TOLERANCE

    def break_once(self, fault, seed):
        """Let a fault happen and recover; return the `FaultRow`."""
        problems = []
        recovered = False
        begin = time.time()
        try:
            self.spin(float(fault.random_source(seed).uniform(*QUIET)))
            begin = time.time()
            self.inject(fault, seed)
            self.recover()
            recovered = True
        except RunError as error:
            problems.append(str(error).splitlines()[0])
        seen, silences = self.observe(begin, problems)
        if fault.goes_on and any(stop - start > STOPPED for start, stop in silences):
            seen.problems.add('commands stopped')
        # The first command of a controller is what the drives do.
        seen = seen._replace(limited_rate=fault.input != CONTROLLER)
        row = outcomes.judge_fault(fault, seed, self.setup, seen)
        if not recovered:
            return replace(row, time_to_safe_s=math.inf)
        ends = [round(stop - begin, 6) for _, stop in silences]
        return replace(row, time_to_safe_s=max([row.time_to_safe_s, *ends]))

    def observe(self, begin, problems):
        """Return what is seen of a fault from `begin` [s] on, and its silences [s]."""
        heard = {topic: self.since(topic, begin) for topic in CHECKED}
        problems = set(problems)
        for topic, sent in heard.items():
            if topic is topics.EFFORT_COMMAND:  # that is for the judge
                continue
            values = [value for _, efforts in sent for value in efforts.values()]
            if not np.isfinite(values).all():
                problems.add(f'{topic.name} not finite')
        commands = heard[topics.EFFORT_COMMAND]
        forces = heard[topics.TRUE_FORCES]
        samples = np.array([sent for sent, _ in forces])
        silences = self._silences(begin, [sent for sent, _ in commands], samples)
        reaction = 'commands'
        if silences:
            reaction = 'silent'
        seen = outcomes.Observation(
            torque=as_rows(commands, self.setup.controller.robot.joint_names),
            time=samples - begin,
            force=as_rows(forces, self.wanted).max(axis=1),
            reaction=reaction,
            problems=problems,
        )
        return seen, silences

    def _silences(self, begin, commands, samples):
        """
        Return from when to when samples came, but no commands [s].

        Samples are looked for after the commands, on a busy machine long after.
        """
        end = min([*samples[-1:], self.polled])
        silences = []
        for start, stop in pairwise([begin, *commands, end]):
            between = np.count_nonzero((samples > start) & (samples < stop))
            expected = (stop - start) * self.setup.controller.rate
            if stop - start > SILENCE and between > 0.5 * expected:
                silences.append((start, stop))
        return silences
