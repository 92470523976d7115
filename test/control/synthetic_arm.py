"""Made-up arms of any number of joints, with up to six independent contacts."""

from collections import namedtuple

from multicontact_control.config import ControllerConfig, RobotConfig, validate
from multicontact_control.dynamics.robot import RobotModel
import numpy as np

# Six independent contacts: unit normals and points, both in world axes.
NORMALS = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0),
           (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0))
POINTS = ((0.1, -0.6, 0.2), (-0.6, 0.1, 0.2), (0.1, 0.2, -0.6),
          (0.2, 0.6, -0.1), (0.6, 0.2, 0.1), (-0.2, 0.1, 0.6))
LINK_LENGTH = 1.2  # of all links together [m]


Setup = namedtuple('Setup', 'config home')  # and a posture that is not singular, shape (n,) [rad]


def synthetic_setup(folder, *, joints, contacts):
    """
    Write the URDF of an arm into a folder and return a configuration for it.

    Its axes, at least 6, go alternately along z and y; it has 1 to 6 contacts.
    """
    path = folder / f'arm{joints}.urdf'
    path.write_text(_urdf(joints), encoding='utf-8')
    names = [f'contact{i + 1}' for i in range(contacts)]
    home = np.resize([0.3, 0.7, -0.4, 0.9, 0.5, -0.8, 0.6], joints)
    robot = {
        'urdf': path.name, 'joint_names': [f'joint{i + 1}' for i in range(joints)],
        'armature': [0.1] * joints, 'operational_frame': 'wrist', 'sensor_frame': 'wrist'}
    pose = RobotModel(validate(RobotConfig, robot), folder).update(home, np.zeros(joints)).pose
    points = (np.array(POINTS) @ pose.rotation_world).tolist()
    return Setup(validate(ControllerConfig, {
        'robot': robot, 'tool': {'mass': 0.5, 'com_sensor': (0.0, 0.02, 0.08)},
        'sensor': {'require_push_test': False}, 'contact_names': names,
        'torque_limit': [200.0] * joints,
        'contacts': {name: {'normal_world': normal, 'point_operational': point}
                     for name, normal, point in zip(names, NORMALS, points)}}, path.name), home)


def _urdf(joints):
    """Return a chain of equal links that get lighter towards the wrist."""
    length = LINK_LENGTH / joints
    parts = ['<robot name="arm"><link name="base"/>']
    parent = 'base'
    for i in range(1, joints + 1):
        axis = '0 0 1' if i % 2 else '0 1 0'
        mass = 4.0 * (1.0 - 0.8 * i / joints)
        parts.append(
            f'<link name="link{i}"><inertial><origin xyz="0.02 0.01 {0.5 * length:.4f}"/>'
            f'<mass value="{mass:.4f}"/><inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" '
            f'ixz="0" iyz="0"/></inertial></link><joint name="joint{i}" type="revolute">'
            f'<parent link="{parent}"/><child link="link{i}"/><origin xyz="0 0 {length:.4f}"/>'
            f'<axis xyz="{axis}"/><limit lower="-3" upper="3" effort="200" velocity="3"/></joint>')
        parent = f'link{i}'
    parts.append(
        f'<link name="wrist"/><joint name="wrist_joint" type="fixed"><parent link="{parent}"/>'
        '<child link="wrist"/><origin xyz="0 0 0.1"/></joint></robot>')
    return ''.join(parts)
