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
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.controller_node import ControllerNode
from multicontact_control.nodes.graph import ignore, take
from multicontact_control.nodes.lifecycle import SUCCESS
from multicontact_control.nodes.parameters import LOCKED
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from ros_graph import wait_for
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

pytestmark = pytest.mark.ros

JOINTS = [f'joint{i}' for i in range(1, 7)]
CONTACTS = ['table', 'board']
PERIOD = 2_000_000
ANY = settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
NUMBER = st.one_of(st.floats(width=64), st.floats(-3, 3), st.just(0.0), st.just(1e308))
SIX = st.lists(NUMBER, min_size=6, max_size=6)
NUMBERS = st.one_of(st.lists(NUMBER, max_size=8), SIX, st.lists(NUMBER, min_size=2, max_size=2))
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
TAKEN = {
    topics.JOINT_STATES: JOINT_STATE, topics.WRENCH: WRENCH, topics.NOISE_VARIANCE: JOINT_STATE,
    topics.FORCE_COMMAND: JOINT_STATE, topics.MOTION_COMMAND: MOTION}
RAW = (topics.JOINT_STATES, topics.WRENCH, topics.NOISE_VARIANCE)
EVENT = st.one_of(*(st.tuples(st.just(topic), strategy) for topic, strategy in TAKEN.items()))
PUBLISHED = [topic for topic in topics.TOPICS
             if topic.publisher == topics.CONTROLLER and topic.rate == 'control']


def sample(stamp, position, velocity, wrench):
    """Return both messages of a sample that fits together, whatever numbers it holds."""
    header = Header(stamp=stamp)
    force, torque = (Vector3(x=x, y=y, z=z) for x, y, z in (wrench[:3], wrench[3:]))
    return ((topics.WRENCH, WrenchStamped(
                header=header, wrench=Wrench(force=force, torque=torque))),
            (topics.JOINT_STATES, JointState(
                header=header, name=JOINTS, position=position, velocity=velocity)))


def resting_sample(k):
    noise = 0.01 * np.random.default_rng(k).standard_normal(6)
    return sample(messages.ns_to_stamp(k * PERIOD), HOME.tolist(), [0.0] * 6, noise.tolist())


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

    def __init__(self, host, supervised):
        self.node, self.host, self.supervised = host.hosted, host, supervised
        self.restart()
        ends = {x.topic_name.lstrip('/'): x for x in self.node.subscriptions}
        self.callbacks = {topic: ends[topic.name].callback for topic in TAKEN}
        self._outputs = [host.node.create_subscription(topic.message, topic.name, ignore, 1000)
                         for topic in PUBLISHED]
        for subscription in self._outputs:
            wait_for(subscription.get_publisher_count, 'connection')
        self.k = self.received = 0

    def give(self, topic, message):
        """Hand over a message, or the bytes of one."""
        self.callbacks[topic](
            serialize_message(message) if topic in RAW and not isinstance(message, bytes)
            else message)

    def values(self, part):
        """Return the values of a part of the diagnostics."""
        return next(x.values for x in self.node.statuses() if x.part == part)

    def restart(self):
        assert self.node.trigger_deactivate() == self.node.trigger_activate() == SUCCESS

    def good(self):
        """Hand over a sample in order, and check the numbers of all that has come."""
        if not self.supervised and self.values('loop')['safe_behaviour']:
            self.restart()  # there was a posture without a torque
        self.k += 1
        for topic, message in resting_sample(self.k):
            self.give(topic, message)
        self.take()

    def take(self):
        for subscription in self._outputs:
            while (taken := take(subscription)) is not None:
                self.received += 1
                assert all(map(math.isfinite, numbers_in(taken[0]))), taken[0]


@pytest.fixture(scope='module', params=[True, False], ids=['supervised', 'bare'])
def live(request, module_host):
    node = module_host.make(
        ControllerNode, f'base_dir:={config_dir()}', f'supervised:={str(request.param).lower()}',
        file=config_dir() / 'controller.yaml')
    node.get_logger().set_level(50)
    assert node.trigger_configure() == node.trigger_activate() == SUCCESS
    return Live(module_host, request.param)


@ANY
@given(data=st.data(), good=st.integers(0, 3), events=st.lists(
    st.one_of(EVENT.map(lambda event: (event,)), SAMPLE), min_size=1, max_size=8))
def test_messages_and_bytes_are_answered_or_refused(live, data, events, good):
    for topic, message in sum(events, ()):
        if topic in RAW and data.draw(st.booleans()):
            whole = serialize_message(message)
            at, written = data.draw(st.integers(0, len(whole))), data.draw(st.binary(max_size=8))
            message = whole[:at] + written + whole[at + len(written):]  # damaged, or cut off
            message = message[:data.draw(st.integers(0, len(whole)))]
        live.give(topic, message)
    for _ in range(good):
        live.good()
    live.node.look(live.host.spinner)
    live.take()


INTEGER = st.integers(-2 ** 63, 2 ** 63 - 1)
TEXT = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=5)
VALUE = st.one_of(NUMBER, INTEGER, st.booleans(), TEXT, SIX, st.lists(NUMBER, min_size=1),
                  st.lists(INTEGER, min_size=1, max_size=3),
                  st.lists(TEXT, min_size=1, max_size=3),
                  st.sampled_from(['zero_torque', 'hold_position']))


@ANY
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
    if result.successful:
        assert live.node.set_parameters([Parameter(name, value=before)])[0].successful


def test_good_samples_are_answered_after_all_that_and_leave_nothing_behind(live):
    """In steady state no memory is kept, and nothing is made that the collector would look at."""
    live.restart()
    live.take()
    before = live.received
    wait_for(lambda: live.good() or live.received > before + 50, 'answers')
    if live.supervised:
        wait_for(lambda: live.good() or live.values('supervisor')['reaction'] == 'none',
                 'control')
    samples = [[(topic, serialize_message(message)) for topic, message in resting_sample(k)]
               for k in range(live.k + 1, live.k + 3001)]

    def feed(first, last):
        for both in samples[first:last]:
            for topic, data in both:
                live.callbacks[topic](data)
        gc.collect()
        # rclpy looks fields up by names made anew, of which the interpreter keeps up to 4096.
        sys._clear_type_cache()
        return tracemalloc.get_traced_memory()[0], len(gc.get_objects())

    slow, steps = live.values('messages')['slow'], live.values('loop')['steps']
    feed(0, 500)
    tracemalloc.start()
    try:
        before = feed(500, 1500)  # what is kept of the past is of 100 ticks
        after = feed(1500, 3000)
    finally:
        tracemalloc.stop()
    assert live.values('loop')['steps'] - steps == len(samples)
    assert live.values('messages')['slow'] - slow <= 2
    assert after[0] - before[0] < 16_384
    assert after[1] - before[1] < 10
