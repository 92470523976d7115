"""Whatever comes over a topic: no callback raises, no number that is not finite goes out."""

from __future__ import annotations

import gc
import math
import sys
import tracemalloc

from arms import HOME
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion, Transform, Twist, Vector3, Wrench, WrenchStamped
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from multicontact_control.errors import MessageError
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.controller_node import ControllerNode
from multicontact_control.nodes.managed_node import SUCCESS
from multicontact_control.nodes.parameters import LOCKED
from multicontact_control.nodes.raw_messages import find_places
from multicontact_control.nodes.runtime import Spinner, StopFlag
from multicontact_control.paths import config_dir
import numpy as np
import pytest
import rclpy
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions
from ros_graph import wait_for
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

pytestmark = pytest.mark.ros

JOINTS = [f'joint{i}' for i in range(1, 7)]
CONTACTS = ['table', 'board']
PERIOD = 2_000_000
NUMBER = st.one_of(st.floats(width=64), st.floats(-3, 3), st.just(0.0), st.just(1e308))
NUMBERS = st.one_of(st.lists(NUMBER, max_size=8), st.lists(NUMBER, min_size=6, max_size=6),
                    st.lists(NUMBER, min_size=2, max_size=2))
STAMP = st.one_of(
    st.builds(Time, sec=st.integers(-2 ** 31, 2 ** 31 - 1), nanosec=st.integers(0, 2 ** 32 - 1)),
    st.integers(0, 400).map(lambda k: messages.ns_to_stamp(k * PERIOD)))
HEADER = st.builds(Header, stamp=STAMP)
NAMES = st.one_of(st.just(JOINTS), st.permutations(JOINTS), st.just(CONTACTS), st.just(['table']),
                  st.lists(st.sampled_from([*JOINTS, *CONTACTS, 'x']), max_size=7))
JOINT_STATE = st.builds(
    JointState, header=HEADER, name=NAMES, position=NUMBERS, velocity=NUMBERS, effort=NUMBERS)
VECTOR = st.builds(Vector3, x=NUMBER, y=NUMBER, z=NUMBER)
WRENCH = st.builds(WrenchStamped, header=HEADER,
                   wrench=st.builds(Wrench, force=VECTOR, torque=VECTOR))
ROTATION = st.one_of(st.builds(Quaternion, x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER),
                     st.just(Quaternion(w=1.0)))
TWISTS = st.lists(st.builds(Twist, linear=VECTOR, angular=VECTOR), max_size=2)
MOTION = st.builds(
    MultiDOFJointTrajectoryPoint,
    transforms=st.lists(st.builds(Transform, translation=VECTOR, rotation=ROTATION), max_size=2),
    velocities=TWISTS, accelerations=TWISTS)
EVENT = st.one_of(
    st.tuples(st.just(topics.JOINT_STATES), JOINT_STATE),
    st.tuples(st.just(topics.WRENCH), WRENCH),
    st.tuples(st.just(topics.NOISE_VARIANCE), JOINT_STATE),
    st.tuples(st.just(topics.FORCE_COMMAND), JOINT_STATE),
    st.tuples(st.just(topics.MOTION_COMMAND), MOTION))
READERS = {
    topics.JOINT_STATES: lambda m: messages.read_joint_state(m, JOINTS),
    topics.WRENCH: messages.read_wrench,
    topics.NOISE_VARIANCE: lambda m: messages.read_effort(m, CONTACTS),
    topics.FORCE_COMMAND: lambda m: messages.read_force_command(m, CONTACTS),
    topics.MOTION_COMMAND: messages.read_motion}
PUBLISHED = [topic for topic in topics.published_by(topics.CONTROLLER) if topic.rate == 'control']


def sample(stamp, position, velocity, wrench):
    """Return both messages of a sample that fits together, whatever numbers it holds."""
    force, torque = Vector3(), Vector3()
    force.x, force.y, force.z, torque.x, torque.y, torque.z = wrench
    header = Header(stamp=stamp)
    return ((topics.WRENCH, WrenchStamped(header=header, wrench=Wrench(
                force=force, torque=torque))),
            (topics.JOINT_STATES, JointState(
                header=header, name=JOINTS, position=position, velocity=velocity)))


SIX = st.lists(NUMBER, min_size=6, max_size=6)
SAMPLE = st.builds(sample, STAMP, st.one_of(st.just(HOME.tolist()), SIX), SIX, SIX)


def numbers_in(value):
    """Return every number in a message."""
    if isinstance(value, (bool, str, bytes)):
        return []
    if isinstance(value, (int, float)):
        return [float(value)]
    if hasattr(value, 'get_fields_and_field_types'):
        return [x for field in value.get_fields_and_field_types()
                for x in numbers_in(getattr(value, field))]
    return [x for item in value for x in numbers_in(item)]


