"""The last step of a tick: a torque goes over smoothly from the one before, within limits."""

from __future__ import annotations

import math
from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.control.arm import ArmState
from multicontact_control.control.tasks import quintic
from multicontact_control.records import JOINT_LIMITS
from multicontact_control.supervision import bounds
from multicontact_control.supervision.bounds import bound_motion
import numpy as np

# What `gate_torque` returns, added up.
NOT_FINITE, JOINT_STOP, TORQUE, TORQUE_RATE, SINGULAR = 1, 2, 4, 8, 16
NAMES = (('not_finite', NOT_FINITE), ('joint', JOINT_STOP), ('torque', TORQUE),
         ('torque_rate', TORQUE_RATE), ('reach', SINGULAR))
ENFORCED = tuple(tuple(name for name, bit in NAMES if flags & bit) for flags in range(32))
BOUNDING_LIMITS = frozenset(('joint', 'reach'))  # of the motion of the arm
LASTING_LIMITS = BOUNDING_LIMITS | {'torque'}  # that may last: the force laws are told of them
JOINT_MARGIN = 0.02  # rad before its stop, where a joint comes to rest
STEEPEST = 1.875  # largest slope of the quintic from 0 to 1
BLEND_TIME = 0.003  # s, time constant by which a change of active contacts or laws is blended
FADED = 1e-6  # N m in every joint, below which such a difference counts as gone


@compiled
def gate_torque(
    torque: Vector, joints: Any, limits: Any, controls: Any, contacts: Any, mass_matrix: Matrix,
    jacobian: Matrix, bounded: bool, by_task: bool, begun: bool,
) -> int:
    """
    Bring a torque, shape (n,), within its limits; return the sum of those that were enforced.

    `bounded`: the joints are known now, and their motion is limited; `by_task` and the arguments
    before are those of `bound_motion`; `begun`: there was a torque before, which is overwritten.
    """
    enforced, n = 0, torque.shape[0]
    if not np.isfinite(torque).all():
        enforced = NOT_FINITE
        for j in range(n):
            carried = joints[j].bias_torque
            torque[j] = carried if np.isfinite(carried) else 0.0
    if bounded:
        passed = bound_motion(
            torque, joints, limits, controls, contacts, mass_matrix, jacobian, by_task)
        if passed & bounds.STOP:
            enforced |= JOINT_STOP
        if passed & bounds.REACH:
            enforced |= SINGULAR
    for j in range(n):
        joint, limit = joints[j], limits[j]
        clipped = min(max(torque[j], joint.added - joint.torque_limit),
                      joint.added + joint.torque_limit)
        if clipped != torque[j]:
            enforced |= TORQUE
        if begun:
            slowed = min(max(clipped, limit.last - limit.step), limit.last + limit.step)
            if slowed != clipped:
                enforced |= TORQUE_RATE
            clipped = slowed
        torque[j] = clipped
        limit.last = clipped
    return enforced


