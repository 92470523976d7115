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
PARABOLA_STEPS = 5  # of the delay to either side of the best; its error is from them
LEAST_SAMPLES = 50
LEAST_STEP_GAP = 0.1  # s, between the accepted samples of two steps
FIT_SIGNALS = ('way', 'rate', 'friction', 'force')  # of a `STIFFNESS_FIT`
# The unknowns of the fit with their largest values; the least are 0.
LARGEST_VALUES = {
    'stiffness_n_m': math.inf,
    'damping_n_s_m': math.inf,
    'tool_mass_kg': math.inf,
    'friction': stiffness.LARGEST_FRICTION,
}
# Of the variance found from n changes, relative to its square, times n: 5.44 for the median of
# independent ones; of white noise neighbouring changes have a value in common.
NOISE_SCATTER = 6.6


class ResultText(NamedTuple):
    """
    How an identified quantity is shown: what it is called, and its number.

    The number is the value times `scale`, in the unit, with the given digits behind the point; its
    standard error has the same ones.
    """

    name: str
    unit: str
    digits: int
    scale: float = 1.0


RESULT_TEXTS = {
    'stiffness_n_m': ResultText('stiffness', 'N/m', 0),
    'damping_n_s_m': ResultText('damping', 'N s/m', 1),
    'friction': ResultText('friction of the others', '', 3),
    'tool_mass_kg': ResultText('tool', 'kg', 3),
    'noise_variance_n2': ResultText('noise variance at rest', 'N^2', 5),
    'delay_s': ResultText('delay', 'ms', 2, scale=1e3),
}


class ContactSignals(NamedTuple):
    """Signals of one contact, row k of sample k: shapes (m,); NaN where one is missing."""

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

    Parameters
    ----------
    data
        A recording with force steps.
    setup
        What it was made with; the controller's configuration with its arm is used.

    Returns
    -------
    dict
        By contact the unknowns of `RESULT_TEXTS`, each a mapping of `value` and `std`, its
        standard error, infinite from a single step, or None where the data cannot tell;
        `samples`, their number, and `explained`, the share of their variance.

    Raises
    ------
    ConfigError
        If the arm is not known or has no wrist sensor.
    RunError
        If no contact has a step of its command.

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
    signals = collect_signals(data, config, setup.urdf_dir)
    contacts = {}
    for name, signal in signals.items():
        contacts[name] = _identify_contact(signal, config.period)
    if not any(contact['stiffness_n_m'] for contact in contacts.values()):
        raise RunError(
            'identify: expected joint states, wrenches and commanded torques of one stamp during '
            'force steps on contacts that are felt, got none'
        )
    return contacts


def collect_signals(
    data: RunData, config: ControllerConfig, base_dir: Path
) -> dict[str, ContactSignals]:
    """
    Return the signals of every contact's normal force; `base_dir` is that of the URDF.

    The controller's own model finds them from joints, wrench and torque of each sample, as it
    would on-line. A sample that lacks one of these is NaN but for the desired force.
    """
    names = config.column_names
    controller = Controller(config, RobotModel(config.robot, base_dir))
    contacts = controller.contacts
    frame = controller.controls[0]['frame']
    wrench = getattr(data, config.wrench_series)
    readings = np.hstack([data.q, data.qd, wrench, data.torque])
    shape = (data.ticks, len(ContactSignals._fields), len(names))
    signals = np.full(shape, np.nan)
    signals[:, 1] = np.nan_to_num(data.alpha_des)
    for k in np.flatnonzero(np.isfinite(readings).all(axis=1)):
        controller.take_sample(data.q[k], data.qd[k], wrench[k])
        twist = frame['twist']
        levers = contacts['config']['point'] @ frame['rotation'].T
        velocities = twist[:3] + np.cross(twist[3:], levers)
        signals[k, 0] = contacts['alpha_meas']
        signals[k, 2] = contacts['N'] @ twist
        signals[k, 3] = np.linalg.norm(velocities, axis=1)
        for i in range(len(names)):
            signals[k, 4, i] = stiffness.friction_of_others(frame, contacts, i)
        signals[k, 5:] = _find_accelerations(controller, data.torque[k])
    by_contact = {}
    for i in config.force_columns:
        by_contact[names[i]] = ContactSignals(*signals[:, :, i].T)
    return by_contact


