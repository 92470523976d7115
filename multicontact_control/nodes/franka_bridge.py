"""
A Franka arm behind the topics: libfranka's torque interface, through its own Python wheel.

The robot sends a state each millisecond and wants a torque before the next one. A thread answers
it: it takes in the newest command and wrench, sends a torque, and publishes every `divider`th
state. It waits for nothing but the robot: a command that is late is replaced as `LateRule` says.
The stamps of samples are the robot's own time, and the age of a command is counted in it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
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
from std_srvs.srv import Trigger

NAME, JOINTS = 'franka_bridge', 7
SEVEN: dict[str, Any] = {'min_length': JOINTS, 'max_length': JOINTS}
CYCLE, MILLISECOND = 0.001, NANOSECONDS // 1000  # s, ns: that of the robot
SWITCH_INTERVAL = (
    5e-5  # s, for which other threads may keep the control thread from Python
)
STATUS_PERIOD, LOG_PERIOD, CONNECT_PERIOD = 1.0, 5.0, 0.5  # s
RECOVERY_TIMEOUT, JOIN_TIMEOUT = 10.0, 2.0  # s
TORQUE_COMMANDED = 'commanded'
TORQUE_HELD = 'held'
TORQUE_DAMPED = 'damped'
TORQUE_STOPPED = 'stopped'
FIGURES = (
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
    """What the bridge sends while the newest command is late; its age counts from its sample."""

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
    """Parameters of the bridge."""

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
    then none: the end. Each cycle is counted by what its torque is.
    """

    def __init__(self, config: LateConfig) -> None:
        self._config, self.kind = config, TORQUE_COMMANDED
        self._damping, self._step = np.array(config.damping), config.torque_rate * CYCLE
        self.figures: dict[str, float] = dict.fromkeys(FIGURES, 0)

    def answer(
        self, age: float, commanded: Vector, speed: Vector, before: Vector
    ) -> Any:
        """
        Return the next torque, shape (7,) [N m]; None to end torque control.

        The newest command has an `age` [s] and a torque, the joints have a speed [rad/s], and the
        robot got the torque `before` last.
        """
        config = self._config
        self.kind = (
            TORQUE_COMMANDED
            if age <= config.command_age
            else TORQUE_HELD
            if age <= config.hold_time
            else TORQUE_DAMPED
            if age <= config.stop_time
            else TORQUE_STOPPED
        )
        self.figures[self.kind] += 1
        if self.kind == TORQUE_STOPPED:
            return None
        change = (
            -self._damping * speed if self.kind == TORQUE_DAMPED else commanded
        ) - before
        limited = np.clip(change, -self._step, self._step)
        self.figures['rate_limited'] += bool(np.any(limited != change))
        self.figures['highest_torque_rate'] = max(
            self.figures['highest_torque_rate'], float(np.abs(limited).max()) / CYCLE
        )
        return np.asarray(before + limited)


