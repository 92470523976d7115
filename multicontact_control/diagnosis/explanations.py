"""What the readings say about the cause of a reaction, when one begins or a report asks."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.contact.wrench import operational_wrench
from multicontact_control.control.controller import Controller
from multicontact_control.diagnosis.collisions import explain_collision
from multicontact_control.diagnosis.efforts import explain_unwatched
from multicontact_control.diagnosis.friction import undeclared_friction
from multicontact_control.diagnosis.gravity import explain_gravity
from multicontact_control.diagnosis.late_wrench import explain_lag
from multicontact_control.diagnosis.sensor_axes import explain_axes
from multicontact_control.diagnosis.velocities import explain_velocities
from multicontact_control.supervision.causes import (
    COLLISION,
    JOINTS_VELOCITY,
    NAMES,
    WRENCH_PULL,
    WRENCH_SIDEWAYS,
    WRENCH_STRAY,
)
from multicontact_control.supervision.contact_task import ContactTask
from multicontact_control.supervision.inputs import Inputs
import numpy as np

STRAY_TORQUE = 0.5  # N m at the operational point that is worth a report
STANDING_SPEED = 0.01  # rad/s, of every joint, below which an arm stands
WRENCH_STALE = 'wrench_stale'
CONTRADICTED = NAMES[WRENCH_PULL], NAMES[WRENCH_STRAY], NAMES[WRENCH_SIDEWAYS]
DOUBTED = (
    'Held by estimates from the positions until ten readings of such joints in motion '
    'agree, or an operator resumes control (~/retry)'
)


def _have_collision(causes: tuple[str, ...]) -> bool:
    """Return whether one of some causes is a collision."""
    return any(cause.startswith(NAMES[COLLISION]) for cause in causes)


class Explanations:
    """
    Explains causes of reactions by the records of a controller; changes nothing.

    Whatever it returns is a sentence, empty where nothing is known. If not `guarded`, nothing is
    said of stray forces: the wrench is used as it comes.
    """

    def __init__(
        self,
        controller: Controller,
        inputs: Inputs,
        task: ContactTask,
        *,
        guarded: bool,
    ) -> None:
        self._controller = controller
        self._inputs = inputs
        self._task = task
        self._guarded = guarded
        self._joints = controller.arm.joints
        self._control = controller.controls[0]

    def explain_causes(self, causes: tuple[str, ...]) -> tuple[str, ...]:
        """Return a sentence for each cause that has just begun and that has one."""
        return tuple(filter(None, map(self._explain, causes)))

    def _explain(self, cause: str) -> str:
        """Return a sentence for a cause; empty if it has none."""
        if cause == WRENCH_STALE:
            return self._wrench_outage()
        if cause in CONTRADICTED:
            return self._sensor_axes() or self.stray_force()
        collides = cause.startswith(NAMES[COLLISION])
        if collides or cause == NAMES[JOINTS_VELOCITY]:
            velocity = self._velocities()
            if velocity:
                return f'{velocity}. {DOUBTED}'
        if collides:
            return self._collision()
        return ''

    def _wrench_outage(self) -> str:
        """Return since when no wrench has come, and what to look at."""
        age = self._inputs.wrench_age
        if np.isnan(age):
            return 'No wrench has come since the start: is its driver running?'
        return (
            f'The newest valid wrench is {1e3 * age:.0f} ms old: its driver has stopped, or '
            'its messages come late or not at all'
        )

    def _collision(self) -> str:
        """Return what speaks for the cause of a collision, and what is felt at the tool."""
        residual = self._sensor_axes()
        if not residual:
            residual = explain_collision(
                self._joints,
                self._control['momentum'],
                self._controller.config.robot.joint_names,
            )
        stray = self.stray_force()
        if stray:
            return f'{residual}; {stray}'
        return residual

    def _velocities(self) -> str:
        """Return what the newest positions say against the velocities."""
        config = self._controller.config
        states, doubt = self._inputs.joint_history
        return explain_velocities(
            states, doubt, config.robot.joint_names, config.period
        )

    def comes_of_velocities(self, causes: tuple[str, ...]) -> bool:
        """Return whether a collision is what the law made of velocities that are wrong."""
        return _have_collision(causes) and self._velocities() != ''

    def _sensor_axes(self) -> str:
        """Return what says that the axes of the wrench sensor are others."""
        if not self._wrench_is_read:
            return ''
        control = self._control
        return explain_axes(
            self._joints,
            control['momentum'],
            self._controller.robot.terms.jacobian,
            control['frame']['sensor_rotation'],
            control['tool']['weight'],
        )

    @property
    def _wrench_is_read(self) -> bool:
        """Whether the wrench is of this sample and of a sensor."""
        return bool(self._control['measured']) and (
            self._controller.config.wrench_input != 'momentum'
        )

    def explain_other_gravity(self, causes: tuple[str, ...]) -> str:
        """Return what says that gravity is another, where a collision has led to a pause."""
        arm = self._controller.arm
        tool = self._controller.tool
        if not _have_collision(causes) or not self._wrench_is_read:
            return ''
        stands = np.abs(arm.velocity).max() < STANDING_SPEED
        if not stands or self._seeks_contact:
            return ''
        force = self._wrench()[:3]
        gravity = np.array(self._controller.config.robot.gravity_world)
        shares = self._controller.robot.compute_gravity_shares(arm.q.copy(), tool)
        return explain_gravity(self._joints, shares, force, tool.mass, gravity)

    @property
    def _seeks_contact(self) -> bool:
        """Whether any contact is sought or held."""
        return bool(self._task.sought_normals().size)

    def _wrench(self) -> Vector:
        """Return the wrench at the operational point, world axes, shape (6,) [N, N m]."""
        wrench = np.zeros(6)
        operational_wrench(self._control, wrench)
        return wrench

    def stray_force(self) -> str:
        """Return what is felt while no contact is sought or held; empty if it is small."""
        if not (self._guarded and self._wrench_is_read) or self._seeks_contact:
            return ''
        wrench = self._wrench()
        force = np.linalg.norm(wrench[:3])
        torque = np.linalg.norm(wrench[3:])
        smallest = self._controller.config.contact_state.smallest_force
        if force <= smallest and torque <= STRAY_TORQUE:
            return ''
        return (
            f'{force:.1f} N and {torque:.2g} N m while no contact is commanded: if nothing '
            'touches the tool, bias or tool weight (tare or calibrate)'
        )

    def explain_late_wrench(self) -> str:
        """Return what says that the wrench comes late, once a collision has passed."""
        return explain_lag(self._joints)

    def explain_unwatched_joints(self) -> str:
        """Return whose measured torques are of no use, and what that leads to."""
        return explain_unwatched(
            self._controller.config, self._inputs.joints_without_effort
        )

    def explain_friction(self) -> str:
        """Return which joints show friction that is not declared."""
        names = self._controller.config.robot.joint_names
        return '; '.join(undeclared_friction(self._joints, names))
