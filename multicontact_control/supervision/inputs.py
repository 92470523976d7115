"""
The input stage: what has come in at a tick, made valid, by one compiled call.

A reading of joints, wrench or R is checked for its stamp, its shape, its numbers and the reading
before it; a wrench is low-passed, too. A reading that fails counts as not received: the newest
valid one stands in for it, and calls for a reaction (`causes.choose_severest_reaction`)
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

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import Controller
from multicontact_control.supervision.causes import (
    find_input_causes,
    name_causes,
    PROBLEMS,
)
from multicontact_control.supervision.input_checks import (
    ABSENT,
    check_inputs,
    EFFORT_ALWAYS_ZERO,
    EFFORT_MISSING,
    EFFORT_NOT_FINITE,
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

EFFORT_FAULTS = ('', 'missing', 'not finite', 'constantly 0')
NOT_THERE: Any = object()  # stands for numbers that have not come
MALFORMED = (TypeError, ValueError, OverflowError)  # numpy's, of what are no numbers


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
    """What is valid of a tick; the numbers themselves are in the controller's records."""

    causes: tuple[str, ...] = ()  # of a reaction
    rejected: tuple[str, ...] = ()  # what is wrong with the readings of this tick
    joints_known: bool = True  # whether any joint state was ever valid
    efforts_unusable: bool = False  # whether those of some joints are, for a while


ALL_VALID = InputVerdict()


def _write_reading(place: Vector, numbers: Any) -> int:
    """Write the numbers of a reading to their place, NaN if they do not fit; return what came."""
    if numbers is NOT_THERE:
        return ABSENT
    try:
        if np.shape(numbers) == place.shape:
            place[:] = numbers
            return FINE
    except MALFORMED:
        pass
    place[:] = math.nan
    return INVALID


