"""
The control law and its supervision in one compiled call, from what the task wants to the gate.

Contact states and limits of the reference, the law, plausibility of its answer, and the gate,
unless something is to be decided before it.
"""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Matrix
from multicontact_control.compiled import compile_for, compiled
from multicontact_control.control.controller import Controller
from multicontact_control.control.law import control_law, limit_torque, OK
from multicontact_control.records import Records
from multicontact_control.supervision.checks import (
    check_plausibility,
    NOT_FINITE,
    PULL,
    SIDEWAYS,
)
from multicontact_control.supervision.gate import gate_torque, TORQUE, TorqueGate
from multicontact_control.supervision.reference_limits import limit_reference
import numpy as np

# What `supervised_law` returns beside what `check_plausibility` does, added up: a limit of the
# motion was enforced; the torque is through the gate; and this times the limits enforced there.
REFERENCE, PASSED, GATE = 16, 32, 64


@compiled
def supervised_law(
    supervisions: Any, controls: Any, joints: Any, mass_matrix: Matrix, jacobian: Matrix,
    jacobian_rate: Matrix, contacts: Any, laws: Any, states: Any, limits: Any,
) -> int:
    """
    Answer a task that may be asked for with a torque that may be commanded.

    Parameters
    ----------
    supervisions
        One record of `SUPERVISION`.
    controls, joints, mass_matrix, jacobian, jacobian_rate, contacts, laws
        As for `control_law`.
    states, limits
        Records of `CONTACT_STATE`, changed, shape (r,), and `JOINT_LIMITS`, shape (n,); `last` of
        these is the torque behind the gate.

    Returns
    -------
    int
        The sum of what there is to say, or what `control_law` finds wrong, negative. Without
        PASSED the torque has not gone through the gate, it is in the joints: it is not settled, a
        contact has come or gone, or something speaks against the answer.

    """
    supervision, control = supervisions[0], controls[0]
    count, n = contacts.shape[0], joints.shape[0]
    was_active = np.empty(count, np.bool_)
    for i in range(count):
        was_active[i] = contacts[i].active
    found = REFERENCE if limit_reference(supervision.reference, control, contacts, states) else 0
    status = control_law(
        controls, joints, mass_matrix, jacobian, jacobian_rate, contacts, laws)
    if status != OK:
        return -status
    found |= check_plausibility(supervision.plausibility, control, joints, contacts, states)
    settled = supervision.settled and not found & (NOT_FINITE | PULL | SIDEWAYS)
    for i in range(count):
        settled = settled and contacts[i].active == was_active[i]
        states[i].stiffness = contacts[i].stiffness
    if not settled:
        return found
    torque, fallback, gated = np.empty(n), np.empty(n), np.empty(n)
    for j in range(n):
        torque[j] = joints[j].torque
        fallback[j] = joints[j].bias_torque
    # What is settled is known and started; numba would compile the gate once more for constants.
    enforced = TORQUE if limit_torque(joints, control.law.least_share, torque) else 0
    enforced |= gate_torque(torque, fallback, joints, settled, limits, settled, gated)
    return found | PASSED | GATE * enforced


class SupervisedLaw:
    """
    That call, with the arrays that it works on.

    Parameters
    ----------
    record
        One record of `SUPERVISION`.
    controller, states, gate
        The law, records of `CONTACT_STATE`, shape (r,), and the gate.

    """

    def __init__(
        self, record: Records, controller: Controller, states: Records, gate: TorqueGate,
    ) -> None:
        self._controller, self._terms = controller, controller.robot.terms
        self._controls, self._joints = controller.controls, controller.arm.joints
        self._contacts, self._states = controller.contacts, states
        self._record, self._limits = record, gate.limits
        self._settled: Any = record['settled']
        compile_for(supervised_law, *self._arguments())

    def _arguments(self) -> tuple[Any, ...]:
        terms = self._terms
        return (
            self._record, self._controls, self._joints, terms.mass_matrix, terms.jacobian,
            terms.jacobian_rate, self._contacts, self._controller.laws, self._states,
            self._limits)

    def answer(self, settled: bool) -> int:
        """
        Answer what has been seen and asked for; see `supervised_law` for what is returned.

        Parameters
        ----------
        settled
            Whether the torque goes through the gate as it is, as long as no contact comes or
            goes.

        Raises
        ------
        MulticontactError
            If there is no torque for this posture.

        """
        self._settled[0] = settled
        found = supervised_law(*self._arguments())
        if found < 0:
            self._controller.refuse(-found)
        return found
