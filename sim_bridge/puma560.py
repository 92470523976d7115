"""
The PUMA 560 with its tool, from the published parameters.

``python -m sim_bridge.puma560`` rewrites ``config/puma560.urdf`` from ``config/puma560.yaml``.
"""

from __future__ import annotations

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
from sim_bridge.arm import Arm, Body, Link, Placement
from sim_bridge.puma_visuals import VISUALS
from sim_bridge.tool import ToolData

DATA_FILE = 'puma560.yaml'
URDF_FILE = 'puma560.urdf'
ROBOT_NAME = 'puma560'

# Link 1 is published without a mass: it only turns about axis 1, on which its centre lies, so its
# mass moves no torque. A simulator needs one, and an inertia about every axis.
MASS_ON_AXIS_1 = 13.0


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
        ..., 'Encoder resolution on the motor shaft, which is not simulated.')
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


def puma_arm(data: RobotData) -> Arm:
    """
    Return the arm with its tool.

    Link i's frame is DH frame i-1 turned by joint i about its z axis, so that every joint axis is
    z; link 6's is DH frame 6 itself.
    """
    inertias = [link.inertia for link in data.links]
    if data.links[0].mass == 0.0:
        inertias[0] = (max(inertias[0]),) * 3
    tool = data.tool
    return Arm(
        name=ROBOT_NAME,
        links=tuple(_arm_link(data, i, inertia) for i, inertia in enumerate(inertias)),
        operational=Placement(), sensor=Placement((0.0, 0.0, tool.face_offset)),
        face_mass=tool.face_mass, tool=tool.body, tips=tool.tips, visuals=VISUALS)


def _arm_link(data: RobotData, index: int, inertia: Vector3) -> Link:
    """Return link `index` with the joint that carries it."""
    row, link, motor = data.dh[index], data.links[index], data.motors[index]
    cosine, sine = math.cos(row.alpha), math.sin(row.alpha)
    x, y, z = link.com
    com = (row.a + x, cosine * y - sine * z, row.d + sine * y + cosine * z)
    mass = MASS_ON_AXIS_1 if index == 0 and link.mass == 0.0 else link.mass
    placement = Placement()
    if index > 0:
        before = data.dh[index - 1]
        placement = Placement((before.a, 0.0, before.d), (before.alpha, 0.0, 0.0))
    low, high = (math.radians(limit) for limit in data.position_limit_deg[index])
    gear = abs(motor.gear)
    positive, negative = motor.coulomb
    return Link(
        data.joint_names[index], placement,
        Body(mass, Placement(com, (row.alpha, 0.0, 0.0)), inertia), low, high,
        data.speed_limit[index], data.torque_limit[index], data.exact_armature[index],
        motor.viscous * gear ** 2, abs(positive) * gear, abs(negative) * gear)


def main() -> None:
    """Rewrite the URDF in the package's configuration folder."""
    path = config_dir() / URDF_FILE
    path.write_text(puma_arm(load_robot()).urdf, encoding='utf-8')


if __name__ == '__main__':
    main()