class Inputs:
    """
    The input stage of a controller: it writes what is valid into the controller's records.

    If not `guarded`, what comes goes there as it is, valid or not (the wrench behind the low-pass,
    R within its bounds); numbers of a wrong shape become NaN.

    Attributes
    ----------
    stages
        One record of `INPUT_STAGE`.
    raw_wrench, filtered_wrench
        The newest wrench that is no outlier, before and behind the low-pass, shape (6,) [N, N m].

    """

    def __init__(
        self,
        config: ControllerConfig,
        controller: Controller,
        *,
        guarded: bool = True,
    ) -> None:
        joints, contacts = controller.arm.joints, controller.contacts
        joint_count = len(joints)
        stage = make_input_stage(config, controller.robot.turning, guarded=guarded)
        self.stages = stage
        self._initial_stage = stage.copy()
        self._initial_variance = config.initial_noise_variance
        self._by_momentum = config.wrench_input == 'momentum'
        self._by_command = config.collision.command_delay >= 0
        self._joints = joints
        self._momentum = controller.controls['momentum']
        self._wrench = controller.controls['wrench'][0]
        self._variance = contacts['noise_variance']
        q, velocity = controller.arm.motion
        self._arguments = stage, q, velocity, joints, controller.controls, contacts
        self._state = stage['state'][0]
        self._found = stage['found'][0]
        self._velocities = self._state['velocities']
        self._tracks = self._state['tracks'][:joint_count]
        self._torques = self._state['torques'][:joint_count]
        self.raw_wrench: Vector = self._state['wrenches']['newest']
        self.filtered_wrench: Vector = self._state['wrenches']['filtered']
        # Where Python writes what comes in; views, so that a tick copies each reading and no more.
        sample = stage['sample']
        self._time = sample['time']
        self._joints_stamp = sample['joints_stamp']
        self._wrench_stamp = sample['wrench_stamp']
        self._variance_stamp = sample['variance_stamp']
        self._effort = sample['effort'][0, :joint_count]
        self._command_came = sample['command_came']
        self._command = sample['command'][0, :joint_count]
        self._places = (
            (sample['joints_came'], sample['q'][0, :joint_count]),
            (sample['velocity_came'], sample['velocity'][0, :joint_count]),
            (sample['effort_came'], self._effort),
            (sample['wrench_came'], sample['wrench'][0]),
            (sample['variance_came'], sample['variance'][0, : len(contacts)]),
        )
        self.reset()
        self.validate(TickInputs(0.0))  # no tick is to wait for numba
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next tick is the first."""
        self.stages[:] = self._initial_stage
        self._variance[:] = self._initial_variance
        for name in ('residual', 'dynamic_threshold', 'effort_uncertainty'):
            self._joints['watch'][name] = 0
        self._momentum['elapsed'] = 0.0
        self._momentum['collided'] = False

    @property
    def joints_without_effort(self) -> dict[str, tuple[int, ...]]:
        """Return the joints whose torques have been of no use, by what is wrong with them."""
        unusable = self._torques['unusable_samples'] >= REPORTED
        found = self._joints['watch']['effort_fault']
        joints = {}
        for fault in (EFFORT_MISSING, EFFORT_NOT_FINITE, EFFORT_ALWAYS_ZERO):
            of_fault = np.flatnonzero(unusable & (found == fault))
            if of_fault.size:
                joints[EFFORT_FAULTS[fault]] = tuple(of_fault.tolist())
        return joints

    @property
    def wrench_arrived(self) -> bool:
        """Whether a wrench came with this tick, valid or not."""
        return self._found['wrench']['problem'] not in (ABSENT, STAMP, OUTLIER)

    @property
    def wrench_age(self) -> float:
        """Return how long ago the newest valid wrench was sampled [s]; NaN if there was none."""
        return float(self._state['time'] - self._state['wrench']['valid'])

    @property
    def sensor_fault(self) -> str:
        """Return what is wrong with the wrench of this tick, empty for nothing or a short gap."""
        return self._name_problem('wrench')

    def _name_problem(self, part: str) -> str:
        """Return what is wrong with a part, `stale` where nothing valid has come for too long."""
        finding = self._found[part]
        if finding['problem'] <= FINE and not finding['stale']:
            return ''
        return PROBLEMS[max(finding['problem'], FINE)]

    @property
    def velocities_refuted(self) -> bool:
        """Whether any velocity was refuted by positions, and not proven in motion since."""
        return bool(self._velocities['on_probation'])

    def refute_worst_velocity(self) -> None:
        """Take the most contradicted velocity for refuted: a collision that it led to says so."""
        contradiction = self._tracks['contradiction']
        worst = int(np.argmax(contradiction))
        if np.isfinite(contradiction[worst]):
            self._tracks['velocity_probation'][worst] = PROOF_STATES
            self._velocities['on_probation'] = True

    @property
    def joint_history(self) -> tuple[Matrix, Vector]:
        """
        Return the newest joint states, and how far positions contradict each velocity.

        Oldest first, shape (k, 2 n) [rad, rad/s], and shape (n,), above 1 for a contradiction.
        """
        count = int(self._velocities['states'])
        newest = np.arange(max(count - HISTORY_STATES, 0), count) % HISTORY_STATES
        q = self._tracks['past_q'][:, newest]
        velocity = self._tracks['past_velocity'][:, newest]
        return np.hstack((q.T, velocity.T)), self._tracks['contradiction'].copy()

    def validate(
        self, inputs: TickInputs, command: Vector | None = None
    ) -> InputVerdict:
        """
        Take in what came at a tick, and write what is valid into the controller's records.

        Parameters
        ----------
        inputs
            The newest readings. Numbers that are missing, of a wrong shape or no numbers at all
            count as invalid.
        command
            What was commanded at the tick before, shape (n,) [N m]; None for nothing.

        Returns
        -------
        InputVerdict
            `ALL_VALID` itself if nothing is wrong.

        """
        time, joints, wrench, variance, _ = inputs
        if self._by_momentum:
            wrench = self._wrench_of_torques(joints)
        q = velocity = effort = forces = variances = NOT_THERE
        self._time[0] = time
        if joints is not None:
            self._joints_stamp[0], q, velocity, effort = joints
        if velocity is None:
            velocity = NOT_THERE
        if effort is None:
            effort = NOT_THERE
        if wrench is not None:
            self._wrench_stamp[0], forces = wrench
        if variance is not None:
            self._variance_stamp[0], variances = variance
        readings = (q, velocity, effort, forces, variances)
        for (came, place), numbers in zip(self._places, readings):
            came[0] = _write_reading(place, numbers)
        if self._by_command:
            self._command_came[0] = command is not None
            if command is not None:
                self._command[:] = command
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
        settings: InputSettings = self.stages['settings'][0]
        if joints is None or self._state['unknown'] > settings['commands'] + 1:
            return None
        return WrenchInput(joints.stamp, self._wrench)

    def _report_faults(self) -> InputVerdict:
        """Return what was found of a tick that is not as it should be."""
        rejected = []
        for part in READINGS:
            finding = self._found[part]
            if finding['problem'] > FINE:
                rejected.append(f'{part}_{PROBLEMS[finding["problem"]]}')
        unusable = self._torques['unusable_samples'] >= REPORTED
        return InputVerdict(
            name_causes(find_input_causes(self._found)),
            tuple(rejected),
            joints_known=bool(self._state['known']),
            efforts_unusable=bool(unusable.any()),
        )
