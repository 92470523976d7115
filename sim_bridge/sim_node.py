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
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from sim_bridge.actuator_delay import ActuatorDelay
from sim_bridge.arm import SENSOR_FRAME
from sim_bridge.config import LARGEST_PUSH, PlantConfig, PUSH_TIME
from sim_bridge.drives import PositionHold
from sim_bridge.plant import Plant, Sample
from sim_bridge.surface_patch import SurfaceMarkers
from std_msgs.msg import Header, String

LARGEST_LATENESS = 2  # periods, beyond which a late node moves the deadlines back
# Lag behind the wall clock that lockstep makes up for [ns].
CATCH_UP = NANOSECONDS // 10
# Time after which sample 0 is sent again [s]: until everything has started, or behind a gate.
RESEND_PERIOD = 1.0
RESEND_PERIOD_GATED = 10.0
ANSWER_TIMEOUT = 10.0  # s, longest wait for a command in lockstep
RESENDS = 16  # times that a sample is sent in lockstep within that
# For the command that answers the last sample [ns].
LAST_ANSWER_TIME = NANOSECONDS // 10
# Of a period, for the command of a sample before the plant moves on.
WAIT_FRACTION = 0.5
# s without a command, free-running; then the drives hold their position.
COMMAND_TIMEOUT = 0.05
TOOL = 'tool'
LATENCY_EDGES = np.logspace(1.0, 5.0, 41)  # us, ten per decade, 10 us to 100 ms
REMEMBERED = 1024  # samples whose time of publication is known


class SimNodeConfig(StartupConfig):
    """Rate, length and pace of the simulation: what the node needs beside the plant."""

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
    """Return the time tick / rate [Hz] in whole nanoseconds, without an error that grows."""
    return int(tick * NANOSECONDS / Fraction(rate))


