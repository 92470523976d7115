"""
The input stage: what has come in at a tick, made valid, by one compiled call.

A reading of joints, wrench or R is checked for its stamp, its shape, its numbers and the reading
before it; a wrench is low-passed, too. A reading that fails counts as not received: the newest
valid one stands in for it, and calls for a reaction (`checks.choose_severest_reaction`)
once it is too old.

A fault is called ``<part>_<problem>``; the parts are `joints`, `wrench`, `variance` and `clock`:
`invalid` (no number, or an impossible one), `jump` (a joint is not where its speed has taken it),
`velocity` (positions contradict it, and make up for it, see `velocities`), `frozen` (identical
readings in a row), `saturated` (at full scale), `outlier` (a wrench far from the one before, and
the only one: two in a row are a change), `stamp` (none, in the future, before an earlier
one, or of a wrench that comes more than a period late), `stale` (too old, and nothing newer has
come), and of the clock `backwards` and `rate` (a wrong period twice).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import Controller
from multicontact_control.records import Input, Records
from multicontact_control.supervision.input_checks import (
    ABSENT,
    check_inputs,
    EFFORT_ALWAYS_ZERO,
    EFFORT_MISSING,
    EFFORT_NOT_FINITE,
    EFFORT_USABLE,
    FINE,
    InputSettings,
    INVALID,
    make_input_stage,
    OUTLIER,
    READINGS,
    REPORTED,
    STAMP,
)
from multicontact_control.supervision.velocities import HISTORY_STATES, PROOF_STATES
import numpy as np

PARTS = (*READINGS, 'clock')
PROBLEMS = (  # by their numbers in `input_checks`
    '',
    'invalid',
    'jump',
    'frozen',
    'saturated',
    'stamp',
    'backwards',
    'rate',
    'velocity',
    'outlier',
)
EFFORT_FAULTS = ('', 'missing', 'not finite', 'constantly 0')
WRENCH_SHAPE = (6,)
MALFORMED = (
    TypeError,
    ValueError,
    OverflowError,
)  # raised by numpy for what are no numbers


class JointInput(NamedTuple):
    """
    A joint state as it came in, in the order of `robot.joint_names`.

    Sampled at `stamp`: [s] at a tick, whole [ns] before. q [rad], qd [rad/s], and the torques
    measured over the period before [N m]. qd and torques are None where there are none.
    """

    stamp: float
    q: Any
    qd: Any
    effort: Any = None


class WrenchInput(NamedTuple):
    """A wrench as the sensor gave it [N, N m], sampled at `stamp`: [s] at a tick, [ns] before."""

    stamp: float
    wrench: Any


class VarianceInput(NamedTuple):
    """An R per contact as it came in [N^2]; `stamp` is that of the newest sample in it [s]."""

    stamp: float
    variance: Any


class TickInputs(NamedTuple):
    """
    The newest of each input, however old, at a tick; `time` is on the stamps' clock [s].

    `ahead` is by how much `time` is beyond the newest sample's stamp less the first [s]: what was
    counted on while no sample came.
    """

    time: float
    joints: JointInput | None = None
    wrench: WrenchInput | None = None
    variance: VarianceInput | None = None
    ahead: float = 0.0


class InputVerdict(NamedTuple):
    """What is valid at a tick; the numbers are in the controller's records."""

    causes: tuple[str, ...] = ()  # of a reaction
    rejected: tuple[str, ...] = ()  # what is wrong with the readings of this tick
    joints_known: bool = True  # whether any joint state was ever valid
    blind: bool = (
        False  # whether the joint state is neither of this tick nor of the one before
    )
    wrench_is_current: bool = True  # whether the wrench is of this tick
    skipped_samples: int = 0  # samples that are missing before this tick
    velocities_refuted: bool = (
        False  # whether velocities were refuted, and not proven in motion since
    )
    efforts_unusable: bool = (
        False  # whether the torques of some joints are of no use for a while
    )


ALL_VALID = InputVerdict()


