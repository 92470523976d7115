"""What disturbs the motion: friction as it is measured, and an observer for the rest, compiled."""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.algebra import (
    add_scaled_vector,
    add_vector,
    component_across,
    dot,
    multiply_vector,
    solve_lower,
    vector_between,
    vector_length,
)
from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.contact.wrench import operational_wrench
from multicontact_control.dynamics.operational_space import InertiaSpace
from multicontact_control.dynamics.rotations import rotation_vector_between
from multicontact_control.records import (
    Contact,
    Control,
    Joint,
    MAX_JOINTS,
    Record,
    record_dtype,
    Records,
)

LARGEST_FORCE = 40.0  # N, by which the observer moves the arm at most
LARGEST_TORQUE = 20.0  # N m, likewise
# Error of the motion, off the contacts' normals, up to which its disturbance may grow: an arm
# that is farther from its reference is held by something else than friction.
LARGEST_ERROR = 0.003  # m
LARGEST_ANGLE = 0.03  # rad
# Speeds of the reference and errors up to which nothing is learnt: at rest friction in the joints
# and coarse encoders would make the arm hunt, and slip where it presses on something hard.
REST_SPEED = 0.002  # m/s
REST_TURN = 0.01  # rad/s
REST_ERROR = 0.001  # m
REST_ANGLE = 0.01  # rad
# Largest share of the forces that are pressed with which is taken for friction.
LARGEST_FRICTION = 1.0


class MotionSpace(Record, Protocol):
    """What `observe_motion` and `feed_friction_forward` work in; one."""

    changed_torque: Annotated[Vector, MAX_JOINTS]  # by the gate [N m]
    acceleration: Annotated[Vector, 6]  # [m/s^2, rad/s^2]
    wrench: Annotated[Vector, 6]  # at the operational point [N, N m]


MOTION_SPACE = record_dtype(MotionSpace)


@compiled
def forget_disturbance(control: Control) -> None:
    """Forget what disturbs the motion: something else than the law moves the arm."""
    observer = control.motion_observer
    observer.running = False
    observer.disturbance[:] = 0.0
    observer.friction[:] = 0.0


@compiled
def observe_motion(
    control: Control,
    joints: Records[Joint],
    contacts: Records[Contact],
    inertia: InertiaSpace,
    space: MotionSpace,
) -> None:
    """
    Update the disturbance p of the motion, by an active observer of every direction.

    The twist follows d theta / dt = u(t - T_d) + p with dp/dt = w, as a contact force follows
    P04 eqs 33-34, with constant gains: u is the acceleration that the law answered, changed by
    what the gate made of its torque, p what friction in the joints, a wrong mass or a wrong scale
    of the torques make of it. p grows only while the arm is near its reference, and moves the arm
    by no more than `LARGEST_FORCE`, so that it does not wind up while something holds the arm.

    Parameters
    ----------
    control, joints, contacts
        A record of `CONTROL`, whose `motion_observer` is changed, records of `JOINT`, shape (n,),
        with the law's answer and the command of the tick before, and of `CONTACT`, shape (r,).
    inertia, space
        A record of `INERTIA_SPACE`, of the tick before, and one of `MOTION_SPACE`.

    """
    observer = control.motion_observer
    config = observer.config
    if config.disturbance_gain == 0.0:
        return
    twist = control.frame.twist
    newest = observer.accelerations.shape[0] - 1
    if not observer.running:
        observer.running = True
        observer.twist_est[:] = twist
        observer.accelerations[:] = 0.0
        return
    n = joints.shape[0]
    changed = space.changed_torque[:n]
    if find_changed_torque(joints, changed):
        solve_lower(inertia.L[:n, :n], changed)
        multiply_vector(inertia.Y[:n].T, changed, space.acceleration)
        add_vector(observer.accelerations[newest], space.acceleration)
    acting = observer.accelerations[newest - config.delay]
    innovation = space.acceleration
    for i in range(6):
        acceleration = acting[i] + observer.disturbance[i]
        expected = observer.twist_est[i] + control.law.period * acceleration
        innovation[i] = twist[i] - expected
        observer.twist_est[i] = expected + config.twist_gain * innovation[i]
    correct_disturbance(control, contacts, inertia, innovation, space.wrench)
    for k in range(newest):
        observer.accelerations[k] = observer.accelerations[k + 1]


