"""The control law of one tick (P04 eqs 23-30), compiled."""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.algebra import (
    add_scaled_vector,
    dot,
    multiply_vector,
    solve_cholesky,
    solve_lower,
)
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.contact.projections import (
    compose_acceleration,
    ContactProjection,
    factorise_contacts,
)
from multicontact_control.contact.surfaces import follow_surfaces
from multicontact_control.control.motion_observer import (
    feed_friction_forward,
    MotionSpace,
)
from multicontact_control.dynamics.operational_space import (
    add_nullspace_torque,
    compute_mobility_and_inertia,
    InertiaSpace,
    NullspaceSpace,
)
from multicontact_control.dynamics.rotations import rotation_vector_between
from multicontact_control.dynamics.terms import ModelTerms
from multicontact_control.flags import (
    COLUMNS_DEPENDENT,
    POSTURE_SINGULAR,
    TORQUE_LIMITED,
)
from multicontact_control.force.force_law import (
    answer_contact_forces,
    ForceLaw,
    ForceSpace,
)
from multicontact_control.records import (
    Contact,
    Control,
    Frame,
    Joint,
    Law,
    MAX_COLUMNS,
    MAX_JOINTS,
    Record,
    record_dtype,
    Records,
    Task,
)
import numpy as np


class LawSpace(Record, Protocol):
    """What `control_law` works in; one."""

    inertia: InertiaSpace
    forces: ForceSpace

    projection: ContactProjection
    nullspace: NullspaceSpace
    motion: MotionSpace

    along: Annotated[Vector, 6]  # Lambda^-1 N_i
    inputs: Annotated[Vector, MAX_COLUMNS]  # u of the force laws [m/s^2]

    # [m/s^2, rad/s^2].
    f_t: Annotated[Vector, 6]
    f_c: Annotated[Vector, 6]

    # That Lambda is applied to; mu + p over Lambda.
    acceleration: Annotated[Vector, 6]
    bias: Annotated[Vector, 6]

    # F, and of that what is fed forward [N, N m].
    force: Annotated[Vector, 6]
    held: Annotated[Vector, 6]

    reduced: Annotated[Vector, MAX_JOINTS]  # L^-1 (C v + g)


LAW_SPACE = record_dtype(LawSpace)


@compiled
def apply_motion_law(law: Law, task: Task, frame: Frame, f_t: Vector) -> None:
    """
    Fill in f_t*, the acceleration that leads the operational point to its reference.

    f_t* = a_des + k_v (theta_des - theta) + k_p (x_des - x), k_p = omega_n^2 and
    k_v = 2 zeta omega_n (P04 sec. 3.1; sec. 5.2: critically damped, 30 rad/s); world axes, shape
    (6,) [m/s^2, rad/s^2].
    """
    turn = rotation_vector_between(task.rotation, frame.rotation)
    for i in range(3):
        f_t[i] = law.k_p * (task.position[i] - frame.position[i])
        f_t[3 + i] = law.k_p * turn[i]
    for i in range(6):
        f_t[i] += task.acceleration[i] + law.k_v * (task.twist[i] - frame.twist[i])


@compiled
def convert_to_coordinates(rows: Matrix, inputs: Vector) -> None:
    """
    Replace u of the contact points by alpha* of the coordinates along N_i, shape (r,) [m/s^2].

    What goes by 1 along N_i takes its contact point N_i^T N_i = 1 + |l x n|^2 into the surface,
    which is then as stiff as k_s = k_env (1 + |l x n|^2) (P04 eq. 17). A force loop for k_s
    commands so much less than one for k_env; Q counts the acceleration of the contact point.
    """
    for i in range(inputs.shape[0]):
        ratio = dot(rows[i], rows[i])
        if ratio > 0.0:  # the contact is active
            inputs[i] /= ratio


