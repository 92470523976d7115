"""
An arm with a wrist sensor and a tool, from which engines and controller get their models.

A chain of joints that turn about the z axis of their own frame, each with one rigid link.
`urdf_arm` makes one of every robot's URDF.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
import math

from multicontact_control.config import Vector3
from multicontact_control.dynamics.robot import load_model
import numpy as np
import pinocchio as pin

BASE_LINK = 'base_link'
OPERATIONAL_FRAME = 'wrist_point'
SENSOR_FRAME = 'ft_face'
TOOL_LINK = 'tool'
FACE_INERTIA = 1e-6  # kg m^2, of the sensor's face about its origin
ENDLESS_LIMIT = 1e9  # rad, the limit that a URDF gives an endless joint
URDF_HEADER = """<?xml version="1.0"?>
<!-- Written by sim_bridge/arm.py from the robot's file: change that. -->"""


@dataclass(frozen=True)
class Placement:
    """
    Position and orientation of one frame in another.

    The angles are kept as the URDF has them: a rotation matrix would cost their last digit.
    """

    position: Vector3 = (0.0, 0.0, 0.0)  # of the origin [m]
    # Orientation: rotations about the other frame's x, then y, then z axis [rad].
    rpy: Vector3 = (0.0, 0.0, 0.0)

    @classmethod
    def from_transform(cls, transform: pin.SE3) -> Placement:
        """Return the placement that pinocchio describes by a translation and a matrix."""
        rpy = pin.rpy.matrixToRpy(transform.rotation)
        return cls(as_triple(transform.translation), as_triple(rpy))

    @property
    def transform(self) -> pin.SE3:
        """Return pinocchio's transform, which takes points of the frame to the other one."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy), np.array(self.position))


@dataclass(frozen=True)
class Body:
    """Mass, centre of mass and principal moments of inertia of a rigid body, in its own frame."""

    mass: float  # [kg]
    com: Placement  # centre of mass, and the principal axes of inertia there
    inertia: Vector3  # moments about these axes [kg m^2]

    @classmethod
    def from_inertia(cls, inertia: pin.Inertia) -> Body:
        """
        Return the body of an inertia of pinocchio's, whose moments are about any axes.

        A diagonal inertia keeps the axes of its frame. Any other is diagonalised, with axes that
        make a right-handed frame.
        """
        matrix = np.array(inertia.inertia)
        moments = np.diag(matrix)
        axes = np.eye(3)
        if np.count_nonzero(matrix - np.diag(moments)) > 0:
            moments, axes = np.linalg.eigh(matrix)
            axes[:, 2] *= np.sign(np.linalg.det(axes))
        com = Placement.from_transform(pin.SE3(axes, np.array(inertia.lever)))
        return cls(float(inertia.mass), com, as_triple(moments))


# A link of a URDF without any inertia weighs 1 kg in PyBullet: this one says that it has none.
MASSLESS = Body(0.0, Placement(), (0.0, 0.0, 0.0))
BULLET_BASE = Body(1.0, Placement(), (1.0, 1.0, 1.0))


@dataclass(frozen=True)
class Link:
    """One revolute joint, which turns about the z axis of its frame, and the link behind it."""

    joint: str  # name of the joint
    placement: Placement  # of the joint's frame in that of the link before
    body: Body  # in the joint's frame
    lower: float  # range, infinite for an endless joint [rad]
    upper: float
    speed_limit: float  # [rad/s]
    torque_limit: float  # [N m]
    armature: float = 0.0  # rotor inertia, joint side [kg m^2]
    viscous: float = 0.0  # friction, joint side [N m s/rad]
    coulomb_positive: float = 0.0  # friction at positive speed, joint side, >= 0 [N m]
    coulomb_negative: float = 0.0  # friction at negative speed, joint side, >= 0 [N m]


@dataclass(frozen=True)
class Arm:
    """
    A chain of links with a wrist sensor and a tool on the last one.

    The plant, its engines and the derived configuration of the controller start from it.
    """

    name: str  # of the robot, in the URDF
    links: tuple[Link, ...]  # base to wrist
    operational: Placement  # of the operational point, in the last link's frame
    sensor: Placement  # of the sensor's face, in the last link's frame
    face_mass: float  # of the sensor's face [kg]
    tool: Body  # hangs on the sensor, in the sensor's frame
    tips: Mapping[str, Vector3]  # of the tool, by URDF link, in the sensor's frame [m]

    # Text of a URDF with sensor and tool that the arm was read from.
    source_urdf: str = ''

    visuals: Mapping[str, str] = field(default_factory=dict)  # elements by URDF link

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, base to wrist: the order of every joint vector."""
        return tuple(link.joint for link in self.links)

    @property
    def armature(self) -> tuple[float, ...]:
        """Rotor inertia of each joint, joint side [kg m^2]."""
        return tuple(link.armature for link in self.links)

    @property
    def torque_limit(self) -> tuple[float, ...]:
        """Largest torque of each joint [N m]."""
        return tuple(link.torque_limit for link in self.links)

    @property
    def bodies(self) -> tuple[Body, ...]:
        """Bodies of the links, of the sensor's face and of the tool, each in its own frame."""
        face = Body(self.face_mass, Placement(), (FACE_INERTIA,) * 3)
        return (*(link.body for link in self.links), face, self.tool)

    @property
    def carried_mass(self) -> float:
        """Mass that the sensor weighs: its face and the tool [kg]."""
        return self.tool.mass + self.face_mass

    @property
    def carried_com(self) -> Vector3:
        """Centre of the mass that the sensor weighs, in the sensor's frame [m]."""
        share = self.tool.mass / self.carried_mass
        return as_triple(share * value for value in self.tool.com.position)

    @property
    def urdf(self) -> str:
        """Text of the URDF with the tool: the one that was read, or what `compose_urdf` makes."""
        return self.source_urdf or compose_urdf(self)

    def model(self) -> pin.Model:
        """Return a rigid-body model of the arm with its tool, without armature."""
        return load_model(self.urdf)


