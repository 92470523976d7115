"""The control law in plain numpy, as the equations stand: what the compiled one must equal."""

from types import SimpleNamespace

from equations import (
    allocate_force,
    contact_coordinates,
    contact_normals,
    contact_rates,
    contact_wrench,
    euclidean_projections,
    inertia_projections,
    joint_torque,
    limited_torque,
    motion_acceleration,
    Observer,
    operational_space,
    operational_stiffness,
    posture_pull,
)
from multicontact_control.control.controller import LEAST_TASK_SHARE, SINGULAR_MOBILITY
from multicontact_control.force.plant import make_delayed_plant, place_poles
import numpy as np


class ReferenceController:
    """Takes the same arguments as `Controller`."""

    def __init__(self, config, robot, reference):
        self.config = config
        self.robot = robot
        self._reference = reference
        contacts = [config.contacts[name] for name in config.contact_names]
        self._normals_world = np.array([contact.normal_world for contact in contacts])
        self._points_operational = np.array(
            [contact.point_operational for contact in contacts]
        )
        self._gravity_world = np.array(config.robot.gravity_world)
        self._torque_limit = (
            np.array(config.torque_limit)
            if config.torque_limit
            else np.full(robot.joint_count, np.inf)
        )
        none = np.zeros(robot.joint_count)
        self._coulomb = (
            np.array(config.friction.coulomb) if config.friction.coulomb else none
        )
        self._viscous = (
            np.array(config.friction.viscous) if config.friction.viscous else none
        )
        self._observers = []
        self._active = np.zeros(len(self.config.contact_names), dtype=bool)

    def step(self, measurement, noise_variance):
        state = self.robot.update(measurement.q, measurement.qd)
        levers = -self._points_operational @ state.pose.rotation_world.T
        N_all = contact_normals(self._normals_world, levers)
        wrench = contact_wrench(
            measurement.wrench_sensor,
            state.sensor_pose,
            state.pose.position_world,
            self.config.tool,
            self._gravity_world,
        )
        alpha_meas = contact_coordinates(N_all, wrench)
        if not self._observers:
            self._observers = self._design_observers()
            self._start = measurement.q.copy()
            self._reference.start(state.pose, self._normals_world)
        reference = self._reference.task_at(measurement.time, alpha_meas)
        self._follow_active_set(reference.active, alpha_meas)
        space = operational_space(state, singular_mobility=SINGULAR_MOBILITY)
        N = N_all[:, self._active]
        inputs = self._force_inputs(reference, alpha_meas, noise_variance)
        if (
            self.config.force.allocation == 'paper'
        ):  # a loop for k_s commands so much less
            k_s = np.array(
                [
                    operational_stiffness(1.0, normal, lever)
                    for normal, lever in zip(self._normals_world, levers)
                ]
            )
            inputs /= k_s[self._active]
        acceleration = self._acceleration(state, space, reference, N, inputs)
        alpha_est = self._of_active('x_est', 0)
        fed = self._fed_forward(
            N_all, space, alpha_meas, alpha_est, reference.alpha_des
        )
        force = space.Lambda @ acceleration + space.mu + space.p + N @ fed[self._active]
        torque = joint_torque(force, state, space, **self._nullspace(measurement.q))
        friction = self._friction(measurement.qd)
        torque += friction
        priority = (
            state.coriolis
            + state.gravity
            + friction
            + state.jacobian.T @ (N @ fed[self._active])
        )
        return SimpleNamespace(
            torque=limited_torque(
                torque, priority, self._torque_limit, LEAST_TASK_SHARE
            ),
            active=self._active,
            alpha_meas=alpha_meas,
            alpha_des=reference.alpha_des,
            alpha_est=alpha_est,
            alpha_rate_est=self._of_active('x_est', 1),
            **{
                name: self._of_active(name)
                for name in ('innovation', 'prior_variance', 'variance_used')
            },
        )

    def _fed_forward(self, N, space, alpha_meas, alpha_est, alpha_des):
        """Return the contact forces that are fed forward, shape (r,) [N]."""
        force = self.config.force
        if force.fed_forward == 'measured':
            return np.maximum(alpha_meas, 0.0)
        k = np.array(
            [self.config.contacts[name].stiffness for name in self.config.contact_names]
        )
        along = np.diag(N.T @ np.linalg.solve(space.Lambda, N))
        share = {
            'estimate': 0.0,
            'desired': 1.0,
            'mixed': np.minimum(force.damping_rate**2 / (2.0 * k * along), 1.0),
        }[force.fed_forward]
        return alpha_est + share * (alpha_des - alpha_est)

    def _nullspace(self, q):
        """Return damping and pull in the null space, which six joints do not have."""
        config = self.config
        if self.robot.joint_count <= 6:
            return {'nullspace_damping': config.nullspace_damping}
        w, margin, limits = config.posture.natural_frequency, 0.1, config.limits
        lower = np.array(limits.joint_lower or [-np.inf] * len(q))
        upper = np.array(limits.joint_upper or [np.inf] * len(q))
        posture = np.clip(self._start, lower + margin, upper - margin)
        return {
            'nullspace_damping': max(config.nullspace_damping, 2.0 * w),
            'pull': posture_pull(q, posture, lower, upper, w, margin),
        }

    def _friction(self, qd):
        """Return the torque that the joints' friction is expected to take, shape (n,) [N m]."""
        friction = self._coulomb * np.tanh(qd / self.config.friction.speed)
        return friction + self._viscous * qd

    def _design_observers(self):
        """Design one AOB per contact, of the acceleration of its contact point."""
        force = self.config.force
        observers = []
        for name in self.config.contact_names:
            k_env = self.config.contacts[name].stiffness
            h = self.config.period
            loop = place_poles(
                make_delayed_plant(k_env, force.damping_rate, force.input_delay, h),
                h,
                time_constant=force.time_constant,
                second_pole_ratio=force.second_pole_ratio,
            )
            observers.append(
                Observer(
                    loop.plant.Phi,
                    loop.plant.Gamma,
                    loop.L,
                    order=force.active_state_order,
                    process_noise=force.process_noise,
                    initial_covariance=1e-3,
                )
            )
        return observers

    def _follow_active_set(self, active, alpha_meas):
        """Start the observer of every contact that has just become force controlled."""
        for i in np.flatnonzero(active & ~self._active):
            self._observers[i].reset(float(alpha_meas[i]))
        self._active = active.copy()

    def _force_inputs(self, reference, alpha_meas, noise_variance):
        """Return u of every active contact (P04 eq. 36)."""
        inputs = []
        for i in np.flatnonzero(self._active):
            observer = self._observers[i]
            observer.update(float(alpha_meas[i]), float(noise_variance[i]))
            inputs.append(observer.command(float(reference.alpha_des[i])))
        return np.array(inputs)

    def _acceleration(self, state, space, reference, N, inputs):
        """Return Omega_m f_t* + Omega_f f_c* (P04 eq. 27)."""
        force = self.config.force
        _, Omega_m = (
            inertia_projections(N, space.Lambda)
            if (force.projection == 'inertia')
            else euclidean_projections(N)
        )
        f_t = motion_acceleration(
            self.config.motion, reference, state.pose, state.twist_world
        )
        rates = contact_rates(N, state.twist_world, force.allocation)
        alpha_star = inputs - force.damping_rate * rates
        f_c = allocate_force(N, alpha_star, force.allocation)
        return Omega_m @ f_t + f_c - Omega_m @ f_c

    def _of_active(self, name, *index):
        """Return what the observers of the active contacts know, 0 for the others."""
        return np.array(
            [
                np.asarray(getattr(observer, name))[index] if active else 0.0
                for observer, active in zip(self._observers, self._active)
            ]
        )
