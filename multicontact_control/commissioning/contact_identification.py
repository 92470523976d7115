"""
What recorded force steps say of the contacts: stiffness, damping, friction, tool, noise, delay.

The signals pass the band-pass of the on-line estimate (`force.stiffness`), whose regression is
done at once over all samples that it would accept, with the tool's inertia as one more unknown,
and every unknown within its physical range. The standard errors are those of the scatter, and of
what changes if any one step is left out (jackknife). The delay is that at which the acceleration
of a contact point by the commanded torque fits best what is measured, less what felt forces and
gravity do.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from pathlib import Path
from typing import Any, NamedTuple

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import Controller
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError, format_count, RunError
from multicontact_control.force import stiffness
from multicontact_control.runs.recording import RunData
from multicontact_control.runs.scenario import Setup
import numpy as np
from scipy import linalg
from scipy.optimize import lsq_linear
from scipy.stats import linregress, median_abs_deviation

QUIET_SPEED = 1e-3  # m/s, below which the contact point counts as being at rest
LONGEST_DELAY = 0.02  # s
DELAY_STEP = 1e-4  # s, in which the delay is looked for
LEAST_SAMPLES = 50
APART = 0.1  # s, between the samples of two steps
SIGNALS = ('way', 'rate', 'friction', 'force')  # z, v, w and alpha of a `STIFFNESS_FIT`
# Of the unknowns: the largest values, with 0 as the least.
LARGEST = {
    'stiffness_n_m': math.inf,
    'damping_n_s_m': math.inf,
    'tool_mass_kg': math.inf,
    'friction': stiffness.LARGEST_FRICTION,
}
# Of the variance found from n changes, relative to its square, times n: 5.44 for the median of
# independent ones; of white noise neighbouring changes have a value in common.
SCATTER = 6.6
# Of each result: text, unit, scale and digits.
TEXTS = {
    'stiffness_n_m': ('stiffness', 'N/m', 1.0, 0),
    'damping_n_s_m': ('damping', 'N s/m', 1.0, 1),
    'friction': ('friction of the others', '', 1.0, 3),
    'tool_mass_kg': ('tool', 'kg', 1.0, 3),
    'noise_variance_n2': ('noise variance at rest', 'N^2', 1.0, 5),
    'delay_s': ('delay', 'ms', 1e3, 2),
}


class ContactSignals(NamedTuple):
    """Signals of one contact, row k of sample k: shapes (m,)."""

    alpha: Vector  # measured force [N]
    alpha_des: Vector  # desired one [N]
    speed: Vector  # of the contact point INTO the surface [m/s]
    motion: Vector  # speed of the contact point in whatever direction [m/s]
    friction: Vector  # of the others, per mu [N]
    commanded: Vector  # acceleration by the commanded torque [m/s^2]
    resisted: Vector  # and by the felt forces, gravity and the arm's own motion [m/s^2]


def identify_contacts(data: RunData, setup: Setup) -> dict[str, dict[str, Any]]:
    """
    Identify the contacts of a recording; the true forces are not used.

    Returns by contact the unknowns of `TEXTS`, each a mapping of `value` and `std`, its standard
    error, infinite from a single step, or None where the data cannot tell; `samples`, their
    number, and `explained`, the share of their variance. Raises ConfigError if the arm is not
    known or has no wrist sensor, RunError if no contact has a step of its command.
    """
    config = setup.controller
    if not config.robot.urdf:
        raise ConfigError(
            '--controller',
            'the parameter file of the controller, for a recording '
            'that is no folder of `multicontact run` or `simulate`',
            'none',
        )
    if config.wrench_input == 'momentum':
        raise ConfigError(
            'wrench_input',
            'raw or filtered: the forces of a wrist sensor',
            config.wrench_input,
        )
    signals = contact_signals(data, config, setup.urdf_dir)
    contacts = {
        name: _identify(signal, config.period) for name, signal in signals.items()
    }
    if all(contact['stiffness_n_m'] is None for contact in contacts.values()):
        raise RunError(
            'identify: expected joint states, wrenches and commanded torques of one stamp during '
            'force steps on contacts that are felt, got none'
        )
    return contacts


def contact_signals(
    data: RunData,
    config: ControllerConfig,
    base_dir: Path,
) -> dict[str, ContactSignals]:
    """Return the signals of every contact's normal force."""
    names = config.column_names
    controller = Controller(config, RobotModel(config.robot, base_dir))
    contacts, frame = controller.contacts, controller.controls[0]['frame']
    wrench = getattr(data, config.wrench_series)
    signals = np.full((len(ContactSignals._fields), len(names), data.ticks), np.nan)
    signals[1] = np.nan_to_num(data.alpha_des.T)
    for k in range(data.ticks):
        if not np.isfinite(
            [*data.q[k], *data.qd[k], *wrench[k], *data.torque[k]]
        ).all():
            continue
        controller.take_sample(data.q[k], data.qd[k], wrench[k])
        twist, levers = (
            frame['twist'],
            contacts['config']['point'] @ frame['rotation'].T,
        )
        signals[0, :, k], signals[2, :, k] = (
            contacts['alpha_meas'],
            contacts['N'] @ twist,
        )
        signals[3, :, k] = np.linalg.norm(
            twist[:3] + np.cross(twist[3:], levers), axis=1
        )
        signals[4, :, k] = [
            stiffness.friction_of_others(frame, contacts, i) for i in range(len(names))
        ]
        signals[5:, :, k] = _reactions(controller, data.torque[k])
    return {names[i]: ContactSignals(*signals[:, i]) for i in config.force_columns}


