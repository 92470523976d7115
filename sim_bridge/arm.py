"""
An arm with a wrist sensor and a tool, from which engines and controller get their models.

A chain of joints that turn about the z axis of their own frame, each with one rigid link.
`urdf_arm` makes one of every robot's URDF.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
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
NO_LIMIT = 1e9  # what an endless joint's limit is in a URDF [rad]


@dataclass(frozen=True)
class Placement:
    """A frame in another one."""

    position: Vector3 = (0.0, 0.0, 0.0)  # of its origin [m]
    rpy: Vector3 = (
        0.0,
        0.0,
        0.0,
    )  # its axes, turned about the other's x, then y, then z [rad]

    @classmethod
    def of(cls, placement: pin.SE3) -> Placement:
        """Return pinocchio's placement."""
        position, rpy = placement.translation, pin.rpy.matrixToRpy(placement.rotation)
        return cls(triple(position), triple(rpy))

    @property
    def se3(self) -> pin.SE3:
        """Return it as pinocchio's."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy), np.array(self.position))


@dataclass(frozen=True)
class Body:
    """Mass properties."""

    mass: float  # [kg]
    com: Placement  # centre of mass, and the principal axes of inertia there
    inertia: Vector3  # about these axes [kg m^2]

    @classmethod
    def of(cls, inertia: pin.Inertia) -> Body:
        """Return pinocchio's inertia about its principal axes."""
        matrix = np.array(inertia.inertia)
        if np.count_nonzero(matrix - np.diag(np.diag(matrix))) == 0:
            moments, axes = np.diag(matrix), np.eye(3)
        else:
            moments, axes = np.linalg.eigh(matrix)
            axes[:, 2] *= np.sign(np.linalg.det(axes))
        com = Placement.of(pin.SE3(axes, np.array(inertia.lever)))
        return cls(float(inertia.mass), com, triple(moments))


MASSLESS = Body(
    0.0, Placement(), (0.0, 0.0, 0.0)
)  # PyBullet takes none at all for 1 kg


@dataclass(frozen=True)
class Link:
    """One joint and what it carries."""

    joint: str  # name of the joint
    placement: (
        Placement  # of the joint's frame in the link before; it turns about its z axis
    )
    body: Body  # in the joint's frame
    lower: float  # range, infinite for a joint without end [rad]
    upper: float
    speed_limit: float  # [rad/s]
    torque_limit: float  # [N m]
    armature: float = 0.0  # rotor inertia, joint side [kg m^2]
    viscous: float = 0.0  # friction, joint side [N m s/rad]
    coulomb_positive: float = 0.0  # friction at positive speed, joint side, >= 0 [N m]
    coulomb_negative: float = 0.0  # at negative speed


@dataclass(frozen=True)
class Arm:
    """A chain of links with a wrist sensor and a tool on the last one."""

    name: str  # of the robot, in the URDF
    links: tuple[Link, ...]  # base to wrist
    operational: Placement  # of the operational point, in the last link's frame
    sensor: Placement  # of the sensor's face, in the last link's frame
    face_mass: float  # of the sensor itself [kg]
    tool: Body  # what hangs on the sensor, in the sensor's frame
    tips: Mapping[str, Vector3]  # of the tool, by URDF link, in the sensor's frame [m]
    text: str = ''  # of a URDF with sensor and tool that the arm was read from
    visuals: Mapping[str, str] = field(default_factory=dict)  # elements by URDF link

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names, base to wrist."""
        return tuple(link.joint for link in self.links)

    @property
    def armature(self) -> tuple[float, ...]:
        """Rotor inertia of each joint [kg m^2]."""
        return tuple(link.armature for link in self.links)

    @property
    def torque_limit(self) -> tuple[float, ...]:
        """Largest torque of each joint [N m]."""
        return tuple(link.torque_limit for link in self.links)

    @property
    def bodies(self) -> tuple[Body, ...]:
        """Bodies of links, sensor face and tool, each in its own frame."""
        face = Body(self.face_mass, Placement(), (FACE_INERTIA,) * 3)
        return (*(link.body for link in self.links), face, self.tool)

    @property
    def carried_mass(self) -> float:
        """All that the sensor weighs: its face and the tool [kg]."""
        return self.tool.mass + self.face_mass

    @property
    def carried_com(self) -> Vector3:
        """Centre of mass of that, in the sensor's frame [m]."""
        share = self.tool.mass / self.carried_mass
        return triple(share * value for value in self.tool.com.position)

    @property
    def urdf(self) -> str:
        """Return the URDF text of the arm with its tool, whose joints all turn about z."""
        return self.text or urdf_text(self)

    def model(self) -> pin.Model:
        """Return a rigid-body model of the arm with its tool, without armature."""
        return load_model(self.urdf)


