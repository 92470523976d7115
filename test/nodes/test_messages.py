"""Any message: read or refused, and no number that is not finite goes out."""

from contextlib import suppress
from functools import partial
import gc
import math
import sys
import tracemalloc

from arms import HOME
from builtin_interfaces.msg import Time
from fake_arm import wrench_message
import geometry_msgs.msg as geo
from hypothesis import example, given, HealthCheck, settings
from hypothesis import strategies as st
from multicontact_control.errors import MessageError
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph import ignore_message, take_message
from multicontact_control.nodes.lifecycle import SUCCESS
from multicontact_control.nodes.messages import JOINT_FIELDS
from multicontact_control.nodes.streams import MessageReader, StreamPublisher
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from ros_graph import wait_for
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

JOINTS = [f'joint{i}' for i in range(1, 7)]
CONTACTS = ['table', 'board']
PERIOD = 2_000_000  # ns
START = 1_795_000_000_123_456_789  # ns
NAN = math.nan
INF = math.inf
ANY = settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
NUMBER = st.one_of(st.floats(width=64), st.floats(-3, 3), st.just(0.0), st.just(1e308))
SIX = st.lists(NUMBER, min_size=6, max_size=6)
NUMBERS = st.one_of(
    st.lists(NUMBER, max_size=8), SIX, st.lists(NUMBER, min_size=2, max_size=2)
)
DAY = 86_400
SECONDS = st.integers(-(2**31), 2**31 - 1)
ANY_STAMP = st.builds(Time, sec=SECONDS, nanosec=st.integers(0, 2**32 - 1))
TICK_STAMP = st.integers(0, 400).map(lambda k: messages.ns_to_stamp(k * PERIOD))
STAMP = ANY_STAMP | TICK_STAMP
HEADER = st.builds(Header, stamp=STAMP)
NAMES = st.one_of(
    st.just(JOINTS),
    st.permutations(JOINTS),
    st.just(CONTACTS),
    st.just(['table']),
    st.lists(st.sampled_from([*JOINTS, *CONTACTS, 'x']), max_size=7),
)
JOINT_STATE = st.builds(
    JointState,
    header=HEADER,
    name=NAMES,
    position=NUMBERS,
    velocity=NUMBERS,
    effort=NUMBERS,
)
VECTOR = st.builds(geo.Vector3, x=NUMBER, y=NUMBER, z=NUMBER)
FORCE_AND_TORQUE = st.builds(geo.Wrench, force=VECTOR, torque=VECTOR)
WRENCH = st.builds(geo.WrenchStamped, header=HEADER, wrench=FORCE_AND_TORQUE)
ANY_ROTATION = st.builds(geo.Quaternion, x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
ROTATION = ANY_ROTATION | st.just(geo.Quaternion(w=1.0))
TWIST = st.builds(geo.Twist, linear=VECTOR, angular=VECTOR)
TWISTS = st.lists(TWIST, max_size=2)
TRANSFORM = st.builds(geo.Transform, translation=VECTOR, rotation=ROTATION)
MOTION = st.builds(
    MultiDOFJointTrajectoryPoint,
    velocities=TWISTS,
    accelerations=TWISTS,
    transforms=st.lists(TRANSFORM, max_size=2),
)
TRAJECTORY = st.builds(
    MultiDOFJointTrajectory, header=HEADER, points=st.lists(MOTION, max_size=3)
)
TAKEN = {
    topics.JOINT_STATES: JOINT_STATE,
    topics.WRENCH: WRENCH,
    topics.NOISE_VARIANCE: JOINT_STATE,
    topics.FORCE_COMMAND: JOINT_STATE,
    topics.MOTION_COMMAND: MOTION,
    topics.TRAJECTORY_COMMAND: TRAJECTORY,
}
EVENT = st.one_of(*(st.tuples(st.tuples(st.just(x), TAKEN[x])) for x in TAKEN))
ABC = ('a', 'b', 'c')


def by_hand(message, names, field):
    """Return the numbers of a field by name, or None where there are none that can be used."""
    values = getattr(message, field)
    for name in names:
        if message.name.count(name) != 1:
            return None
    if len(values) != len(message.name):
        return None
    ours = [values[message.name.index(name)] for name in names]
    if not math.isfinite(sum(ours)):
        return None
    return ours


def too_far(stamp):
    """Return whether a stamp is within a day of the ends of ROS's time."""
    return not -(2**31) + DAY <= stamp.sec < 2**31 - DAY


POSITION = JOINT_FIELDS[:1]
OTHER_FIELDS = JOINT_FIELDS[1:]


def as_lists(vectors):
    """Return vectors as lists, None where one is missing."""
    lists = []
    for vector in vectors:
        if vector is not None:
            vector = vector.tolist()
        lists.append(vector)
    return lists


def read(message, names, fields, optional=()):
    """Return the vectors of a message as lists, or None if it is refused."""
    try:
        stamp, *vectors = messages.read_named_vectors(message, names, fields, optional)
    except MessageError:
        return None
    assert stamp == messages.stamp_to_ns(message.header.stamp)
    return as_lists(vectors)


@ANY
@given(message=JOINT_STATE, names=st.permutations(JOINTS))
@example(
    JointState(name=[*JOINTS, JOINTS[0]], **dict.fromkeys(JOINT_FIELDS, [0.0] * 7)),
    JOINTS,
)
def test_joint_readers_read_by_name_or_refuse(message, names):
    with_position = [by_hand(message, names, field) for field in JOINT_FIELDS]
    whole = with_position
    if None in whole or too_far(message.header.stamp):
        whole = None
    if with_position[0] is None or too_far(message.header.stamp):
        with_position = None
    assert read(message, names, POSITION, OTHER_FIELDS) == with_position
    assert read(message, names, JOINT_FIELDS) == whole


def test_joints_of_others_are_passed_over_whatever_their_numbers():
    position = [NAN, *np.arange(6.0), INF]
    message = JointState(name=['f', *JOINTS, 'g'], position=position, effort=[1.0] * 2)
    vectors = read(message, JOINTS[::-1], POSITION, OTHER_FIELDS)
    assert vectors == [[5.0, 4.0, 3.0, 2.0, 1.0, 0.0], None, None]


@ANY
@given(message=WRENCH, frame=st.sampled_from(['ft', '/ft', '', 'tool0']))
def test_read_wrench_reads_every_bit_or_refuses(message, frame):
    message.header.frame_id = frame
    numbers = numbers_in(message.wrench)
    unusable = frame == 'tool0' or not math.isfinite(sum(numbers))
    if unusable or too_far(message.header.stamp):
        with pytest.raises(MessageError):
            messages.read_wrench(message, 'ft')
    else:
        stamp, wrench = messages.read_wrench(message, 'ft')
        assert stamp == messages.stamp_to_ns(message.header.stamp)
        assert wrench.tolist() == numbers


@ANY
@given(
    sent=st.lists(JOINT_STATE, min_size=1, max_size=4), names=st.permutations(JOINTS)
)
def test_reader_in_place_reads_what_message_objects_have(sent, names):
    """What one message has taught it must not spoil the next."""
    fields = {'names': names, 'fields': POSITION, 'optional': OTHER_FIELDS}
    reader = MessageReader(JointState, partial(messages.read_named_vectors, **fields))
    for message in (*sent, *sent, six(), six(2.0), *sent):
        data = serialize_message(message)
        vectors = None
        with suppress(MessageError):
            _stamp, *arrays = reader(data)
            vectors = as_lists(arrays)
        assert vectors == read(message, **fields)
        for length in (0, 3, 11):
            with pytest.raises(MessageError):
                reader(data[:length])


def test_efforts_of_some_joints_are_read_beside_those_that_are_no_numbers():
    fields = {
        'names': JOINTS,
        'fields': POSITION,
        'optional': ('velocity',),
        'unchecked': ('effort',),
    }
    reader = MessageReader(JointState, partial(messages.read_named_vectors, **fields))
    message = six()
    for number in (1.0, math.nan, 2.0):
        message.effort[2] = number
        effort = reader(serialize_message(message))[3]
        np.testing.assert_array_equal(effort, message.effort)
    message.effort = message.effort[:-1]
    assert reader(serialize_message(message))[3] is None


def six(scale=1.0):
    numbers = np.arange(6.0)
    return messages.joint_state_message(
        START, JOINTS, position=scale * numbers, velocity=-numbers, effort=numbers**2
    )


NUMBERS_7 = np.random.default_rng(0).standard_normal(7)


def pose_message(stamp, numbers):
    position = geo.Point(**dict(zip('xyz', numbers[:3])))
    orientation = geo.Quaternion(**dict(zip('xyzw', numbers[3:])))
    pose = geo.Pose(position=position, orientation=orientation)
    return geo.PoseStamped(header=Header(stamp=messages.ns_to_stamp(stamp)), pose=pose)


def assert_stream_writes(node, topic, pattern, expected, *numbers):
    """Check that numbers written into a pattern are the expected message, and no byte more."""
    data = StreamPublisher(node, topic, pattern).encode_message(START, *numbers)
    assert deserialize_message(data, type(pattern)) == expected
    store = get_typestore(Stores.ROS2_JAZZY)
    store.deserialize_cdr(data, topic.type_name)  # refuses bytes beyond the message


@pytest.mark.ros
def test_stream_writes_poses_that_rclpy_reads(middleware):
    expected = pose_message(START, NUMBERS_7)
    assert_stream_writes(
        middleware.node, topics.POSE, geo.PoseStamped(), expected, NUMBERS_7
    )


@pytest.mark.ros
def test_stream_writes_wrenches_that_rclpy_reads(middleware):
    wrench = NUMBERS_7[:6]
    pattern = wrench_message(0, 'ft_face', np.zeros(6))
    expected = wrench_message(START, 'ft_face', wrench)
    assert_stream_writes(middleware.node, topics.WRENCH, pattern, expected, wrench)


@pytest.mark.ros
def test_stream_writes_joint_states_that_rclpy_reads(middleware):
    rest = np.arange(6.0)
    assert_stream_writes(
        middleware.node,
        topics.JOINT_STATES,
        six(),
        six(2.0),
        2.0 * rest,
        -rest,
        rest**2,
    )


@pytest.mark.ros
@pytest.mark.parametrize('size', range(1, 9))
def test_stream_writes_efforts_behind_names_of_any_length(middleware, size):
    """Padding before the numbers depends on the names."""
    for count in (3, 7):
        names = ['x' * size] * count
        effort = NUMBERS_7[:count]
        pattern = messages.joint_state_message(0, names, effort=np.zeros(count))
        expected = messages.joint_state_message(START, names, effort=effort)
        assert_stream_writes(
            middleware.node, topics.EFFORT_COMMAND, pattern, expected, effort
        )


@pytest.mark.parametrize('second', [-(2**31), 2**31 - 1])
def test_reader_in_place_refuses_a_stamp_that_answers_could_not_follow(second):
    message = six()
    reader = MessageReader(
        JointState, partial(messages.read_named_vectors, names=JOINTS, fields=POSITION)
    )
    reader(serialize_message(message))
    message.header.stamp.sec = second
    with pytest.raises(MessageError, match=r'^header.stamp.sec: expected'):
        reader(serialize_message(message))


@pytest.mark.ros
@pytest.mark.parametrize(
    ('stamp', 'number'),
    [(START, NAN), (START, INF), (START, -INF), (2**31 * 10**9, 1.0)],
)
def test_stream_refuses_what_is_not_finite_and_a_stamp_beyond_those_of_ros(
    middleware, stamp, number
):
    stream = StreamPublisher(middleware.node, topics.JOINT_STATES, six())
    ones = np.ones(6)
    before = stream.encode_message(START, ones, ones, ones)
    with pytest.raises(MessageError):
        stream.encode_message(stamp, ones, np.full(6, number), ones)
    assert stream.encode_message(START, ones, ones, ones) == before


@pytest.mark.parametrize(
    ('names', 'efforts', 'positions', 'expected'),
    [
        (['c'], [5.0], [], ({'c': 5.0}, {})),
        (['a', 'c'], [], [0.01, -0.02], ({}, {'a': 0.01, 'c': -0.02})),
        (['d'], [1.0], [], None),
        (['a', 'a'], [1.0, 2.0], [], None),
        ([], [], [], None),
        (['a'], [], [], None),
        (['a'], [NAN], [], None),
        (['a'], [5.0], [0.01], None),
    ],
)
def test_force_command_has_forces_or_centres_of_some_contacts(
    names, efforts, positions, expected
):
    message = JointState(name=names, effort=efforts, position=positions)
    if expected is None:
        with pytest.raises(MessageError):
            messages.read_force_command(message, ABC)
    else:
        assert messages.read_force_command(message, ABC) == expected


def motion_point(turn=1.0005, height=0.0, poses=1, twists=1):
    place = geo.Vector3(x=0.5, z=height)
    pose = geo.Transform(translation=place, rotation=geo.Quaternion(w=turn))
    twist = geo.Twist(linear=geo.Vector3(y=0.1), angular=geo.Vector3(z=0.2))
    return MultiDOFJointTrajectoryPoint(
        transforms=[pose] * poses,
        velocities=[twist] * twists,
        accelerations=[twist] * min(twists, 1),
    )


def test_read_motion_normalises_its_quaternion_and_takes_no_twist_for_rest():
    twist = np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.2])
    for twists in (0, 1):
        motion = messages.read_motion(motion_point(twists=twists))
        np.testing.assert_array_equal(motion.position_world, [0.5, 0.0, 0.0])
        np.testing.assert_allclose(motion.quaternion_xyzw, [0, 0, 0, 1], atol=1e-15)
        np.testing.assert_array_equal(motion.twist_world, twists * twist)
        np.testing.assert_array_equal(motion.acceleration_world, twists * twist)


