"""Contacts, and their columns of N: a force each, and the couples of an edge or a plane."""

from __future__ import annotations

from typing import Literal, NamedTuple

from multicontact_control.choices import OptionalLawName
from multicontact_control.config.base import Config, parameter, UnitVector3, Vector3

ContactType = Literal['point', 'edge', 'plane']

# Kinds of columns: a force along the normal, and couples that move it along and across.
FORCE, ALONG, ACROSS = range(3)
KINDS: dict[str, tuple[int, ...]] = {
    'point': (FORCE,),
    'edge': (FORCE, ALONG),
    'plane': (FORCE, ALONG, ACROSS),
}
SUFFIXES = {FORCE: '', ALONG: '/along', ACROSS: '/across'}
# Of the commanded centre of pressure from the centre [half lengths].
LARGEST_OFFSET = 0.8


class ContactConfig(Config):
    """
    One contact: a point, an edge or a plane face of the tool on a surface.

    An edge is pressed with a force and a couple about the axis across it, a plane with a force
    and two couples. Couples are counted in newtons: two forces at the ends of the contact that
    differ by 1 N. The centre of pressure is alpha_couple / alpha half lengths from the centre.
    """

    type: ContactType = parameter(  # noqa: A003 - that is what it is called
        'point', 'What touches: a point, an edge or a plane face of the tool.'
    )
    normal_world: UnitVector3 = parameter(
        ..., 'Unit surface normal INTO the surface, in world axes.', live=True
    )
    point_operational: Vector3 = parameter(
        ...,
        'Contact point, or centre of an edge or plane, in the operational frame.',
        unit='m',
    )
    direction_operational: UnitVector3 = parameter(
        (1.0, 0.0, 0.0), 'Edge, or first side of a plane, in the operational frame.'
    )
    half_length: float = parameter(
        0.05,
        'Half the length of an edge, or of a plane along its direction.',
        unit='m',
        gt=0.0,
    )
    half_width: float = parameter(
        0.05, 'Half the width of a plane across its direction.', unit='m', gt=0.0
    )
    stiffness: float = parameter(
        6000.0, 'Modelled stiffness k_env at the contact.', unit='N/m', gt=0.0
    )
    couple_stiffness: float = parameter(
        0.0,
        'The same for couples, torque per angle and half length squared; 0: stiffness / 3.',
        unit='N/m',
        ge=0.0,
    )
    friction_std: float = parameter(
        0.0,
        'Standard deviation of the friction beyond friction_coefficient that is allowed for '
        'when contact forces are found from the wrench; 0 for none.',
        unit='N',
        ge=0.0,
    )
    friction_coefficient: float = parameter(
        0.0,
        'Expected Coulomb friction along the sliding velocity.',
        live=True,
        ge=0.0,
        le=2.0,
    )
    normal_turn_rate: float = parameter(
        0.0,
        'Largest rate at which the normal turns to the one that the force on a sliding '
        'contact indicates; 0 to keep normal_world. Needs friction_std.',
        unit='rad/s',
        live=True,
        ge=0.0,
        le=10.0,
    )
    normal_range: float = parameter(
        0.6,
        'Largest angle of the normal to normal_world.',
        unit='rad',
        live=True,
        gt=0.0,
        le=1.5,
    )
    tool_turn_limit: float = parameter(
        0.0,
        'Largest angle by which the tool turns out of its task, about a point contact that is '
        'pressed, until tool_axis_operational is along the estimated normal; 0 for none. Needs '
        'normal_turn_rate, at one contact at most.',
        unit='rad',
        live=True,
        ge=0.0,
        le=1.0,
    )
    tool_axis_operational: UnitVector3 = parameter(
        (0.0, 0.0, 1.0),
        'Axis of the tool that goes along the normal there, in the operational frame.',
    )
    surface_speed: float = parameter(
        0.0,
        'Speed of the surface along its normal, away from the robot if positive.',
        unit='m/s',
        live=True,
        ge=-0.5,
        le=0.5,
    )
    surface_speed_limit: float = parameter(
        0.0,
        'Largest estimated speed of the surface beyond that; 0 for no estimate.',
        unit='m/s',
        live=True,
        ge=0.0,
        le=0.5,
    )
    law: OptionalLawName = parameter(
        '', 'Force law of this contact, empty for force.law.'
    )


class Column(NamedTuple):
    """
    One controlled coordinate of a contact, a column of N.

    It is the normal force of its contact, or a couple that moves the centre of pressure.
    """

    name: str
    contact: str  # name
    kind: int  # FORCE, ALONG or ACROSS
    leader: int  # index of the column with the normal force of its contact
    stiffness: float  # modelled, along this coordinate [N/m]
    half_length: float  # unit of a couple's lever, 0 for a force [m]