class FrankaBridge(Node):
    """Connects a Franka arm with the controller."""

    def __init__(self, library: Any = None, **options: Any) -> None:
        super().__init__(NAME, **options)
        self._config: FrankaBridgeConfig = load_parameters(self, FrankaBridgeConfig)[0]
        self._library = _library() if library is None else library
        self._robot: Any = None
        self._model: Any = None
        self._active: Any = None  # torque control, while it runs
        self._lost: list[
            Any
        ] = []  # of lost connections; deleted, they would wait for the robot
        self._problem = 'connecting'  # for which `~/recover` is needed
        self._mode, self._errors = 'Idle', ''  # of the robot, in its own words
        self._rule = LateRule(self._config.late)
        self._figures = self._rule.figures
        self._torques = self._library.Torques([0.0] * JOINTS)  # the last
        self._time = self._origin = self._sample = (
            0  # of the robot [ms], its stamp at 0 [ns]
        )
        self._command, self._command_stamp = np.zeros(JOINTS), 0
        self._wrench, self._wrench_stamp = np.zeros(6), 0  # and when it came
        self._refusals = graph.RefusalLog(self.get_logger())
        self._refused: deque[tuple[str, Exception]] = deque(maxlen=100)
        self._samples = StreamPublisher(
            self,
            topics.JOINT_STATES,
            messages.joint_state_message(
                0,
                self._config.joint_names,
                **dict.fromkeys(messages.JOINT_FIELDS, np.zeros(JOINTS)),
            ),
        )
        self._wrenches = StreamPublisher(self, topics.WRENCH, WrenchStamped())
        sensor = replace(
            topics.WRENCH,
            publisher='the driver of the wrist sensor',
            name=self.resolve_topic_name('~/wrench'),
        )
        # Taken in by the control thread: an executor would empty the subscriptions of its node.
        self._listener = Node(
            f'{NAME}_inputs', context=self.context, start_parameter_services=False
        )
        self._heard = {
            topic: (
                self._listener.create_subscription(
                    topic.message,
                    topic.name,
                    graph.ignore_message,
                    qos.SENSOR,
                    raw=True,
                ),
                MessageReader(topic.message, read),
            )
            for topic, read in (
                (
                    topics.EFFORT_COMMAND,
                    partial(
                        messages.read_named_vectors,
                        names=self._config.joint_names,
                        fields=['effort'],
                    ),
                ),
                (sensor, messages.read_wrench),
            )
        }
        self._watch = diagnostics.LoopStatistics(1.0 / CYCLE)
        self._inputs = diagnostics.InputMonitor(
            self, 1.0 / (CYCLE * self._config.divider), sensor
        )
        self._diagnostics = diagnostics.DiagnosticsPublisher(
            self, self._statuses, BackgroundThread()
        )
        self._status_publisher = self.create_publisher(
            DiagnosticStatus, '~/status', qos.EVENT
        )
        self._reported: tuple[float, tuple[str, ...]] = (0.0, (self._problem,))
        self._ending, self._recovery, self._recovered = False, Event(), Event()
        self.create_service(Trigger, '~/recover', self._on_recover)
        graph.StartupGate(
            self, self._config
        )  # the control thread inherits its scheduling

    def run(self, spinner: Spinner) -> None:
        """Run the control thread until asked to stop; report meanwhile."""
        thread = Thread(target=self._control, name='control', daemon=True)
        self.get_logger().info(f'connecting with {self._config.address}')
        spinner.spin_once(0.0)  # with the first line logged, what takes long is done
        sys.setswitchinterval(SWITCH_INTERVAL)
        thread.start()
        while not spinner.stop and thread.is_alive():
            spinner.spin_once(0.02)
            self._diagnostics.poll()
            self._report()
        self._ending = True
        thread.join(JOIN_TIMEOUT)
        if not spinner.stop:
            raise RunError('the control thread has ended, as above')

    def close(self) -> None:
        """Write the counts of this run, if asked to."""
        self._listener.destroy_node()
        self._config.write_counts(
            {
                **self._figures,
                'answer_us': self._watch.latencies.percentiles(),
                'refused': dict(self._refusals.counts),
            }
        )

    # What the control thread does. It writes no log: the first line of one takes 40 ms.

    def _control(self) -> None:
        """Answer the robot until the node ends."""
        while not self._ending or self._active is not None:
            asked = self._recovery.is_set() or self._robot is None and not self._lost
            try:
                if asked:
                    self._recover()
                if self._robot is not None and not self._ending:
                    self._turn()
                elif self._active is not None:
                    self._finish()
            except (
                self._library.FrankaException,
                RuntimeError,
                MulticontactError,
            ) as error:
                self._fail(error)
            if asked:
                self._recovery.clear()
                self._recovered.set()
            if self._robot is None:
                time.sleep(CONNECT_PERIOD)

    def _turn(self) -> None:
        """Take one state of the robot: answer it, then publish it."""
        state = (
            self._robot.read_once()
            if self._active is None
            else self._active.readOnce()[0]
        )
        received = time.monotonic_ns()
        now = round(state.time.to_sec() / CYCLE)
        self._mode, self._errors = (
            str(state.robot_mode).split('.')[-1],
            str(state.current_errors),
        )
        if not self._origin:
            self._origin = (
                time.time_ns() // MILLISECOND * MILLISECOND - now * MILLISECOND
            )
        if self._active is not None and self._time:
            self._figures['lost_cycles'] += now - self._time - 1
        self._time, stamp = now, self._origin + now * MILLISECOND
        self._take_inputs(stamp)
        speed, age = np.array(state.dq), abs(1e-9 * (stamp - self._command_stamp))
        if self._active is not None:
            self._answer(state, age, speed)
            self._watch.latencies.add(time.monotonic_ns() - received)
        elif (
            not self._problem
            and self._mode == 'Idle'
            and (age <= self._config.late.command_age)
        ):
            self._active = self._robot.start_torque_control()
            self._time = 0  # in which some cycles pass
            self._figures['starts'] += 1
        self._watch.add_period(received)
        if now // self._config.divider != self._sample:
            self._sample = now // self._config.divider
            self._publish(stamp, state, speed)
        time.sleep(
            0.0
        )  # libfranka keeps other threads from Python while it waits for the robot

    def _take_inputs(self, stamp: int) -> None:
        """Take in the newest command and wrench."""
        for topic, (subscription, read) in self._heard.items():
            while (taken := graph.take_message(subscription)) is not None:
                try:
                    if topic is topics.EFFORT_COMMAND:
                        self._command_stamp, self._command = read(taken[0])
                    else:
                        _, self._wrench = read(taken[0])
                        self._wrench_stamp = stamp
                        self._inputs.last[topic] = time.monotonic_ns()
                except MulticontactError as error:
                    self._refused.append((topic.name, error))

    def _answer(self, state: Any, age: float, speed: Vector) -> None:
        """Send a torque, or end torque control."""
        torque = self._rule.answer(age, self._command, speed, np.array(state.tau_J_d))
        if torque is None:
            self._finish()
        else:
            self._torques = self._library.Torques(torque.tolist())
            self._active.writeOnce(self._torques)
            self._figures['cycles'] += 1
            self._figures['success_rate'] = state.control_command_success_rate

    def _finish(self) -> None:
        """End torque control: the robot holds its position."""
        active, self._active = self._active, None
        self._torques.motion_finished = True
        active.writeOnce(self._torques)

    def _publish(self, stamp: int, state: Any, speed: Vector) -> None:
        """Publish a sample."""
        if 1e-9 * (stamp - self._wrench_stamp) <= self._config.wrench_age:
            self._wrenches.publish_if_subscribed(stamp, self._wrench)
        else:
            self._figures['wrench_late'] += 1
        effort = (
            np.array(state.tau_J_d)
            if self._model is None
            else (np.array(state.tau_J) - np.array(self._model.gravity(state)))
        )
        self._samples.publish_if_subscribed(stamp, state.q, speed, effort)

    def _fail(self, error: Exception) -> None:
        """Take note of what ended torque control or the connection."""
        self._figures['aborts'] += self._active is not None
        if isinstance(error, self._library.NetworkException):
            self._lost += [self._active, self._robot] if self._robot is not None else []
            self._active = self._robot = self._model = None
        elif self._active is not None:
            with contextlib.suppress(RuntimeError, self._library.FrankaException):
                self._finish()  # libfranka then knows that it has ended
        text = shorten_ros_error(error).removeprefix('libfranka: ').rstrip('.')
        self._problem = (
            f'{self._config.address}: {text}' if self._robot is None else text
        )

    def _recover(self) -> None:
        """Connect, or clear the robot's errors; torque control may then start."""
        if self._robot is None:
            config, kinds = self._config, self._library.RealtimeConfig
            robot = self._library.Robot(
                config.address,
                kinds.kEnforce if config.enforce_realtime else kinds.kIgnore,
            )
            robot.set_collision_behavior(
                *[list(config.collision_torque)] * 2,
                *[list(config.collision_force)] * 2,
            )
            measures = any(
                robot.read_once().O_ddP_O
            )  # simulators know no direction of gravity
            self._model = robot.load_model() if measures else None
            self._robot, self._origin = robot, 0
            self._inputs.restart()
        elif self._mode == 'UserStopped':
            raise RunError('release the user stop')
        elif self._active is None:
            self._robot.automatic_error_recovery()
            self._figures['recoveries'] += 1
        self._problem = ''

    # What the main thread does.

    def _on_recover(self, _request: Any, response: Any) -> Any:
        self._recovered.clear()
        self._recovery.set()
        done = self._recovered.wait(RECOVERY_TIMEOUT)
        response.success = done and not self._problem
        response.message = self._problem if done else 'no answer of the robot'
        return response

    def _robot_status(self) -> diagnostics.ComponentStatus:
        """Return what the robot and the bridge do."""
        mode, error, warning = self._mode, self._problem, ''
        if self._active is not None:
            control = self._rule.kind
        elif error or mode != 'Idle':
            control = 'off'
        else:
            control = (
                'has ended; ' * (self._rule.kind == TORQUE_STOPPED)
                + 'starts with the next command'
            )
        if control in (TORQUE_HELD, TORQUE_DAMPED):
            warning = f'no command in time: torques are {control}'
        elif control == 'off' and mode != 'Idle':
            warning = f'the robot is in mode {mode}'
        if error and (self._lost or self._robot is not None):
            error += '; call ~/recover'
        return diagnostics.ComponentStatus(
            'robot',
            {
                'torque_control': control,
                'robot_mode': mode,
                'errors': self._errors,
                **self._figures,
            },
            error=error,
            warning=warning,
        )

    def _report(self) -> None:
        """Publish on ``~/status`` what changes, and once a second; log it."""
        while self._refused:
            self._refusals.log_refusal(*self._refused.popleft())
        status, now = self._robot_status(), time.monotonic()
        control = status.values['torque_control']
        texts = (
            status.error,
            status.warning,
            f'{self._config.address}: torque control '
            + (
                'runs'
                if control in (TORQUE_COMMANDED, TORQUE_HELD, TORQUE_DAMPED)
                else control
            ),
        )
        if texts != self._reported[1] or now > self._reported[0] + STATUS_PERIOD:
            if status.error and status.error not in self._reported[1]:
                self.get_logger().error(status.error)
            elif status.warning and not status.error:
                self.get_logger().warning(
                    status.warning, throttle_duration_sec=LOG_PERIOD
                )
            elif not status.error and texts[2] not in self._reported[1]:
                self.get_logger().info(texts[2])
            self._reported = (now, texts)
            self._status_publisher.publish(
                diagnostics.build_status_message(NAME, status)
            )

    def _statuses(self) -> Sequence[diagnostics.ComponentStatus]:
        return [
            self._robot_status(),
            diagnostics.ComponentStatus('loop', self._watch.report()),
            self._inputs.status(needed=self._robot is not None),
            diagnostics.refusal_status(self._refusals),
        ]


def _library() -> Any:
    """Return the module of libfranka; ConfigError if it is not installed."""
    try:
        import pylibfranka
    except ImportError as error:
        raise ConfigError(
            'pylibfranka', "the extra: pip install '.[franka]'", error
        ) from None
    return pylibfranka


def main() -> int:
    """Run the bridge."""
    return run_node(FrankaBridge)


if __name__ == '__main__':
    sys.exit(main())