def _reactions(controller: Controller, torque: Vector) -> Matrix:
    """Return how torque, and all else, accelerates the contact points."""
    terms, contacts = controller.robot.terms, controller.contacts
    felt = terms.jacobian.T @ (contacts['N'].T @ contacts['alpha_meas'])
    torques = np.column_stack([torque, controller.arm.bias_torque + felt])
    # Of the mass matrix the upper half is known.
    both = linalg.solve(terms.mass_matrix, torques, assume_a='pos')
    reactions: Matrix = (contacts['N'] @ terms.jacobian @ both).T
    return reactions


def _identify(signal: ContactSignals, h: float) -> dict[str, Any]:
    filtered, accepted = _band_passed(signal, h)
    return {
        'samples': int(accepted.sum()),
        **_fit(filtered, accepted, h),
        'noise_variance_n2': noise_at_rest(signal),
        'delay_s': _delay(signal, accepted, h),
    }


def _fit(filtered: Matrix, accepted: Mask, h: float) -> dict[str, Any]:
    """Return the unknowns with their errors, and what share they explain; None if too little."""
    z, v, w, y, a = filtered[accepted].T
    columns = np.column_stack(
        [z, v, a] + ([w] if np.abs(w).max(initial=0.0) > stiffness.COMMAND_STEP else [])
    )
    count = columns.shape[1]
    scale = np.linalg.norm(columns, axis=0)
    if len(y) < LEAST_SAMPLES or np.linalg.matrix_rank(columns / scale, 1e-6) < count:
        return dict.fromkeys((*LARGEST, 'explained'))

    def solve(kept: Any) -> Vector:
        largest = np.array(list(LARGEST.values()))[:count] * scale
        return np.asarray(
            lsq_linear(columns[kept] / scale, y[kept], (0.0, largest)).x / scale
        )

    values = solve(slice(None))
    left = y - columns @ values
    scatter = (
        stiffness.CORRELATION
        * float(left @ left)
        / max(len(y) - count, 1)
        * np.diag(np.linalg.inv((columns / scale).T @ (columns / scale)))
        / scale**2
    )
    ends = np.flatnonzero(np.diff(np.flatnonzero(accepted)) > APART / h) + 1
    steps = np.split(np.arange(len(y)), ends)
    without = [
        solve(np.delete(np.arange(len(y)), step)) for step in steps if len(steps) > 1
    ]
    of_model = (len(steps) - 1) * np.var(without, axis=0) if without else math.inf
    estimates: dict[str, Any] = {
        name: {'value': float(value), 'std': float(error)}
        for name, value, error in zip(LARGEST, values, np.sqrt(scatter + of_model))
    }
    return (
        dict.fromkeys(LARGEST)
        | estimates
        | {'explained': 1.0 - float(left @ left) / float(y @ y)}
    )


