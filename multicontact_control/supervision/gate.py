"""The last step of a tick: a torque goes over smoothly from the one before, within limits."""

from __future__ import annotations

from functools import lru_cache
import math
from typing import Protocol

from multicontact_control.algebra import quintic_blend
from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.config.controller import TransitionConfig
from multicontact_control.control.arm import ArmState
from multicontact_control.dynamics.operational_space import InertiaSpace
from multicontact_control.dynamics.terms import ModelTerms
from multicontact_control.flags import (
    JOINT_BOUNDED,
    REFERENCE_LIMITED,
    SINGULARITY_BOUNDED,
    TORQUE_LIMITED,
    TORQUE_RATE_LIMITED,
    TORQUE_REPLACED,
)
from multicontact_control.records import (
    Contact,
    Control,
    Joint,
    JointConfig,
    Record,
    record_dtype,
    Records,
)
from multicontact_control.supervision.bounds import bound_motion, BoundSpace
import numpy as np

# What a status calls the limits: those of the gate, and that of the task's reference.
LIMIT_NAMES = {
    REFERENCE_LIMITED: 'reference',
    TORQUE_REPLACED: 'not_finite',
    JOINT_BOUNDED: 'joint',
    TORQUE_LIMITED: 'torque',
    TORQUE_RATE_LIMITED: 'torque_rate',
    SINGULARITY_BOUNDED: 'reach',
}
JOINT_MARGIN = 0.02  # rad before its stop, where a joint comes to rest
# 15/8, largest slope of the quintic from 0 to 1, which is in the middle.
STEEPEST = 1.875
# s, time constant with which the difference fades where active contacts or the law change by
# themselves: short, since what has happened is to be answered soon.
LAW_BLEND_TIME = 0.003
FADED = 1e-6  # N m in every joint, below which such a difference counts as gone


class GateConfig(Record, Protocol):
    """What is set for the gate: whether it bounds the motion, and how it blends."""

    guarded: bool  # whether motion and rates are limited

    period: float  # h [s]
    kept_share: float  # of a fading difference, that remains a period later

    # Of a commanded change: see `TransitionConfig`.
    blend_time: float
    blend_rate: float


class GateState(Record, Protocol):
    """The gate: what is set for it, and what it remembers; one."""

    config: GateConfig
    seen: bool  # whether the joints are known now, so that their motion is limited

    begun: bool  # whether a torque acts
    ranged: bool  # whether `lower` and `upper` of the joints are set

    law: int  # what has answered last; see `number_of_law`
    pending: bool  # whether the next torque is to be the one that acts

    blending: bool  # whether `blended_difference` of the joints is still added
    fading: bool  # whether `faded_difference` is

    # Of the blend [periods].
    elapsed: float
    duration: float

    space: BoundSpace  # with the torque on its way through


GATE_STATE = record_dtype(GateState)


@compiled
def number_of_law(contacts: Records[Contact], guarded: bool) -> int:
    """
    Return the number of the control law with these active contacts; 0 without guards.

    It is 1 with a bit for each active contact, so that other contacts make another number.
    """
    if not guarded:
        return 0
    number = 1
    for i in range(contacts.shape[0]):
        if contacts[i].answer.active:
            number += 2 << i
    return number


