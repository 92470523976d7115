"""
The paper's equations as they stand, in full matrices.

This file imports nothing of what it is held against.
"""

from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation


def contact_normals(normals_world, levers_world):
    """Return N, N_i = [n_i; n_i x l_i] (P04 eq. 5)."""
    return np.vstack([normals_world.T, np.cross(normals_world, levers_world).T])


def free_motions(N):
    """Return T with N^T T = 0 and T^T T = 1 (P04 eqs 4, 6)."""
    U, _, _ = np.linalg.svd(N)
    return U[:, N.shape[1] :]


def contact_coordinates(N, vector):
    """Return N^+ f (P04 eqs 2, 7)."""
    return np.linalg.pinv(N) @ vector


def general_projections(N, T, N_prime, T_prime):
    """Omega_f = N (T'^T N)^-1 T'^T, Omega_m = T (N'^T T)^-1 N'^T (P04 eqs 7-12)."""
    Omega_f = N @ np.linalg.solve(T_prime.T @ N, T_prime.T)
    Omega_m = T @ np.linalg.solve(N_prime.T @ T, N_prime.T)
    return Omega_f, Omega_m


def euclidean_projections(N):
    """Return those of N' = T, T' = N (P04 eqs 11-13)."""
    T = free_motions(N)
    return general_projections(N, T, T, N)


def inertia_projections(N, Lambda):
    """Return those of N' = Lambda T, T' = Lambda^-1 N."""
    T = free_motions(N)
    return general_projections(N, T, Lambda @ T, np.linalg.solve(Lambda, N))


def allocate_force(N, alpha_star, allocation):
    """Return N alpha* (P04 eq. 30), or N (N^T N)^-1 alpha* for `decoupled`."""
    if allocation == 'paper':
        return N @ alpha_star
    return np.linalg.pinv(N).T @ alpha_star


def operational_stiffness(k_env, normal, lever):
    """Return k_s = k_env (1 + |l x n|^2) (P04 eq. 17)."""
    return k_env * (1.0 + np.linalg.norm(np.cross(lever, normal)) ** 2)


def contact_rates(N, twist, allocation):
    """Return N^+ theta, or N^T theta for `decoupled`."""
    if allocation == 'paper':
        return np.linalg.pinv(N) @ twist
    return N.T @ twist


def rotation_error(rotation_des, rotation):
    """Return log(R_des R^T)."""
    return Rotation.from_matrix(rotation_des @ rotation.T).as_rotvec()


def motion_acceleration(config, reference, pose, twist):
    """Return a_des + k_v (theta_des - theta) + k_p (x_des - x) (P04 sec. 3.1)."""
    k_p = config.natural_frequency**2
    k_v = 2.0 * config.damping_ratio * config.natural_frequency
    wanted = reference.pose_des
    position_error = wanted.position_world - pose.position_world
    turn_error = rotation_error(wanted.rotation_world, pose.rotation_world)
    pull = k_p * np.concatenate([position_error, turn_error])
    return reference.acceleration_des + k_v * (reference.twist_des - twist) + pull


def contact_wrench(reading, sensor_pose, position, tool, gravity):
    """Take off bias and weight, turn to world axes, move to the operational point."""
    R = sensor_pose.rotation_world
    force, moment = np.reshape(reading - np.array(tool.bias_sensor), (2, 3))
    weight = tool.mass * gravity
    force = R @ force + weight
    lever_of_weight = R @ np.array(tool.com_sensor)
    moment = R @ moment + np.cross(lever_of_weight, weight)
    lever_of_force = sensor_pose.position_world - position
    return np.concatenate([force, moment + np.cross(lever_of_force, force)])


def operational_space(state, singular_mobility=0.0):
    """
    Lambda = (J M^-1 J^T)^-1, J_bar = M^-1 J^T Lambda, mu and p (P04 eq. 23).

    Lambda^-1 is damped by e_0 / 2 (1 - e / e_0)^2 if its smallest eigenvalue e is below e_0.
    """
    M = state.mass_matrix
    J = state.jacobian
    mobility = J @ np.linalg.solve(M, J.T)
    smallest = np.linalg.eigvalsh(mobility)[0]
    if smallest < singular_mobility:
        depth = 1.0 - smallest / singular_mobility
        mobility += 0.5 * singular_mobility * depth**2 * np.eye(6)
    Lambda = np.linalg.inv(mobility)
    J_bar = np.linalg.solve(M, J.T @ Lambda)
    return SimpleNamespace(
        Lambda=Lambda,
        J_bar=J_bar,
        p=J_bar.T @ state.gravity,
        mu=J_bar.T @ state.coriolis - Lambda @ state.jacobian_drift,
    )


