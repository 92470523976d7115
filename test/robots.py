"""The robots and engines that are installed here; the others are skipped, with the reason."""

from importlib.util import find_spec

from multicontact_control.errors import ConfigError
import numpy as np
import pinocchio as pin
import pytest
from sim_bridge.robots import find_robot, find_urdf, robot_names

NO_MUJOCO = 'MuJoCo is not installed: extra [mujoco]'
needs_mujoco = pytest.mark.skipif(find_spec('mujoco') is None, reason=NO_MUJOCO)
ENGINES = ['pybullet', pytest.param('mujoco', marks=needs_mujoco)]


def has_urdf(name):
    """Return whether the URDF of a robot is installed."""
    robot = find_robot(name)
    try:
        return find_urdf(robot.file.urdf, robot.folder).is_file()
    except ConfigError:
        return False


def robot_parameters(names):
    """Return robots as parameters of a test; all but the PUMA and the Panda are nightly."""
    parameters = []
    for name in names:
        reason = f'no URDF of {name}: extra [robots] or [franka]'
        marks = [pytest.mark.skipif(not has_urdf(name), reason=reason)]
        if name not in ('puma', 'panda'):
            marks.append(pytest.mark.nightly)
        parameters.append(pytest.param(name, marks=marks))
    return parameters


ROBOTS = robot_parameters(robot_names())
OTHERS = robot_parameters([name for name in robot_names() if name != 'puma'])


def carried(arm):
    """Return the inertia that hangs on the sensor, in its frame."""
    com = arm.tool.com.transform
    inertia = com.rotation @ np.diag(arm.tool.inertia) @ com.rotation.T
    tool = pin.Inertia(arm.tool.mass, com.translation, inertia)
    return tool + pin.Inertia(arm.face_mass, np.zeros(3), 1e-6 * np.eye(3))