def _band_passed(signal: ContactSignals, h: float) -> tuple[Matrix, Mask]:
    """Return z, v, w, alpha and a behind the on-line estimate's band-pass, and what it takes."""
    record: stiffness.Stiffness = np.zeros(1, dtype=stiffness.STIFFNESS)[0]
    space: stiffness.FitSpace = np.zeros(1, dtype=stiffness.FIT_SPACE)[0]
    record['config']['period'] = h
    fit = record['slow']
    stiffness.set_fit_band(fit, stiffness.SLOW_BAND, h, math.inf)
    filtered = np.zeros((len(signal.alpha), 5))
    accepted = np.zeros(len(signal.alpha), dtype=bool)
    rows = zip(signal.alpha, signal.alpha_des, signal.speed, signal.friction)
    for k, (alpha, alpha_des, speed, friction) in enumerate(rows):
        if not math.isfinite(alpha):
            record['felt'] = False  # a gap: the filters begin anew
            continue
        before, weight = float(fit['rate']['passed']), float(fit['weight'])
        stiffness.estimate_stiffness(record, alpha, alpha_des, speed, friction, space)
        filtered[k, :4] = [fit[name]['passed'] for name in SIGNALS]
        filtered[k, 4] = (filtered[k, 1] - before) / h
        accepted[k] = fit['weight'] > weight
    return filtered, accepted


def noise_at_rest(signal: ContactSignals) -> dict[str, float] | None:
    """Return the variance of the force at rest, not in sliding, from its changes."""
    quiet = (signal.motion < QUIET_SPEED) & (signal.alpha_des > 0.0)
    both = quiet[1:] & quiet[:-1] & (np.diff(signal.alpha_des) == 0.0)
    changes = np.diff(signal.alpha)[both]
    if len(changes) < LEAST_SAMPLES:
        return None
    # Of differences, whatever a step has left in them.
    variance = 0.5 * float(median_abs_deviation(changes, scale='normal')) ** 2
    return {'value': variance, 'std': variance * math.sqrt(SCATTER / len(changes))}


def _delay(signal: ContactSignals, accepted: Mask, h: float) -> dict[str, float] | None:
    """Return after what time a commanded acceleration is best seen in the speed."""
    times = np.flatnonzero(accepted[1:-1]) + 1
    if len(times) < LEAST_SAMPLES:
        return None
    measured = (signal.speed[times + 1] - signal.speed[times]) / h + signal.resisted[
        times
    ]
    times, measured = times[np.isfinite(measured)], measured[np.isfinite(measured)]
    known = np.flatnonzero(np.isfinite(signal.commanded))

    def explained(delay: float) -> float:
        shifted = np.interp(times * h - delay, known * h, signal.commanded[known])
        return float(linregress(shifted, measured).rvalue ** 2)

    delays = np.arange(0.0, LONGEST_DELAY, DELAY_STEP)
    left = (
        len(times)
        * measured.var()
        * (1.0 - np.array([explained(delay) for delay in delays]))
    )
    best = int(np.argmin(left))
    if not 0 < best < len(delays) - 1:
        return None
    near = slice(max(best - 5, 0), best + 6)
    curvature = np.polyfit(delays[near] - delays[best], left[near], 2)[0]
    variance = stiffness.CORRELATION * left[best] / len(times)
    return {
        'value': float(delays[best]),
        'std': math.sqrt(variance / curvature) if curvature > 0.0 else math.inf,
    }


def show(contacts: Mapping[str, Mapping[str, Any]]) -> str:
    """Return what was identified as lines of text."""
    lines = []
    for name, contact in contacts.items():
        share = (
            ''
            if contact['explained'] is None
            else (f', {100.0 * contact["explained"]:.1f} % explained')
        )
        lines.append(f'{name}: {format_count(contact["samples"], "samples")}{share}')
        for key, (text, unit, scale, digits) in TEXTS.items():
            value = contact[key]
            lines.append(
                f'  {text}: not known from this recording'
                if value is None
                else (
                    f'  {text}: {scale * value["value"]:.{digits}f} +- '
                    f'{scale * value["std"]:.{digits}f} {unit}'
                )
                .rstrip()
                .replace('+- inf', '+- unknown (one step only)')
            )
    return '\n'.join(
        [
            *lines,
            'stiffness and damping are those of surface and arm in series, as '
            'the force loop feels them',
        ]
    )