class _Intake:
    """
    Where Python writes what comes in at a tick: one record of `INPUT`.

    Places are held as views, so that a good tick costs a copy of each reading and no more: that a
    reading is there as it should be is only written after a tick at which one was not.

    Parameters
    ----------
    record
        That record, as an array of one.
    joint_count, column_count
        Numbers of a joint state, and of an R.

    Attributes
    ----------
    time, joints_stamp, q, velocity, effort, wrench_stamp, wrench, variance_stamp, variance
        Places, of the joints shape (n,), of R (r,).
    joint_shape, variance_shape
        What these are.
    complete
        Whether all that came before was as it should be.

    """

    def __init__(
        self, record: Records[Input], joint_count: int, column_count: int
    ) -> None:
        self.time, self._command_came = record['time'], record['command_came']
        self._joints_came, self.joints_stamp = (
            record['joints_came'],
            record['joints_stamp'],
        )
        self._velocity_came, self._effort_came = (
            record['velocity_came'],
            record['effort_came'],
        )
        self._wrench_came, self.wrench_stamp = (
            record['wrench_came'],
            record['wrench_stamp'],
        )
        self._variance_came = record['variance_came']
        self.variance_stamp = record['variance_stamp']
        self.joint_shape, self.variance_shape = (joint_count,), (column_count,)
        self.q: Vector = record['q'][0, :joint_count]
        self.velocity: Vector = record['velocity'][0, :joint_count]
        self.effort: Vector = record['effort'][0, :joint_count]
        self._command: Vector = record['command'][0, :joint_count]
        self.wrench: Vector = record['wrench'][0]
        self.variance: Vector = record['variance'][0, :column_count]
        self.complete = False

    def expect_all(self) -> None:
        """Take what is put in from now on for complete."""
        for came in (
            self._joints_came,
            self._velocity_came,
            self._effort_came,
            self._wrench_came,
            self._variance_came,
        ):
            came[0] = FINE
        self.complete = True

    def put(self, inputs: TickInputs, wrench: WrenchInput | None) -> None:
        """Put what has come in its place, and say what is missing or malformed."""
        self.expect_all()
        try:
            self.time[0] = inputs.time
        except MALFORMED:
            self.time[0] = math.nan
        self._put_joints(inputs.joints)
        self._put_wrench(wrench)
        self._put_variance(inputs.variance)

    def _put_joints(self, joints: JointInput | None) -> None:
        """Put a joint state and its torques in their places."""
        if joints is None:
            self._mark(self._joints_came, ABSENT)
            self._mark(self._effort_came, ABSENT)
            return
        shape = self.joint_shape
        if joints.qd is None:
            self._mark(self._velocity_came, ABSENT)
        try:
            self.joints_stamp[0] = joints.stamp
            self.q[...] = _array(joints.q, shape)
            if joints.qd is not None:
                self.velocity[...] = _array(joints.qd, shape)
        except MALFORMED:
            self.q[...] = math.nan
            self._mark(self._joints_came, INVALID)
        if joints.effort is None:
            self._mark(self._effort_came, ABSENT)
            return
        try:
            self.effort[...] = _array(joints.effort, shape)
        except MALFORMED:
            self._mark(self._effort_came, INVALID)

    def _put_wrench(self, wrench: WrenchInput | None) -> None:
        """Put a wrench in its place."""
        if wrench is None:
            self._mark(self._wrench_came, ABSENT)
            return
        try:
            self.wrench_stamp[0] = wrench.stamp
            self.wrench[...] = _array(wrench.wrench, WRENCH_SHAPE)
        except MALFORMED:
            self._mark(self._wrench_came, INVALID)

    def _put_variance(self, variance: VarianceInput | None) -> None:
        """Put an R in its place."""
        if variance is None:
            self._mark(self._variance_came, ABSENT)
            return
        try:
            self.variance_stamp[0] = variance.stamp
            self.variance[...] = _array(variance.variance, self.variance_shape)
        except MALFORMED:
            self.variance[...] = math.nan
            self._mark(self._variance_came, INVALID)

    def put_command(self, command: Vector | None) -> None:
        """Put the command of the tick before in its place, if there was one."""
        self._command_came[0] = command is not None
        if command is not None:
            self._command[...] = command

    def _mark(self, came: Any, what: int) -> None:
        """Say of a reading that it is not there as it should be."""
        came[0] = what
        self.complete = False


