"""Recordings of a controller and a robot of seven joints, made without this package or ROS."""

from types import SimpleNamespace

from arms import seven_joint_urdf
from mcap_ros2.writer import Writer
import numpy as np
from rosbags.typesys import get_typestore, Stores
import yaml

RATE = 125.0
JOINTS = tuple(f'j{i}' for i in range(7))
COMMAND = 10.0  # N
PRELOAD = 2.0  # N
AT = 1.0  # s, of the command
MADE = 1.5  # s, of the contact
REFUSED_AT = 2.0  # s, of a command beyond the limits
START = 1_700_000_000_000_000_000  # ns
TRUTH = 'ground_truth/contact_forces'
SENT = 'contact_forces/command'
COMMANDED = 'controller_node/status'
MEASURED = 'contact_forces/measured'
JOINT_STATE = 'sensor_msgs/msg/JointState'
POSE = 'geometry_msgs/msg/PoseStamped'
TYPES = {
    'joint_states': JOINT_STATE,
    'joint_effort_command': JOINT_STATE,
    MEASURED: JOINT_STATE,
    'contact_forces/estimated': JOINT_STATE,
    'contact_forces/desired': JOINT_STATE,
    'contact_forces/noise_variance': JOINT_STATE,
    TRUTH: JOINT_STATE,
    SENT: JOINT_STATE,
    COMMANDED: 'diagnostic_msgs/msg/DiagnosticStatus',
    'ft_sensor/wrench': 'geometry_msgs/msg/WrenchStamped',
    'operational_point/pose': POSE,
    'operational_point/pose_desired': POSE,
}
TOPICS = tuple(topic for topic in TYPES if topic not in (TRUTH, SENT))


def header(ns):
    stamp = SimpleNamespace(sec=ns // 10**9, nanosec=ns % 10**9)
    return SimpleNamespace(frame_id='world', stamp=stamp)


def joint_state(ns, name, position=(), velocity=(), effort=()):
    return SimpleNamespace(
        header=header(ns),
        name=list(name),
        position=list(map(float, position)),
        velocity=list(map(float, velocity)),
        effort=list(map(float, effort)),
    )


def xyz(*values):
    return SimpleNamespace(**dict(zip('xyzw', map(float, values))))


def wrench(ns, normal_force):
    pressed = SimpleNamespace(force=xyz(normal_force, 0, 0), torque=xyz(0, 0, 0))
    return SimpleNamespace(header=header(ns), wrench=pressed)


def pose(ns):
    place = SimpleNamespace(position=xyz(0.5, 0, 0.3), orientation=xyz(0, 0, 0, 1))
    return SimpleNamespace(header=header(ns), pose=place)


def status(ns, event):
    values = [
        SimpleNamespace(key='event', value=event),
        SimpleNamespace(key='forces', value=f'wall {COMMAND}'),
    ]
    return SimpleNamespace(
        header=header(ns), level=0, name='', message='', hardware_id='', values=values
    )


def forces_at(time):
    """Return the wanted and the true force at a time [s], which is that of the preload first."""
    if time < MADE - 0.1:
        return 0.0, 0.0
    if time < MADE:
        return PRELOAD, PRELOAD
    missing = (COMMAND - PRELOAD) * np.exp(-(time - MADE) / 0.05)
    return COMMAND, COMMAND - missing


def messages_at(time, noise):
    """Yield topic and message of a contact that is made and pressed with 10 N."""
    ns = START + round(time * 1e9)
    wanted, force = forces_at(time)
    measured = force + noise
    for asked_at, asked, event in (
        (AT, COMMAND, 'accepted'),
        (REFUSED_AT, 5000.0, 'refused'),
    ):
        if time == asked_at:
            yield SENT, joint_state(0, ['wall'], effort=[asked])
            yield COMMANDED, status(ns, event)
    yield 'joint_states', joint_state(ns, JOINTS, np.full(7, 0.3), np.zeros(7))
    yield 'ft_sensor/wrench', wrench(ns, measured)
    yield 'joint_effort_command', joint_state(ns, JOINTS, effort=np.full(7, 3.0))
    for topic, value in (
        (MEASURED, measured),
        ('contact_forces/desired', wanted),
        (TRUTH, force),
        ('contact_forces/noise_variance', 0.5),
    ):
        yield topic, joint_state(ns, ['wall'], effort=[value])
    estimated = joint_state(ns, ['wall'], velocity=[0.0], effort=[force])
    yield 'contact_forces/estimated', estimated
    yield 'operational_point/pose', pose(ns)
    yield 'operational_point/pose_desired', pose(ns)


def rows(seconds):
    """Yield topic, time [s] and message of so many seconds."""
    random = np.random.default_rng(0)
    for k in range(round(seconds * RATE)):
        for topic, message in messages_at(k / RATE, 0.05 * random.normal()):
            yield topic, k / RATE, message


def write_bag(folder, *, without=(TRUTH,), seconds=4.0, change=lambda x: x):
    """Write a recording to the only MCAP file of a new folder, and return it."""
    messages = []
    for topic, time, message in rows(seconds):
        if topic not in without:
            messages.append((topic, START + round(time * 1e9), change(message)))
    return write_messages(folder, messages)


def write_messages(folder, messages, types=TYPES):
    """Write messages, each with its topic and time [ns], to the only file of a new folder."""
    folder.mkdir(parents=True)
    path = folder / 'bag_0.mcap'
    store = get_typestore(Stores.ROS2_JAZZY)
    schemas = {}
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=4096)
        for kind in types.values():
            definition, _ = store.generate_msgdef(kind, ros_version=2)
            schemas[kind] = writer.register_msgdef(kind, definition)
        for topic, ns, message in messages:
            writer.write_message(f'/{topic}', schemas[types[topic]], message, ns, ns)
        writer.finish()
    return path


def controller_file(folder, **changes):
    """Write the parameter file of that robot's controller beside its URDF, and return it."""
    values = {
        'rate': RATE,
        'robot': {
            'urdf': seven_joint_urdf(folder).name,
            'joint_names': list(JOINTS),
            'armature': [0.1] * 7,
            'operational_frame': 'wrist',
            'sensor_frame': 'wrist',
        },
        'contact_names': ['wall'],
        'contacts': {
            'wall': {
                'normal_world': [1.0, 0.0, 0.0],
                'point_operational': [0.0, 0.0, 0.0],
                'stiffness': 5000.0,
            }
        },
        'torque_limit': [100.0] * 7,
        **changes,
    }
    path = folder / 'controller.yaml'
    path.write_text(yaml.safe_dump({'controller_node': {'ros__parameters': values}}))
    return path
