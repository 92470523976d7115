"""What the diagnostics of the controller say of its supervisor, contacts and sensor."""

from __future__ import annotations

from collections import Counter
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.control_loop import ControlLoop
from multicontact_control.nodes.diagnostics import Status
from multicontact_control.supervision.contacts import GIVEN_UP, LOST, NAMES, RETRACTING
from multicontact_control.supervision.reactions import INFLATE, NONE, SEVERITY

TROUBLED = tuple(NAMES[code] for code in (LOST, RETRACTING, GIVEN_UP))


class SupervisorReport:
    """Reports what the supervisor of a loop does, and what it did since the last report."""

    def __init__(self, loop: ControlLoop) -> None:
        self._loop = loop
        self._before: tuple[Counter[str], ...] = (Counter(), Counter(), Counter())

    def status(self) -> Status:
        """Return the status, and begin the next report."""
        loop, status = self._loop, self._loop.status
        counts = (loop.reactions, loop.rejected, loop.limited)
        since = [_since(now, before) for now, before in zip(counts, self._before)]
        self._before = tuple(Counter(count) for count in counts)
        values: dict[str, Any] = {'reaction': status.reaction if status else 'none'}
        if status is None:
            return Status('supervisor', values)
        values |= {'causes': ' '.join(status.causes) or 'none',
                   'task_time_s': status.task_time, 'events': len(loop.events.events)}
        values |= loop.collisions
        if loop.supervised:
            values |= {f'{name} residual_nm': value for name, value in zip(
                loop.config.robot.joint_names, loop.supervisor.collisions.residual.tolist())}
        values |= {f'ticks with {name}': n for name, n in counts[0].items() if name != NONE}
        values |= {f'rejected {name}': n for name, n in counts[1].items()}
        values |= {f'limited {name}': n for name, n in counts[2].items()}
        rates = loop.events.alternating(loop.time)
        values['fastest_change_hz'] = max(rates.values(), default=0.0)
        if SEVERITY.index(status.reaction) > SEVERITY.index(INFLATE):
            return Status('supervisor', values, error=reaction_text(loop))
        return Status('supervisor', values, warning='; '.join(filter(None, [
            reaction_text(loop),
            ', '.join(f'{name} changes {rate:.1f} times a second' for name, rate in rates.items()),
            _told('reacted', {k: n for k, n in since[0].items() if k not in (NONE, INFLATE)}),
            _told('rejected', since[1]), _told('limited', since[2])])))


def reaction_text(loop: ControlLoop) -> str:
    """Return what the supervisor does instead of control, and why; empty if nothing."""
    status, supervisor = loop.status, loop.supervisor
    if status is None or status.reaction == NONE:
        return ''
    causes = ', '.join(status.causes)
    if status.reaction == INFLATE:
        return f'R is inflated: {causes}'
    outside = '; '.join(supervisor.outside)
    return f'{status.reaction} instead of control: {causes}' + (
        f', until the arm is inside its limits: {outside}' if outside else '')


def _since(now: Counter[str], before: Counter[str]) -> dict[str, int]:
    """Return what has been counted since; all of it if the counting has begun anew."""
    return {name: n - before[name] if n >= before[name] else n
            for name, n in now.items() if n != before[name]}


def _told(what: str, counts: dict[str, int]) -> str:
    return f'{what}: ' + ', '.join(
        f'{name} in {n} ticks' for name, n in counts.items()) if counts else ''


def contact_status(loop: ControlLoop, variance: Vector | None) -> Status:
    """Return the states and forces of the contacts, and R [N^2]."""
    output, status = loop.output, loop.status
    values: dict[str, Any] = {'held': loop.held}
    if output is None:
        return Status('contacts', values)
    config = loop.config
    trouble = [f'1 N of friction at {where} is read as {gain:.1f} N at {what}: give '
               f'contacts.{where}.friction_std'
               for where, what, gain in loop.supervisor.controller.misread_friction]
    for i, name in enumerate(config.column_names):
        values[f'{name} measured_n'] = float(output.alpha_meas[i])
        values[f'{name} estimated_n'] = float(output.alpha_est[i])
        values[f'{name} desired_n'] = float(output.alpha_des[i])
        values[f'{name} noise_variance_n2'] = float(
            config.initial_noise_variance if variance is None else variance[i])
    for contact, (i, name) in enumerate(zip(config.leaders, config.contact_names)):
        values[name] = status.contact_states[contact] if status else (
            'force' if output.active[i] else 'motion')
        if config.force.stiffness == 'adaptive':
            values |= _stiffness(name, output.contacts[i])
        if values[name] in TROUBLED:
            trouble.append(f'{name} is {values[name]}')
    return Status('contacts', values, warning='; '.join(trouble))


def _stiffness(name: str, contact: Any) -> dict[str, Any]:
    """Return what is known of the stiffness of a contact, in words, and of its stability."""
    used, found, error = (float(contact[key]) for key in (
        'stiffness', 'stiffness_est', 'stiffness_std'))
    known = f'{found:.0f} +- {error:.0f} N/m' if found > 0.0 else 'not known'
    stable = (f'true/model at most {contact["ratio_bound"]:.2f}, margin {contact["margin"]:.1f}'
              if found > 0.0 else 'not known')
    return {f'{name} stiffness': f'{known}, model {used:.0f} N/m', f'{name} stability': stable}


def sensor_status(loop: ControlLoop) -> Status:
    """Return the health of the wrist sensor, and what is still to be proved of it."""
    gate, fault = loop.push_gate, loop.sensor_fault
    values = {'fault': fault or 'none', 'force_control': 'allowed' if gate.open else 'disabled',
              'push_test': gate.instruction or 'none'}
    failed = gate.result is not None and not gate.result.passed and not gate.running
    error = f'the readings are {fault}' if fault else gate.instruction if failed else ''
    return Status('sensor', values, error=error,
                  warning=gate.instruction if gate.running or not gate.open else '')
