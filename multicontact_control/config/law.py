"""The control law: motion, contacts, friction, and how one law hands over."""

from __future__ import annotations

from typing import Literal

from multicontact_control.config.base import Config, parameter, Real, UnitVector3, Vector, Vector3
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


class ContactConfig(Config):
    """One point contact."""

    normal_world: UnitVector3 = parameter(
        ..., 'Unit surface normal INTO the surface, in world axes.')
    point_operational: Vector3 = parameter(
        ..., 'Contact point in the operational frame.', unit='m')
    stiffness: Real = parameter(
        6000.0, 'Modelled stiffness k_env at the contact point.', unit='N/m', gt=0.0)
    law: Literal[LawName, ''] = parameter('', 'Force law of this contact, empty for force.law.')


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