class TorqueGate:
    """
    Blends and bounds the torque of every tick.

    What is commanded (a start, other gains, a hold) acts with all its gain at once; what it lacks
    of the torque before fades by the `quintic`, as `transition` says. What happens by itself (a
    contact that comes or goes, a reaction) fades with a time constant of 3 ms.

    Then a torque that is not finite is replaced by the one that carries the arm; near a stop,
    above its speed, or near a singular posture the arm brakes (`bound_motion`); the torque is
    clipped to its limits and to their rate. If not `guarded`, motion and rates are not limited.
    `last` is the torque that acts, shape (n,) [N m], `begun` whether there is one.
    """

    def __init__(self, config: ControllerConfig, arm: ArmState, *, guarded: bool = True) -> None:
        self._arm, self._joints = arm, arm.joints
        self._guarded = guarded
        limits: Any = np.zeros(len(self._joints), dtype=JOINT_LIMITS)
        rate = config.limits.torque_rate if guarded else ()
        limits['step'] = np.array(rate or np.inf) * config.period
        limits['speed'] = config.limits.joint_speed or np.inf
        self._stops = (np.array(config.limits.joint_lower or -np.inf),
                       np.array(config.limits.joint_upper or np.inf))
        self._limits, self.last = limits, limits['last']
        self._period = config.period
        self._keep = math.exp(-config.period / BLEND_TIME)
        self.pace = config.transition
        self.reset()
        self.apply(None, np.zeros(len(self._joints)))  # no tick is to wait for numba
        self.reset()

    def reset(self) -> None:
        """Forget the torque that acts."""
        self.begun = self._ranged = False
        self._joints['added'] = self.last[:] = 0.0
        self._end_blend()

    def _set_range(self) -> None:
        """Keep joints a margin off their stops; one that starts beyond it may stay there."""
        (lower, upper), q = self._stops, self._joints['q']
        self._limits['lower'] = np.minimum(lower + JOINT_MARGIN, q)
        self._limits['upper'] = np.maximum(upper - JOINT_MARGIN, q)
        self._ranged = True

    def _end_blend(self) -> None:
        self._law: object = None
        self._pending = False  # whether the next torque is to be the one that acts
        self._slow: Vector | None = None  # what a commanded torque lacks, before it fades
        self._fast: Vector | None = None  # what is left of any other difference

    def begin(self, torque: Vector) -> None:
        """Go over from a torque, shape (n,) [N m], that acts before the first tick."""
        limit, added = self._joints['torque_limit'], self._joints['added']
        self.last[:] = np.clip(torque, added - limit, added + limit)
        self.begun = True
        self.go_over()

    def go_over(self) -> None:
        """Let the next torque be the one that acts: what is commanded is about to jump."""
        self._pending, self._slow, self._fast = self.begun, None, None

    def hurry(self) -> None:
        """Leave what has still to fade slowly to the fast way."""
        if self._pending or self._slow is not None:
            self._end_blend()

    def allow_for(self, added: Vector) -> None:
        """Take in what the drives add to a command [N m], which changes the torque that acts."""
        self.last += added - self._joints['added']
        self._joints['added'] = added

    def apply(
        self, law: object, torque: Vector, *, limited: bool = False, seen: bool = True,
        by_task: bool = False,
    ) -> tuple[Vector, tuple[str, ...]]:
        """
        Let a torque through as far as continuity and the limits allow; name those enforced.

        The torque, shape (n,) [N m], is overwritten. A `law` is anything that differs from others;
        `limited`: it was brought within torque limits already; `seen`: the joints are known now;
        `by_task`: it serves the contacts and the task in the records.
        """
        if self._pending or self._slow is not None or self._fast is not None or law != self._law:
            torque = self._blend(law, torque)
        if seen and not self._ranged:
            self._set_range()
        arm, terms = self._arm, self._arm.robot.terms
        enforced = gate_torque(
            torque, self._joints, self._limits, arm.controls, arm.contacts, terms.mass_matrix,
            terms.jacobian, seen and self._guarded, by_task, self.begun)
        self.begun = True
        return torque, ENFORCED[enforced | TORQUE if limited else enforced]

    def _blend(self, law: object, torque: Vector) -> Vector:
        """Return a torque with what is left of the differences from the ones before."""
        if not np.isfinite(torque).all():
            return torque  # for the limits; a blend waits for a torque that is finite
        if self._pending:
            self._pending, self._slow = False, self.last - torque
            steepest = STEEPEST * float(np.abs(self._slow).max())
            duration = max(self.pace.blend_time, steepest / self.pace.torque_rate)
            self._tick, self._ticks = 0, np.ceil(duration / self._period)
            torque = self.last.copy()
        elif self._slow is not None:
            self._tick += 1
            torque = torque + (1.0 - quintic(self._tick, self._ticks)[0]) * self._slow
            if self._tick >= self._ticks:
                self._slow = None
        if law != self._law and self.begun:
            self._fast = self.last - torque
        elif self._fast is not None:
            self._fast = self._fast * self._keep
            if np.abs(self._fast).max() < FADED:
                self._fast = None
        self._law = law
        return torque if self._fast is None else torque + self._fast
