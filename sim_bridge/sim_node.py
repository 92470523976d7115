"""
The plant as a ROS 2 node: it waits for the controller, or runs free as a robot does.

In lockstep, the default, the next sample is published when the command for the last one has come,
and not before its time by the wall clock (at `speed` times real time).

Free-running, sample k is published at the absolute deadline k h of the monotonic clock, and the
plant advances by one period with the torque that is due then. A command that is not there one
period after its sample is a deadline miss: the last torque is held, for `COMMAND_TIMEOUT` at most;
then the drives hold their position. A node that is late itself moves the deadlines back.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import partial
import sys
import time
from typing import Any

from geometry_msgs.msg import Vector3Stamped, WrenchStamped
from multicontact_control.arrays import Vector
from multicontact_control.config import parameter
from multicontact_control.errors import MessageError, RunError
from multicontact_control.nodes import diagnostics, messages, qos, topics
from multicontact_control.nodes.background import BackgroundThread
from multicontact_control.nodes.graph import (
    create_publisher,
    RefusalLog,
    StartupConfig,
    StartupGate,
)
from multicontact_control.nodes.parameters import ParameterSet
from multicontact_control.nodes.runtime import run_node, Spinner
from multicontact_control.nodes.streams import MessageReader, StreamPublisher
from multicontact_control.sampling import NANOSECONDS
import numpy as np
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from sim_bridge.actuator_delay import ActuatorDelay
from sim_bridge.arm import SENSOR_FRAME
from sim_bridge.config import LARGEST_PUSH, PlantConfig, PUSH_TIME
from sim_bridge.drives import PositionHold
from sim_bridge.plant import Plant, Sample
from sim_bridge.surface_patch import SurfaceMarkers
from std_msgs.msg import Header, String

MAX_LATE_PERIODS = 2
CATCH_UP = (
    NANOSECONDS // 10
)  # lag behind the wall clock that lockstep makes up for [ns]
RESEND_PERIOD, RESEND_PERIOD_GATED = 1.0, 10.0
ANSWER_TIMEOUT = 10.0  # s, longest wait for a command in lockstep
RESENDS = 16  # times that a sample is sent in lockstep within that
WAIT_FRACTION = (
    0.5  # of a period: time for the command of a sample before the plant moves on
)
COMMAND_TIMEOUT = (
    0.05  # s without a command, free-running; then the drives hold their position
)
TOOL = 'tool'
EDGES = np.logspace(
    1.0, 5.0, 41
)  # us, of the latencies: ten per decade, 10 us to 100 ms
REMEMBERED = 1024  # samples whose time of publication is known


class SimNodeConfig(StartupConfig):
    """What only the node needs to know, not the plant in it."""

    rate: float = parameter(500.0, 'Samples per second.', unit='Hz', gt=0.0)
    seed: int = parameter(0, 'Seed of roughness and sensor noise.', ge=0)
    ticks: int = parameter(0, 'Samples after which the node ends, 0 for never.', ge=0)
    lockstep: bool = parameter(
        True,
        'Whether to wait for the command that answers each sample; false for a plant that '
        'runs on, as a robot does.',
    )
    speed: float = parameter(
        1.0,
        'Simulated time per wall time at most, in lockstep; 0 for as fast as it goes.',
        ge=0.0,
        le=100.0,
    )
    payload: float = parameter(
        0.0,
        'Mass that the tool picks up, at its centre of mass, and lays down with 0.',
        unit='kg',
        live=True,
        ge=0.0,
        le=50.0,
    )


def stamp_of_tick(tick: int, rate: float) -> int:
    """Return tick / rate in whole nanoseconds, without an error that grows."""
    return int(tick * NANOSECONDS / Fraction(rate))


class SimNode(Node):
    """Simulates the arm: publishes joint states and wrench, applies the commanded torques."""

    def __init__(self) -> None:
        super().__init__(topics.SIM)
        plant_config: PlantConfig
        config: SimNodeConfig
        parameters = ParameterSet(self, PlantConfig, SimNodeConfig)
        plant_config, config = parameters.build_configurations()
        self._plant_config, self._config = plant_config, config
        parameters.apply_design = self._change
        self._plant = Plant(plant_config, rate=config.rate, seed=config.seed)
        # The first step ever takes many times as long as all others: not in the run.
        self._plant.step(self._plant.initial_torque)
        self._sample: Sample = self._plant.reset()
        self._plant.payload = config.payload
        self._delay_ticks = plant_config.actuator_delay_ticks
        self._delay = ActuatorDelay(self._delay_ticks, self._plant.initial_torque)
        self._refusals = RefusalLog(self.get_logger())
        self._tick = 0
        self._answered = -1
        self._commanded = 0  # when the last command came
        self._hold = PositionHold(self._plant.model)
        # Longest time to a command that is no miss [ns].
        self._period = np.inf if config.lockstep else NANOSECONDS / config.rate
        self._misses = self._slips = self._timeouts = 0
        self._due = 0  # when the newest sample was due [ns]
        self._step_times = diagnostics.DurationLog()
        self._start = time.monotonic_ns()
        self._wall = 0
        self._published = np.zeros(REMEMBERED, dtype=np.int64)
        description = create_publisher(self, topics.ROBOT_DESCRIPTION)
        self._surfaces = SurfaceMarkers(plant_config, rate=config.rate)
        self._surface_publisher = create_publisher(self, topics.SURFACE_MARKERS)
        joints, contacts = self._plant.joint_names, self._plant.contact_names
        zeros, wrench = (
            np.zeros(len(joints)),
            WrenchStamped(header=Header(frame_id=SENSOR_FRAME)),
        )
        self._streams = {
            topic: StreamPublisher(self, topic, pattern)
            for topic, pattern in (
                (topics.WRENCH, wrench),
                (topics.WRENCH_FILTERED, wrench),
                (
                    topics.JOINT_STATES,
                    messages.joint_state_message(
                        0, joints, position=zeros, velocity=zeros, effort=zeros
                    ),
                ),
                (
                    topics.TRUE_FORCES,
                    messages.joint_state_message(
                        0, contacts, effort=np.zeros(len(contacts))
                    ),
                ),
            )
        }
        self._clock_publisher = (
            create_publisher(self, topics.CLOCK) if config.lockstep else None
        )
        self.create_subscription(
            topics.EFFORT_COMMAND.message,
            topics.EFFORT_COMMAND.name,
            self._on_command,
            qos.INPUT,
            raw=True,
        )
        self._read = MessageReader(
            JointState,
            partial(messages.read_named_vectors, names=joints, fields=['effort']),
        )
        self.create_subscription(
            topics.PUSH.message, topics.PUSH.name, self._on_push, topics.PUSH.profile
        )
        self._watch = diagnostics.LoopStatistics(config.rate)
        self._inputs = diagnostics.InputMonitor(
            self, config.rate, topics.EFFORT_COMMAND
        )
        self._diagnostics = diagnostics.DiagnosticsPublisher(
            self, self._statuses, BackgroundThread()
        )
        description.publish(String(data=self._plant.description.urdf))
        self._gate = StartupGate(self, config)
        self._origin = 0  # stamp of sample 0 [ns]

    def run(self, spinner: Spinner) -> None:
        """Run the plant until the last tick or a signal; RunError if a command does not come."""
        while not (spinner.stop or self._gate.poll()):
            spinner.spin_once(0.01)
            self._diagnostics.poll()
        self._start_up(spinner)
        self._start = time.monotonic_ns()
        if self._config.lockstep:
            self._run_lockstep(spinner)
        else:
            self._run_free(spinner)
        self._wall = time.monotonic_ns() - self._start

    def close(self) -> None:
        """Write the counts and times of this run, if asked to, and free the plant."""
        self._plant.close()
        self._config.write_counts(
            {
                'ticks': self._tick + 1,
                'deadline_misses': self._misses,
                'pace_slips': self._slips,
                'command_timeouts': self._timeouts,
                'wall_s': self._wall * 1e-9,
                'latency_us': self._watch.latencies.percentiles(),
                'latency_histogram': latency_histogram(
                    self._watch.latencies.microseconds()
                ),
                'plant_us': self._step_times.percentiles(),
                'refused': dict(self._refusals.counts),
            }
        )

    def _start_up(self, spinner: Spinner) -> None:
        """Publish sample 0 until it is answered; nothing moves before that."""
        period = stamp_of_tick(1, self._config.rate)
        # Lockstep knows no wall clock; one period on, so that no stamp is the zero of "none".
        self._origin = (
            period if self._config.lockstep else time.time_ns() // period * period
        )
        self._publish_surfaces()
        # Behind the gate it cannot have been lost; a second copy would only be in the bag.
        resend = RESEND_PERIOD_GATED if self._config.startup_peers else RESEND_PERIOD
        due = 0.0
        while not spinner.stop and self._answered < 0:
            if time.monotonic() >= due:
                self._publish()
                due = time.monotonic() + resend
            spinner.spin_once(0.05)
            self._diagnostics.poll()
        self._publish_truth()

    @property
    def _done(self) -> bool:
        return 0 < self._config.ticks <= self._tick + 1

    def _run_free(self, spinner: Spinner) -> None:
        period = self._period
        # Sample 0 was answered just now: the next one follows a period after it, or at once.
        anchor = max(int(self._published[0]), time.monotonic_ns() - int(period))
        wait = int(WAIT_FRACTION * period)
        slipped = 0
        torque = self._delay.torque_for(0)
        while not (spinner.stop or self._done):
            self._advance(
                self._watched(
                    torque if self._delay_ticks else self._delay.torque_for(self._tick)
                )
            )
            deadline = anchor + slipped + int((self._tick + 1) * period)
            self._spin_until(spinner, deadline)
            late = time.monotonic_ns() - deadline
            if late > MAX_LATE_PERIODS * period:
                slipped += late
                deadline += late
                self._slips += 1
            if self._answered < self._tick:
                self._miss()
            self._tick += 1
            if self._delay_ticks:
                torque = self._delay.torque_for(self._tick)
            self._publish()
            self._spin_until(spinner, deadline + wait, answered=True)
            self._publish_truth()
            self._diagnostics.poll()
        # The last sample deserves its answer, too.
        self._spin_until(
            spinner, time.monotonic_ns() + NANOSECONDS // 10, answered=True
        )

    def _miss(self) -> None:
        self._misses += 1
        self._watch.missed += 1

    def _watched(self, torque: Vector) -> Vector:
        """Return the torque that acts: the commanded one, or what the drives do without."""
        if self._tick - self._commanded <= COMMAND_TIMEOUT * self._config.rate:
            self._hold.posture = None
            return torque
        self._timeouts += self._hold.posture is None
        return self._hold.torque(self._sample.q, self._sample.qd)

    def _run_lockstep(self, spinner: Spinner) -> None:
        self._due = int(self._published[0])
        if self._delay_ticks == 0:
            self._wait_for_answer(spinner)
        while not (spinner.stop or self._done):
            # Sample k + 1 needs only commands up to k, or k - 1 with a delay: the plant then
            # moves on while the controller thinks about sample k.
            self._advance(self._delay.torque_for(self._tick))
            self._wait_for_answer(spinner)
            self._keep_pace(spinner)
            if spinner.stop:
                return
            self._tick += 1
            self._publish()
            self._publish_truth()
            self._diagnostics.poll()
            if self._delay_ticks == 0:
                self._wait_for_answer(spinner)
        self._wait_for_answer(spinner)

    def _keep_pace(self, spinner: Spinner) -> None:
        """Wait until the next sample is due by the wall clock."""
        period = NANOSECONDS / self._config.rate
        if self._config.speed == 0.0:
            return
        self._due += int(period / self._config.speed)
        self._spin_until(spinner, self._due)
        late = time.monotonic_ns() - self._due
        if late > CATCH_UP:
            self._due += late

    def _advance(self, torque: Any) -> None:
        start = time.perf_counter_ns()
        self._sample = self._plant.step(torque)
        self._step_times.add(time.perf_counter_ns() - start)

    def _spin_until(
        self, spinner: Spinner, deadline: int, *, answered: bool = False
    ) -> None:
        """Run callbacks until an absolute time [ns], or until the sample is `answered`."""
        remaining = deadline - time.monotonic_ns()
        if remaining <= 0 and not answered:
            spinner.spin_once(0.0)  # late, but what has arrived has arrived in time
        while remaining > 0 and not (
            spinner.stop or answered and self._answered >= self._tick
        ):
            spinner.spin_once(remaining * 1e-9)
            remaining = deadline - time.monotonic_ns()

    def _wait_for_answer(self, spinner: Spinner) -> None:
        start, sent = time.monotonic(), 1
        while self._answered < self._tick and not spinner.stop:
            spinner.spin_once(0.1)
            waited = time.monotonic() - start
            if waited > sent * ANSWER_TIMEOUT / RESENDS and self._answered < self._tick:
                if sent == RESENDS:
                    raise RunError(
                        f'no {topics.EFFORT_COMMAND.name} for sample {self._tick} after '
                        f'{ANSWER_TIMEOUT:g} s: has the controller stopped?'
                    )
                # A controller that was cleaned up and configured again has not seen it.
                sent += 1
                self._send()

    def _publish(self) -> None:
        """Publish a new sample; the clock of its latency starts here."""
        now = time.monotonic_ns()
        self._published[self._tick % REMEMBERED] = now
        self._watch.add_period(now)
        self._send()

    def _send(self) -> None:
        """Send what the controller works with."""
        sample, streams, stamp = self._sample, self._streams, self._stamp(self._tick)
        if self._clock_publisher is not None:
            self._clock_publisher.publish(Clock(clock=messages.ns_to_stamp(stamp)))
        streams[topics.WRENCH].publish_if_subscribed(stamp, sample.wrench)
        streams[topics.WRENCH_FILTERED].publish_if_subscribed(
            stamp, sample.wrench_filtered
        )
        streams[topics.JOINT_STATES].publish_if_subscribed(
            stamp, sample.q, sample.qd, sample.effort
        )

    def _publish_truth(self) -> None:
        """Publish what only an observer may know."""
        self._streams[topics.TRUE_FORCES].publish_if_subscribed(
            self._stamp(self._tick), self._sample.contact_force
        )
        if self._surfaces.due(self._tick):
            self._publish_surfaces()

    def _publish_surfaces(self) -> None:
        self._surface_publisher.publish(
            self._surfaces.message(
                self._stamp(self._tick), self._plant.contacts.places_world
            )
        )

    def _stamp(self, tick: int) -> int:
        return self._origin + stamp_of_tick(tick, self._config.rate)

    def _on_command(self, data: bytes) -> None:
        received = self._inputs.last[topics.EFFORT_COMMAND] = time.monotonic_ns()
        with self._refusals.logging_refusals(topics.EFFORT_COMMAND):
            stamp, torque = self._read(data)
            tick = round((stamp - self._origin) * 1e-9 * self._config.rate)
            if not (tick >= 0 and self._stamp(tick) == stamp):
                raise MessageError('stamp', 'that of a sample', f'{stamp} ns')
            # A controller that has waited for a sample in vain may have counted on.
            tick = min(tick, self._tick)
            if tick < self._answered:
                return
            # The same sample may get another answer, from a controller that hears of no newer.
            self._delay.command(tick, torque)
            self._commanded = self._tick
            if tick > self._answered:
                self._answered = tick
                if (
                    tick > 0
                ):  # the answer to the first sample waits for everything to start
                    latency = received - int(self._published[tick % REMEMBERED])
                    self._watch.latencies.add(latency)
                    # The node was late itself, and has not counted this deadline.
                    if tick == self._tick and latency > self._period:
                        self._miss()

    def _on_push(self, message: Vector3Stamped) -> None:
        with self._refusals.logging_refusals(topics.PUSH):
            place, force = message.header.frame_id, message.vector
            if place not in ('', TOOL):
                raise MessageError(
                    'header.frame_id', f"'{TOOL}', or none", f"'{place}'"
                )
            pushed = messages.finite_array([force.x, force.y, force.z], 3, 'vector')
            size = float(np.linalg.norm(pushed))
            if size > LARGEST_PUSH:
                raise MessageError(
                    'vector', f'at most {LARGEST_PUSH:g} N', f'{size:g} N'
                )
            self._plant.push(pushed, PUSH_TIME, tool=place == TOOL)

    def _change(self, configurations: Sequence[Any]) -> None:
        """Change payload, stiffness and friction; ConfigError with native contacts."""
        config: PlantConfig = configurations[0]
        contacts, before = self._plant.contacts, self._plant_config.surfaces
        for number, name in enumerate(config.met):
            old, new = before[name], config.surfaces[name]
            if new.stiffness != old.stiffness:
                contacts.scale_stiffness(number, new.stiffness / old.stiffness)
            if new.friction != old.friction:
                contacts.set_friction(number, new.friction)
        self._plant_config, self._plant.payload = config, configurations[1].payload

    def _statuses(self) -> list[diagnostics.ComponentStatus]:
        wall = (time.monotonic_ns() - self._start) * 1e-9
        loop = {
            **self._watch.report(),
            'ticks': self._tick + 1,
            'pace_slips': self._slips,
            'command_timeouts': self._timeouts,
            'lockstep': self._config.lockstep,
            'realtime_factor': round(self._tick / self._config.rate / wall, 3),
        }
        missed = loop['deadline_misses']
        forces = zip(self._plant.contact_names, self._sample.contact_force.tolist())
        return [
            diagnostics.ComponentStatus(
                'loop', loop, warning=f'{missed} deadlines missed' if missed else ''
            ),
            self._inputs.status(
                needed=self._tick > 0,
                consequence=': the last torque is held'
                if self._hold.posture is None
                else ': the drives hold their position',
            ),
            diagnostics.ComponentStatus(
                'contacts',
                {
                    name: f'touching with {force:.4g} N' if force > 0.0 else 'free'
                    for name, force in forces
                },
            ),
            diagnostics.refusal_status(self._refusals),
        ]


def latency_histogram(microseconds: Vector) -> dict[str, list[float] | list[int]]:
    """Return counts between edges [us]; the first and the last take all beyond."""
    kept = np.clip(microseconds, EDGES[0], EDGES[-1])
    return {
        'edges_us': EDGES.round(1).tolist(),
        'counts': np.histogram(kept, EDGES)[0].tolist(),
    }


def main() -> int:
    """Run the simulated plant."""
    return run_node(SimNode)


if __name__ == '__main__':
    sys.exit(main())