@compiled
def blend_torque(
    gate: GateState, joints: Records[Joint], law: int, torque: Vector
) -> None:
    """
    Add to a torque, shape (n,), what is left of the differences from the ones before.

    After `start_blend` the output starts at the torque that acts; its difference from the new one
    fades by the quintic. When `law` changes by itself, the difference fades with
    `LAW_BLEND_TIME`.
    """
    n = joints.shape[0]
    for j in range(n):
        if not np.isfinite(torque[j]):
            return  # for the limits; a blend waits for a torque that is finite
    if gate.pending:
        largest = 0.0
        for j in range(n):
            joint = joints[j].gate
            joint.blended_difference = joint.commanded_torque - torque[j]
            largest = max(largest, abs(joint.blended_difference))
            torque[j] = joint.commanded_torque
        duration = max(
            gate.config.blend_time, STEEPEST * largest / gate.config.blend_rate
        )
        gate.pending = False
        gate.blending = True
        gate.elapsed = 0.0
        gate.duration = np.ceil(duration / gate.config.period)
    elif gate.blending:
        gate.elapsed += 1.0
        missing = 1.0 - quintic_blend(gate.elapsed, gate.duration)[0]
        for j in range(n):
            torque[j] += missing * joints[j].gate.blended_difference
        gate.blending = gate.elapsed < gate.duration
    if law != gate.law and gate.begun:
        gate.fading = True
        for j in range(n):
            joint = joints[j].gate
            joint.faded_difference = joint.commanded_torque - torque[j]
    elif gate.fading:
        largest = 0.0
        for j in range(n):
            joint = joints[j].gate
            joint.faded_difference *= gate.config.kept_share
            largest = max(largest, abs(joint.faded_difference))
        gate.fading = largest >= FADED
    gate.law = law
    if gate.fading:
        for j in range(n):
            torque[j] += joints[j].gate.faded_difference


@compiled
def pass_gate(
    gate: GateState,
    joints: Records[Joint],
    control: Control,
    contacts: Records[Contact],
    terms: ModelTerms,
    inertia: InertiaSpace,
    law: int,
) -> int:
    """
    Let the torque of the joints through as far as continuity and the limits allow.

    Parameters
    ----------
    gate, joints, control, contacts
        A record of `GATE_STATE`, records of `JOINT`, shape (n,), whose `gate.commanded_torque`
        becomes what is commanded, a record of `CONTROL`, and records of `CONTACT`, shape (r,).
    terms
        Of the arm's model: M and J are read.
    inertia
        A record of `INERTIA_SPACE`, which a law that answers has filled in.
    law
        What has answered: `number_of_law`, so that contacts and the task are kept as far as
        possible, or a negative number for something else.

    Returns
    -------
    int
        The `LIMITS` that were enforced.

    """
    n = joints.shape[0]
    enforced = 0
    torque = gate.space.torque[:n]
    for j in range(n):
        torque[j] = joints[j].answer.torque
    blend_torque(gate, joints, law, torque)
    if gate.seen and not gate.ranged:
        gate.ranged = True
        for j in range(n):  # a margin off its stops, unless a joint starts beyond it
            joint = joints[j]
            joint.gate.lower = min(joint.config.lower + JOINT_MARGIN, joint.q)
            joint.gate.upper = max(joint.config.upper - JOINT_MARGIN, joint.q)
    finite = True
    for j in range(n):
        finite = finite and np.isfinite(torque[j])
    if not finite:
        enforced = TORQUE_REPLACED
        for j in range(n):
            torque[j] = 0.0
            if np.isfinite(joints[j].bias_torque):
                torque[j] = joints[j].bias_torque
    if gate.seen and gate.config.guarded:
        enforced |= bound_motion(
            joints, control, contacts, terms, law >= 0, inertia, gate.space
        )
    for j in range(n):
        joint = joints[j]
        # The limit holds for the command; the torque here includes what the drives add.
        added = joint.drive_gravity_torque
        last = joint.gate.commanded_torque
        limit = joint.config.torque_limit
        step = joint.config.torque_step
        clipped = min(max(torque[j], added - limit), added + limit)
        if clipped != torque[j]:
            enforced |= TORQUE_LIMITED
        slowed = clipped
        if gate.begun:
            slowed = min(max(clipped, last - step), last + step)
        if slowed != clipped:
            enforced |= TORQUE_RATE_LIMITED
        joint.gate.commanded_torque = slowed
    gate.begun = True
    return enforced


@compiled
def start_blend(gate: GateState) -> None:
    """Let the next torque be the one that acts: what is commanded is about to jump."""
    gate.pending = gate.begun
    gate.blending = False
    gate.fading = False