def _find_accelerations(controller: Controller, torque: Vector) -> Matrix:
    """Return how a torque, and all else, accelerates the contact points, shape (2, r) [m/s^2]."""
    terms = controller.robot.terms
    contacts = controller.contacts
    felt = terms.jacobian.T @ (contacts['N'].T @ contacts['alpha_meas'])
    torques = np.column_stack([torque, controller.arm.bias_torque + felt])
    # Of the mass matrix the upper half is known.
    joint_accelerations = linalg.solve(terms.mass_matrix, torques, assume_a='pos')
    accelerations: Matrix = (contacts['N'] @ terms.jacobian @ joint_accelerations).T
    return accelerations


def _identify_contact(signal: ContactSignals, h: float) -> dict[str, Any]:
    """Return all that is identified of a contact; `h` is the control period [s]."""
    filtered, accepted = _pass_band(signal, h)
    return {
        'samples': int(accepted.sum()),
        **_fit_contact(filtered, accepted, h),
        'noise_variance_n2': find_noise_at_rest(signal),
        'delay_s': _find_delay(signal, accepted, h),
    }


def _fit_contact(filtered: Matrix, accepted: Mask, h: float) -> dict[str, Any]:
    """
    Return the unknowns with their errors, and what share they explain; None if too little.

    `filtered` has z, v, w, alpha and a as columns, shape (m, 5), of which the `accepted` rows are
    used. The force is y = k z + b v + m a + mu w, of stiffness, damping, tool mass and friction.
    """
    z, v, w, y, a = filtered[accepted].T
    columns = [z, v, a]
    if np.abs(w).max(initial=0.0) > stiffness.COMMAND_STEP:
        columns.append(w)
    X = np.column_stack(columns)
    count = X.shape[1]
    scale = np.linalg.norm(X, axis=0)
    if len(y) < LEAST_SAMPLES or np.linalg.matrix_rank(X / scale, 1e-6) < count:
        return dict.fromkeys((*LARGEST_VALUES, 'explained'))
    X /= scale
    largest = np.array(list(LARGEST_VALUES.values()))[:count] * scale

    def solve(X: Matrix, y: Vector) -> Vector:
        return np.asarray(lsq_linear(X, y, (0.0, largest)).x)

    scaled_values = solve(X, y)
    residual = y - X @ scaled_values
    power = float(residual @ residual)
    freedom = max(len(y) - count, 1)
    covariance = np.diag(np.linalg.inv(X.T @ X))
    variance = stiffness.CORRELATION * power / freedom * covariance
    distances = np.diff(np.flatnonzero(accepted))
    gaps = np.flatnonzero(distances > LEAST_STEP_GAP / h)
    steps = np.split(np.arange(len(y)), gaps + 1)
    if len(steps) > 1:
        without_step = []
        for step in steps:
            rows = np.delete(X, step, axis=0)
            without_step.append(solve(rows, np.delete(y, step)))
        variance += (len(steps) - 1) * np.var(without_step, axis=0)
    else:
        variance += math.inf
    values = scaled_values / scale
    errors = np.sqrt(variance) / scale
    result: dict[str, Any] = dict.fromkeys(LARGEST_VALUES)
    for name, value, error in zip(LARGEST_VALUES, values, errors):
        result[name] = {'value': float(value), 'std': float(error)}
    result['explained'] = 1.0 - power / float(y @ y)
    return result


