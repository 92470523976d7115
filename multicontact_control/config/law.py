"""The control law: motion, contacts, friction, and how one law hands over."""

from __future__ import annotations

from typing import Literal

from multicontact_control.config.base import Config, parameter, Real, UnitVector3, Vector, Vector3
from multicontact_control.config.columns import ContactType, UNIFORM
from multicontact_control.config.force import LawName


class MotionConfig(Config):
    """The PD motion law (P04 sec. 3.1, 5.2)."""

    natural_frequency: Real = parameter(
        30.0, 'Natural frequency of the motion loop.', unit='rad/s', live=True, gt=0.0, le=200.0)
    damping_ratio: Real = parameter(
        1.0, 'Damping ratio of the motion loop.', live=True, gt=0.0, le=5.0)


class FrictionConfig(Config):
    """Compensation of the joints' friction, which the paper's model does not have."""

    coulomb: Vector = parameter(
        (), 'Coulomb friction added per joint in the direction of its motion; empty for none.',
        unit='N m')
    viscous: Vector = parameter(
        (), 'Viscous friction added per joint; empty for none.', unit='N m s/rad')
    speed: Real = parameter(
        0.02, 'Joint speed at which tanh(v / speed) lets most of the Coulomb friction in.',
        unit='rad/s', live=True, gt=0.0)


class PostureConfig(Config):
    """What an arm with more joints than its task needs does with the rest."""

    natural_frequency: Real = parameter(
        5.0, 'Natural frequency, critically damped, by which joints go to the posture as far as '
        'the operational point does not see it; 0 to damp them only (nullspace_damping).',
        unit='rad/s', live=True, ge=0.0, le=50.0)
    joints: Vector = parameter(
        (), 'The posture; empty for the one the arm starts in.', unit='rad')


class ContactConfig(Config):
    """
    One contact: a point, an edge or a plane face of the tool on a surface.

    An edge is pressed with a force and a couple about the axis across it, a plane with a force
    and two couples. Couples are counted in newtons: that of 1 N is the one by which two forces
    at the ends of the contact, half_length from its centre, differ by 1 N. So the centre of
    pressure is alpha_couple / alpha half lengths from the centre, and stays within the contact
    as long as that is at most 1.
    """

    type: ContactType = parameter(  # noqa: A003 - that is what it is called
        'point', 'What touches: a point, an edge or a plane face of the tool.')
    normal_world: UnitVector3 = parameter(
        ..., 'Unit surface normal INTO the surface, in world axes.', live=True)
    point_operational: Vector3 = parameter(
        ..., 'Contact point, or the centre of an edge or plane, in the operational frame.',
        unit='m')
    direction_operational: UnitVector3 = parameter(
        (1.0, 0.0, 0.0), 'Direction of an edge, or of a first side of a plane, in the '
        'operational frame.')
    half_length: Real = parameter(
        0.05, 'Half the length of an edge, or of a plane along its direction.', unit='m', gt=0.0)
    half_width: Real = parameter(
        0.05, 'Half the width of a plane across its direction.', unit='m', gt=0.0)
    largest_offset: Real = parameter(
        0.8, 'How far from the centre the centre of pressure is commanded at most, relative to '
        'half_length and half_width.', gt=0.0, le=1.0)
    stiffness: Real = parameter(
        6000.0, 'Modelled stiffness k_env at the contact.', unit='N/m', gt=0.0)
    couple_stiffness: Real = parameter(
        0.0, 'The same for couples, torque per angle and half length squared; 0 for a third of '
        'stiffness, as of a contact that is equally stiff everywhere.', unit='N/m', ge=0.0)
    friction_std: Real = parameter(
        0.0, 'Standard deviation of the friction that is allowed for when the wrench is taken '
        'apart, so that it is not taken for a normal force; 0 for none.', unit='N', ge=0.0)
    friction_coefficient: Real = parameter(
        0.0, 'Coulomb friction that is expected along the sliding velocity when the wrench is '
        'taken apart; friction_std is then that of what differs from it.', live=True, ge=0.0,
        le=2.0)
    normal_turn_rate: Real = parameter(
        0.0, 'How fast the normal may turn to where the force on a sliding contact says that it '
        'is; 0 to keep to normal_world. Not more than is needed: what slips at the touch turns it '
        'as fast. Needs friction_std.', unit='rad/s', live=True, ge=0.0, le=10.0)
    normal_range: Real = parameter(
        0.6, 'How far from normal_world it may turn.', unit='rad', live=True, gt=0.0, le=1.5)
    surface_speed: Real = parameter(
        0.0, 'Speed of the surface along its normal, away from the robot if positive; K_2 damps '
        'the motion relative to it.', unit='m/s', live=True, ge=-0.5, le=0.5)
    surface_speed_limit: Real = parameter(
        0.0, 'Largest speed beyond that which is estimated; 0 to not estimate it.', unit='m/s',
        live=True, ge=0.0, le=0.5)
    law: Literal[LawName, ''] = parameter('', 'Force law of this contact, empty for force.law.')

    @property
    def stiffness_of_couples(self) -> float:
        """Return the stiffness along the couples' coordinates [N/m]."""
        return self.couple_stiffness or UNIFORM * self.stiffness


class TransitionConfig(Config):
    """How the torque gets from one law to another: at a start, a stop and a live change."""

    blend_time: Real = parameter(
        0.2, 'Shortest time for the difference between two laws to fade.', unit='s', live=True,
        ge=0.0, le=10.0)
    torque_rate: Real = parameter(
        100.0, 'Largest rate at which it fades, in any joint.', unit='N m/s', live=True, gt=0.0)


class SafeBehaviourConfig(Config):
    """What is commanded after a deactivation."""

    kind: Literal['gravity_compensation', 'zero_torque', 'hold_position'] = parameter(
        'gravity_compensation', 'Gravity compensation with damping, no torque at all, or the '
        'posture held.', live=True)
    damping_rate: Real = parameter(
        5.0, 'Damping of the joints over their inertia, with gravity compensation.', unit='1/s',
        live=True, ge=0.0, le=100.0)
    hold_frequency: Real = parameter(
        10.0, 'Natural frequency of the critically damped joints, with the posture held.',
        unit='rad/s', live=True, gt=0.0, le=100.0)
