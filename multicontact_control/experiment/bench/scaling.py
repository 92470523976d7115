"""How the tick's time grows with columns of N, joints and the order of the active state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter_ns
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig, RobotConfig, validate
from multicontact_control.control.controller import Controller, Measurement
from multicontact_control.control.reference import Reference
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import RobotModel
import numpy as np

COLUMNS = (1, 2, 3, 4, 5, 6, 12)  # 12 are four planes that share the wrench
JOINTS = (6, 7, 14)
ORDERS = (0, 1, 2, 3)
# Six independent contacts: unit normals and points, both in world axes.
NORMALS = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0),
           (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0))
POINTS = ((0.1, -0.6, 0.2), (-0.6, 0.1, 0.2), (0.1, 0.2, -0.6),
          (0.2, 0.6, -0.1), (0.6, 0.2, 0.1), (-0.2, 0.1, 0.6))
LINK_LENGTH = 1.2  # of all links together [m]


@dataclass(frozen=True, slots=True)
class SyntheticSetup:
    """A controller's configuration for a made-up arm, whose URDF lies in a folder."""

    config: ControllerConfig
    home: Vector  # a posture that is not singular, shape (n,) [rad]


def synthetic_setup(
    folder: Path, *, joints: int, contacts: int, order: int = 1, planes: bool = False,
) -> SyntheticSetup:
    """
    Write the URDF of an arm into a folder and return a configuration for it.

    Its axes, at least 6, go alternately along z and y; it has 1 to 6 contacts, points or planes,
    with active states of an order.
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
    config = validate(ControllerConfig, {
        'robot': robot,
        'tool': {'mass': 0.5, 'com_sensor': (0.0, 0.02, 0.08)},
        'sensor': {'require_push_test': False},
        'force': {'active_state_order': order,
                  'dependent_columns': 'minimum_norm' if planes else 'refused'},
        'contact_names': names, 'torque_limit': [200.0] * joints,
        'contacts': {
            name: {'normal_world': normal, 'point_operational': point,
                   **({'type': 'plane', 'friction_std': 3.0} if planes else {})}
            for name, normal, point in zip(names, NORMALS, points)}}, path.name)
    return SyntheticSetup(config, home)


def _urdf(joints: int) -> str:
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


class _AllContacts:
    """A reference that holds the pose and presses on every contact."""

    def __init__(self, leader_of: Sequence[int]) -> None:
        self._active = np.ones(len(leader_of), dtype=bool)
        self._forces = np.where(np.arange(len(leader_of)) == leader_of, 5.0, 0.0)
        self._still = np.zeros(6)

    def start(self, pose: Pose, normals_world: Any) -> None:
        self._pose = pose

    def update(self, time: float, alpha_meas: Any) -> Reference:
        return Reference(self._pose, self._still, self._still, self._active, self._forces)


def tick_time(setup: SyntheticSetup, folder: Path, ticks: int) -> float:
    """Return the median time of a tick of the controller [us]."""
    contacts = len(setup.config.columns)
    controller = Controller.from_config(
        setup.config, _AllContacts(setup.config.leader_of), folder)
    random = np.random.default_rng(0)
    moves = random.standard_normal((100, 2, setup.home.shape[0]))
    wrenches = random.standard_normal((100, 6))
    samples = [
        Measurement(0.002 * k, setup.home + 0.02 * move[0], 0.1 * move[1], wrench)
        for k, (move, wrench) in enumerate(zip(moves, wrenches))]
    variance = np.full(contacts, 0.6)
    times = np.zeros(ticks)
    for k in range(ticks):
        sample = samples[k % len(samples)]
        start = perf_counter_ns()
        controller.step(sample, variance)
        times[k] = perf_counter_ns() - start
    return round(1e-3 * float(np.median(times)), 3)


def bench_scaling(ticks: int) -> dict[str, dict[str, float]]:
    """Return median times [us] by number of columns, of joints (two contacts), and order."""
    with TemporaryDirectory() as name:
        folder = Path(name)

        def at(joints: int = 6, columns: int = 2, order: int = 1) -> float:
            planes = columns > len(NORMALS)
            setup = synthetic_setup(
                folder, joints=joints, contacts=columns // 3 if planes else columns, order=order,
                planes=planes)
            return tick_time(setup, folder, ticks)

        return {
            'columns_us': {str(columns): at(columns=columns) for columns in COLUMNS},
            'joints_us': {str(joints): at(joints=joints) for joints in JOINTS},
            'order_us': {str(order): at(order=order) for order in ORDERS}}
