"""
The URDF of the PUMA 560 with its tool, generated from the published parameters.

``python -m sim_bridge.puma560`` rewrites ``config/puma560.urdf`` from ``config/puma560.yaml``.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from pathlib import Path

from multicontact_control.config import (
    Config,
    parameter,
    read_yaml,
    Real,
    validate,
    Vector,
    Vector3,
)
from multicontact_control.errors import ConfigError
from multicontact_control.paths import config_dir
from pydantic import model_validator

DATA_FILE = 'puma560.yaml'
URDF_FILE = 'puma560.urdf'
ROBOT_NAME = 'puma560'
OPERATIONAL_FRAME = 'wrist_point'
SENSOR_FRAME = 'ft_face'
TOOL_LINK = 'tool'

# Link 1 is published without a mass: it only turns about axis 1, on which its centre lies, so its
# mass moves no torque. A simulator needs one, and an inertia about every axis.
MASS_ON_AXIS_1 = 13.0
FACE_INERTIA = 1e-6


class DhRow(Config):
    """One row of the standard Denavit-Hartenberg table (the joint angle is the variable)."""

    a: Real = parameter(..., 'Link length.', unit='m')
    alpha: Real = parameter(..., 'Link twist.', unit='rad')
    d: Real = parameter(..., 'Link offset.', unit='m')


class LinkData(Config):
    """Mass properties of one link in its Denavit-Hartenberg frame."""

    mass: Real = parameter(..., 'Mass.', unit='kg', ge=0.0)
    com: Vector3 = parameter(..., 'Centre of mass.', unit='m')
    inertia: Vector3 = parameter(..., 'Ixx, Iyy, Izz about the com.', unit='kg m^2')


class MotorData(Config):
    """One motor with its gear; friction as seen on the motor's side."""

    rotor_inertia: Real = parameter(..., 'Rotor inertia.', unit='kg m^2', ge=0.0)
    gear: Real = parameter(..., 'Gear ratio, the sign gives the direction.')
    viscous: Real = parameter(..., 'Viscous friction.', unit='N m s', ge=0.0)
    coulomb: tuple[Real, Real] = parameter(
        ..., 'Coulomb friction for positive and negative joint speed.', unit='N m')


class ToolData(Config):
    """The tool beyond the wrist sensor, in the sensor's frame."""

    face_offset: Real = parameter(..., 'Wrist point to sensor face, along z6.', unit='m')
    face_mass: Real = parameter(..., 'Mass of the face itself.', unit='kg', gt=0.0)
    mass: Real = parameter(..., 'Mass of the tool.', unit='kg', gt=0.0)
    com: Vector3 = parameter(..., 'Centre of mass of the tool.', unit='m')
    inertia: Vector3 = parameter(..., 'Ixx, Iyy, Izz about the com.', unit='kg m^2')
    tips: dict[str, Vector3] = parameter(..., 'Bar tips by URDF link name.', unit='m')