@pytest.mark.parametrize(
    ('spoiled', 'field'),
    [
        ({'turn': 0.5}, 'rotation'),
        ({'height': INF}, 'translation'),
        ({'poses': 0}, 'transforms'),
        ({'twists': 2}, 'velocities'),
    ],
)
def test_read_motion_refuses_by_field(spoiled, field):
    with pytest.raises(MessageError, match=f'^{field}: expected'):
        messages.read_motion(motion_point(**spoiled))


@pytest.mark.parametrize('effort', [[0.0, NAN, 0.0], [0.0, INF, 0.0], [1.0, 2.0]])
def test_joint_state_is_not_made_of_numbers_that_are_not_finite_or_too_few(effort):
    with pytest.raises(MessageError, match='^effort: expected'):
        messages.joint_state_message(START, ABC, effort=effort)


@pytest.mark.parametrize('number', [NAN, INF])
def test_motion_is_not_made_of_numbers_that_are_not_finite(number):
    rest = [0.0] * 6
    with pytest.raises(MessageError, match='^translation: expected'):
        messages.motion_message([number] * 3, [0.0] * 4, rest, rest)
    with pytest.raises(MessageError, match='^velocities: expected'):
        messages.motion_message([0.0] * 3, [0.0] * 4, [0.0] * 5 + [number], rest)


