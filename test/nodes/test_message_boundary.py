"""Any message or parameter: no callback raises, no number that is not finite goes out."""

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
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.controller_node import ControllerNode
from multicontact_control.nodes.graph_node import ignore, take
from multicontact_control.nodes.managed_node import SUCCESS
from multicontact_control.nodes.parameters import LOCKED
from multicontact_control.nodes.runtime import Spinner, StopFlag
from multicontact_control.paths import config_dir
import numpy as np
import pytest
import rclpy
from rclpy._rclpy_pybind11 import RMWError
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions
from ros_graph import Middleware, wait_for
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
PUBLISHED = [topic for topic in topics.TOPICS
             if topic.publisher == topics.CONTROLLER and topic.rate == 'control']


def sample(stamp, position, velocity, wrench):
    """Return both messages of a sample that fits together, whatever numbers it holds."""
    header = Header(stamp=stamp)
    vectors = [Vector3(x=x, y=y, z=z) for x, y, z in (wrench[:3], wrench[3:])]
    return ((topics.WRENCH, WrenchStamped(header=header, wrench=Wrench(
                force=vectors[0], torque=vectors[1]))),
            (topics.JOINT_STATES, JointState(
                header=header, name=JOINTS, position=position, velocity=velocity)))


SIX = st.lists(NUMBER, min_size=6, max_size=6)
SAMPLE = st.builds(sample, STAMP, st.one_of(st.just(HOME.tolist()), SIX), SIX, SIX)


def numbers_in(value):
    """Return every number in a message."""
    if hasattr(value, 'get_fields_and_field_types'):
        value = [getattr(value, field) for field in value.get_fields_and_field_types()]
    if isinstance(value, (int, float)):
        return [float(value)]
    return [] if isinstance(value, (str, bytes)) else [x for y in value for x in numbers_in(y)]


class Live:
    """An active controller in this process, fed with good samples as well."""

    def __init__(self, middleware, supervised):
        self.node, self.supervised = ControllerNode(), supervised
        self.spinner = Spinner(self.node, StopFlag())
        assert self.node.trigger_configure() == self.node.trigger_activate() == SUCCESS
        ends = {x.topic_name.lstrip('/'): x for x in self.node.subscriptions}
        self.callbacks = {topic: ends[topic.name].callback for topic in READERS}
        self._outputs = {
            topic: middleware.node.create_subscription(
                topic.message, topic.name, ignore, 1000) for topic in PUBLISHED}
        for subscription in self._outputs.values():
            wait_for(subscription.get_publisher_count, 'connection')
        self.k = self.received = 0

    def give(self, topic, message):
        """Hand over a message, or the bytes of one."""
        raw = self.node.streams.subscriptions
        self.callbacks[topic](
            serialize_message(message) if topic in raw and not isinstance(message, bytes)
            else message)

    def values(self, part):
        """Return the values of a part of the diagnostics."""
        return next(x.values for x in self.node.statuses() if x.part == part)

    def restart(self):
        assert self.node.trigger_deactivate() == self.node.trigger_activate() == SUCCESS

    def good(self):
        """Hand over a sample in order."""
        if not self.supervised and self.values('loop')['safe_behaviour']:
            self.restart()  # there was a posture without a torque
        self.k += 1
        self.give(topics.WRENCH, messages.wrench_message(
            self.k * PERIOD, 0.01 * np.random.default_rng(self.k).standard_normal(6), 'ft_face'))
        self.give(topics.JOINT_STATES, messages.joint_state_message(
            self.k * PERIOD, JOINTS, position=HOME, velocity=np.zeros(6)))

    def take(self):
        """Take everything that has come over the wire, and check its numbers."""
        for subscription in self._outputs.values():
            while (taken := take(subscription)) is not None:
                self.received += 1
                assert all(map(math.isfinite, numbers_in(taken[0]))), taken[0]


@pytest.fixture(scope='module', params=[True, False], ids=['supervised', 'bare'])
def live(request, tmp_path_factory):
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
        if isinstance(message, bytes):
            message = deserialize_message(message, topic.message)
        READERS[topic](message)
    except (messages.MessageError, RMWError):
        return False
    return True


