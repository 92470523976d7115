"""A task made safe to follow: contacts are found first, and held only while they are there."""

from __future__ import annotations

import numpy as np

from multicontact_control.arrays import Mask, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.contact_state import ContactMachine, ContactState
from multicontact_control.control.energy import PassivityObserver
from multicontact_control.control.reference import Reference, TaskSource
from multicontact_control.dynamics.pose import Pose, rotation_error

RETURN_RATE = 2.0  # 1/s, of the way left, at which the task is caught up with after a pause


class ContactReference:
    """
    A reference source that follows a task as far as the contacts and the limits allow.

    Contacts the task asks for are approached along their normals, handed to the force law from
    touch to loss, and sought again; see `ContactMachine`. The pose is bounded: the motion law
    never asks for more than the limits' speeds (k_p times the bounded error is at most k_v times
    the speed), nor to leave the workspace box.

    Parameters
    ----------
    config
        Contacts, motion law, limits.
    task
        What is to be done.

    Attributes
    ----------
    machines, observers
        State machine and passivity observer of each contact.

    """

    def __init__(self, config: ControllerConfig, task: TaskSource) -> None:
        contact_state = task.contact_state(config.contact_state)
        self._config, self._task = config, task
        self.machines = [
            ContactMachine(contact_state, config.period) for _ in config.contact_names]
        self.observers = [
            PassivityObserver(contact_state, config.contacts[name].stiffness, config.period)
            for name in config.contact_names]
        self._points = np.array(
            [config.contacts[name].point_operational for name in config.contact_names])
        motion, limits = config.motion, config.limits
        lead = 2.0 * motion.damping_ratio / motion.natural_frequency  # k_v / k_p [s]
        self._reach = lead * limits.operational_speed
        self._turn = lead * limits.operational_turn
        self._box = (np.array(limits.workspace_lower), np.array(limits.workspace_upper))
        self._pose: Pose | None = None
        self._twist = np.zeros(6)
        self._offset = np.zeros(3)
        self._held_back = False
        self.limited = False

    @property
    def states(self) -> tuple[ContactState, ...]:
        """State of each contact."""
        return tuple(machine.state for machine in self.machines)

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`."""
        self._task.start(pose, normals_world)
        self._normals = normals_world
        for machine, observer in zip(self.machines, self.observers):
            machine.reset()
            observer.reset()
        self._offset = np.zeros(3)
        self._held_back = False
        if self._pose is None:
            self._pose = pose

    def observe(self, pose: Pose, twist_world: Vector) -> None:
        """Take note of where the arm is, before `update`."""
        self._pose, self._twist = pose, twist_world

    def release(self) -> None:
        """Leave all contacts to the motion law; those still touched are taken up again."""
        for machine in self.machines:
            machine.let_go(machine.displacement)

    def resume(self) -> None:
        """Go on after a pause, from where the arm is: no contact counts as held any more."""
        self._offset = np.full(3, np.nan)  # set at the next update
        self._held_back = True

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """Return the reference of one tick; see `ReferenceSource.update`."""
        task = self._task.task(time)
        pose = task.pose_des if self._pose is None else self._pose
        gap = pose.position_world - task.pose_des.position_world
        self._return(gap)
        damping = self._follow_contacts(task, gap - self._offset, alpha_meas, pose)
        active: Mask = np.array([machine.active for machine in self.machines], dtype=bool)
        if self._held_back:  # one tick without: the observers of what is touched start anew
            active, self._held_back = np.zeros_like(active), False
        limits = np.array([machine.force_limit for machine in self.machines])
        alpha_des = np.where(active, np.minimum(task.alpha_des, limits) - damping, 0.0)
        moving = np.array([(0.0, 0.0, 0.0) if machine.active else
                           (machine.displacement, machine.speed, machine.acceleration)
                           for machine in self.machines])
        held = np.array([machine.displacement if machine.active else 0.0
                         for machine in self.machines])
        shift = (moving[:, 0] + held) @ self._normals + self._offset
        twist, acceleration = task.twist_des.copy(), task.acceleration_des.copy()
        twist[:3] += moving[:, 1] @ self._normals
        acceleration[:3] += moving[:, 2] @ self._normals
        return self._bounded(Reference(
            Pose(task.pose_des.position_world + shift, task.pose_des.rotation_world), twist,
            acceleration, active, np.maximum(alpha_des, 0.0)), pose)

    def _return(self, gap: Vector) -> None:
        """Let the offset that a pause has left go to zero."""
        if np.isnan(self._offset[0]):
            # What lies along the normals belongs to the contacts, only the rest is caught up.
            along = np.linalg.lstsq(self._normals.T, gap, rcond=None)[0]
            for machine, place in zip(self.machines, along):
                machine.let_go(float(place))
            self._offset = gap - along @ self._normals
        length = float(np.sqrt(self._offset @ self._offset))
        if length > 0.0:
            speed = min(RETURN_RATE * length, 0.2 * self._config.limits.operational_speed)
            self._offset *= max(1.0 - speed * self._config.period / length, 0.0)
            if length < 1e-6:
                self._offset = np.zeros(3)

    def _follow_contacts(
        self, task: Reference, gap: Vector, alpha_meas: Vector, pose: Pose,
    ) -> Vector:
        """Advance every machine; return the forces that passivity takes from the command."""
        displacements = np.array([machine.displacement for machine in self.machines])
        overlap = self._normals @ self._normals.T
        places = self._normals @ gap - overlap @ displacements + displacements
        speeds = self._normals @ (self._twist[:3] - task.twist_des[:3])
        damping = np.zeros(len(self.machines))
        for i, machine in enumerate(self.machines):
            lever = pose.rotation_world @ self._points[i]
            point_speed = self._twist[:3] + np.array([
                self._twist[4] * lever[2] - self._twist[5] * lever[1],
                self._twist[5] * lever[0] - self._twist[3] * lever[2],
                self._twist[3] * lever[1] - self._twist[4] * lever[0]])
            damping[i] = self.observers[i].update(
                float(alpha_meas[i]), float(self._normals[i] @ point_speed))
            machine.update(bool(task.active[i]), float(alpha_meas[i]), float(task.alpha_des[i]),
                           float(places[i]), float(speeds[i]))
        return damping

    def _bounded(self, reference: Reference, pose: Pose) -> Reference:
        """Return the reference within reach of the speed limits and within the box."""
        position = reference.pose_des.position_world
        rotation = reference.pose_des.rotation_world
        twist, acceleration = reference.twist_des, reference.acceleration_des
        self.limited = False
        if self._box[0].size:
            inside = np.minimum(np.maximum(position, self._box[0]), self._box[1])
            if (inside != position).any():
                outward = (inside != position)
                twist, acceleration = twist.copy(), acceleration.copy()
                twist[:3][outward] = acceleration[:3][outward] = 0.0
                position, self.limited = inside, True
        error = position - pose.position_world
        length = float(np.sqrt(error @ error))
        if length > self._reach:
            position = pose.position_world + error * (self._reach / length)
            twist, acceleration = np.zeros(6), np.zeros(6)
            self.limited = True
        turn = rotation_error(rotation, pose.rotation_world)
        angle = float(np.sqrt(turn @ turn))
        if angle > self._turn:
            rotation = rotation_of(turn * (self._turn / angle)) @ pose.rotation_world
            self.limited = True
        if not self.limited:
            return reference
        return Reference(Pose(position, rotation), twist, acceleration, reference.active,
                         reference.alpha_des)


def rotation_of(vector: Vector) -> Vector:
    """Return the rotation matrix of a rotation vector [rad] (Rodrigues)."""
    angle = float(np.sqrt(vector @ vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: Vector = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
    return rotation