PUBLISHED = [
    topic
    for topic in topics.TOPICS
    if topic.publisher == topics.CONTROLLER and topic.rate == 'control'
]


def sample(stamp, position, velocity, wrench):
    """Return both messages of a sample that fits together, whatever numbers it holds."""
    reading = wrench_message(0, '', wrench)
    reading.header.stamp = stamp
    joints = JointState(
        header=reading.header, name=JOINTS, position=position, velocity=velocity
    )
    return (topics.WRENCH, reading), (topics.JOINT_STATES, joints)


def resting_sample(k):
    stamp = messages.ns_to_stamp(k * PERIOD)
    noise = 0.01 * np.random.default_rng(k).standard_normal(6)
    return sample(stamp, HOME.tolist(), [0.0] * 6, noise.tolist())


SAMPLE = st.builds(sample, STAMP, st.one_of(st.just(HOME.tolist()), SIX), SIX, SIX)


def numbers_in(value):
    """Return every number in a message."""
    if hasattr(value, 'get_fields_and_field_types'):
        value = [getattr(value, field) for field in value.get_fields_and_field_types()]
    if isinstance(value, (int, float)):
        return [float(value)]
    if isinstance(value, (str, bytes)):
        return []
    numbers = []
    for part in value:
        numbers += numbers_in(part)
    return numbers