class SimNode(Node):
    """
    Simulates the arm: publishes joint states and wrench, applies the commanded torques.

    Beside what a robot would publish are the true forces and the surfaces, for observers. Pushes
    come over a topic, payload and surfaces change with the node's parameters.
    """

    def __init__(self) -> None:
        super().__init__(topics.SIM)
        plant_config: PlantConfig
        config: SimNodeConfig
        parameters = ParameterSet(self, PlantConfig, SimNodeConfig)
        plant_config, config = parameters.build_configurations()
        self._plant_config = plant_config
        self._config = config
        parameters.apply_design = self._change_plant
        self._plant = Plant(plant_config, rate=config.rate, seed=config.seed)
        # The first step ever takes many times as long as all others: not in the run.
        self._plant.step(self._plant.initial_torque)
        self._sample: Sample = self._plant.reset()
        self._plant.payload = config.payload
        self._delay_ticks = plant_config.actuator_delay_ticks
        self._delay = ActuatorDelay(self._delay_ticks, self._plant.initial_torque)
        self._hold = PositionHold(self._plant.model)
        self._tick = 0  # of the newest sample
        self._origin = 0  # stamp of sample 0 [ns]
        self._answered = -1  # newest tick whose command has come
        self._commanded = 0  # tick at which the last command came
        # Longest time to a command that is no miss [ns].
        self._period = NANOSECONDS / config.rate
        if config.lockstep:
            self._period = np.inf
        self._misses = 0
        self._reported_misses = 0
        self._slips = 0
        self._timeouts = 0
        self._due = 0  # when the newest sample was due [ns]
        self._step_times = diagnostics.DurationLog()
        self._start = time.monotonic_ns()
        self._wall = 0  # length of the run [ns]
        self._published = np.zeros(REMEMBERED, dtype=np.int64)  # [ns]
        description = create_publisher(self, topics.ROBOT_DESCRIPTION)
        self._surfaces = SurfaceMarkers(plant_config, rate=config.rate)
        self._surface_publisher = create_publisher(self, topics.SURFACE_MARKERS)
        self._clock_publisher: Publisher | None = None
        if config.lockstep:
            self._clock_publisher = create_publisher(self, topics.CLOCK)
        self._streams = self._make_streams()
        self._refusals = RefusalLog(self.get_logger())
        self._read_command = MessageReader(
            JointState,
            partial(
                messages.read_named_vectors,
                names=self._plant.joint_names,
                fields=['effort'],
            ),
        )
        self.create_subscription(
            topics.EFFORT_COMMAND.message,
            topics.EFFORT_COMMAND.name,
            self._on_command,
            qos.INPUT,
            raw=True,
        )
        self.create_subscription(
            topics.PUSH.message, topics.PUSH.name, self._on_push, topics.PUSH.profile
        )
        self._watch = diagnostics.LoopStatistics(config.rate)
        self._inputs = diagnostics.InputMonitor(
            self, config.rate, topics.EFFORT_COMMAND
        )
        self._diagnostics = diagnostics.DiagnosticsPublisher(
            self, self._component_statuses, BackgroundThread()
        )
        description.publish(String(data=self._plant.description.urdf))
        self._gate = StartupGate(self, config)

    def _make_streams(self) -> dict[topics.Topic, StreamPublisher]:
        """Return the publishers of what comes with every sample, by topic."""
        joints = self._plant.joint_names
        contacts = self._plant.contact_names
        zeros = np.zeros(len(joints))
        wrench = WrenchStamped(header=Header(frame_id=SENSOR_FRAME))
        patterns = {
            topics.WRENCH: wrench,
            topics.WRENCH_FILTERED: wrench,
            topics.JOINT_STATES: messages.joint_state_message(
                0, joints, position=zeros, velocity=zeros, effort=zeros
            ),
            topics.TRUE_FORCES: messages.joint_state_message(
                0, contacts, effort=np.zeros(len(contacts))
            ),
        }
        return {
            topic: StreamPublisher(self, topic, pattern)
            for topic, pattern in patterns.items()
        }

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
        latencies = self._watch.latencies
        self._config.write_counts(
            {
                'ticks': self._tick + 1,
                'deadline_misses': self._misses,
                'pace_slips': self._slips,
                'command_timeouts': self._timeouts,
                'wall_s': self._wall * 1e-9,
                'latency_us': latencies.percentiles(),
                'latency_histogram': latency_histogram(latencies.microseconds()),
                'plant_us': self._step_times.percentiles(),
                'refused': dict(self._refusals.counts),
            }
        )

    def _start_up(self, spinner: Spinner) -> None:
        """Publish sample 0 until it is answered; nothing moves before that."""
        period = stamp_of_tick(1, self._config.rate)
        # Lockstep knows no wall clock; one period on, so that no stamp is the zero of "none".
        self._origin = period
        if not self._config.lockstep:
            self._origin = time.time_ns() // period * period
        self._publish_surfaces()
        resend = RESEND_PERIOD
        if self._config.startup_peers:
            # Behind the gate it cannot have been lost; a second copy would only be in the bag.
            resend = RESEND_PERIOD_GATED
        due = 0.0
        while not spinner.stop and self._answered < 0:
            if time.monotonic() >= due:
                self._publish_sample()
                due = time.monotonic() + resend
            spinner.spin_once(0.05)
            self._diagnostics.poll()
        self._publish_truth()

    @property
    def _done(self) -> bool:
        return 0 < self._config.ticks <= self._tick + 1

    def _run_free(self, spinner: Spinner) -> None:
        """Publish samples at the deadlines of the clock, whether they are answered or not."""
        period = self._period
        # Sample 0 was answered just now: the next one follows a period after it, or at once.
        anchor = max(int(self._published[0]), time.monotonic_ns() - int(period))
        slipped = 0
        torque = self._delay.torque_for(0)
        while not (spinner.stop or self._done):
            if self._delay_ticks == 0:
                torque = self._delay.torque_for(self._tick)
            self._advance_plant(self._acting_torque(torque))
            deadline = anchor + slipped + int((self._tick + 1) * period)
            self._spin_until(spinner, deadline)
            late = time.monotonic_ns() - deadline
            if late > LARGEST_LATENESS * period:
                slipped += late
                deadline += late
                self._slips += 1
            if self._answered < self._tick:
                self._misses += 1
            self._tick += 1
            if self._delay_ticks > 0:
                torque = self._delay.torque_for(self._tick)
            self._publish_sample()
            self._spin_until_answered(spinner, deadline + int(WAIT_FRACTION * period))
            self._publish_truth()
            self._diagnostics.poll()
        # The last sample deserves its answer, too.
        self._spin_until_answered(spinner, time.monotonic_ns() + LAST_ANSWER_TIME)

    def _acting_torque(self, torque: Vector) -> Vector:
        """Return the torque that acts: the commanded one, or what the drives do without."""
        if self._tick - self._commanded <= COMMAND_TIMEOUT * self._config.rate:
            self._hold.posture = None
            return torque
        if self._hold.posture is None:
            self._timeouts += 1
        return self._hold.holding_torque(self._sample.q, self._sample.qd)

    def _run_lockstep(self, spinner: Spinner) -> None:
        """Publish each sample when the one before is answered, not before its time."""
        self._due = int(self._published[0])
        if self._delay_ticks == 0:
            self._wait_for_answer(spinner)
        while not (spinner.stop or self._done):
            # Sample k + 1 needs only commands up to k, or k - 1 with a delay: the plant then
            # moves on while the controller thinks about sample k.
            self._advance_plant(self._delay.torque_for(self._tick))
            self._wait_for_answer(spinner)
            self._keep_pace(spinner)
            if spinner.stop:
                return
            self._tick += 1
            self._publish_sample()
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

    def _advance_plant(self, torque: Vector) -> None:
        start = time.perf_counter_ns()
        self._sample = self._plant.step(torque)
        self._step_times.add(time.perf_counter_ns() - start)

    def _spin_until(self, spinner: Spinner, deadline: int) -> None:
        """Run callbacks until a monotonic time [ns]; once if it is past."""
        remaining = deadline - time.monotonic_ns()
        if remaining <= 0:
            spinner.spin_once(0.0)  # late, but what has arrived has arrived in time
        while remaining > 0 and not spinner.stop:
            spinner.spin_once(remaining * 1e-9)
            remaining = deadline - time.monotonic_ns()

    def _spin_until_answered(self, spinner: Spinner, deadline: int) -> None:
        """Run callbacks until the newest sample is answered, or a monotonic time [ns]."""
        remaining = deadline - time.monotonic_ns()
        while remaining > 0 and not spinner.stop and self._answered < self._tick:
            spinner.spin_once(remaining * 1e-9)
            remaining = deadline - time.monotonic_ns()

    def _wait_for_answer(self, spinner: Spinner) -> None:
        """Run callbacks until the newest sample is answered; RunError after `ANSWER_TIMEOUT`."""
        start = time.monotonic()
        sent = 1
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
                self._send_sample()

    def _publish_sample(self) -> None:
        """Publish a new sample; the clock of its latency starts here."""
        now = time.monotonic_ns()
        self._published[self._tick % REMEMBERED] = now
        self._watch.add_turn(now)
        self._send_sample()

    def _send_sample(self) -> None:
        """Send what the controller works with."""
        sample = self._sample
        streams = self._streams
        stamp = self._stamp_of(self._tick)
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
        stamp = self._stamp_of(self._tick)
        self._streams[topics.TRUE_FORCES].publish_if_subscribed(
            stamp, self._sample.contact_force
        )
        if self._surfaces.is_due(self._tick):
            self._publish_surfaces()

    def _publish_surfaces(self) -> None:
        places = self._plant.contacts.places_world
        stamp = self._stamp_of(self._tick)
        self._surface_publisher.publish(self._surfaces.build_message(stamp, places))

    def _stamp_of(self, tick: int) -> int:
        return self._origin + stamp_of_tick(tick, self._config.rate)

    def _on_command(self, data: bytes) -> None:
        received = time.monotonic_ns()
        self._inputs.last[topics.EFFORT_COMMAND] = received
        with self._refusals.logging_refusals(topics.EFFORT_COMMAND):
            stamp, torque = self._read_command(data)
            tick = round((stamp - self._origin) * 1e-9 * self._config.rate)
            if tick < 0 or self._stamp_of(tick) != stamp:
                raise MessageError('stamp', 'that of a sample', f'{stamp} ns')
            # A controller that has waited for a sample in vain may have counted on.
            tick = min(tick, self._tick)
            if tick < self._answered:
                return
            # The same sample may get another answer, from a controller that hears of no newer.
            self._delay.enter_command(tick, torque)
            self._commanded = self._tick
            first_answer = tick > self._answered
            self._answered = tick
            # The answer to sample 0 waits for everything to start: no latency of the loop.
            if first_answer and tick > 0:
                self._add_latency(tick, received)

    def _add_latency(self, tick: int, received: int) -> None:
        """Take note of when a sample was answered, monotonic time [ns]."""
        latency = received - int(self._published[tick % REMEMBERED])
        self._watch.latencies.add(latency)
        # The node was late itself, and has not counted this deadline.
        if tick == self._tick and latency > self._period:
            self._misses += 1

    def _on_push(self, message: Vector3Stamped) -> None:
        with self._refusals.logging_refusals(topics.PUSH):
            place = message.header.frame_id
            if place not in ('', TOOL):
                raise MessageError(
                    'header.frame_id', f"'{TOOL}', or none", f"'{place}'"
                )
            vector = message.vector
            force = messages.finite_array([vector.x, vector.y, vector.z], 3, 'vector')
            size = float(np.linalg.norm(force))
            if size > LARGEST_PUSH:
                raise MessageError(
                    'vector', f'at most {LARGEST_PUSH:g} N', f'{size:g} N'
                )
            self._plant.push(force, PUSH_TIME, tool=place == TOOL)

    def _change_plant(self, configurations: Sequence[Any]) -> None:
        """Change payload, stiffness and friction; ConfigError with native contacts."""
        config: PlantConfig = configurations[0]
        contacts = self._plant.contacts
        for number, name in enumerate(config.met):
            old = self._plant_config.surfaces[name]
            new = config.surfaces[name]
            if new.stiffness != old.stiffness:
                contacts.scale_stiffness(number, new.stiffness / old.stiffness)
            if new.friction != old.friction:
                contacts.changeable_surface(number)['friction'] = new.friction
        self._plant_config = config
        self._plant.payload = configurations[1].payload

    def _component_statuses(self) -> list[diagnostics.ComponentStatus]:
        """Return what the diagnostics say of the loop, its input and the contacts."""
        wall = (time.monotonic_ns() - self._start) * 1e-9
        misses = self._misses - self._reported_misses
        self._reported_misses = self._misses
        loop = {
            **self._watch.report(),
            'deadline_misses': misses,
            'ticks': self._tick + 1,
            'pace_slips': self._slips,
            'command_timeouts': self._timeouts,
            'lockstep': self._config.lockstep,
            'realtime_factor': round(self._tick / self._config.rate / wall, 3),
        }
        warning = ''
        if misses:
            warning = f'{misses} deadlines missed'
        consequence = ': the drives hold their position'
        if self._hold.posture is None:
            consequence = ': the last torque is held'
        contacts = {}
        forces = self._sample.contact_force.tolist()
        for name, force in zip(self._plant.contact_names, forces):
            contacts[name] = 'free'
            if force > 0.0:
                contacts[name] = f'touching with {force:.4g} N'
        return [
            diagnostics.ComponentStatus('loop', loop, warning=warning),
            self._inputs.status(needed=self._tick > 0, consequence=consequence),
            diagnostics.ComponentStatus('contacts', contacts),
            diagnostics.refusal_status(self._refusals),
        ]


def latency_histogram(microseconds: Vector) -> dict[str, list[float] | list[int]]:
    """
    Return how many latencies lie between edges [us]; the first and the last take all beyond.

    It is what the file of counts, which a report reads, has of them.
    """
    kept = np.clip(microseconds, LATENCY_EDGES[0], LATENCY_EDGES[-1])
    counts, _ = np.histogram(kept, LATENCY_EDGES)
    return {'edges_us': LATENCY_EDGES.round(1).tolist(), 'counts': counts.tolist()}


def main() -> int:
    """Run the simulated plant."""
    return run_node(SimNode)


if __name__ == '__main__':
    sys.exit(main())