@compiled
def apply_force_law(
    law: Law,
    twist: Vector,
    contacts: Records[Contact],
    projection: ContactProjection,
    inputs: Vector,
    f_c: Vector,
) -> None:
    """
    Fill in f_c*, the acceleration that serves the force loops with damping K_2 (P04 eq. 30).

    N alpha* is the paper's: the contact points then accelerate by N^T N alpha*, which couples the
    loops unless N^T N is diagonal. N (N^T N)^-1 alpha*, if `decoupled`, lets contact point i
    accelerate by alpha*_i whatever the geometry. The damping acts on the rates along the
    coordinates that are driven: N^+ theta where theta_c,i multiplies N_i (P04 eq. 16), or N^T
    theta, the speeds of the contact points along their normals, less what is known of the
    surfaces' speeds.

    `twist` is theta of the operational frame, shape (6,) [m/s, rad/s]; N^T of the active contacts
    and the factor of N^T N are in `projection`; `inputs` are u of the contact points or, as
    published, of the coordinates along N_i, shape (r,) [m/s^2].
    """
    count = contacts.shape[0]
    rows = projection.rows[:count]
    factor = projection.factor[:count, :count]
    alpha_star = projection.alpha_star[:count]
    multiply_vector(rows, twist, alpha_star)
    if not law.decoupled:
        solve_cholesky(factor, alpha_star)
    for i in range(count):
        if law.decoupled and contacts[i].answer.active:
            alpha_star[i] -= (
                contacts[i].config.surface_speed + contacts[i].surface_speed_est
            )
        alpha_star[i] = inputs[i] - law.K_2 * alpha_star[i]
    if law.decoupled:
        solve_cholesky(factor, alpha_star)
    multiply_vector(rows.T, alpha_star, f_c)


@compiled
def limit_torque(law: Law, joints: Records[Joint]) -> bool:
    """
    Add the expected friction, then keep to the limits without turning what the task asks for.

    Gamma += F_c tanh(v / v_0) + F_v v, then Gamma_p + s (Gamma - Gamma_p) with the largest s in
    [s_0, 1] within all limits. The priority Gamma_p carries the arm, overcomes its friction and
    presses with the forces that are fed forward; cut joint by joint, the rest would accelerate the
    arm in another direction, into its contacts. What still exceeds is cut: in a joint that Gamma_p
    alone takes beyond its limit, and in one, of the wrist say, for whose sake less than s_0 of the
    task would be left. What is not a number stays that.

    `law` is a record of `LAW`, `joints` are records of `JOINT`, shape (n,), changed. Returns
    whether a limit was enforced.
    """
    n = joints.shape[0]
    share = 1.0
    exceeded = False
    for j in range(n):
        joint = joints[j]
        answer = joint.answer
        config = joint.config
        if config.coulomb != 0.0:
            friction = config.coulomb * np.tanh(joint.velocity / law.friction_speed)
            answer.torque += friction
            answer.priority += friction
        answer.torque += config.viscous * joint.velocity
        answer.priority += config.viscous * joint.velocity
        answer.unlimited = answer.torque
        upper = joint.drive_gravity_torque + config.torque_limit
        lower = joint.drive_gravity_torque - config.torque_limit
        priority = answer.priority
        if answer.torque > upper:
            exceeded = True
            if priority < upper:
                share = min(share, (upper - priority) / (answer.torque - priority))
        elif answer.torque < lower:
            exceeded = True
            if priority > lower:
                share = min(share, (priority - lower) / (priority - answer.torque))
    if not exceeded:
        return False
    share = max(share, law.least_share)
    for j in range(n):
        joint = joints[j]
        answer = joint.answer
        upper = joint.drive_gravity_torque + joint.config.torque_limit
        lower = joint.drive_gravity_torque - joint.config.torque_limit
        answer.torque = answer.priority + share * (answer.torque - answer.priority)
        if answer.torque > upper:
            answer.torque = upper
        elif answer.torque < lower:
            answer.torque = lower
    return True