class Live:
    """An active controller in this process, fed with good samples as well."""

    def __init__(self, middleware, supervised):
        self.node = ControllerNode()
        assert self.node.trigger_configure() == SUCCESS
        assert self.node.trigger_activate() == SUCCESS
        self.spinner = Spinner(self.node, StopFlag())
        raw = {topic: x.callback for topic, x in self.node.streams.subscriptions.items()}
        self.callbacks = {
            **{topic: lambda message, call=call: call(serialize_message(message))
               for topic, call in raw.items()},
            **{topic: x.callback for topic, x in self.node._commands.subscriptions.items()}}
        self.raw_callbacks = raw
        self._outputs = {
            topic: middleware.node.create_subscription(
                topic.message, topic.name, lambda _: None, 1000) for topic in PUBLISHED}
        self._wires = {
            topic: middleware.node.create_publisher(topic.message, topic.name, 10)
            for topic in (topics.JOINT_STATES, topics.WRENCH)}
        for subscription in self._outputs.values():
            wait_for(subscription.get_publisher_count, 'connection')
        for topic, publisher in self._wires.items():
            # Both ends: a writer that knows its reader may yet be unknown to it.
            wait_for(publisher.get_subscription_count, 'connection')
            wait_for(self.node.streams.subscriptions[topic].get_publisher_count, 'connection')
        self.supervised = supervised
        self.k = 0
        self.received = 0

    def good(self):
        """Hand over a sample in order."""
        if not self.supervised and self.node._configured.safe:
            self.node._configured.restart()  # there was a posture without a torque
        self.k += 1
        stamp = self.k * PERIOD
        self.callbacks[topics.WRENCH](messages.wrench_message(
            stamp, 0.01 * np.random.default_rng(self.k).standard_normal(6), 'ft_face'))
        self.callbacks[topics.JOINT_STATES](messages.joint_state_message(
            stamp, JOINTS, position=HOME, velocity=np.zeros(6)))

    def send(self, topic, message):
        """Hand over a message over the wire."""
        heard = self.node._heard
        self._wires[topic].publish(message)
        wait_for(lambda: self.spinner.spin_once(0.05) or self.node._heard > heard, 'the message')

    def take(self):
        """Take everything that has come over the wire, and check its numbers."""
        for topic, subscription in self._outputs.items():
            with subscription.handle:
                while (taken := subscription.handle.take_message(topic.message, False)):
                    self.received += 1
                    assert all(map(math.isfinite, numbers_in(taken[0]))), taken[0]


@pytest.fixture(scope='module', params=[True, False], ids=['supervised', 'bare'])
def live(request, tmp_path_factory):
    from ros_graph import Middleware
    # A domain of its own: what is left of a node of this process must answer nobody later.
    with reserve_domain() as domain_id, pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        patch.setenv('ROS_LOG_DIR', str(tmp_path_factory.mktemp('ros')))
        rclpy.init(args=[
            '--ros-args', '--params-file', str(config_dir() / 'controller.yaml'),
            '-p', f'base_dir:={config_dir()}', '-p', f'supervised:={str(request.param).lower()}',
            '--log-level', 'fatal'], domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO)
        try:
            with Middleware(domain_id) as middleware:
                live = Live(middleware, request.param)
                yield live
                live.spinner.close()
                live.node.destroy_node()
        finally:
            rclpy.try_shutdown()


def is_readable(topic, message):
    try:
        READERS[topic](message)
    except messages.MessageError:
        return False
    return True


def is_message(topic, data):
    """Return whether bytes are a message that can be read; damage need not be seen."""
    try:
        find_places(topic.message, data)
    except MessageError:
        return False
    return is_readable(topic, deserialize_message(data, topic.message))


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(events=st.lists(st.one_of(EVENT.map(lambda event: (event,)), SAMPLE), min_size=1,
                       max_size=8).map(lambda parts: sum(parts, ())), good=st.integers(0, 3))
def test_nothing_that_comes_raises_or_brings_out_what_is_not_finite(live, events, good):
    for topic, message in events:
        before = live.node.refusals.total
        live.callbacks[topic](message)
        if not is_readable(topic, message):
            assert live.node.refusals.total > before
    for _ in range(good):
        live.good()
    live.node.look(live.spinner)
    assert len(live.node.statuses()) >= 5
    live.take()


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(message=st.one_of(JOINT_STATE, WRENCH))
def test_over_the_wire_is_no_different(live, message):
    topic = topics.WRENCH if isinstance(message, WrenchStamped) else topics.JOINT_STATES
    before = live.node.refusals.total
    live.send(topic, message)
    if not is_readable(topic, message):
        assert live.node.refusals.total > before
    live.take()