def _pass_band(signal: ContactSignals, h: float) -> tuple[Matrix, Mask]:
    """
    Return signals behind the band-pass of the on-line estimate, and the samples that it accepts.

    The columns are z, v, w, alpha and the derivative a of v, shape (m, 5).
    """
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
        rate_before = float(fit['rate']['passed'])
        weight_before = float(fit['weight'])
        stiffness.estimate_stiffness(record, alpha, alpha_des, speed, friction, space)
        filtered[k, :4] = [fit[name]['passed'] for name in FIT_SIGNALS]
        filtered[k, 4] = (filtered[k, 1] - rate_before) / h
        accepted[k] = fit['weight'] > weight_before
    return filtered, accepted


def find_noise_at_rest(signal: ContactSignals) -> dict[str, float] | None:
    """
    Return the variance of the force at rest, not in sliding, from its changes [N^2].

    It has `value` and `std`, its standard error; None if there are fewer than 50 changes.
    """
    quiet = (signal.motion < QUIET_SPEED) & (signal.alpha_des > 0.0)
    held = np.diff(signal.alpha_des) == 0.0
    at_rest = quiet[1:] & quiet[:-1] & held
    changes = np.diff(signal.alpha)[at_rest]
    if len(changes) < LEAST_SAMPLES:
        return None
    # Of differences, whatever a step has left in them.
    variance = 0.5 * float(median_abs_deviation(changes, scale='normal')) ** 2
    error = variance * math.sqrt(NOISE_SCATTER / len(changes))
    return {'value': variance, 'std': error}


def _find_delay(
    signal: ContactSignals, accepted: Mask, h: float
) -> dict[str, float] | None:
    """Return after what time a commanded acceleration is best seen in the speed [s], or None."""
    samples = np.flatnonzero(accepted[1:-1]) + 1
    if len(samples) < LEAST_SAMPLES:
        return None
    changes = signal.speed[samples + 1] - signal.speed[samples]
    measured = changes / h + signal.resisted[samples]
    known = np.isfinite(measured)
    samples = samples[known]
    measured = measured[known]
    commands = np.flatnonzero(np.isfinite(signal.commanded))
    commanded = signal.commanded[commands]

    def find_unexplained(delay: float) -> float:
        shifted = np.interp(samples * h - delay, commands * h, commanded)
        return 1.0 - float(linregress(shifted, measured).rvalue ** 2)

    delays = np.arange(0.0, LONGEST_DELAY, DELAY_STEP)
    power = len(samples) * measured.var()
    residual = power * np.array([find_unexplained(delay) for delay in delays])
    best = int(np.argmin(residual))
    if not 0 < best < len(delays) - 1:
        return None
    near = slice(max(best - PARABOLA_STEPS, 0), best + PARABOLA_STEPS + 1)
    offsets = delays[near] - delays[best]
    curvature = np.polyfit(offsets, residual[near], 2)[0]
    variance = stiffness.CORRELATION * residual[best] / len(samples)
    error = math.inf
    if curvature > 0.0:
        error = math.sqrt(variance / curvature)
    return {'value': float(delays[best]), 'std': error}


def describe_contacts(contacts: Mapping[str, Mapping[str, Any]]) -> str:
    """
    Return what `identify_contacts` found as lines of text.

    Each contact has a line with its samples, and one for each quantity of `RESULT_TEXTS` with its
    standard error; the last line says what the stiffness is of.
    """
    lines = []
    for name, contact in contacts.items():
        line = f'{name}: {format_count(contact["samples"], "samples")}'
        if contact['explained'] is not None:
            line += f', {100.0 * contact["explained"]:.1f} % explained'
        lines.append(line)
        for key, text in RESULT_TEXTS.items():
            lines.append(f'  {text.name}: {_describe_result(contact[key], text)}')
    lines.append(
        'stiffness and damping are those of surface and arm in series, as the force loop '
        'feels them'
    )
    return '\n'.join(lines)


def _describe_result(result: Mapping[str, float] | None, text: ResultText) -> str:
    if result is None:
        return 'not known from this recording'
    value = f'{text.scale * result["value"]:.{text.digits}f}'
    if math.isinf(result['std']):
        error = 'unknown (one step only)'
    else:
        error = f'{text.scale * result["std"]:.{text.digits}f}'
    return f'{value} +- {error} {text.unit}'.rstrip()
