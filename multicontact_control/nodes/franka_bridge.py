"""
A Franka arm behind the topics: libfranka's torque interface, through its own Python wheel.

The robot sends a state each millisecond and wants a torque before the next one. A thread answers
it: it takes in the newest command and wrench, sends a torque, and publishes every `divider`th
state. It waits for nothing but the robot: a command that is late is replaced as `LateRule` says.
The stamps of samples are the robot's own time, and the age of a command is counted in it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
import contextlib
from dataclasses import replace
from functools import partial
import sys
from threading import Event, Thread
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from multicontact_control.arrays import Vector
from multicontact_control.config import Config, parameter
from multicontact_control.config import Vector as Numbers
from multicontact_control.errors import ConfigError, MulticontactError, RunError
from multicontact_control.nodes import diagnostics, graph, messages, qos, topics
from multicontact_control.nodes.background import BackgroundThread
from multicontact_control.nodes.parameters import load_parameters
from multicontact_control.nodes.runtime import run_node, shorten_ros_error, Spinner
from multicontact_control.nodes.streams import MessageReader, StreamPublisher
from multicontact_control.sampling import NANOSECONDS
import numpy as np
from rclpy.node import Node
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

NAME = 'franka_bridge'
JOINTS = 7
SEVEN: dict[str, Any] = {'min_length': JOINTS, 'max_length': JOINTS}
CYCLE = 0.001  # s, of the robot
MILLISECOND = NANOSECONDS // 1000  # ns
# s, for which other threads may keep the control thread from Python.
SWITCH_INTERVAL = 5e-5
STATUS_PERIOD = 1.0  # s, between two equal messages on ~/status
LOG_PERIOD = 5.0  # s, between two equal warnings
CONNECT_PERIOD = 0.5  # s, between two attempts to connect
RECOVERY_TIMEOUT = 10.0  # s, that ~/recover waits for the control thread
JOIN_TIMEOUT = 2.0  # s, that the end waits for the control thread
# Kinds of torque that a cycle is answered with.
TORQUE_COMMANDED = 'commanded'
TORQUE_HELD = 'held'
TORQUE_DAMPED = 'damped'
TORQUE_STOPPED = 'stopped'
FIGURES = (  # keys of the diagnostics, and of the counts of a run
    'cycles',
    'starts',
    'aborts',
    'recoveries',
    'lost_cycles',
    TORQUE_COMMANDED,
    TORQUE_HELD,
    TORQUE_DAMPED,
    TORQUE_STOPPED,
    'rate_limited',
    'wrench_late',
    'highest_torque_rate',
    'success_rate',
)


class LateConfig(Config):
    """
    The torque that the bridge sends while the newest command is late, by the command's age.

    The age counts from the sample that the command answers, in the robot's own time.
    """

    command_age: float = parameter(
        0.006, 'Age up to which a command is in time.', unit='s', gt=0.0
    )
    hold_time: float = parameter(
        0.02,
        'Age up to which its torque is held, as the robot does by itself.',
        unit='s',
    )
    stop_time: float = parameter(
        0.5,
        'Age up to which the joints are damped; then torque control ends.',
        unit='s',
    )
    damping: Numbers = parameter(
        (20.0,) * 4 + (5.0,) * 3,
        'Torque per speed of damped joints.',
        unit='N m s/rad',
        **SEVEN,
    )
    torque_rate: float = parameter(
        999.9,
        'Largest change of any torque that is sent, of commands as well; the robot stops '
        'at 1000.',
        unit='N m/s',
        gt=0.0,
        lt=1000.0,
    )


class FrankaBridgeConfig(graph.StartupConfig):
    """Parameters of the bridge: address and names of the arm, timing, limits of collisions."""

    address: str = parameter(..., 'IP address or name of the robot.')
    enforce_realtime: bool = parameter(
        True,
        'Whether libfranka asks for a real-time kernel; false for a simulated robot.',
    )
    divider: int = parameter(
        2, 'States of the robot, at 1 kHz, for each sample: 2 for 500 Hz.', ge=1, le=10
    )
    joint_names: tuple[str, ...] = parameter(
        tuple(f'joint{i + 1}' for i in range(JOINTS)), 'Joints, base to wrist.', **SEVEN
    )
    wrench_age: float = parameter(
        0.005, 'Age from which a wrench is published no more.', unit='s', gt=0.0
    )
    collision_torque: Numbers = parameter(
        (40.0,) * JOINTS,
        'External joint torques at which the robot stops.',
        unit='N m',
        **SEVEN,
    )
    collision_force: Numbers = parameter(
        (50.0,) * 3 + (25.0,) * 3,
        'External wrench at which it does.',
        unit='N, N m',
        min_length=6,
        max_length=6,
    )
    late: LateConfig = LateConfig()

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        late = self.late
        if not late.command_age < late.hold_time < late.stop_time:
            yield ConfigError(
                'late.hold_time',
                'a value between late.command_age and late.stop_time',
                late.hold_time,
            )


class LateRule:
    """
    Chooses and limits the torque of each cycle, without gravity.

    While the newest command is in time, its torque; then that torque for a while, then damping,
    then none: the end.

    Attributes
    ----------
    kind
        Kind of the newest torque, e.g. `TORQUE_HELD`.
    figures
        Cycles by the kind of their torque, and how often and how far torques changed.

    """

    def __init__(self, config: LateConfig) -> None:
        self._config = config
        self._damping = np.array(config.damping)
        self._largest_change = config.torque_rate * CYCLE
        self.kind = TORQUE_COMMANDED
        self.figures: dict[str, float] = dict.fromkeys(FIGURES, 0)

    def choose_torque(
        self, age: float, commanded: Vector, speed: Vector, before: Vector
    ) -> Vector | None:
        """
        Return the torque of the next cycle, None to end torque control.

        Parameters
        ----------
        age, commanded
            Age of the newest command [s], and its torque, shape (7,) [N m].
        speed
            Speed of the joints, shape (7,) [rad/s].
        before
            Torque of the last cycle, shape (7,) [N m]: the next one is within `torque_rate` of it.

        """
        self.kind = self._classify(age)
        self.figures[self.kind] += 1
        if self.kind == TORQUE_STOPPED:
            return None
        wanted = commanded
        if self.kind == TORQUE_DAMPED:
            wanted = -self._damping * speed
        change = wanted - before
        limited = np.clip(change, -self._largest_change, self._largest_change)
        if np.any(limited != change):
            self.figures['rate_limited'] += 1
        rate = float(np.abs(limited).max()) / CYCLE
        self.figures['highest_torque_rate'] = max(
            rate, self.figures['highest_torque_rate']
        )
        return np.asarray(before + limited)

    def _classify(self, age: float) -> str:
        """Return the kind of torque for a command of some age [s]."""
        if age <= self._config.command_age:
            return TORQUE_COMMANDED
        if age <= self._config.hold_time:
            return TORQUE_HELD
        if age <= self._config.stop_time:
            return TORQUE_DAMPED
        return TORQUE_STOPPED


class FrankaBridge(Node):
    """
    Connects a Franka arm with the controller.

    The control thread answers the robot and owns everything but the reports, which the main
    thread makes of strings and numbers that the control thread replaces as a whole.

    Parameters
    ----------
    library
        Module with the classes of libfranka; None for pylibfranka.
    options
        Those of `rclpy.node.Node`.

    """

    def __init__(self, library: Any = None, **options: Any) -> None:
        super().__init__(NAME, **options)
        self._config: FrankaBridgeConfig = load_parameters(self, FrankaBridgeConfig)[0]
        self._library = _import_library() if library is None else library
        self._robot: Any = None
        self._model: Any = None  # of the robot's dynamics; None if it knows no gravity
        self._control: Any = None  # torque control, while it runs
        # Of lost connections: deleted, they would wait for the robot.
        self._lost: list[Any] = []
        self._problem = 'connecting'  # for which `~/recover` is needed
        self._mode = 'Idle'  # of the robot, in its own words
        self._errors = ''  # of the robot, likewise
        self._rule = LateRule(self._config.late)
        self._figures = self._rule.figures
        self._torques = self._library.Torques([0.0] * JOINTS)  # the last
        self._time = 0  # of the robot [ms]; 0 for unknown
        self._origin = 0  # stamp of the robot's time 0 [ns]; 0 for unknown
        self._sample = 0  # number of the last
        self._command = np.zeros(JOINTS)  # N m
        self._command_stamp = 0  # of the sample that it answers [ns]
        self._wrench = np.zeros(6)  # N, N m
        self._wrench_stamp = 0  # when it came [ns]
        self._refusals = graph.RefusalLog(self.get_logger())
        self._refused: deque[tuple[str, Exception]] = deque(maxlen=100)
        zeros = np.zeros(JOINTS)
        pattern = messages.joint_state_message(
            0, self._config.joint_names, position=zeros, velocity=zeros, effort=zeros
        )
        self._samples = StreamPublisher(self, topics.JOINT_STATES, pattern)
        self._wrenches = StreamPublisher(self, topics.WRENCH, WrenchStamped())
        self._sensor = replace(
            topics.WRENCH,
            publisher='the driver of the wrist sensor',
            name=self.resolve_topic_name('~/wrench'),
        )
        # Taken in by the control thread: an executor would empty the subscriptions of its node.
        self._listener = Node(
            f'{NAME}_inputs', context=self.context, start_parameter_services=False
        )
        self._commands_heard = self._subscribe(
            topics.EFFORT_COMMAND,
            partial(
                messages.read_named_vectors,
                names=self._config.joint_names,
                fields=['effort'],
            ),
        )
        self._wrenches_heard = self._subscribe(self._sensor, messages.read_wrench)
        self._watch = diagnostics.LoopStatistics(1.0 / CYCLE)
        self._inputs = diagnostics.InputMonitor(
            self, 1.0 / (CYCLE * self._config.divider), self._sensor
        )
        self._diagnostics = diagnostics.DiagnosticsPublisher(
            self, self._collect_statuses, BackgroundThread()
        )
        self._status_publisher = self.create_publisher(
            DiagnosticStatus, '~/status', qos.EVENT
        )
        self._reported_texts: tuple[str, ...] = (self._problem,)
        self._report_due = 0.0  # s, monotonic
        self._ending = False
        self._recovery_wanted = Event()
        self._recovery_done = Event()
        self.create_service(Trigger, '~/recover', self._on_recover)
        # Claims the processor; the control thread inherits its scheduling.
        graph.StartupGate(self, self._config)

    def _subscribe(
        self, topic: topics.Topic, read: Callable[[Any], tuple[Any, ...]]
    ) -> tuple[Subscription, MessageReader]:
        subscription = self._listener.create_subscription(
            topic.message, topic.name, graph.ignore_message, qos.SENSOR, raw=True
        )
        return subscription, MessageReader(topic.message, read)

    def run(self, spinner: Spinner) -> None:
        """Run the control thread until asked to stop; RunError if it ends by itself."""
        thread = Thread(target=self._answer_robot, name='control', daemon=True)
        self.get_logger().info(f'connecting with {self._config.address}')
        spinner.spin_once(0.0)  # with the first line logged, what takes long is done
        sys.setswitchinterval(SWITCH_INTERVAL)
        thread.start()
        while not spinner.stop and thread.is_alive():
            spinner.spin_once(0.02)
            self._diagnostics.poll()
            self._report_changes()
        self._ending = True
        thread.join(JOIN_TIMEOUT)
        if not spinner.stop:
            raise RunError('the control thread has ended, as above')

    def close(self) -> None:
        """Destroy the listener, and write the counts of this run to `timing_file`, if given."""
        self._listener.destroy_node()
        self._config.write_counts(
            {
                **self._figures,
                'answer_us': self._watch.latencies.percentiles(),
                'refused': dict(self._refusals.counts),
            }
        )

    # The control thread. It writes no log: the first line of one takes 40 ms.

    def _answer_robot(self) -> None:
        """Connect, and answer the robot until the node ends."""
        failures = (self._library.FrankaException, RuntimeError, MulticontactError)
        while not self._ending or self._control is not None:
            never_connected = self._robot is None and not self._lost
            recovering = self._recovery_wanted.is_set() or never_connected
            try:
                if recovering:
                    self._recover()
                if self._robot is not None and not self._ending:
                    self._answer_state()
                elif self._control is not None:
                    self._finish_control()
            except failures as error:
                self._note_failure(error)
            if recovering:
                self._recovery_wanted.clear()
                self._recovery_done.set()
            if self._robot is None:
                time.sleep(CONNECT_PERIOD)

    def _answer_state(self) -> None:
        """Take one state of the robot: answer it, then publish it."""
        if self._control is None:
            state = self._robot.read_once()
        else:
            state, _ = self._control.readOnce()
        received = time.monotonic_ns()
        now = round(state.time.to_sec() / CYCLE)
        stamp = self._stamp_state(now)
        self._mode = str(state.robot_mode).split('.')[-1]
        self._errors = str(state.current_errors)
        self._take_inputs(stamp)
        age = abs(1e-9 * (stamp - self._command_stamp))
        if self._control is not None:
            self._send_torque(state, age)
            self._watch.latencies.add(time.monotonic_ns() - received)
        elif not self._problem and self._mode == 'Idle':
            if age <= self._config.late.command_age:
                self._start_control()
        self._watch.add_turn(received)
        sample = now // self._config.divider
        if sample != self._sample:
            self._sample = sample
            self._publish_sample(stamp, state)
        # libfranka keeps other threads from Python while it waits for the robot.
        time.sleep(0.0)

    def _stamp_state(self, now: int) -> int:
        """Return the stamp [ns] of a time of the robot [ms]; count the cycles it has passed by."""
        if not self._origin:
            started = time.time_ns() // MILLISECOND - now
            self._origin = started * MILLISECOND
        if self._control is not None and self._time:
            self._figures['lost_cycles'] += now - self._time - 1
        self._time = now
        return self._origin + now * MILLISECOND

    def _take_inputs(self, stamp: int) -> None:
        """Take in the newest command and wrench, at a time of the robot [ns]."""
        for command_stamp, command in self._read_arrived(*self._commands_heard):
            self._command_stamp = command_stamp
            self._command = command
        for _, wrench in self._read_arrived(*self._wrenches_heard):
            self._wrench = wrench
            self._wrench_stamp = stamp
            self._inputs.last[self._sensor] = time.monotonic_ns()

    def _read_arrived(
        self, subscription: Subscription, read: MessageReader
    ) -> Iterator[tuple[Any, ...]]:
        """Yield what is read in the messages that wait; keep what is refused for the log."""
        while (taken := graph.take_message(subscription)) is not None:
            try:
                yield read(taken[0])
            except MulticontactError as error:
                self._refused.append((subscription.topic_name, error))

    def _start_control(self) -> None:
        self._control = self._robot.start_torque_control()
        self._time = 0  # unknown: some cycles pass meanwhile
        self._figures['starts'] += 1

    def _send_torque(self, state: Any, age: float) -> None:
        """Answer a state by a torque while the command has some age [s], or end torque control."""
        torque = self._rule.choose_torque(
            age, self._command, np.array(state.dq), np.array(state.tau_J_d)
        )
        if torque is None:
            self._finish_control()
        else:
            self._torques = self._library.Torques(torque.tolist())
            self._control.writeOnce(self._torques)
            self._figures['cycles'] += 1
            self._figures['success_rate'] = state.control_command_success_rate

    def _finish_control(self) -> None:
        """End torque control: the robot holds its position."""
        control = self._control
        self._control = None  # also if the robot does not take the end
        self._torques.motion_finished = True
        control.writeOnce(self._torques)

    def _publish_sample(self, stamp: int, state: Any) -> None:
        """Publish joint state and wrench at a stamp [ns]; efforts without gravity."""
        if 1e-9 * (stamp - self._wrench_stamp) <= self._config.wrench_age:
            self._wrenches.publish_if_subscribed(stamp, self._wrench)
        else:
            self._figures['wrench_late'] += 1
        effort = np.array(state.tau_J_d)
        if self._model is not None:
            effort = np.array(state.tau_J) - np.array(self._model.gravity(state))
        self._samples.publish_if_subscribed(stamp, state.q, state.dq, effort)

    def _note_failure(self, error: Exception) -> None:
        """Give up what an error has ended: the connection, or torque control."""
        if self._control is not None:
            self._figures['aborts'] += 1
        text = shorten_ros_error(error).removeprefix('libfranka: ').rstrip('.')
        if isinstance(error, self._library.NetworkException):
            if self._robot is not None:
                self._lost += [self._control, self._robot]
            self._control = self._robot = self._model = None
        elif self._control is not None:
            with contextlib.suppress(RuntimeError, self._library.FrankaException):
                self._finish_control()  # libfranka then knows that it has ended
        if self._robot is None:
            text = f'{self._config.address}: {text}'
        self._problem = text

    def _recover(self) -> None:
        """Connect, or clear the robot's errors; torque control may then start."""
        if self._robot is None:
            self._connect()
        elif self._mode == 'UserStopped':
            raise RunError('release the user stop')
        elif self._control is None:
            self._robot.automatic_error_recovery()
            self._figures['recoveries'] += 1
        self._problem = ''

    def _connect(self) -> None:
        config = self._config
        kinds = self._library.RealtimeConfig
        realtime = kinds.kEnforce if config.enforce_realtime else kinds.kIgnore
        robot = self._library.Robot(config.address, realtime)
        torque = list(config.collision_torque)
        force = list(config.collision_force)
        robot.set_collision_behavior(torque, torque, force, force)
        # Simulators know no direction of gravity, and measure no torque.
        self._model = robot.load_model() if any(robot.read_once().O_ddP_O) else None
        self._robot = robot
        self._origin = 0
        self._inputs.restart()

    # The main thread.

    def _on_recover(self, _request: Any, response: Any) -> Any:
        self._recovery_done.clear()
        self._recovery_wanted.set()
        if self._recovery_done.wait(RECOVERY_TIMEOUT):
            response.success = not self._problem
            response.message = self._problem
        else:
            response.message = 'no answer of the robot'
        return response

    def _describe_control(self) -> str:
        """Return the kind of torque while torque control runs, else whether it starts."""
        if self._control is not None:
            return self._rule.kind
        if self._problem or self._mode != 'Idle':
            return 'off'
        if self._rule.kind == TORQUE_STOPPED:
            return 'has ended; starts with the next command'
        return 'starts with the next command'

    def _robot_status(self) -> diagnostics.ComponentStatus:
        """Return the status of robot and torque control."""
        control = self._describe_control()
        warning = ''
        if control in (TORQUE_HELD, TORQUE_DAMPED):
            warning = f'no command in time: torques are {control}'
        elif control == 'off' and self._mode != 'Idle':
            warning = f'the robot is in mode {self._mode}'
        error = self._problem
        if error and (self._lost or self._robot is not None):
            error += '; call ~/recover'
        return diagnostics.ComponentStatus(
            'robot',
            {
                'torque_control': control,
                'robot_mode': self._mode,
                'errors': self._errors,
                **self._figures,
            },
            error=error,
            warning=warning,
        )

    def _report_changes(self) -> None:
        """Publish changes on ~/status, the state once a second as well; log what changes."""
        while self._refused:
            self._refusals.log_refusal(*self._refused.popleft())
        status = self._robot_status()
        control = status.values['torque_control']
        if control in (TORQUE_COMMANDED, TORQUE_HELD, TORQUE_DAMPED):
            control = 'runs'
        text = f'{self._config.address}: torque control {control}'
        texts = (status.error, status.warning, text)
        before = self._reported_texts
        now = time.monotonic()
        if texts == before and now <= self._report_due:
            return
        if status.error:
            if status.error not in before:
                self.get_logger().error(status.error)
        elif status.warning:
            self.get_logger().warning(status.warning, throttle_duration_sec=LOG_PERIOD)
        elif text not in before:
            self.get_logger().info(text)
        self._reported_texts = texts
        self._report_due = now + STATUS_PERIOD
        self._status_publisher.publish(diagnostics.build_status_message(NAME, status))

    def _collect_statuses(self) -> Sequence[diagnostics.ComponentStatus]:
        return [
            self._robot_status(),
            diagnostics.ComponentStatus('loop', self._watch.report()),
            self._inputs.status(needed=self._robot is not None),
            diagnostics.refusal_status(self._refusals),
        ]


def _import_library() -> Any:
    """Return the module of libfranka; ConfigError if it is not installed."""
    try:
        import pylibfranka
    except ImportError as error:
        raise ConfigError(
            'pylibfranka', "the extra: pip install '.[franka]'", error
        ) from None
    return pylibfranka


def main() -> int:
    """Run the bridge in this process; return the exit code, see `run_node`."""
    return run_node(FrankaBridge)


if __name__ == '__main__':
    sys.exit(main())