@compiled
def find_changed_torque(joints: Records[Joint], changed: Vector) -> bool:
    """Fill in what the gate added to the law's torque, shape (n,) [N m]; whether it did."""
    any_changed = False
    for j in range(joints.shape[0]):
        joint = joints[j]
        changed[j] = joint.gate.commanded_torque - joint.answer.unlimited
        any_changed = any_changed or changed[j] != 0.0
    return any_changed


@compiled
def correct_disturbance(
    control: Control,
    contacts: Records[Contact],
    inertia: InertiaSpace,
    innovation: Vector,
    wrench: Vector,
) -> None:
    """
    Correct p by the innovation of the twist, shape (6,), within its bounds.

    It stays at rest, and while a contact is sought: a touch is no disturbance of the motion.
    """
    observer = control.motion_observer
    frame = control.frame
    task = control.task
    gain = observer.config.disturbance_gain
    p = observer.disturbance
    error = vector_between(frame.position, task.position)
    for i in range(contacts.shape[0]):
        if contacts[i].answer.active:
            error = component_across(error, contacts[i].normal)
        elif contacts[i].sought:
            return
    distance = vector_length(error)
    angle = vector_length(rotation_vector_between(task.rotation, frame.rotation))
    if is_at_rest(task.twist, distance, angle):
        return
    if may_grow(p[:3], innovation[:3], distance < LARGEST_ERROR):
        add_scaled_vector(p[:3], gain, innovation[:3])
    if may_grow(p[3:], innovation[3:], angle < LARGEST_ANGLE):
        add_scaled_vector(p[3:], gain, innovation[3:])
    multiply_vector(inertia.Lambda, p, wrench)
    share = min(
        LARGEST_FORCE / max(vector_length(wrench[:3]), LARGEST_FORCE),
        LARGEST_TORQUE / max(vector_length(wrench[3:]), LARGEST_TORQUE),
    )
    for i in range(6):
        p[i] *= share


@compiled
def is_at_rest(twist_des: Vector, distance: float, angle: float) -> bool:
    """Return whether the reference rests, and the arm is at it but for a small error [m, rad]."""
    stands = vector_length(twist_des[:3]) < REST_SPEED
    keeps_still = vector_length(twist_des[3:]) < REST_TURN
    return stands and keeps_still and distance < REST_ERROR and angle < REST_ANGLE


@compiled
def may_grow(disturbance: Vector, innovation: Vector, is_near: bool) -> bool:
    """Return whether a disturbance may follow an innovation: near the reference, or back to 0."""
    return is_near or dot(disturbance, innovation) < 0.0


@compiled
def feed_friction_forward(
    control: Control,
    contacts: Records[Contact],
    force: Vector,
    held: Vector,
    space: MotionSpace,
) -> None:
    """
    Add to the task's force the measured wrench that the contact forces do not explain.

    That is the friction of the contacts, f_c - N alpha_meas, low-passed. The arm bears it as it
    bears N alpha (P04 eq. 24), so that it disturbs neither the motion nor, through Lambda, the
    contact forces. What touches a tool in free space is not fed forward, and in contact no more
    than `LARGEST_FRICTION` of the force that presses.

    Parameters
    ----------
    control, contacts
        A record of `CONTROL`, whose `motion_observer.friction` is changed, and records of
        `CONTACT`, shape (r,).
    force, held
        F and the part of it that goes before the rest at a torque limit, shape (6,) [N, N m].
    space
        A record of `MOTION_SPACE`.

    """
    observer = control.motion_observer
    if observer.config.friction_share == 0.0:
        return
    if control.measured:
        follow_friction(control, contacts, space.wrench)
    add_vector(force, observer.friction)
    add_vector(held, observer.friction)


@compiled
def follow_friction(
    control: Control, contacts: Records[Contact], unexplained: Vector
) -> None:
    """Let the friction follow its measurement by a share of the way."""
    observer = control.motion_observer
    operational_wrench(control, unexplained)
    pressed = 0.0
    for i in range(contacts.shape[0]):
        contact = contacts[i]
        if contact.answer.active:
            reading = contact.alpha_meas + contact.untared
            add_scaled_vector(unexplained, -reading, contact.N)
            if contact.config.leader == i:
                pressed += max(contact.answer.alpha_est, 0.0)
    scale = 1.0
    largest = LARGEST_FRICTION * pressed
    size = vector_length(unexplained[:3])
    if size > largest:
        scale = largest / size
    for i in range(6):
        missing = scale * unexplained[i] - observer.friction[i]
        observer.friction[i] += observer.config.friction_share * missing