def urdf_text(arm: Arm, *, for_bullet: bool = False) -> str:
    """
    Return the URDF of an arm with its tool.

    For PyBullet it is without the links that only name a place (operational point, tips), which
    would cost time at every step, with a mass for the base, without joint limits, which are the
    controller's, and with isotropic inertias, since the importer refuses some published ones: the
    true inertias have to be set afterwards.
    """
    bodies, visuals = arm.bodies, {} if for_bullet else arm.visuals
    base = _link(BASE_LINK, MASSLESS, visuals.get(BASE_LINK, ''))
    if for_bullet:
        bodies = tuple(
            replace(body, inertia=(max(body.inertia),) * 3) for body in bodies
        )
        base = _link(BASE_LINK, Body(1.0, Placement(), (1.0, 1.0, 1.0)))
    parts, parent = base, BASE_LINK
    for number, (link, body) in enumerate(zip(arm.links, bodies), start=1):
        name = f'link{number}'
        endless = for_bullet or not (
            math.isfinite(link.lower) and math.isfinite(link.upper)
        )
        lower, upper = (-NO_LIMIT, NO_LIMIT) if endless else (link.lower, link.upper)
        parts += _link(name, body, visuals.get(name, ''))
        parts += _joint(
            link.joint,
            'continuous' if endless else 'revolute',
            parent,
            name,
            link.placement,
            [
                '    <axis xyz="0 0 1"/>',
                f'    <limit lower="{lower!r}" upper="{upper!r}" effort="{link.torque_limit!r}"'
                f' velocity="{link.speed_limit!r}"/>',
            ],
        )
        parent = name
    places = (
        {}
        if for_bullet
        else {
            OPERATIONAL_FRAME: (parent, arm.operational),
            **{tip: (TOOL_LINK, Placement(point)) for tip, point in arm.tips.items()},
        }
    )
    parts += _link(SENSOR_FRAME, bodies[-2])
    parts += _joint(f'{SENSOR_FRAME}_joint', 'fixed', parent, SENSOR_FRAME, arm.sensor)
    parts += _link(TOOL_LINK, bodies[-1], visuals.get(TOOL_LINK, ''))
    parts += _joint(f'{TOOL_LINK}_joint', 'fixed', SENSOR_FRAME, TOOL_LINK, Placement())
    for name, (carrier, placement) in places.items():
        parts += _link(name, MASSLESS)
        parts += _joint(f'{name}_joint', 'fixed', carrier, name, placement)
    return '\n'.join([_HEADER, f'<robot name="{arm.name}">', *parts, '</robot>', ''])


_HEADER = """<?xml version="1.0"?>
<!-- Written by sim_bridge/arm.py from the robot's file: change that. -->"""


def _link(name: str, body: Body, visuals: str = '') -> list[str]:
    ixx, iyy, izz = body.inertia
    return [
        f'  <link name="{name}">',
        '    <inertial>',
        f'      {_origin(body.com)}',
        f'      <mass value="{body.mass!r}"/>',
        f'      <inertia ixx="{ixx!r}" iyy="{iyy!r}" izz="{izz!r}" ixy="0" ixz="0" iyz="0"/>',
        f'    </inertial>{visuals}',
        '  </link>',
    ]


def _joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    placement: Placement,
    turning: Sequence[str] = (),
) -> list[str]:
    return [
        f'  <joint name="{name}" type="{kind}">',
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
        f'    {_origin(placement)}',
        *turning,
        '  </joint>',
    ]


def _origin(placement: Placement) -> str:
    return (
        f'<origin xyz="{numbers(placement.position)}" rpy="{numbers(placement.rpy)}"/>'
    )


def numbers(values: Iterable[float]) -> str:
    """Return numbers with blanks between, with every digit they have."""
    return ' '.join(repr(float(value)) for value in values)


def triple(values: Iterable[float | str]) -> Vector3:
    """Return three numbers as floats."""
    x, y, z = (float(value) for value in values)
    return (x, y, z)