class RobotData(Config):
    """Everything published about the arm, and the tool on it."""

    dh: tuple[DhRow, ...]
    links: tuple[LinkData, ...]
    motors: tuple[MotorData, ...]
    armature: Vector = parameter(..., 'Rotor inertia at the joint, rounded.', unit='kg m^2')
    torque_limit: Vector = parameter(..., 'Largest joint torque.', unit='N m')
    speed_limit: Vector = parameter(..., 'Largest joint speed.', unit='rad/s')
    position_limit_deg: tuple[tuple[Real, Real], ...] = parameter(
        ..., 'Joint range.', unit='deg')
    encoder_counts_per_motor_rev: tuple[int, ...] = parameter(
        ..., 'Encoder resolution on the motor shaft.')
    tool: ToolData

    @model_validator(mode='after')
    def _check_lengths(self) -> RobotData:
        joints = len(self.dh)
        for name in ('links', 'motors', 'armature', 'torque_limit', 'speed_limit',
                     'position_limit_deg', 'encoder_counts_per_motor_rev'):
            found = len(getattr(self, name))
            if found != joints:
                raise ConfigError(name, f'{joints} entries, one per row of dh', found)
        return self

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names, base to wrist."""
        return tuple(f'joint{i + 1}' for i in range(len(self.dh)))

    @property
    def exact_armature(self) -> tuple[float, ...]:
        """Rotor inertia seen at each joint, Jm G^2 [kg m^2], not rounded."""
        return tuple(motor.rotor_inertia * motor.gear ** 2 for motor in self.motors)


def load_robot(path: Path | None = None) -> RobotData:
    """
    Read the arm's data, from the package's own file by default.

    Raises
    ------
    ConfigError
        If the file cannot be read or a value in it is not acceptable.

    """
    source = config_dir() / DATA_FILE if path is None else path
    return validate(RobotData, read_yaml(source), str(source))


def urdf_text(data: RobotData, *, for_bullet: bool = False) -> str:
    """
    Return the URDF of the arm with its tool.

    Link i's URDF frame is DH frame i-1 turned by joint i about its z axis, so that every joint
    axis is z; link 6's is DH frame 6 itself.

    Parameters
    ----------
    data
        The arm's data.
    for_bullet
        Whether PyBullet is to read it: without the links that only name a place (wrist point,
        bar tips), which would cost it time at every step, with a mass for the base, and with
        every inertia made isotropic, since the importer refuses some of the published ones. The
        true ones have to be set afterwards.

    Returns
    -------
    str
        The XML.

    """
    inertias = link_inertias(data)
    parts = ['  <link name="base_link"/>']
    if for_bullet:
        inertias = tuple((max(inertia),) * 3 for inertia in inertias)
        parts = _link('base_link', 1.0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    for index in range(len(data.dh)):
        parts += _arm_link(data, index, inertias[index])
    last = f'link{len(data.dh)}'
    tool = data.tool
    parts += _link(SENSOR_FRAME, tool.face_mass, (0.0, 0.0, 0.0), inertias[-2])
    parts += _fixed_joint(last, SENSOR_FRAME, (0.0, 0.0, tool.face_offset))
    parts += _link(TOOL_LINK, tool.mass, tool.com, inertias[-1])
    parts += _fixed_joint(SENSOR_FRAME, TOOL_LINK, (0.0, 0.0, 0.0))
    if not for_bullet:
        parts.append(f'  <link name="{OPERATIONAL_FRAME}"/>')
        parts += _fixed_joint(last, OPERATIONAL_FRAME, (0.0, 0.0, 0.0))
        for name, point in tool.tips.items():
            parts.append(f'  <link name="{name}"/>')
            parts += _fixed_joint(TOOL_LINK, name, point)
    return '\n'.join([_HEADER, f'<robot name="{ROBOT_NAME}">', *parts, '</robot>', ''])


_HEADER = f"""<?xml version="1.0"?>
<!-- Generated from config/{DATA_FILE} by sim_bridge/puma560.py: change that, then run
     python3 -m sim_bridge.puma560 -->"""


def link_inertias(data: RobotData) -> tuple[Vector3, ...]:
    """Return Ixx, Iyy, Izz about the com of links, sensor face and tool, in order [kg m^2]."""
    inertias = [link.inertia for link in data.links]
    if data.links[0].mass == 0.0:
        inertias[0] = (max(inertias[0]),) * 3
    return (*inertias, (FACE_INERTIA,) * 3, data.tool.inertia)


def _arm_link(data: RobotData, index: int, inertia: Vector3) -> list[str]:
    """Return link `index` and the joint that carries it."""
    row, link = data.dh[index], data.links[index]
    cosine, sine = math.cos(row.alpha), math.sin(row.alpha)
    x, y, z = link.com
    com = (row.a + x, cosine * y - sine * z, row.d + sine * y + cosine * z)
    mass = MASS_ON_AXIS_1 if index == 0 and link.mass == 0.0 else link.mass
    parent, origin = 'base_link', 'xyz="0 0 0" rpy="0 0 0"'
    if index > 0:
        before = data.dh[index - 1]
        parent = f'link{index}'
        origin = f'xyz="{_numbers((before.a, 0.0, before.d))}" rpy="{before.alpha!r} 0 0"'
    low, high = (math.radians(limit) for limit in data.position_limit_deg[index])
    return [
        *_link(f'link{index + 1}', mass, com, inertia, row.alpha),
        f'  <joint name="{data.joint_names[index]}" type="revolute">',
        f'    <parent link="{parent}"/>',
        f'    <child link="link{index + 1}"/>',
        f'    <origin {origin}/>',
        '    <axis xyz="0 0 1"/>',
        f'    <limit lower="{low!r}" upper="{high!r}" effort="{data.torque_limit[index]!r}"'
        f' velocity="{data.speed_limit[index]!r}"/>',
        '  </joint>']


def _link(
    name: str, mass: float, com: Sequence[float], inertia: Sequence[float], roll: float = 0.0,
) -> list[str]:
    ixx, iyy, izz = inertia
    return [
        f'  <link name="{name}">',
        '    <inertial>',
        f'      <origin xyz="{_numbers(com)}" rpy="{roll!r} 0 0"/>',
        f'      <mass value="{mass!r}"/>',
        f'      <inertia ixx="{ixx!r}" iyy="{iyy!r}" izz="{izz!r}" ixy="0" ixz="0" iyz="0"/>',
        '    </inertial>',
        '  </link>']


def _fixed_joint(parent: str, child: str, position: Sequence[float]) -> list[str]:
    return [
        f'  <joint name="{child}_joint" type="fixed">',
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
        f'    <origin xyz="{_numbers(position)}" rpy="0 0 0"/>',
        '  </joint>']


def _numbers(values: Sequence[float]) -> str:
    return ' '.join(repr(float(value)) for value in values)


def main() -> None:
    """Rewrite the URDF in the package's configuration folder."""
    path = config_dir() / URDF_FILE
    path.write_text(urdf_text(load_robot()), encoding='utf-8')


if __name__ == '__main__':
    main()
