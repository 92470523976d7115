"""Recordings of a controller and a robot of seven joints, made without this package or ROS."""

from types import SimpleNamespace

from arms import seven_joint_urdf
from mcap_ros2.writer import Writer
import numpy as np
from rosbags.typesys import get_typestore, Stores
import yaml

RATE = 125.0
JOINTS = tuple(f'j{i}' for i in range(7))
COMMAND, PRELOAD, AT, MADE, REFUSED_AT = 10.0, 2.0, 1.0, 1.5, 2.0  # N, N, s, s, s
START = 1_700_000_000_000_000_000  # ns
NAMED = (
    'joint_states',
    'joint_effort_command',
    *(
        f'contact_forces/{name}'
        for name in ('measured', 'estimated', 'desired', 'noise_variance')
    ),
)
TRUTH, SENT, COMMANDED, MEASURED = (
    'ground_truth/contact_forces',
    'contact_forces/command',
    'controller_node/status',
    'contact_forces/measured',
)
TYPES = (
    dict.fromkeys((*NAMED, TRUTH), 'sensor_msgs/msg/JointState')
    | {
        SENT: 'sensor_msgs/msg/JointState',
        COMMANDED: 'diagnostic_msgs/msg/DiagnosticStatus',
        'ft_sensor/wrench': 'geometry_msgs/msg/WrenchStamped',
    }
    | dict.fromkeys(
        ('operational_point/pose', 'operational_point/pose_desired'),
        'geometry_msgs/msg/PoseStamped',
    )
)
TOPICS = tuple(topic for topic in TYPES if topic not in (TRUTH, SENT))


def header(ns):
    return SimpleNamespace(
        frame_id='world', stamp=SimpleNamespace(sec=ns // 10**9, nanosec=ns % 10**9)
    )


def joint_state(ns, name, position=(), velocity=(), effort=()):
    return SimpleNamespace(
        header=header(ns),
        name=list(name),
        **{
            field: list(map(float, values))
            for field, values in (
                ('position', position),
                ('velocity', velocity),
                ('effort', effort),
            )
        },
    )


def xyz(values):
    return SimpleNamespace(**dict(zip('xyzw', map(float, values))))


def wrench(ns, values):
    return SimpleNamespace(
        header=header(ns),
        wrench=SimpleNamespace(force=xyz(values[:3]), torque=xyz(values[3:])),
    )


def rows(seconds):
    """Yield topic, time [s] and message of a contact that is made and pressed with 10 N."""
    random = np.random.default_rng(0)
    for k in range(round(seconds * RATE)):
        t = k / RATE
        ns = START + round(t * 1e9)
        wanted = 0.0 if t < MADE - 0.1 else PRELOAD if t < MADE else COMMAND
        way = np.exp(-max(t - MADE, 0.0) / 0.05)  # that is left, from the preload
        force = COMMAND - (COMMAND - PRELOAD) * way if t >= MADE else wanted
        seen = force + 0.05 * random.normal()
        pose = SimpleNamespace(
            header=header(ns),
            pose=SimpleNamespace(
                position=xyz((0.5, 0.0, 0.3)), orientation=xyz((0.0, 0.0, 0.0, 1.0))
            ),
        )
        if t in (AT, REFUSED_AT):
            yield (
                SENT,
                t,
                joint_state(0, ['wall'], effort=[COMMAND if t == AT else 5000.0]),
            )
            yield (
                COMMANDED,
                t,
                SimpleNamespace(
                    header=header(ns),
                    level=0,
                    name='',
                    message='',
                    hardware_id='',
                    values=[
                        SimpleNamespace(
                            key='event', value='accepted' if t == AT else 'refused'
                        ),
                        SimpleNamespace(key='forces', value=f'wall {COMMAND}'),
                    ],
                ),
            )
        yield 'joint_states', t, joint_state(ns, JOINTS, np.full(7, 0.3), np.zeros(7))
        yield 'ft_sensor/wrench', t, wrench(ns, [seen, 0, 0, 0, 0, 0])
        yield 'joint_effort_command', t, joint_state(ns, JOINTS, effort=np.full(7, 3.0))
        for name, value in (
            (MEASURED, seen),
            ('contact_forces/desired', wanted),
            (TRUTH, force),
            ('contact_forces/noise_variance', 0.5),
        ):
            yield name, t, joint_state(ns, ['wall'], effort=[value])
        yield (
            'contact_forces/estimated',
            t,
            joint_state(ns, ['wall'], velocity=[0.0], effort=[force]),
        )
        yield 'operational_point/pose', t, pose
        yield 'operational_point/pose_desired', t, pose


def write_bag(folder, *, without=(TRUTH,), seconds=4.0, change=lambda x: x):
    """Write a recording to the only MCAP file of a new folder, and return it."""
    folder.mkdir(parents=True)
    store, schemas, path = get_typestore(Stores.ROS2_JAZZY), {}, folder / 'bag_0.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=4096)
        for topic, time, message in rows(seconds):
            kind, ns = TYPES[topic], START + round(time * 1e9)
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(
                    kind, store.generate_msgdef(kind, ros_version=2)[0]
                )
            if topic not in without:
                writer.write_message(
                    f'/{topic}', schemas[kind], change(message), ns, ns
                )
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
