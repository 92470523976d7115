"""A task made safe to follow: contacts are found first, and held only while they are there."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Codes, Mask, Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.buffers import Buffers
from multicontact_control.control.kernels import ACCELERATION, POSITION, TWIST
from multicontact_control.control.reference import Reference, TaskSource
from multicontact_control.dynamics.pose import Pose
from multicontact_control.supervision.arm_state import ArmState
from multicontact_control.supervision.contact_kernels import CONTACT
from multicontact_control.supervision.contact_state import (
    contact_settings,
    ContactMachine,
    ContactState,
)
from multicontact_control.supervision.gate_kernels import POSTURE
from multicontact_control.supervision.passivity import PassivityObserver
from multicontact_control.supervision.reference_kernels import limit_reference, REFERENCE_LIMITS
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
        self._settings = contact_settings(contact_state, config.period)
        self._contacts = np.zeros(len(config.contact_names), dtype=CONTACT)
        rows = [self._contacts[i:i + 1] for i in range(len(self._contacts))]
        stiffness = [config.contacts[name].stiffness for name in config.contact_names]
        self.machines = [ContactMachine(contact_state, config.period, row, k)
                         for row, k in zip(rows, stiffness)]
        self.observers = [PassivityObserver(contact_state, k, config.period, row)
                          for row, k in zip(rows, stiffness)]
        self._points = np.array(
            [config.contacts[name].point_operational for name in config.contact_names])
        self._normals = np.zeros_like(self._points)
        self._overlap = self._normals @ self._normals.T
        self._wanted: Mask = np.zeros(len(rows), dtype=bool)
        self._desired = np.zeros(len(rows))
        self._limiter = ReferenceLimiter(config)
        self._buffers: Buffers | None = None
        self._posture: Any = np.zeros(1, dtype=POSTURE)
        self._observed = self._catching_up = False
        self.limited = False
        self._codes: Codes = self._contacts['state']
        self._energies: Vector = self._contacts['energy']
        self._states: tuple[bytes, tuple[str, ...]] = (b'', ())
        self._follow(self._desired)  # no tick is to wait for numba
        for machine, observer in zip(self.machines, self.observers):
            machine.reset()
            observer.reset()

    @property
    def states(self) -> tuple[ContactState, ...]:
        """State of each contact."""
        return tuple(machine.state for machine in self.machines)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of these states; the same object as long as none changes."""
        codes = self._codes.tobytes()
        if codes != self._states[0]:
            self._states = codes, tuple(state.value for state in self.states)
        return self._states[1]

    @property
    def state_codes(self) -> Codes:
        """States as `contact_kernels` counts them, which the next tick overwrites, shape (r,)."""
        return self._codes

    @property
    def energies(self) -> Vector:
        """Energy of each contact's passivity observer, shape (r,) [J]."""
        return self._energies.copy()

    @property
    def energy_limits(self) -> Vector:
        """Bound of that energy, shape (r,) [J]."""
        return np.array([observer.limit for observer in self.observers])

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`."""
        self._task.start(pose, normals_world)
        self._normals[:] = normals_world
        self._overlap[:] = normals_world @ normals_world.T
        for machine, observer in zip(self.machines, self.observers):
            machine.reset()
            observer.reset()
        self._limiter.offset[:] = 0.0
        self._catching_up = False
        self._limiter.hold_back(False)
        if not self._observed:
            self._note(pose, np.zeros(6))

    def observe(self, pose: Pose, twist_world: Vector) -> None:
        """Take note of where the arm is, before `update`."""
        self._note(pose, twist_world)
        self._observed = True

    def bind_arm(self, arm: ArmState) -> None:
        """Use what is seen of the arm, from now on, instead of `observe`."""
        self._posture = arm.posture
        self._observed = True

    def bind_buffers(self, buffers: Buffers) -> None:
        """Make references in a controller's arrays: the next overwrites all but its pose."""
        self._buffers = buffers

    def _note(self, pose: Pose, twist_world: Vector) -> None:
        seen = self._posture[0]
        seen['position'], seen['rotation'] = pose
        seen['twist'] = twist_world

    def release(self) -> None:
        """Leave all contacts to the motion law; those still touched are taken up again."""
        for machine in self.machines:
            machine.let_go(machine.displacement)

    def sought_normals(self) -> Matrix:
        """Return the normals of the contacts that are sought or held, shape (k, 3)."""
        sought = [state is not ContactState.FREE for state in self.states]
        normals: Matrix = self._normals[sought]
        return normals

    def retune(self, config: ControllerConfig) -> None:
        """Keep to the speed limits with the gains of another configuration."""
        self._limiter.retune(config)

    def stand_still(self, pose: Pose) -> Pose:
        """
        Stop looking for contacts, and keep those that are held.

        Returns
        -------
        Pose
            Where the task has to be for the arm to stay at `pose`.

        """
        position = pose.position_world.copy()
        for machine, normal in zip(self.machines, self._normals):
            if machine.active:
                position -= machine.displacement * normal
            else:
                machine.reset()
        self._limiter.offset[:] = 0.0
        self._catching_up = False
        return Pose(position, pose.rotation_world)

    def resume(self) -> None:
        """Go on after a pause, from where the arm is: no contact counts as held any more."""
        self._limiter.offset[:] = np.nan  # set at the next update
        self._catching_up = True
        self._limiter.hold_back(True)

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """Return the reference of one tick; see `ReferenceSource.update`."""
        task = self._task.task(time)
        self._limiter.ask(task)
        self._wanted[:] = task.active
        self._desired[:] = task.alpha_des
        if self._catching_up:
            self._return()
        return self._follow(alpha_meas)

    def _follow(self, alpha_meas: Vector) -> Reference:
        """Advance the contacts and return the task with what comes of them."""
        buffers = self._buffers or Buffers(0, len(self.machines))
        pose_des, motion_des = buffers.pose_des, buffers.motion_des
        self.limited = limit_reference(
            self._limiter.record, self._posture, self._contacts, self._settings, self._normals,
            self._points, self._overlap, self._wanted, self._desired, alpha_meas, pose_des,
            motion_des, buffers.active, buffers.alpha_des)
        pose_des = pose_des.copy()
        return Reference(Pose(pose_des[POSITION], pose_des[:POSITION]), motion_des[TWIST],
                         motion_des[ACCELERATION], buffers.active, buffers.alpha_des)

    def _return(self) -> None:
        """Let the offset that a pause has left go to zero."""
        offset = self._limiter.offset
        if np.isnan(offset[0]):
            # What lies along the normals belongs to the contacts, only the rest is caught up.
            gap = self._posture['position'][0] - self._limiter.position_task
            along = np.linalg.lstsq(self._normals.T, gap, rcond=None)[0]
            for machine, place in zip(self.machines, along):
                machine.let_go(float(place))
            offset[:] = gap - along @ self._normals
        length = float(np.sqrt(offset @ offset))
        if length > 0.0:
            speed = min(RETURN_RATE * length, 0.2 * self._config.limits.operational_speed)
            offset *= max(1.0 - speed * self._config.period / length, 0.0)
        if length < 1e-6:
            offset[:] = 0.0
            self._catching_up = False


class ReferenceLimiter:
    """
    The record of `REFERENCE_LIMITS`: bounds, and what the task asks for.

    Parameters
    ----------
    config
        Motion law and limits.

    Attributes
    ----------
    record
        For compiled code, shape (1,).
    offset
        What a pause has left of the way to the task, in the record, shape (3,) [m].
    position_task
        Where the task is, in the record, shape (3,) [m].

    """

    def __init__(self, config: ControllerConfig) -> None:
        limits = config.limits
        self.record: Any = np.zeros(1, dtype=REFERENCE_LIMITS)
        self.retune(config)
        self.record['box'] = [limits.workspace_lower or [-np.inf] * 3,
                              limits.workspace_upper or [np.inf] * 3]
        record = self.record[0]
        self.offset = record['offset']
        self.position_task = record['pose_task'][POSITION]
        self._rotation_task = record['pose_task'][:POSITION]
        self._twist_task, self._acceleration_task = record['motion_task']

    def retune(self, config: ControllerConfig) -> None:
        """Set how far ahead the reference may be, so that the motion law keeps to its speeds."""
        motion, limits = config.motion, config.limits
        lead = 2.0 * motion.damping_ratio / motion.natural_frequency  # k_v / k_p [s]
        self.record['reach'] = lead * limits.operational_speed
        self.record['turn'] = lead * limits.operational_turn

    def ask(self, task: Reference) -> None:
        """Take note of the motion that is asked for."""
        self.position_task[:] = task.pose_des.position_world
        self._rotation_task[:] = task.pose_des.rotation_world
        self._twist_task[:] = task.twist_des
        self._acceleration_task[:] = task.acceleration_des

    def hold_back(self, held_back: bool) -> None:
        """Let no contact be force controlled in the next tick, or let it."""
        self.record['held_back'] = held_back
