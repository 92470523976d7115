"""A task made safe to follow: contacts are found first, and held only while they are there."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Codes, Mask, Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.config.contact import FORCE
from multicontact_control.control.controller import Controller, place_columns
from multicontact_control.control.reference import Reference, TaskArrays
from multicontact_control.control.reference.holdable import HeldSource
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import turn_between
from multicontact_control.records import CONTACT, CONTACT_REFERENCE, CONTROL, Records
from multicontact_control.supervision.contacts import (
    contact_settings,
    contact_states,
    ContactState,
    FREE,
    GIVEN_UP,
    is_active,
    let_go,
    reset,
    retreat,
    STATES,
)
from multicontact_control.supervision.reference_limits import limit_reference
import numpy as np

NEAR = 2e-4  # m from the task, that count as none
TURNED = 1e-5  # rad, below which the same holds
NEW_TURN = 1e-3  # rad in one period beyond its twist: an orientation that is commanded anew
RETURN_RATE = 2.0  # 1/s, of the way left, at which the task is caught up with after a pause


class ContactReference:
    """
    A reference source that follows a task as far as the contacts and the limits allow.

    Contacts the task asks for are approached along their normals, handed to the force law from
    touch to loss, and sought again; see `supervision.contacts`. Pose and twist are bounded: the
    motion law never asks for more than the limits' speeds (`bound_task`), nor to leave the
    workspace box.

    Parameters
    ----------
    config
        Contacts, motion law, limits.
    task
        What is to be done.
    guarded
        Whether that is so; otherwise the task is asked for as it is.

    Attributes
    ----------
    contact_states
        Records of `CONTACT_STATE`, shape (r,).
    limited
        Whether a limit of the motion was enforced in the last `update`.

    """

    def __init__(
        self, config: ControllerConfig, task: HeldSource, *, guarded: bool = True,
    ) -> None:
        contact_state = task.contact_state(config.contact_state)
        self._config, self._task, self._guarded = config, task, guarded
        self._record: Any = np.zeros(1, dtype=CONTACT_REFERENCE)
        self._record['settings'] = contact_settings(contact_state, config.period)
        self._limits = self._record['limits']
        self._leaders = np.array(config.leaders)
        self.contact_states: Any = contact_states(
            [column.stiffness for column in config.columns],
            [column.kind != FORCE for column in config.columns])
        self._codes: Codes = self.contact_states['state']
        self._wanted = TaskArrays(
            self._record['wanted'], self.contact_states['wanted'], self.contact_states['asked'])
        contacts_alone: Any = np.zeros(len(config.columns), dtype=CONTACT)
        place_columns(config, contacts_alone)
        controls: Any = np.zeros(1, dtype=CONTROL)
        controls['frame']['rotation'] = np.eye(3)
        self._use(controls, contacts_alone)
        self._offset: Vector = self._limits['offset'][0]
        self._turned: Vector = self._limits['turned'][0]
        self.retune(config)
        limits = config.limits
        self._limits['box'] = [limits.workspace_lower or [-np.inf] * 3,
                               limits.workspace_upper or [np.inf] * 3]
        self._observed = self._catching_up = False
        self.limited = False
        self._states: tuple[bytes, tuple[str, ...]] = (b'', ())
        # No tick is to wait for numba.
        let_go(self.contact_states[0], 0.0, 0.0)
        retreat(self.contact_states[0], self._record['settings'][0], 0.0, 0.0)
        self.reset()

    def reset(self) -> None:
        """Let all contacts start anew, free."""
        reset(self.contact_states)
        self._wanted.forget()

    @property
    def states(self) -> tuple[ContactState, ...]:
        """State of each contact, which is that of its normal force."""
        return tuple(STATES[code] for code in self._codes[self._leaders].tolist())

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of these states; the same object as long as none changes."""
        codes = self._codes.tobytes()
        if codes != self._states[0]:
            self._states = codes, tuple(state.value for state in self.states)
        return self._states[1]

    @property
    def state_codes(self) -> Codes:
        """States as `supervision.contacts` counts them, shape (r,)."""
        return self._codes

    @property
    def held(self) -> Mask:
        """Which contacts, and their couples, are held, also while a reaction pauses control."""
        if not self._guarded:
            return self._contacts['active'].astype(bool)
        return np.array([is_active(state) for state in self.contact_states], dtype=bool)

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`."""
        self._task.start(pose, normals_world)
        self._contacts['normal'] = normals_world
        self.reset()
        self._offset[:] = self._turned[:] = 0.0
        self._catching_up = False
        if not self._observed:
            self._note(pose, np.zeros(6))

    def observe(self, pose: Pose, twist_world: Vector) -> None:
        """Take note of where the arm is, before `update`."""
        self._note(pose, twist_world)
        self._observed = True

    def bind(self, controller: Controller) -> None:
        """
        Look at a controller's arm from now on, and make references in its arrays.

        Then `observe` is not needed, and `ask` is `update`.
        """
        self._observed = True
        self._use(controller.controls, controller.contacts)

    def _use(self, controls: Records, contacts: Records) -> None:
        self._controls: Any = controls
        self._contacts: Any = contacts
        self._made = TaskArrays(controls['task'], contacts['active'], contacts['alpha_des'])

    def _note(self, pose: Pose, twist_world: Vector) -> None:
        frame = self._controls['frame']
        frame['position'], frame['rotation'] = pose
        frame['twist'] = twist_world

    def lead_back(self) -> None:
        """
        Leave the contacts that are held, as those beyond their force ceiling are.

        They have led the arm out of its workspace, and would again.
        """
        for state in self.contact_states:
            if is_active(state) and not state['couple']:
                place = state['displacement' if np.isnan(state['origin']) else 'origin']
                retreat(state, self._record['settings'][0], place, 0.0)

    def seek_again(self) -> bool:
        """Seek the contacts that were given up; return whether there are any."""
        given_up = self._codes == GIVEN_UP
        self.contact_states['again'] |= given_up
        return bool(given_up.any())

    def sought_normals(self) -> Matrix:
        """Return the normals of the contacts that are sought or held, shape (k, 3)."""
        sought = [i for i in self._leaders if self._codes[i] != FREE]
        normals: Matrix = self._contacts['normal'][sought]
        return normals

    def retune(self, config: ControllerConfig) -> None:
        """
        Keep to the speed limits with the gains of another configuration.

        The reference may be so far ahead of the arm that the motion law asks for these speeds.
        """
        motion, limits = config.motion, config.limits
        lead = 2.0 * motion.damping_ratio / motion.natural_frequency  # k_v / k_p [s]
        self._limits['lead'] = lead
        self._limits['reach'] = lead * limits.operational_speed
        self._limits['turn'] = lead * limits.operational_turn

    def stand_still(self, pose: Pose) -> Pose:
        """
        Stop looking for contacts, and keep those that are held.

        Returns
        -------
        Pose
            Where the task has to be for the arm to stay at `pose`.

        """
        if not self._guarded:
            return pose
        position = pose.position_world.copy()
        active = self.held
        for state, normal in zip(
                self.contact_states[active], self._contacts['normal'][active]):
            position -= state['displacement'] * normal
        reset(self.contact_states, ~active)
        self._wanted.forget()
        self._offset[:] = self._turned[:] = 0.0
        self._catching_up = False
        return Pose(position, pose.rotation_world)

    def resume(self) -> Mask:
        """
        Go on after a pause, from where the arm is.

        Returns
        -------
        Mask
            Which contacts still count as held: those that were and are felt now, shape (r,).

        """
        self._offset[:] = self._turned[:] = np.nan  # set at the next update
        self._catching_up = True
        held = self.held & (
            self._contacts['alpha_meas'] > self._record['settings']['contact_threshold'])
        self._held: Mask = held[self._contacts['leader']]
        return self._held

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """
        Return the reference of one tick; see `ReferenceSource.update`.

        It is overwritten by the next but for its pose.
        """
        self._contacts['alpha_meas'] = alpha_meas
        self.ask(time)
        return self._made.reference()

    def ask(self, time: float) -> None:
        """Ask for what is wanted at a time of the task [s], as far as it may be asked for."""
        if not self._guarded:
            self._made.take(self._task.update(time, self._contacts['alpha_meas']))
            return
        self._want(time)
        self.limited = limit_reference(
            self._record, self._controls, self._contacts, self.contact_states)

    def _want(self, time: float) -> None:
        """Take in what is wanted at a time of the task [s]."""
        if not self._catching_up:
            self._wanted.take(self._task.task(time))
            return
        wanted = self._record['wanted']
        before, rotation_before = wanted['position'][0].copy(), wanted['rotation'][0].copy()
        self._wanted.take(self._task.task(time))
        # A pose that is commanded anew, and no way that the task goes.
        moved = self._config.period * wanted['twist'][0]
        self._return(wanted['position'][0] - before - moved[:3])
        turn = turn_between(wanted['rotation'][0], rotation_before)
        self._turn_back(turn - moved[3:])
        free = self.contact_states['displacement'][self._codes == FREE]
        self._catching_up = bool(
            self._offset.any() or self._turned.any() or (np.abs(free) > NEAR).any())

    def _turn_back(self, jump: Vector) -> None:
        """Let the rotation that a pause has left go to zero, from where the arm is."""
        turned = self._turned
        if np.isnan(turned[0]) or turned.any() and float(np.abs(jump).max()) > NEW_TURN:
            turned[:] = turn_between(self._controls['frame']['rotation'][0],
                                     self._record['wanted']['rotation'][0])
        angle = float(np.sqrt(turned @ turned))
        if angle < TURNED:
            turned[:] = 0.0
        else:
            speed = min(RETURN_RATE * angle, 0.2 * self._config.limits.operational_turn)
            turned *= max(angle - speed * self._config.period, 0.0) / angle

    def _return(self, jump: Vector) -> None:
        """
        Let the offset that a pause has left go to zero.

        A jump of the task towards where the arm is takes as much off it: the arm is to go from
        there to what is commanded, and not by the whole offset beyond it.
        """
        offset, normals = self._offset, self._contacts['normal']
        if np.isnan(offset[0]):
            # What lies along the normals belongs to the contacts, only the rest is caught up.
            gap = self._controls['frame']['position'][0] - self._record['wanted']['position'][0]
            along = np.linalg.lstsq(normals.T, gap, rcond=None)[0]
            for state, place, held in zip(self.contact_states, along, self._held):
                if held:
                    state['displacement'] = place
                else:
                    let_go(state, float(place), 0.0)
            offset[:] = gap - along @ normals
            jump = np.zeros(3)
        if jump.any():
            along = np.linalg.lstsq(normals.T, jump, rcond=None)[0]
            for state, step in zip(self.contact_states, along.tolist()):
                if state['state'] == FREE:
                    state['displacement'] = _closer(float(state['displacement']), step)
            jump = jump - along @ normals
        length = float(np.sqrt(offset @ offset))
        if length > 0.0:
            left = _closer(length, float(jump @ offset) / length)
            speed = min(RETURN_RATE * left, 0.2 * self._config.limits.operational_speed)
            offset *= max(left - speed * self._config.period, 0.0) / length
        if length < 1e-6:
            offset[:] = 0.0


def _closer(gap: float, step: float) -> float:
    """Return what is left of a gap when its far end comes towards the near one by a step."""
    return gap - min(max(step, min(gap, 0.0)), max(gap, 0.0))
