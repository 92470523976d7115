"""The control law: motion, forces, contacts, friction, and how one law hands over."""

from __future__ import annotations

from typing import Literal

from multicontact_control.config.base import Config, parameter, Real, UnitVector3, Vector, Vector3


class MotionConfig(Config):
    """The PD motion law (P04 sec. 3.1, 5.2)."""

    natural_frequency: Real = parameter(
        30.0, 'Natural frequency of the motion loop.', unit='rad/s', live=True, gt=0.0, le=200.0)
    damping_ratio: Real = parameter(
        1.0, 'Damping ratio of the motion loop.', live=True, gt=0.0, le=5.0)


class ForceConfig(Config):
    """The force law and its active observer, one per contact (P04 sec. 3.2, 4)."""

    time_constant: Real = parameter(
        0.02, 'Time constant of the dominant closed-loop pole.', unit='s', live=True, gt=0.0)
    second_pole_ratio: Real = parameter(
        1.0, 'Second pole relative to the first, 1 for two equal ones.', live=True, ge=1.0)
    damping_rate: Real = parameter(
        20.0, 'K_2 of eq. 32, damping of the contact motion.', unit='1/s', live=True, ge=0.0)
    input_delay: Real = parameter(
        0.006, 'T_d of eq. 32, from commanded to acting input.', unit='s', ge=0.0)
    process_noise: Real = parameter(
        1e-3, 'Q_k = process_noise I (P04 sec. 5.2).', live=True, gt=0.0)
    initial_covariance: Real = parameter(1e-3, 'P_0 = initial_covariance I.', gt=0.0)
    active_state_order: int = parameter(
        1, 'Order of the active state p_k, 0 for plain pole placement without it.', ge=0, le=3)
    allocation: Literal['decoupled', 'paper'] = parameter(
        'decoupled', 'Force allocation: f_c* = N (N^T N)^-1 alpha* or N alpha* (eq. 30).')
    projection: Literal['euclidean', 'inertia'] = parameter(
        'euclidean', 'Metric of Omega_f and Omega_m: eqs 11-12 or dynamically consistent.')


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