class Live:
    """An active controller in this process, fed with good samples as well."""

    def __init__(self, host, supervised):
        self.node = host.hosted
        self.host = host
        self.supervised = supervised
        self.restart()
        self._inputs = {x.topic_name.lstrip('/'): x for x in self.node.subscriptions}
        self._outputs = []
        for topic in PUBLISHED:
            subscription = host.node.create_subscription(
                topic.message, topic.name, ignore_message, 1000
            )
            wait_for(subscription.get_publisher_count, 'connection')
            self._outputs.append(subscription)
        self.k = 0
        self.received = 0

    def hand_over(self, topic, message):
        """Let the controller have a message, as bytes where it wants these."""
        subscription = self._inputs[topic.name]
        if subscription.raw:
            message = serialize_message(message)
        subscription.callback(message)

    def values(self, part):
        """Return the values of a part of the diagnostics."""
        for status in self.node.collect_statuses():
            if status and status.component == part:
                return status.values
        raise AssertionError(f'no {part} in the diagnostics')

    def restart(self):
        assert self.node.trigger_deactivate() == SUCCESS
        assert self.node.trigger_activate() == SUCCESS

    def good(self):
        """Hand over a sample in order, and check the numbers of all that has come."""
        if not self.supervised and self.values('loop')['safe_behaviour']:
            self.restart()  # there was a posture without a torque
        self.k += 1
        for topic, message in resting_sample(self.k):
            self.hand_over(topic, message)
        self.take()

    def take(self):
        for subscription in self._outputs:
            while (taken := take_message(subscription)) is not None:
                self.received += 1
                message, _ = taken
                assert np.isfinite(numbers_in(message)).all(), message