@compiled
def control_law(
    control: Control,
    joints: Records[Joint],
    terms: ModelTerms,
    contacts: Records[Contact],
    laws: Records[ForceLaw],
    space: LawSpace,
) -> int:
    """
    Work out the joint torque of one tick.

    F = Lambda (Omega_m f_t* + Omega_c f_c*) + mu + p + N alpha_fed_forward, Gamma = J^T F (P04
    eqs 23-27), then null space, friction and limits. As published
    alpha_fed_forward is the estimate; see `choose_fed_force`.

    Parameters
    ----------
    control, joints
        A record of `CONTROL`, and records of `JOINT`, shape (n,), whose torque is filled in.
    terms
        Of the arm's model: M, J and dJ/dt are read.
    contacts, laws
        Records of `CONTACT` and `FORCE_LAW`, both changed, shape (r,).
    space
        A record of `LAW_SPACE`.

    Returns
    -------
    int
        TORQUE_LIMITED if a limit was enforced; POSTURE_SINGULAR or COLUMNS_DEPENDENT if there is
        no answer, and the force laws have not been touched.

    """
    law = control.law
    frame = control.frame
    n = joints.shape[0]
    count = contacts.shape[0]
    inertia = space.inertia
    damping, frame.mobility = compute_mobility_and_inertia(
        terms.mass_matrix, terms.jacobian, law.singular_mobility, inertia
    )
    if damping < 0.0:
        return POSTURE_SINGULAR
    projection = space.projection
    rows = projection.rows[:count]
    weighted_rows = projection.weighted_rows[:count]
    factor = projection.factor[:count, :count]
    weighted_factor = projection.weighted_factor[:count, :count]
    inputs = space.inputs[:count]
    for i in range(count):
        multiply_vector(inertia.mobility, contacts[i].N, space.along)
        contacts[i].mobility = dot(contacts[i].N, space.along)
        rows[i] = 0.0
        if contacts[i].answer.active:
            rows[i] = contacts[i].N
        weighted_rows[i] = rows[i]
        if law.inertia_metric:
            multiply_vector(inertia.mobility, rows[i], weighted_rows[i])
    if not (
        factorise_contacts(contacts, False, rows, rows, factor)
        and factorise_contacts(contacts, False, rows, weighted_rows, weighted_factor)
    ):
        return COLUMNS_DEPENDENT
    observer = control.motion_observer
    apply_motion_law(law, control.task, frame, space.f_t)
    add_scaled_vector(space.f_t, -1.0, observer.disturbance)
    answer_contact_forces(laws, contacts, control, inputs, space.forces)
    if not law.decoupled:
        convert_to_coordinates(rows, inputs)
    apply_force_law(law, frame.twist, contacts, projection, inputs, space.f_c)
    follow_surfaces(frame, contacts)
    acceleration = space.acceleration
    compose_acceleration(projection, count, space.f_t, space.f_c, acceleration)
    observer.accelerations[observer.accelerations.shape[0] - 1] = acceleration
    reduced = space.reduced[:n]  # mu + p = Lambda (J M^-1 (C v + g) - dJ/dt v)
    for j in range(n):
        reduced[j] = joints[j].bias_torque
    solve_lower(inertia.L[:n, :n], reduced)
    multiply_vector(inertia.Y[:n].T, reduced, space.bias)
    for i in range(6):
        for j in range(n):
            space.bias[i] -= terms.jacobian_rate[i, j] * joints[j].velocity
        acceleration[i] += space.bias[i]
    force = space.force
    held = space.held
    multiply_vector(inertia.Lambda, acceleration, force)
    held[:] = 0.0
    for i in range(count):
        add_scaled_vector(force, contacts[i].answer.alpha_fed_forward, rows[i])
        add_scaled_vector(held, contacts[i].answer.alpha_fed_forward, rows[i])
    feed_friction_forward(control, contacts, force, held, space.motion)
    for j in range(n):
        joints[j].answer.torque = 0.0
        joints[j].answer.priority = joints[j].bias_torque
    for i in range(6):
        for j in range(n):
            joints[j].answer.torque += terms.jacobian[i, j] * force[i]
            joints[j].answer.priority += terms.jacobian[i, j] * held[i]
    if n > 6 or damping > 0.0:
        add_nullspace_torque(joints, terms, inertia, law, space.nullspace)
    if limit_torque(law, joints):
        return TORQUE_LIMITED
    return 0