def damaged(data, message):
    """Return bytes that are no message, or one that is cut off or written over."""
    whole = serialize_message(message)
    return data.draw(st.one_of(
        st.binary(max_size=64), st.integers(0, len(whole) - 1).map(lambda n: whole[:n]),
        st.tuples(st.integers(0, len(whole) - 1), st.binary(min_size=1, max_size=8)).map(
            lambda x: (whole[:x[0]] + x[1] + whole[x[0] + len(x[1]):])[:len(whole)])))


@settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data(), good=st.integers(0, 3), events=st.lists(
    st.one_of(EVENT.map(lambda event: (event,)), SAMPLE), min_size=1, max_size=8))
def test_messages_and_bytes_are_answered_or_refused(live, data, events, good):
    for topic, message in sum(events, ()):
        if topic in live.node.streams.subscriptions and data.draw(st.booleans()):
            message = damaged(data, message)
        before = live.node.refusals.total
        live.give(topic, message)
        if not is_readable(topic, message):
            assert live.node.refusals.total > before
    for _ in range(good):
        live.good()
    live.node.look(live.spinner)
    live.take()


INTEGER = st.integers(-2 ** 63, 2 ** 63 - 1)
TEXT = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=5)
VALUE = st.one_of(NUMBER, INTEGER, st.booleans(), TEXT, SIX, st.lists(NUMBER, min_size=1),
                  st.lists(INTEGER, min_size=1, max_size=3),
                  st.lists(TEXT, min_size=1, max_size=3),
                  st.sampled_from(['zero_torque', 'hold_position']))


@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data(), value=VALUE)
def test_values_of_parameters_are_taken_or_refused(live, data, value):
    known = [name for name in sorted(live.node.list_parameters([], 0).names)
             if not name.startswith(('use_sim_time', 'start_type', 'qos_'))]
    live_ones = [name for name in known if not live.node.describe_parameter(name)
                 .additional_constraints.endswith(LOCKED)]
    name = data.draw(st.sampled_from(live_ones) | st.sampled_from(known))
    before = live.node.get_parameter(name).value
    result = live.node.set_parameters([Parameter(name, value=value)])[0]
    if not result.successful:
        assert result.reason
        assert str(live.node.get_parameter(name).value) == str(before)
    live.good()
    live.take()
    if result.successful:
        assert live.node.set_parameters([Parameter(name, value=before)])[0].successful


def test_good_samples_are_answered_after_all_that_and_leave_nothing_behind(live):
    """In steady state no memory is kept, and nothing is made that the collector would look at."""
    live.restart()
    live.take()
    before = live.received
    wait_for(lambda: live.good() or live.take() or live.received > before + 50, 'answers')
    if live.supervised:
        wait_for(lambda: live.good() or live.values('supervisor')['reaction'] == 'none',
                 'control')
    random = np.random.default_rng(live.k)
    stamps = [(live.k + 1 + k) * PERIOD for k in range(3500)]
    live.k += len(stamps)
    wrenches = [serialize_message(messages.wrench_message(
        stamp, 0.01 * random.standard_normal(6), 'ft_face')) for stamp in stamps]
    joints = [serialize_message(messages.joint_state_message(
        stamp, JOINTS, position=HOME, velocity=np.zeros(6))) for stamp in stamps]
    wrench, joint_states = (
        live.callbacks[topic] for topic in (topics.WRENCH, topics.JOINT_STATES))

    def feed(first, last):
        for k in range(first, last):
            wrench(wrenches[k])
            joint_states(joints[k])
        gc.collect()
        # rclpy looks fields up by names made anew, of which the interpreter keeps up to 4096.
        sys._clear_type_cache()
        return tracemalloc.get_traced_memory()[0], len(gc.get_objects())

    slow, steps = live.values('messages')['slow'], live.values('loop')['steps']
    feed(0, 500)
    tracemalloc.start()
    try:
        before = feed(500, 1500)  # what is kept of the past is of 100 ticks
        after = feed(1500, 3500)
    finally:
        tracemalloc.stop()
    assert live.values('loop')['steps'] - steps == len(stamps)
    assert live.values('messages')['slow'] - slow <= 2
    assert after[0] - before[0] < 16_384
    assert after[1] - before[1] < 10