@compiled
def cancel_blend(gate: GateState) -> None:
    """
    Let the rest of a commanded change fade fast.

    No answer of a guarded law has the number 0, so the next one counts as another law.
    """
    if gate.pending or gate.blending:
        gate.pending = False
        gate.blending = False
        gate.fading = False
        gate.law = 0


@compiled
def begin_torque(gate: GateState, joints: Records[Joint], torque: Vector) -> None:
    """Go over from a torque, shape (n,) [N m], that acts before the first tick, within limits."""
    for j in range(joints.shape[0]):
        joint = joints[j]
        limit = joint.config.torque_limit
        added = joint.drive_gravity_torque
        joint.gate.commanded_torque = min(max(torque[j], added - limit), added + limit)
    gate.begun = True
    start_blend(gate)


@compiled
def update_added_torque(joints: Records[Joint], added: Vector) -> None:
    """
    Take in what the drives add to a command, which changes the torque that acts.

    `added` has shape (n,) [N m]; what is not finite changes nothing.
    """
    for j in range(joints.shape[0]):
        if not np.isfinite(added[j]):
            return
    for j in range(joints.shape[0]):
        joint = joints[j]
        joint.gate.commanded_torque += added[j] - joint.drive_gravity_torque
        joint.drive_gravity_torque = added[j]


@lru_cache(maxsize=256)  # a run meets few of them
def limit_names(found: int) -> tuple[str, ...]:
    """Return the names of the limits that a tick has enforced."""
    return tuple(name for flag, name in LIMIT_NAMES.items() if found & flag)


class TorqueGate:
    """
    Blends and bounds the torque of every tick.

    What is commanded (a start, other gains, a hold) acts with all its gain at once; what it lacks
    of the torque before fades by the quintic, as `transition` says. What happens by itself (a
    contact that comes or goes, a reaction) fades with a time constant of 3 ms.

    Then a torque that is not finite is replaced by the one that carries the arm; near a stop,
    above its speed, or near a singular posture the arm brakes (`bound_motion`); the torque is
    clipped to its limits and to their rate. If not `guarded`, motion and rates are not limited.

    Attributes
    ----------
    records
        One record of `GATE_STATE`.
    last
        The torque that acts, with what the drives add, shape (n,) [N m].

    """

    def __init__(
        self, config: ControllerConfig, arm: ArmState, *, guarded: bool = True
    ) -> None:
        self._joints = arm.joints
        self.records: Records[GateState] = np.zeros(1, dtype=GATE_STATE)
        self._gate = self.records[0]
        settings = self.records['config']
        settings['guarded'] = guarded
        settings['period'] = config.period
        settings['kept_share'] = math.exp(-config.period / LAW_BLEND_TIME)
        joints: Records[JointConfig] = self._joints['config']
        joints['torque_step'] = np.inf
        if guarded and config.limits.torque_rate:
            joints['torque_step'] = np.array(config.limits.torque_rate) * config.period
        joints['gate_speed'] = config.limits.joint_speed or np.inf
        self.last: Vector = self._joints['gate']['commanded_torque']
        self.apply_config(config.transition)
        self.reset()

    def apply_config(self, transition: TransitionConfig) -> None:
        """Set how fast the difference fades after a commanded change."""
        self._gate['config']['blend_time'] = transition.blend_time
        self._gate['config']['blend_rate'] = transition.torque_rate

    def reset(self) -> None:
        """Forget the torque that acts."""
        self._joints['drive_gravity_torque'] = self.last[:] = 0.0
        for name in ('begun', 'ranged', 'law', 'pending', 'blending', 'fading'):
            self._gate[name] = 0

    def start_blend(self) -> None:
        """Let the next torque be the one that acts: what is commanded is about to jump."""
        start_blend(self._gate)

    def update_added_torque(self, added: Vector) -> None:
        """Take in what the drives add to a command [N m], which changes the torque that acts."""
        update_added_torque(self._joints, added)