@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data(), topic=st.sampled_from(
    [topics.JOINT_STATES, topics.WRENCH, topics.NOISE_VARIANCE]))
def test_bytes_that_are_no_message_are_refused(live, data, topic):
    message = data.draw(WRENCH if topic is topics.WRENCH else JOINT_STATE)
    whole = serialize_message(message)
    damaged = data.draw(st.one_of(
        st.binary(max_size=64), st.integers(0, len(whole) - 1).map(lambda n: whole[:n]),
        st.tuples(st.integers(0, len(whole) - 1), st.binary(min_size=1, max_size=8)).map(
            lambda x: (whole[:x[0]] + x[1] + whole[x[0] + len(x[1]):])[:len(whole)])))
    before = live.node.refusals.total
    live.raw_callbacks[topic](damaged)
    if not is_message(topic, damaged):
        assert live.node.refusals.total > before
    live.good()
    live.take()


def test_bytes_over_the_wire_that_are_no_message_are_refused(live):
    for topic in (topics.JOINT_STATES, topics.WRENCH):
        before = live.node.refusals.total
        for data in (b'', b'\0\1', b'\0\1\0\0' + b'\xff' * 40, b'\7\7\0\0' + bytes(400)):
            if len(data) >= 4:  # less is nothing that the middleware would send
                live.send(topic, data)
        assert live.node.refusals.total >= before + 2
    live.take()


def test_after_all_that_good_samples_are_answered(live):
    """Run last: whatever has gone before, the controller goes on with good samples."""
    live.take()
    live.node._configured.restart()  # bare, an older stamp would have done it
    before = live.received

    def answered():
        live.good()
        live.take()
        return live.received > before + 50

    wait_for(answered, 'answers')
    if live.supervised:
        wait_for(lambda: live.good() or live.node._configured.status.reaction == 'none', 'control')
    assert live.received > before + 50


def test_ten_seconds_leave_nothing_behind(live):
    """In steady state no memory is kept, and nothing is made that the collector would look at."""
    stamps = [(live.k + 1 + k) * PERIOD for k in range(6500)]
    live.k += len(stamps)
    random = np.random.default_rng(live.k)
    wrenches = [serialize_message(messages.wrench_message(
        stamp, 0.01 * random.standard_normal(6), 'ft_face')) for stamp in stamps]
    joints = [serialize_message(messages.joint_state_message(
        stamp, JOINTS, position=HOME, velocity=np.zeros(6))) for stamp in stamps]
    wrench, joint_states = (
        live.raw_callbacks[topic] for topic in (topics.WRENCH, topics.JOINT_STATES))

    def feed(first, last):
        for k in range(first, last):
            wrench(wrenches[k])
            joint_states(joints[k])
        gc.collect()
        # rclpy looks fields up by names made anew, of which the interpreter keeps up to 4096.
        sys._clear_type_cache()
        return tracemalloc.get_traced_memory()[0], len(gc.get_objects())

    slow = sum(reader.slow for reader in live.node._readers.values())
    feed(0, 500)
    tracemalloc.start()
    try:
        before = feed(500, 1500)  # what is kept of the past is of 100 ticks
        after = feed(1500, 6500)
    finally:
        tracemalloc.stop()
    assert live.node._configured.last_stamp == stamps[-1]
    assert sum(reader.slow for reader in live.node._readers.values()) - slow <= 2
    assert after[0] - before[0] < 16_384
    assert after[1] - before[1] < 10


INTEGER = st.integers(-2 ** 63, 2 ** 63 - 1)
TEXT = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=5)
VALUE = st.one_of(NUMBER, INTEGER, st.booleans(), TEXT, SIX, st.lists(NUMBER, min_size=1),
                  st.lists(INTEGER, min_size=1, max_size=3),
                  st.lists(TEXT, min_size=1, max_size=3),
                  st.sampled_from(['zero_torque', 'hold_position']))


@settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data(), value=VALUE)
def test_no_value_of_a_parameter_raises_or_brings_out_what_is_not_finite(live, data, value):
    known = [name for name in sorted(live.node._parameters)
             if not name.startswith(('use_sim_time', 'start_type', 'qos_'))]
    live_ones = [name for name in known if not live.node.describe_parameter(name)
                 .additional_constraints.endswith(LOCKED)]
    name = data.draw(st.sampled_from(live_ones) | st.sampled_from(known))
    before, config = live.node.get_parameter(name).value, live.node._configured.config
    result = live.node.set_parameters([Parameter(name, value=value)])[0]
    if not result.successful:
        assert result.reason
        assert str(live.node.get_parameter(name).value) == str(before)
        assert live.node._configured.config is config
    live.good()
    live.take()
    if result.successful:
        assert live.node.set_parameters([Parameter(name, value=before)])[0].successful
