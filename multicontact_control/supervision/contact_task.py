"""The task of a controller, between its source and the records that a tick works on."""

from __future__ import annotations

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import ControllerConfig, validate
from multicontact_control.config.supervision import ContactStateConfig
from multicontact_control.control.controller import Controller
from multicontact_control.control.tasks import TaskSource, WantedTask
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.records import Records, Task
from multicontact_control.supervision import contacts
from multicontact_control.supervision.contacts import CONTACT_STATE, ContactState
from multicontact_control.supervision.reference import TASK_LIMITS, TaskLimits
from multicontact_control.supervision.task_limits import (
    hold_task,
    lock_task,
    restart_task,
)
import numpy as np

# How far the reference may be ahead of an arm at rest that cannot follow.
LEAST_LEAD = 0.002  # m
LEAST_TURN = 0.005  # rad
# m and rad that the task is ahead of the arm, off normals, from where a trajectory waits for it.
WAITING_DISTANCE = 0.02
WAITING_ANGLE = 0.1


class ContactTask:
    """
    A task as far as contacts and limits allow it, in the records of a controller.

    In a tick `update_wanted_task` writes what the source wants into `wanted` of the records, of
    which `limit_task` makes the `task` and what is asked of each contact. A hold keeps the arm
    where it is and pressing as it does, a lock keeps it where it is without contact; the time of
    the source stands still meanwhile. If not `guarded`, neither contact states nor limits apply:
    the source makes the contacts.

    Attributes
    ----------
    limits, states
        One record of `TASK_LIMITS`, and records of `CONTACT_STATE`, shape (r,). `tick` sets
        `bounded_at`.

    """

    def __init__(
        self,
        config: ControllerConfig,
        source: TaskSource,
        controller: Controller,
        *,
        guarded: bool = True,
    ) -> None:
        self._source = source
        self._guarded = guarded
        self._controls = controller.controls
        self._columns = controller.contacts
        wanted = self._controls['wanted'][0]
        wanted['rotation'] = np.eye(3)
        self._places = (
            wanted['position'],
            wanted['rotation'],
            wanted['twist'],
            wanted['acceleration'],
            self._columns['wanted'],
            self._columns['alpha_wanted'],
        )
        self._active = self._columns['answer']['active']
        self._names = config.column_names
        self._leaders = np.array(config.force_columns)
        self.states: Records[ContactState] = np.zeros(
            len(config.columns), dtype=CONTACT_STATE
        )
        self._codes = self.states['state']
        self.limits: Records[TaskLimits] = np.zeros(1, dtype=TASK_LIMITS)
        self._held = self.limits['held']
        self._locked = self.limits['locked']
        self._changed = self.limits['changed']
        self._linear_ahead = self.limits['linear']['ahead'][0]
        self._angular_ahead = self.limits['angular']['ahead'][0]
        limits = self.limits['config']
        limits['guarded'] = guarded
        approach = {**config.contact_state.model_dump(), **source.contact_state}
        limits['contacts'] = contacts.contact_settings(
            validate(ContactStateConfig, approach, 'reference.approach'),
            config.period,
            config.measuring_delay,
        )
        limits['lower'] = config.limits.workspace_lower or -np.inf
        limits['upper'] = config.limits.workspace_upper or np.inf
        self.limits['linear']['least_lead'] = LEAST_LEAD
        self.limits['angular']['least_lead'] = LEAST_TURN
        self.apply_config(config)
        self.limits['free_contact'] = contacts.FREE_CONTACT
        self.limits['locked'] = config.sensor.require_push_test  # at first
        self.reset()

    def apply_config(self, config: ControllerConfig) -> None:
        """
        Let the task be so far ahead of the arm that the motion law asks for its limits.

        The momentum observer knows of the tool's inertia; what a wrist sensor feels has it.
        """
        mass = config.tool.mass
        if config.wrench_input == 'momentum':
            mass = 0.0
        motion, limits = config.motion, config.limits
        lead = 2.0 * motion.damping_ratio / motion.natural_frequency  # k_v / k_p
        self.limits['config']['contacts']['tool_mass'] = mass
        self.limits['config']['lead'] = lead
        self.limits['linear']['reach'] = lead * limits.operational_speed
        self.limits['linear']['ramp'] = limits.operational_acceleration
        self.limits['angular']['reach'] = lead * limits.operational_turn
        self.limits['angular']['ramp'] = limits.operational_turn_acceleration

    def reset(self) -> None:
        """Let all contacts start anew, free; a hold ends."""
        restart_task(self.limits[0], self._controls[0], self._columns, self.states)
        self.forget_source()

    def forget_source(self) -> None:
        """Take what stands in the records for what is wanted; the source's time begins."""
        self._lost_time = 0.0
        self._source_time = 0.0
        self.forget_written()

    def forget_written(self) -> None:
        """Write all that the source wants anew: the records ask for something else."""
        self._task: WantedTask | None = None
        self._written: tuple[object, ...] = (None,) * len(self._places)

    def start_source(self, pose: Pose) -> None:
        """Let the source begin from a pose at rest, after the task has been restarted."""
        self.forget_source()
        self._source.start(pose, self._columns['normal'].copy())

    def start_task(self, pose: Pose) -> None:
        """Begin from a pose at rest; a hold ends, a lock does not."""
        self.reset()
        self.start_source(pose)

    def update_wanted_task(self, time: float) -> None:
        """Get what is wanted at a time since the start [s]; see `limit_task`."""
        if self.held or self.locked:
            self._lost_time += time - self._source_time
        else:
            measured = None
            if not self._guarded:
                measured = self._columns['alpha_meas']
            elif self._source.follower is not None:
                self._source.follower.waits = self._is_behind()
            task = self._source.task_at(time - self._lost_time, measured)
            if task is not self._task:
                self._write_wanted(task)
        self._source_time = time

    def _is_behind(self) -> bool:
        """Return whether the arm cannot follow: behind, bounded, or a contact is lost."""
        linear = self._linear_ahead
        angular = self._angular_ahead
        if (
            self.catching_up
            or linear @ linear > WAITING_DISTANCE**2
            or angular @ angular > WAITING_ANGLE**2
        ):
            return True
        losses = self.states['losses']
        if not losses.any():
            return False
        pressed = (self._codes == contacts.IMPACT) | (self._codes == contacts.HOLDING)
        lost = self._columns['wanted'] & (losses > 0) & ~pressed
        return bool(lost[self._leaders].any())

    def reference_pose(self) -> Pose:
        """Return where the reference is, which may be behind the task, without its contacts."""
        if not self._guarded:
            reference: Task | TaskLimits = self._controls['wanted'][0]
        else:
            reference = self.limits[0]
        return Pose(reference['position'].copy(), reference['rotation'].copy())

    @property
    def catching_up(self) -> bool:
        """Whether the reference has still to catch up with the task."""
        return bool(self.limits['catching_up'][0])

    def _write_wanted(self, task: WantedTask) -> None:
        """Write what is new in a task into the records; what is the same object stands there."""
        self._task = task
        parts = (*task.pose_des, *task[1:])
        for place, part, written in zip(self._places, parts, self._written):
            if part is not written:
                place[:] = part
        self._written = parts

    @property
    def seeks(self) -> bool:
        """Whether the source makes contacts of the forces of this sample: it is seen first."""
        return not self._guarded and self._source.seeks

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the state of each contact's normal force."""
        if self._changed[0]:
            self._changed[0] = False
            codes = self._codes[self._leaders].tolist()
            self._state_names = tuple([contacts.STATE_NAMES[code] for code in codes])
        return self._state_names

    @property
    def read_before(self) -> tuple[str, ...]:
        """Return a sentence for each force or couple that was read before anything was touched."""
        readings = self.states['untared'] + self.states['resting_force']
        return tuple(
            f'{name} reads {reading:+.1f} N before it touches: nothing should press, tare'
            for name, reading in zip(self._names, readings.tolist())
            if reading
        )

    @property
    def held(self) -> bool:
        """Whether there is a hold: pose and forces stay."""
        return bool(self._held[0])

    @property
    def locked(self) -> bool:
        """Whether there is a lock: the arm stays where it is without contact."""
        return bool(self._locked[0])

    def set_hold(self, wanted: bool) -> None:
        """Stay where the arm is and press as it does, or go on from there."""
        hold_task(self.limits[0], self._controls[0], self._columns, self.states, wanted)
        if wanted:
            self.forget_written()
        else:
            self.go_on()

    def set_lock(self, wanted: bool) -> None:
        """Stay without contact where the arm is, or starts next; or go on if it is not held."""
        lock_task(self.limits[0], self._controls[0], self._columns, self.states, wanted)
        if wanted or self.held:
            self.forget_written()
        else:
            self.go_on()

    def go_on(self) -> None:
        """Ask the source anew, after a pause; what it follows was stopped with the arm."""
        self.forget_written()
        if self._source.follower is not None:
            self._source.follower.pace = 0.0

    def sought_normals(self) -> Matrix:
        """Return normals of what is sought or held, couples with 0, shape (k, 3)."""
        normals: Matrix = self._columns['normal'][self._codes != contacts.FREE]
        return normals

    def placing_columns(self) -> dict[str, Vector]:
        """Return N_i of what is sought or held, shape (6,), by the force's or couple's name."""
        return self._name_columns((self._codes != contacts.FREE) | self._active)

    def pressed_columns(self) -> dict[str, Vector]:
        """Return N_i of what is pressed, shape (6,), by the force's or couple's name."""
        return self._name_columns(self._active)

    def _name_columns(self, chosen: Mask) -> dict[str, Vector]:
        """Return N_i of some forces and couples, shape (6,), by their names."""
        return {
            name: column['N'].copy()
            for name, column, is_chosen in zip(self._names, self._columns, chosen)
            if is_chosen
        }
