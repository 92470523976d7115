"""The control law of one tick (P04 eqs 23-30), compiled."""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import dot, multiply, solve_cholesky, solve_lower
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.contact.projections import compose_acceleration, factorise_contacts
from multicontact_control.contact.surfaces import follow_surfaces
from multicontact_control.dynamics.operational_space import (
    add_nullspace_torque,
    mobility_and_inertia,
)
from multicontact_control.dynamics.rotations import rotation_vector
from multicontact_control.force.force_law import answer_forces
import numpy as np

# What `control_law` returns; LIMITED: a torque limit was enforced.
OK, LIMITED, SINGULAR, DEPENDENT = range(4)


@compiled
def motion_law(law: Any, task: Any, frame: Any, f_t: Vector) -> None:
    """
    Fill in f_t*, the acceleration that leads the operational point to its reference.

    f_t* = a_des + k_v (theta_des - theta) + k_p (x_des - x), k_p = omega_n^2 and
    k_v = 2 zeta omega_n (P04 sec. 3.1; sec. 5.2: critically damped, 30 rad/s); world axes, shape
    (6,) [m/s^2, rad/s^2].
    """
    turn = np.empty(3)
    rotation_vector(task.rotation, frame.rotation, turn)
    f_t[:3], f_t[3:] = law.k_p * (task.position - frame.position), law.k_p * turn
    f_t += task.acceleration + law.k_v * (task.twist - frame.twist)


@compiled
def drive_coordinates(rows: Matrix, inputs: Vector) -> None:
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
def force_law(
    law: Any, rows: Matrix, factor: Matrix, twist: Vector, contacts: Any, inputs: Vector,
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

    N^T of the active contacts is in `rows`, shape (r, 6), N^T N is factorised in `factor`, shape
    (r, r); `inputs` are u of the contact points or, as published, of the coordinates along N_i,
    shape (r,) [m/s^2].
    """
    alpha_star = np.empty(inputs.shape[0])
    multiply(rows, twist, alpha_star)
    if not law.decoupled:
        solve_cholesky(factor, alpha_star)
    for i in range(inputs.shape[0]):
        if law.decoupled and contacts[i].answer.active:
            alpha_star[i] -= contacts[i].config.surface_speed + contacts[i].surface_speed_est
        alpha_star[i] = inputs[i] - law.K_2 * alpha_star[i]
    if law.decoupled:
        solve_cholesky(factor, alpha_star)
    multiply(rows.T, alpha_star, f_c)


@compiled
def finish_torque(law: Any, joints: Any) -> bool:
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
    n, share, exceeded = joints.shape[0], 1.0, False
    for j in range(n):
        joint = joints[j]
        if joint.coulomb != 0.0:
            friction = joint.coulomb * np.tanh(joint.velocity / law.friction_speed)
            joint.torque += friction
            joint.priority += friction
        joint.torque += joint.viscous * joint.velocity
        joint.priority += joint.viscous * joint.velocity
        joint.unlimited = joint.torque
        upper, lower = joint.added + joint.torque_limit, joint.added - joint.torque_limit
        first = joint.priority
        if joint.torque > upper:
            exceeded = True
            if first < upper:
                share = min(share, (upper - first) / (joint.torque - first))
        elif joint.torque < lower:
            exceeded = True
            if first > lower:
                share = min(share, (first - lower) / (first - joint.torque))
    if not exceeded:
        return False
    share = max(share, law.least_share)
    for j in range(n):
        joint = joints[j]
        upper, lower = joint.added + joint.torque_limit, joint.added - joint.torque_limit
        joint.torque = joint.priority + share * (joint.torque - joint.priority)
        if joint.torque > upper:
            joint.torque = upper
        elif joint.torque < lower:
            joint.torque = lower
    return True


@compiled
def control_law(
    controls: Any, joints: Any, mass_matrix: Matrix, jacobian: Matrix, jacobian_rate: Matrix,
    contacts: Any, laws: Any,
) -> int:
    """
    Work out the joint torque of one tick.

    F = Lambda (Omega_m f_t* + Omega_c f_c*) + mu + p + N alpha_fed, Gamma = J^T F (P04
    eqs 23-27), then null space, friction and limits. As published alpha_fed is the estimate; see
    `force_to_feed`.

    Parameters
    ----------
    controls, joints
        One record of `CONTROL`, and records of `JOINT`, shape (n,), whose torque is filled in.
    mass_matrix, jacobian, jacobian_rate
        M (upper triangle), J and dJ/dt.
    contacts, laws
        Records of `CONTACT` and `FORCE_LAW`, both changed, shape (r,).

    Returns
    -------
    int
        OK or LIMITED, or what is wrong; the force laws have not been touched then.

    """
    law, frame, task = controls[0].law, controls[0].frame, controls[0].task
    n, count = joints.shape[0], contacts.shape[0]
    L, Y = np.empty((n, n)), np.empty((n, 6))
    mobility, Lambda = np.empty((6, 6)), np.empty((6, 6))
    damping, frame.mobility = mobility_and_inertia(
        mass_matrix, jacobian, law.singular_mobility, L, Y, mobility, Lambda)
    if damping < 0.0:
        return SINGULAR
    rows, factor = np.zeros((count, 6)), np.empty((count, count))
    weighted_rows, weighted_factor = np.empty((count, 6)), np.empty((count, count))
    along = np.empty(6)
    for i in range(count):
        multiply(mobility, contacts[i].N, along)
        contacts[i].mobility = dot(contacts[i].N, along)
        if contacts[i].answer.active:
            rows[i] = contacts[i].N
        weighted_rows[i] = rows[i]
        if law.inertia_metric:
            multiply(mobility, rows[i], weighted_rows[i])
    if not (factorise_contacts(contacts, False, rows, rows, factor) and factorise_contacts(
            contacts, False, rows, weighted_rows, weighted_factor)):
        return DEPENDENT
    f_t, f_c, acceleration = np.empty(6), np.empty(6), np.empty(6)
    bias, force, inputs = np.empty(6), np.empty(6), np.empty(count)
    motion_law(law, task, frame, f_t)
    answer_forces(laws, contacts, controls[0], inputs)
    if not law.decoupled:
        drive_coordinates(rows, inputs)
    force_law(law, rows, factor, frame.twist, contacts, inputs, f_c)
    follow_surfaces(frame, contacts)
    compose_acceleration(rows, weighted_rows, weighted_factor, f_t, f_c, acceleration)
    reduced = joints['bias_torque'].copy()  # mu + p = Lambda (J M^-1 (C v + g) - dJ/dt v)
    solve_lower(L, reduced)
    multiply(Y.T, reduced, bias)
    for i in range(6):
        for j in range(n):
            bias[i] -= jacobian_rate[i, j] * joints[j].velocity
        acceleration[i] += bias[i]
    multiply(Lambda, acceleration, force)
    held = np.zeros(6)
    for i in range(count):
        contact = contacts[i]
        force += rows[i] * contact.answer.alpha_fed
        held += rows[i] * contact.answer.alpha_fed
    for j in range(n):
        joints[j].torque, joints[j].priority = 0.0, joints[j].bias_torque
    for i in range(6):
        for j in range(n):
            joints[j].torque += jacobian[i, j] * force[i]
            joints[j].priority += jacobian[i, j] * held[i]
    if n > 6 or damping > 0.0:
        add_nullspace_torque(joints, mass_matrix, jacobian, L, Y, Lambda, law)
    return LIMITED if finish_torque(law, joints) else OK