def _array(numbers: Any, shape: tuple[int, ...]) -> Any:
    """Return numbers as an array; one of `MALFORMED` is raised if they have not this shape."""
    if type(numbers) is not np.ndarray:
        numbers = np.asarray(numbers)
    if numbers.shape != shape:
        raise ValueError(f'expected shape {shape}, got {numbers.shape}')
    return numbers


class Inputs:
    """
    The input stage of a controller, into whose records goes what is valid.

    If not `guarded`, what comes goes there as it is, valid or not (the wrench behind the low-pass,
    R within its bounds); numbers of a wrong shape are NaN.

    Attributes
    ----------
    raw_wrench, filtered_wrench
        The newest wrench that was no outlier before and behind the low-pass, shape (6,) [N, N m].

    """

    def __init__(
        self,
        config: ControllerConfig,
        controller: Controller,
        *,
        guarded: bool = True,
    ) -> None:
        joints, controls, contacts = (
            controller.arm.joints,
            controller.controls,
            controller.contacts,
        )
        n = len(joints)
        self._stage = make_input_stage(
            config, controller.robot.turning, guarded=guarded
        )
        self._initial = self._stage.copy()
        self._initial_variance = config.initial_noise_variance
        self._by_momentum = config.wrench_input == 'momentum'
        self._by_command = config.collision.command_delay >= 0
        self._joints, self._momentum = joints, controls['momentum']
        self._wrench, self._variance = controls['wrench'][0], contacts['noise_variance']
        q, velocity = controller.arm.motion
        self._arguments = self._stage, q, velocity, joints, controls, contacts
        state, self._found = self._stage['state'][0], self._stage['found'][0]
        self._state, self._velocities = state, state['velocities']
        self._tracks, self._torques = state['tracks'][:n], state['torques'][:n]
        self.raw_wrench: Vector = state['wrenches']['newest']
        self.filtered_wrench: Vector = state['wrenches']['filtered']
        self._intake = _Intake(self._stage['sample'], n, len(contacts))
        self.reset()
        self.validate(TickInputs(0.0))  # no tick is to wait for numba
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next tick is the first."""
        self._stage[:], self._variance[:] = self._initial, self._initial_variance
        for name in ('residual', 'dynamic_threshold', 'effort_uncertainty'):
            self._joints['watch'][name] = 0
        self._momentum['elapsed'], self._momentum['collided'] = 0.0, False

    @property
    def measured_effort(self) -> Vector:
        """Return the torques of the newest joint state, NaN where they say nothing [N m]."""
        measured = self._intake.effort
        heard = (self._joints['watch']['effort_fault'] == EFFORT_USABLE) & (
            measured != 0.0
        )
        effort: Vector = np.where(heard, measured, math.nan)
        return effort

    @property
    def joints_without_effort(self) -> dict[str, tuple[int, ...]]:
        """Return the joints whose torques are of no use, by what is wrong with them."""
        unheard = self._torques['unusable_samples'] >= REPORTED
        faults = np.where(unheard, self._joints['watch']['effort_fault'], EFFORT_USABLE)
        return {
            EFFORT_FAULTS[fault]: tuple(np.flatnonzero(faults == fault).tolist())
            for fault in (EFFORT_MISSING, EFFORT_NOT_FINITE, EFFORT_ALWAYS_ZERO)
            if (faults == fault).any()
        }

    @property
    def wrench_arrived(self) -> bool:
        """Whether a wrench came with this tick, valid or not."""
        return self._found['wrench']['problem'] not in (ABSENT, STAMP, OUTLIER)

    @property
    def sensor_fault(self) -> str:
        """Return what is wrong with the wrench of this tick, empty for nothing."""
        return PROBLEMS[max(self._found['wrench']['problem'], FINE)]

    @property
    def refuted_joints(self) -> Mask:
        """Return whose velocities are refuted, and not proven in motion since, shape (n,)."""
        refuted: Mask = self._tracks['velocity_probation'] > 0
        return refuted

    @property
    def velocities_refuted(self) -> bool:
        """Whether any are."""
        return bool(self._velocities['on_probation'])

    def refute_worst_velocity(self) -> None:
        """Take the velocity that is most in doubt for refuted: what it led to says so."""
        doubt = self._tracks['contradiction']
        worst = int(np.argmax(doubt))
        if np.isfinite(doubt[worst]):
            self._tracks['velocity_probation'][worst] = PROOF_STATES
            self._velocities['on_probation'] = True

    @property
    def estimated_velocity(self) -> Vector:
        """Return the velocities that positions make up for [rad/s]."""
        rate: Vector = self._tracks['v_tracked'].copy()
        return rate

    @property
    def joint_history(self) -> tuple[Matrix, Vector]:
        """Return the newest joint states, shape (k, 2 n) [rad, rad/s], and the doubts of each."""
        count = int(self._velocities['states'])
        newest = np.arange(max(count - HISTORY_STATES, 0), count) % HISTORY_STATES
        q, velocity = self._tracks['past_q'], self._tracks['past_velocity']
        states = np.hstack((q[:, newest].T, velocity[:, newest].T))
        return states, self._tracks['contradiction'].copy()

    def validate(
        self, inputs: TickInputs, command: Vector | None = None
    ) -> InputVerdict:
        """Take in what came at a tick, and the command before it [N m]; say what is valid."""
        _, joints, wrench, variance, _ = inputs
        intake = self._intake
        if self._by_momentum:
            wrench = self._wrench_of_torques(joints)
        try:
            q, velocity, effort = joints.q, joints.qd, joints.effort  # type: ignore[union-attr]
            reading, R = wrench.wrench, variance.variance  # type: ignore[union-attr]
            complete = (
                q.shape == velocity.shape == effort.shape == intake.joint_shape
                and (reading.shape == WRENCH_SHAPE and R.shape == intake.variance_shape)
            )
            if complete:
                intake.time[0] = inputs.time
                intake.joints_stamp[0] = joints.stamp  # type: ignore[union-attr]
                intake.wrench_stamp[0] = wrench.stamp  # type: ignore[union-attr]
                intake.variance_stamp[0] = variance.stamp  # type: ignore[union-attr]
                intake.q[...], intake.velocity[...], intake.effort[...] = (
                    q,
                    velocity,
                    effort,
                )
                intake.wrench[...], intake.variance[...] = reading, R
        except (
            AttributeError,
            *MALFORMED,
        ):  # something is missing, or is no array of numbers
            complete = False
        if not complete:
            intake.put(inputs, wrench)
        elif not intake.complete:
            intake.expect_all()
        if self._by_command:
            intake.put_command(command)
        if check_inputs(*self._arguments):
            return ALL_VALID
        return self._report_faults()

    def recent_wrenches(self, time: float) -> tuple[Matrix, Matrix]:
        """
        Return the wrenches that came with ticks from a time on [s], at most `RECENT_WRENCHES`.

        Shape (k, 6) [N, N m], and the joint velocities then, shape (k, n) [rad/s].
        """
        recent = self._state['recent']
        recent = recent[recent['time'] >= time]
        return recent['wrench'], recent['velocity'][:, : len(self._joints)]

    def _wrench_of_torques(self, joints: JointInput | None) -> WrenchInput | None:
        """Return the wrench that the momentum observer finds; it takes some samples to begin."""
        settings: InputSettings = self._stage['settings'][0]
        if joints is None or self._state['unknown'] > settings['commands'] + 1:
            return None
        return WrenchInput(joints.stamp, self._wrench)

    def _report_faults(self) -> InputVerdict:
        """Return what was found of a tick that is not as it should be."""
        found, causes, rejected = self._found, [], []
        for part in PARTS:
            problem = PROBLEMS[max(found[part]['problem'], FINE)]
            if found[part]['stale']:
                causes.append(f'{part}_{problem or "stale"}')
            if problem and part in READINGS:
                rejected.append(f'{part}_{problem}')
        return InputVerdict(
            tuple(causes),
            tuple(rejected),
            joints_known=bool(self._state['known']),
            blind=bool(found['blind']),
            wrench_is_current=bool(found['wrench']['problem'] == FINE),
            skipped_samples=int(found['skipped']),
            velocities_refuted=self.velocities_refuted,
            efforts_unusable=bool(
                (self._torques['unusable_samples'] >= REPORTED).any()
            ),
        )