def compose_urdf(arm: Arm, *, for_bullet: bool = False) -> str:
    """
    Return the text of a URDF of an arm with its tool.

    For PyBullet four things differ. Links that only name a place (operational point, tips) are
    missing, since each costs time at every step. The base has a mass. Joints have no limits, which
    are the controller's. Inertias are isotropic, since the importer refuses some published ones:
    `BulletArm` sets the true ones afterwards.
    """
    base = MASSLESS
    visuals = arm.visuals
    if for_bullet:
        arm = _simplify_for_bullet(arm)
        base = BULLET_BASE
        visuals = {}
    *link_bodies, face, tool = arm.bodies
    parts = _link_element(BASE_LINK, base, visuals.get(BASE_LINK, ''))
    parent = BASE_LINK
    for number, (link, body) in enumerate(zip(arm.links, link_bodies), start=1):
        name = f'link{number}'
        parts += _link_element(name, body, visuals.get(name, ''))
        parts += _turning_joint_element(link, parent, name)
        parent = name
    parts += _link_element(SENSOR_FRAME, face)
    parts += _fixed_joint_element(parent, SENSOR_FRAME, arm.sensor)
    parts += _link_element(TOOL_LINK, tool, visuals.get(TOOL_LINK, ''))
    parts += _fixed_joint_element(SENSOR_FRAME, TOOL_LINK, Placement())
    if not for_bullet:
        parts += _link_element(OPERATIONAL_FRAME, MASSLESS)
        parts += _fixed_joint_element(parent, OPERATIONAL_FRAME, arm.operational)
        for tip, point in arm.tips.items():
            parts += _link_element(tip, MASSLESS)
            parts += _fixed_joint_element(TOOL_LINK, tip, Placement(point))
    lines = [URDF_HEADER, f'<robot name="{arm.name}">', *parts, '</robot>', '']
    return '\n'.join(lines)


def _simplify_for_bullet(arm: Arm) -> Arm:
    """Return an arm of endless joints and isotropic inertias."""
    links = [
        replace(link, body=make_isotropic(link.body), lower=-math.inf, upper=math.inf)
        for link in arm.links
    ]
    return replace(arm, links=tuple(links), tool=make_isotropic(arm.tool))


def make_isotropic(body: Body) -> Body:
    """
    Return a body all of whose moments of inertia are its largest one.

    The importers of engines refuse published inertias that break the triangle inequality; they
    take these, until the true ones are set.
    """
    return replace(body, inertia=(max(body.inertia),) * 3)


def _link_element(name: str, body: Body, visuals: str = '') -> list[str]:
    ixx, iyy, izz = body.inertia
    return [
        f'  <link name="{name}">',
        '    <inertial>',
        f'      {_origin_element(body.com)}',
        f'      <mass value="{body.mass!r}"/>',
        f'      <inertia ixx="{ixx!r}" iyy="{iyy!r}" izz="{izz!r}" ixy="0" ixz="0" iyz="0"/>',
        f'    </inertial>{visuals}',
        '  </link>',
    ]


def _turning_joint_element(link: Link, parent: str, child: str) -> list[str]:
    kind = 'revolute'
    lower, upper = link.lower, link.upper
    if math.isinf(lower) or math.isinf(upper):
        kind = 'continuous'
        lower, upper = -ENDLESS_LIMIT, ENDLESS_LIMIT
    return [
        f'  <joint name="{link.joint}" type="{kind}">',
        *_joint_ends(parent, child, link.placement),
        '    <axis xyz="0 0 1"/>',
        f'    <limit lower="{lower!r}" upper="{upper!r}" effort="{link.torque_limit!r}"'
        f' velocity="{link.speed_limit!r}"/>',
        '  </joint>',
    ]


def _fixed_joint_element(parent: str, child: str, placement: Placement) -> list[str]:
    return [
        f'  <joint name="{child}_joint" type="fixed">',
        *_joint_ends(parent, child, placement),
        '  </joint>',
    ]


def _joint_ends(parent: str, child: str, placement: Placement) -> list[str]:
    return [
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
        f'    {_origin_element(placement)}',
    ]


def _origin_element(placement: Placement) -> str:
    position = format_numbers(placement.position)
    return f'<origin xyz="{position}" rpy="{format_numbers(placement.rpy)}"/>'


def format_numbers(values: Iterable[float]) -> str:
    """Return numbers as text, with blanks between, each with every digit that it has."""
    return ' '.join(repr(float(value)) for value in values)


def as_triple(values: Iterable[float | str]) -> Vector3:
    """Return three numbers, also of numpy or written as text, as a tuple of floats."""
    x, y, z = (float(value) for value in values)
    return (x, y, z)
