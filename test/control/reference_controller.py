"""The control law in plain numpy, as the equations stand: what the compiled one must equal."""

from types import SimpleNamespace

import equations
from multicontact_control.control.controller import LEAST_TASK_SHARE, SINGULAR_MOBILITY
from multicontact_control.force.plant import make_delayed_plant, place_poles
import numpy as np


class ReferenceController:
    """Takes the same arguments as `Controller`."""

    def __init__(self, config, robot, reference):
        self.config = config
        self.robot = robot
        self._reference = reference
        self._contacts = [config.contacts[name] for name in config.contact_names]
        self._normals = np.array([each.normal_world for each in self._contacts])
        self._points = np.array([each.point_operational for each in self._contacts])
        self._torque_limit = np.array(config.torque_limit or [np.inf])
        self._coulomb = np.array(config.friction.coulomb or [0.0])
        self._viscous = np.array(config.friction.viscous or [0.0])
        self._observers = []
        self._active = np.zeros(len(self._contacts), dtype=bool)
        self._contact_friction = np.zeros(6)

    def step(self, measurement, noise_variance):
        config = self.config
        state = self.robot.update(measurement.q, measurement.qd)
        levers = -self._points @ state.pose.rotation_world.T
        N_all = equations.contact_normals(self._normals, levers)
        wrench = equations.contact_wrench(
            measurement.wrench_sensor,
            state.sensor_pose,
            state.pose.position_world,
            config.tool,
            np.array(config.robot.gravity_world),
        )
        alpha_meas = equations.contact_coordinates(N_all, wrench)
        if not self._observers:
            self._observers = self._design_observers()
            self._start = measurement.q.copy()
            self._reference.start(state.pose, self._normals)
        reference = self._reference.task_at(measurement.time, alpha_meas)
        self._follow_active_set(reference.active, alpha_meas)
        space = equations.operational_space(state, SINGULAR_MOBILITY)
        N = N_all[:, self._active]
        inputs = self._force_inputs(reference, alpha_meas, noise_variance)
        if config.force.allocation == 'paper':  # a loop for k_s commands so much less
            k_s = np.diag(N_all.T @ N_all)
            inputs = inputs / k_s[self._active]
        acceleration = self._acceleration(state, space, reference, N, inputs)
        alpha_est = self._of_active('force')
        share = self._share_of_desired(N_all, space)
        fed_forward = alpha_est + share * (reference.alpha_des - alpha_est)
        if config.force.fed_forward == 'measured':
            fed_forward = np.maximum(alpha_meas, 0.0)
        self._follow_contact_friction(wrench - N @ alpha_meas[self._active], alpha_est)
        pressing = N @ fed_forward[self._active] + self._contact_friction
        force = space.Lambda @ acceleration + space.mu + space.p + pressing
        friction = self._friction(measurement.qd)
        torque = friction + equations.joint_torque(
            force, state, space, *self._nullspace(measurement.q)
        )
        carried = state.coriolis + state.gravity + friction
        priority = carried + state.jacobian.T @ pressing
        return SimpleNamespace(
            torque=equations.limited_torque(
                torque, priority, self._torque_limit, LEAST_TASK_SHARE
            ),
            alpha_meas=alpha_meas,
            alpha_des=reference.alpha_des,
            alpha_est=alpha_est,
            alpha_rate_est=self._of_active('force_rate'),
            innovation=self._of_active('innovation'),
            prior_variance=self._of_active('prior_variance'),
            variance_used=self._of_active('variance_used'),
        )

    def _follow_contact_friction(self, unexplained, alpha_est):
        """Low-pass what no contact force explains, up to the size of the forces."""
        size = np.linalg.norm(unexplained[:3])
        largest = np.maximum(alpha_est[self._active], 0.0).sum()
        if size > largest:
            unexplained = unexplained * largest / size
        share = 1.0 - np.exp(-self.config.period / self.config.motion.friction_time)
        self._contact_friction += share * (unexplained - self._contact_friction)

    def _share_of_desired(self, N, space):
        """Return how far what is fed forward goes from the estimated to the desired force."""
        force = self.config.force
        if force.fed_forward == 'desired':
            return 1.0
        if force.fed_forward == 'estimate':
            return 0.0
        k = np.array([contact.stiffness for contact in self._contacts])
        mobility = np.diag(N.T @ np.linalg.solve(space.Lambda, N))
        return np.minimum(force.damping_rate**2 / (2.0 * k * mobility), 1.0)

    def _nullspace(self, q):
        """Return damping and pull in the null space, which six joints do not have."""
        config = self.config
        if self.robot.joint_count <= 6:
            return config.nullspace_damping, 0.0
        w = config.posture.natural_frequency
        margin = 0.1
        lower = np.array(config.limits.joint_lower or [-np.inf])
        upper = np.array(config.limits.joint_upper or [np.inf])
        posture = np.clip(self._start, lower + margin, upper - margin)
        pull = equations.posture_pull(q, posture, lower, upper, w, margin)
        return max(config.nullspace_damping, 2.0 * w), pull

    def _friction(self, qd):
        """Return the torque that the joints' friction is expected to take, shape (n,) [N m]."""
        friction = self._coulomb * np.tanh(qd / self.config.friction.speed)
        return friction + self._viscous * qd

    def _design_observers(self):
        """Design one AOB per contact, of the acceleration of its contact point."""
        force = self.config.force
        h = self.config.period
        observers = []
        for contact in self._contacts:
            plant = make_delayed_plant(
                contact.stiffness, force.damping_rate, force.input_delay, h
            )
            loop = place_poles(
                plant,
                h,
                time_constant=force.time_constant,
                second_pole_ratio=force.second_pole_ratio,
            )
            observer = equations.Observer(
                plant.Phi,
                plant.Gamma,
                loop.L,
                order=force.active_state_order,
                process_noise=force.process_noise,
                initial_covariance=1e-3,
            )
            observers.append(observer)
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
        config = self.config
        allocation = config.force.allocation
        if config.force.projection == 'inertia':
            _, Omega_m = equations.inertia_projections(N, space.Lambda)
        else:
            _, Omega_m = equations.euclidean_projections(N)
        twist = state.twist_world
        f_t = equations.motion_acceleration(config.motion, reference, state.pose, twist)
        rates = equations.contact_rates(N, twist, allocation)
        alpha_star = inputs - config.force.damping_rate * rates
        f_c = equations.allocate_force(N, alpha_star, allocation)
        return Omega_m @ f_t + f_c - Omega_m @ f_c

    def _of_active(self, name):
        """Return what the observers of the active contacts know, 0 for the others."""
        values = np.array([getattr(observer, name) for observer in self._observers])
        return np.where(self._active, values, 0.0)