def joint_torque(wrench, state, space, nullspace_damping=0.0, pull=0.0):
    """Return J^T F + (1 - J^T J_bar^T)(C v + g + M (pull - d v)) (P04 sec. 3)."""
    J = state.jacobian
    acceleration = pull - nullspace_damping * state.velocity
    free = state.coriolis + state.gravity + state.mass_matrix @ acceleration
    free_wrench = space.J_bar.T @ free
    return free + J.T @ (wrench - free_wrench)


def posture_pull(q, posture, lower, upper, frequency, margin):
    """Return w^2 (q_0 - q), and 16 w^2 (m - x)^2 / m away from a stop nearer than m."""
    push_up = np.maximum(margin - (q - lower), 0.0) ** 2 / margin
    push_down = np.maximum(margin - (upper - q), 0.0) ** 2 / margin
    return frequency**2 * (posture - q + 16.0 * (push_up - push_down))


def limited_torque(torque, priority, limit, least_share):
    """Scale what goes beyond a priority as far as any joint asks for; cut what is left."""
    over = np.abs(torque) > limit
    if not over.any():
        return torque
    beyond = torque - priority
    side = np.sign(torque)
    has_room = over & (side * priority < limit)
    shares = (side * limit - priority)[has_room] / beyond[has_room]
    share = max(least_share, np.min(shares, initial=1.0))
    return np.clip(priority + share * beyond, -limit, limit)


PREDICTIONS = ([], [1.0], [2.0, -1.0], [3.0, -3.0, 1.0])


class Observer:
    """
    The active observer, with full matrices and P04's own form of the update (eqs 34-41).

    Phi, Gamma, L are those of the delayed plant and its state feedback.
    """

    def __init__(self, Phi, Gamma, L, *, order, process_noise, initial_covariance):
        n = len(Gamma)
        size = n + order
        kept = PREDICTIONS[order]  # weights of p_k-1, p_k-2, ... in p_k
        Phi_p = np.eye(order, k=-1)
        Phi_p[:1] = kept
        self.Phi_n = np.zeros((size, size))
        self.Phi_n[:n, :n] = Phi
        self.Phi_n[n:, n:] = Phi_p
        self.Phi_c = self.Phi_n.copy()
        self.Phi_c[:n, :n] -= np.outer(Gamma, L)
        self.Gamma = np.append(Gamma, np.zeros(order))
        self.feedback = np.append(L, np.zeros(order))
        self.Q = np.zeros((size, size))
        self.Q[:n, :n] = process_noise * np.eye(n)
        if order:
            self.Phi_n[:n, n] = Gamma  # the newest disturbance acts
            self.feedback[n] = 1.0
            self.Q[n, n] = process_noise
        self.P_0 = initial_covariance * np.eye(size)
        self.C = np.eye(size)[:1]
        self.reset(0.0)

    @property
    def force(self):
        return self.x_est[0]

    @property
    def force_rate(self):
        return self.x_est[1]

    def reset(self, force):
        self.x_est = force * self.C[0]
        self.P = self.P_0
        self.r = 0.0
        self.fresh = True
        self.innovation = self.prior_variance = self.variance_used = 0.0

    def update(self, force, variance):
        if self.fresh:
            self.fresh = False
            return
        C = self.C
        x_1 = self.Phi_c @ self.x_est + self.Gamma * self.r
        P_1 = self.Phi_n @ self.P @ self.Phi_n.T + self.Q
        K = P_1 @ C.T / (C @ P_1 @ C.T + variance)
        self.innovation = force - x_1[0]
        self.prior_variance = P_1[0, 0]
        self.variance_used = variance
        self.x_est = x_1 + K[:, 0] * self.innovation
        self.P = P_1 - K @ C @ P_1

    def command(self, force_des):
        self.r = self.feedback[0] * force_des
        return self.r - self.feedback @ self.x_est
