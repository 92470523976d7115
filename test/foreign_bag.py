"""Recordings that somebody else made of a controller and a robot of seven joints."""

from __future__ import annotations

from arms import seven_joint_urdf
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.bag import Bag
import numpy as np
from rclpy.serialization import serialize_message
import yaml

RATE = 125.0
JOINTS = tuple(f'j{i}' for i in range(7))
COMMAND, PRELOAD, AT, MADE = 10.0, 2.0, 1.0, 1.5  # N, N, s, s
START = 1_700_000_000_000_000_000  # ns
ANSWERS = (topics.EFFORT_COMMAND, topics.MEASURED_FORCES)
TOPICS = (
    topics.JOINT_STATES, topics.WRENCH, topics.EFFORT_COMMAND, topics.MEASURED_FORCES,
    topics.ESTIMATED_FORCES, topics.DESIRED_FORCES, topics.NOISE_VARIANCE, topics.POSE,
    topics.POSE_DESIRED, topics.FORCE_COMMAND)


def rows(seconds, seed=0):
    """Yield topic, time [s] and message of a contact that is made and pressed with 10 N."""
    random = np.random.default_rng(seed)
    for k in range(round(seconds * RATE)):
        t = k / RATE
        stamp = START + round(t * 1e9)
        wanted = 0.0 if t < MADE - 0.1 else PRELOAD if t < MADE else COMMAND
        way = np.exp(-max(t - MADE, 0.0) / 0.05)  # that is left, from the preload
        force = COMMAND - (COMMAND - PRELOAD) * way if t >= MADE else wanted
        seen = force + 0.05 * random.normal()

        def named(value, stamp=stamp, **more):
            return messages.joint_state_message(stamp, ['wall'], effort=[value], **more)

        pose = messages.pose_message(stamp, np.array([0.5, 0.0, 0.3]), [0, 0, 0, 1], 'world')
        if t == AT:
            yield topics.FORCE_COMMAND, t, messages.joint_state_message(
                0, ['wall'], effort=[COMMAND])
        yield from (
            (topics.JOINT_STATES, t, messages.joint_state_message(
                stamp, JOINTS, position=np.full(7, 0.3), velocity=np.zeros(7))),
            (topics.WRENCH, t, messages.wrench_message(stamp, [seen, 0, 0, 0, 0, 0], 'wrist')),
            (topics.EFFORT_COMMAND, t, messages.joint_state_message(
                stamp, JOINTS, effort=np.full(7, 3.0))),
            (topics.MEASURED_FORCES, t, named(seen)),
            (topics.ESTIMATED_FORCES, t, named(force, velocity=[0.0])),
            (topics.DESIRED_FORCES, t, named(wanted)),
            (topics.NOISE_VARIANCE, t, named(0.5)), (topics.POSE, t, pose),
            (topics.POSE_DESIRED, t, pose), (topics.TRUE_FORCES, t, named(force)))


def write_bag(
    folder, *, without=(topics.TRUE_FORCES,), seconds=4.0, space='', change=lambda x: x,
    unanswered=0.0,
):
    """Write a recording, whose first seconds are not answered; return its MCAP file."""
    with Bag(folder) as writer:
        known = set()
        for topic, time, message in rows(seconds):
            name = f'{space}/{topic.name}'
            if topic in without or (topic in ANSWERS and time < unanswered):
                continue
            if name not in known:
                known.add(name)
                writer.add_topic(name, topic.type_name, topic.profile)
            at = START + round(time * 1e9)
            writer.write(name, serialize_message(change(message)), at)
            if topic is topics.POSE_DESIRED:
                writer.flush()
    return next(folder.glob('*.mcap'))


def controller_file(folder, **changes):
    """Write the parameter file of that robot's controller beside its URDF, and return it."""
    values = {
        'rate': RATE, 'robot': {
            'urdf': seven_joint_urdf(folder).name, 'joint_names': list(JOINTS),
            'armature': [0.1] * 7, 'operational_frame': 'wrist', 'sensor_frame': 'wrist'},
        'contact_names': ['wall'], 'contacts': {'wall': {
            'normal_world': [1.0, 0.0, 0.0], 'point_operational': [0.0, 0.0, 0.0],
            'stiffness': 5000.0}}, 'torque_limit': [100.0] * 7, **changes}
    path = folder / 'controller.yaml'
    path.write_text(yaml.safe_dump({'controller_node': {'ros__parameters': values}}))
    return path
