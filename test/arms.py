"""Arms, plants and configurations that several tests use."""

from pathlib import Path
from typing import NamedTuple

from multicontact_control.config import (
    ControllerConfig,
    merge,
    read_parameters,
    RobotConfig,
    validate,
)
from multicontact_control.control.controller import Controller, ControlOutput
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.flags import FORCES_AMBIGUOUS
from multicontact_control.paths import find_config_folder
from multicontact_control.supervision.contact_task import ContactTask
from multicontact_control.supervision.task_limits import limit_task
import numpy as np
from sim_bridge.config import PlantConfig

HOME = np.array(
    [
        1.847117449942421,
        0.8705595994175255,
        2.9372057614605662,
        0.0,
        -0.6661727072882984,
        1.847117449942421,
    ]
)


def controller_config(**changes):
    """Return the PUMA's configuration with nested changes."""
    values = read_parameters(find_config_folder() / 'controller.yaml')
    return validate(ControllerConfig, merge(values, changes), 'controller.yaml')


def still_config(**changes):
    """Return the same for an arm that stands still whatever its torques and its wrench say."""
    return controller_config(**merge({'collision': {'threshold': [1e9] * 6}}, changes))


class Measurement(NamedTuple):
    """A sample of the sensors: time [s], joints [rad, rad/s], wrench [N, N m]."""

    time: float
    q: np.ndarray
    qd: np.ndarray
    wrench_sensor: np.ndarray


class Law:
    """The control law of a configuration, asked for what a reference says, without its gate."""

    def __init__(self, config, reference, base_dir=None):
        self.controller = Controller(
            config, RobotModel(config.robot, base_dir or find_config_folder())
        )
        self.reference = reference
        self._task = ContactTask(
            self.controller.config, reference, self.controller, guarded=False
        )

    def __getattr__(self, name):
        return getattr(self.controller, name)

    def step(self, measurement, noise_variance):
        """Return the answer to a sample."""
        law = self.controller
        law.contacts['noise_variance'] = noise_variance
        law.take_sample(measurement.q, measurement.qd, measurement.wrench_sensor)
        if law.arm.flags & FORCES_AMBIGUOUS:
            raise law.explain_no_answer(law.arm.flags)
        if not law.started:
            self._task.start_task(law.start())
        self._task.update_wanted_task(measurement.time)
        limit_task(
            self._task.limits[0], law.controls[0], law.contacts, self._task.states
        )
        law.answer()
        return ControlOutput(law.torque.copy(), law.memory.tobytes())


def plant_config(name, **changes):
    """Return a plant that comes with the package, ``puma`` or ``rigid``, with nested changes."""
    values = read_parameters(find_config_folder() / f'plant_{name}.yaml')
    return validate(PlantConfig, merge(values, changes))


def pressed_wrench(config, state, **forces):
    """Return what the wrist sensor adds to its reading when contacts press [N], shape (6,)."""
    sensor, pose = state.sensor_pose, state.pose
    force = np.zeros(3)
    moment = np.zeros(3)
    for name, alpha in forces.items():
        contact = config.contacts[name]
        point = pose.position_world + pose.rotation_world @ contact.point_operational
        pressed = alpha * np.array(contact.normal_world)
        force += pressed
        moment += np.cross(point - sensor.position_world, pressed)
    R = sensor.rotation_world
    return np.concatenate([force @ R, moment @ R])


def seven_joint_urdf(folder: Path, joints: int = 7) -> Path:
    """Write an arm of alternating joints with a wrist frame, and return its file."""
    parts = ['<robot name="seven"><link name="base"/>']
    parent = 'base'
    for i in range(joints):
        axis = '0 0 1' if i % 2 == 0 else '0 1 0'
        mass = 3.0 - 0.3 * min(i, 6)
        parts.append(
            f'<link name="l{i}"><inertial><origin xyz="0.02 0.01 0.1"/><mass value="{mass:.1f}"'
            '/><inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
            f'</link><joint name="j{i}" type="revolute"><parent link="{parent}"/>'
            f'<child link="l{i}"/><origin xyz="0 0 0.2"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="100" velocity="3"/></joint>'
        )
        parent = f'l{i}'
    parts.append(
        f'<link name="wrist"/><joint name="fixed" type="fixed"><parent link="{parent}"/>'
        '<child link="wrist"/><origin xyz="0 0 0.1"/></joint></robot>'
    )
    path = folder / 'seven.urdf'
    path.write_text(''.join(parts), encoding='utf-8')
    return path


def seven_joint_config(path: Path) -> RobotConfig:
    """Return the names of that arm."""
    return RobotConfig(
        urdf=path.name,
        joint_names=tuple(f'j{i}' for i in range(7)),
        armature=(0.1,) * 7,
        operational_frame='wrist',
        sensor_frame='wrist',
    )
