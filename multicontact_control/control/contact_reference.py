"""A task made safe to follow: contacts are found first, and held only while they are there."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.contact_state import ContactMachine, ContactState
from multicontact_control.control.energy import PassivityObserver
from multicontact_control.control.reference import Reference, TaskSource
from multicontact_control.dynamics.pose import Pose, rotation_error
import numpy as np

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
        self._catching_up = self._held_back = False
        self.limited = False

    @property
    def states(self) -> tuple[ContactState, ...]:
        """State of each contact."""
        return tuple(machine.state for machine in self.machines)

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`."""
        self._task.start(pose, normals_world)
        self._normals = normals_world
        self._normal_lists = normals_world.tolist()
        self._overlap = (normals_world @ normals_world.T).tolist()
        for machine, observer in zip(self.machines, self.observers):
            machine.reset()
            observer.reset()
        self._offset = np.zeros(3)
        self._catching_up = self._held_back = False
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
        self._catching_up = self._held_back = True

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """
        Return the reference of one tick; see `ReferenceSource.update`.

        Written for speed: numbers one by one, as there are few.
        """
        task = self._task.task(time)
        pose = task.pose_des if self._pose is None else self._pose
        gap = pose.position_world - task.pose_des.position_world
        if self._catching_up:
            self._return(gap)
            gap = gap - self._offset
        damping = self._follow_contacts(task, gap, alpha_meas, pose)
        shift, velocity, change = self._offset.tolist(), [0.0] * 3, [0.0] * 3
        alpha_des, active = np.zeros(len(self.machines)), np.zeros(len(self.machines), dtype=bool)
        for i, machine in enumerate(self.machines):
            held = machine.active
            if held and not self._held_back:
                active[i] = True
                alpha_des[i] = max(
                    min(float(task.alpha_des[i]), machine.force_limit) - damping[i], 0.0)
            for axis, component in enumerate(self._normal_lists[i]):
                shift[axis] += machine.displacement * component
                if not held:
                    velocity[axis] += machine.speed * component
                    change[axis] += machine.acceleration * component
        self._held_back = False
        return self._bounded(Reference(
            Pose(task.pose_des.position_world + np.array(shift), task.pose_des.rotation_world),
            task.twist_des + np.array(velocity + [0.0] * 3),
            task.acceleration_des + np.array(change + [0.0] * 3), active, alpha_des), pose)

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
            self._offset, self._catching_up = np.zeros(3), False

    def _follow_contacts(
        self, task: Reference, gap: Vector, alpha_meas: Vector, pose: Pose,
    ) -> list[float]:
        """Advance every machine; return the forces that passivity takes from the command."""
        displacements = [machine.displacement for machine in self.machines]
        places = (self._normals @ gap).tolist()
        speeds = (self._normals @ (self._twist[:3] - task.twist_des[:3])).tolist()
        levers = (self._points @ pose.rotation_world.T).tolist()
        vx, vy, vz, wx, wy, wz = self._twist.tolist()
        wanted, forces, desired = task.active.tolist(), alpha_meas.tolist(), (
            task.alpha_des.tolist())
        damping = []
        for i, machine in enumerate(self.machines):
            nx, ny, nz = self._normal_lists[i]
            lx, ly, lz = levers[i]
            speed = (nx * (vx + wy * lz - wz * ly) + ny * (vy + wz * lx - wx * lz)
                     + nz * (vz + wx * ly - wy * lx))
            damping.append(self.observers[i].update(forces[i], speed))
            others = sum(self._overlap[i][j] * other for j, other in enumerate(displacements)
                         if j != i)
            machine.update(wanted[i], forces[i], desired[i], places[i] - others, speeds[i])
        return damping

    def _bounded(self, reference: Reference, pose: Pose) -> Reference:
        """Return the reference within reach of the speed limits and within the box."""
        position = reference.pose_des.position_world
        rotation = reference.pose_des.rotation_world
        twist, acceleration = reference.twist_des, reference.acceleration_des
        self.limited = False
        if self._box[0].size:
            inside = np.minimum(np.maximum(position, self._box[0]), self._box[1])
            outward = inside != position
            if outward.any():
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