@pytest.fixture(scope='module', params=[True, False], ids=['supervised', 'bare'])
def live(request, make_host):
    with make_host() as host:
        node = host.activate(f'supervised:={str(request.param).lower()}')
        node.get_logger().set_level(50)
        yield Live(host, request.param)


@pytest.mark.ros
@ANY
@given(good=st.integers(0, 3), events=st.lists(EVENT | SAMPLE, min_size=1, max_size=8))
def test_messages_are_answered_or_refused(live, events, good):
    for topic, message in sum(events, ()):
        live.hand_over(topic, message)
    for _ in range(good):
        live.good()
    live.node.do_due_work(live.host.spinner)
    live.take()


@pytest.mark.ros
def test_good_samples_are_answered_after_all_that_and_leave_nothing_behind(live):
    """In steady state no memory is kept, and nothing is made that the collector would look at."""
    live.restart()
    live.take()
    before = live.received

    def answers():
        live.good()
        return live.received > before + 50

    def controls():
        live.good()
        return live.values('supervisor')['reaction'] == 'none'

    wait_for(answers, 'answers')
    if live.supervised:
        wait_for(controls, 'control')
    samples = []
    for k in range(live.k + 1, live.k + 3001):
        samples += resting_sample(k)

    def feed(first, last):
        for topic, message in samples[2 * first : 2 * last]:
            live.hand_over(topic, message)
        gc.collect()
        # rclpy looks fields up by names made anew, of which the interpreter keeps up to 4096.
        sys._clear_type_cache()
        return tracemalloc.get_traced_memory()[0], len(gc.get_objects())

    steps = live.values('loop')['steps']
    feed(0, 500)
    tracemalloc.start()
    try:
        # What is kept of the past is of 100 ticks.
        memory_before, objects_before = feed(500, 1500)
        memory_after, objects_after = feed(1500, 3000)
    finally:
        tracemalloc.stop()
    assert live.values('loop')['steps'] - steps == 3000
    assert memory_after - memory_before < 16_384
    assert objects_after - objects_before < 10
