"""The fastest gains of a force law that leave a margin, as text and as parameter files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
from pathlib import Path
from typing import Any

from multicontact_control.arrays import Matrix
from multicontact_control.config import ForceConfig, validate
from multicontact_control.errors import ConfigError
from multicontact_control.force.laws.aob import make_steady_law
from multicontact_control.force.laws.design import find_law, LoopModel
from multicontact_control.force.laws.linear import (
    ALPHA_DES,
    ALPHA_MEAS,
    LinearLaw,
    SPEED,
    U,
)
from multicontact_control.force.margins import find_last_stable, spectral_radius
from multicontact_control.force.observer import solve_steady_gain
from multicontact_control.runs.parameter_file import write_parameters
import numpy as np
import yaml

PARAMETER_FILE_NODES = {
    'controller': '/**/controller_node',
    'noise_estimator': '/**/noise_estimator_node',
}
LOWEST_FREQUENCY = 0.1  # rad/s, of the frequency response
FREQUENCY_COUNT = 4000
LONGEST_RISE = 5.0  # s
RISE_SHARE = 0.63  # of a step, at which its rise time is taken
READINGS = [ALPHA_MEAS, SPEED]  # inputs of a law that a plant answers
STIFFNESS_RATIOS = tuple(np.geomspace(1.0, 1000.0, 121).tolist())
RATIO_TOLERANCE = 1e-3  # relative, of the largest stable ratio
SPEEDS = np.geomspace(8.0, 1.0 / 64.0, 73).tolist()  # of the usual gains
LEAST_GAIN_MARGIN = 2.0  # left on the stiffest surface


@dataclass(frozen=True)
class Margins:
    """
    Margins of a force loop, cut open at the input of P04 eq. 32.

    They tell how wrong the model of a surface may be before the loop oscillates; a margin is
    infinite where nothing limits it.
    """

    gain: float  # factor by which the loop's gain may grow
    phase: float  # that may be added [rad]
    delay: float  # that may be added [s]
    crossover: float  # frequency at which the loop's gain is 1 [rad/s]


def _reading_matrix(model: LoopModel) -> Matrix:
    """Return what of a plant's state a law reads: alpha, and the speed dalpha/dt / k."""
    outputs = np.zeros((2, len(model.plant.Gamma)))
    outputs[0, 0] = 1.0
    outputs[1, 1] = 1.0 / model.stiffness
    return outputs


def closed_loop_matrix(law: LinearLaw, model: LoopModel, ratio: float = 1.0) -> Matrix:
    """
    Return the matrix of one period of a law on a contact of P04 eq. 32, with no command.

    Parameters
    ----------
    law
        The force law, with l states.
    model
        The contact that it is designed for, with p states.
    ratio
        True over modelled stiffness.

    Returns
    -------
    Matrix
        Of the state [x of the plant, x of the law], shape (p + l, p + l).

    """
    contact = replace(model, stiffness=ratio * model.stiffness)
    plant = contact.plant
    rows = _reading_matrix(contact)
    fed_back = law.D[U, READINGS] @ rows
    from_plant = plant.Phi + np.outer(plant.Gamma, fed_back)
    from_law = np.outer(plant.Gamma, law.C[U])
    to_law = law.B[:, READINGS] @ rows
    return np.block([[from_plant, from_law], [to_law, law.A]])


def find_rise_time(law: LinearLaw, model: LoopModel) -> float:
    """Return when the force first passes 63 % of a step of the command [s]; infinite if never."""
    loop = closed_loop_matrix(law, model)
    to_plant = model.plant.Gamma * law.D[U, ALPHA_DES]
    entering = np.concatenate([to_plant, law.B[:, ALPHA_DES]])
    state = np.zeros(len(loop))
    for tick in range(round(LONGEST_RISE / model.period)):
        if state[0] > RISE_SHARE:
            return tick * model.period
        state = loop @ state + entering
    return math.inf


def find_margins(law: LinearLaw, model: LoopModel) -> Margins:
    """
    Return the margins of a force law on the model that it is designed for.

    Of an active observer the law is its `make_steady_law`. A margin without a limit is infinite.
    """
    import control  # takes a second

    period = model.period
    plant = control.ss(
        model.plant.Phi,
        model.plant.Gamma[:, None],
        _reading_matrix(model),
        np.zeros((2, 1)),
        period,
    )
    B = law.B[:, READINGS]
    C = law.C[[U]]
    D = law.D[[U]][:, READINGS]
    feedback = control.ss(law.A, B, C, D, period)
    highest = math.pi / period
    frequencies = np.geomspace(LOWEST_FREQUENCY, highest, FREQUENCY_COUNT)
    response = control.frequency_response(-1.0 * feedback * plant, frequencies)
    gain, degrees, _, _, crossover, _ = control.stability_margins(response)
    phase = math.inf
    if np.isfinite(degrees):
        phase = math.radians(degrees)
    if not np.isfinite(crossover):
        return Margins(float(gain), phase, math.inf, 0.0)
    crossover = float(crossover)
    return Margins(float(gain), phase, phase / crossover, crossover)


def find_stable_ratios(law: LinearLaw, model: LoopModel) -> tuple[float, float]:
    """Return the smallest and largest true over modelled stiffness that a law is stable with."""

    def is_stable(ratio: float) -> bool:
        return spectral_radius(closed_loop_matrix(law, model, ratio)) < 1.0 + 1e-9

    def is_stable_softer(ratio: float) -> bool:
        return is_stable(1.0 / ratio)

    softer = find_last_stable(is_stable_softer, STIFFNESS_RATIOS, RATIO_TOLERANCE)[0]
    largest = find_last_stable(is_stable, STIFFNESS_RATIOS, RATIO_TOLERANCE)[0]
    if not softer:
        return math.inf, largest
    return 1.0 / softer, largest


def _scale_gains(
    exponents: Mapping[str, Any], usual: Any, speed: float
) -> dict[str, Any]:
    """
    Return the gains of a law that is `speed` times as fast as the usual one, with four digits.

    `exponents` has for each gain the power of the speed that multiplies it, by section.
    """
    gains: dict[str, Any] = {}
    for name, exponent in exponents.items():
        value = getattr(usual, name)
        if isinstance(exponent, Mapping):
            gains[name] = _scale_gains(exponent, value, speed)
        else:
            gains[name] = float(f'{value * speed**exponent:.4g}')
    return gains


@dataclass(frozen=True)
class DesignedLaw:
    """
    Gains of a force law for a range of surfaces, and what they lead to.

    What a user decides by: how long a step takes on either end of the range, and what margins are
    left on the stiffest surface, where a loop is nearest to oscillating.
    """

    # Of `force` in a controller's configuration, beside the defaults.
    values: dict[str, Any]
    stiffness: float  # of the model [N/m]
    margins: Margins  # on the stiffest surface
    stiffest_ratio: float  # up to which the loop of the stiffest surface is stable
    rise_softest: float  # of a step on the softest surface [s]
    rise_stiffest: float  # and on the stiffest [s]


def design_for_range(
    name: str,
    *,
    stiffness: tuple[float, float],
    input_delay: float,
    noise_variance: float,
    damping_rate: float = 100.0,
    period: float = 0.002,
) -> DesignedLaw:
    """
    Return the fastest gains with a gain margin of 2 and a period's delay left on every surface.

    Parameters
    ----------
    name
        That of a registered force law.
    stiffness
        That of the softest and of the stiffest surface [N/m]; the model has their geometric mean.
    input_delay
        T_d [s].
    noise_variance
        R [N^2].
    damping_rate
        K_2 [1/s].
    period
        h [s].

    Raises
    ------
    ConfigError
        If a number is not acceptable, or no gains have these margins.

    """
    softest, stiffest = stiffness
    entry = find_law(name)
    given = {'law': name, 'damping_rate': damping_rate}
    usual = validate(ForceConfig, given)
    if not 0.0 < softest <= stiffest:
        raise ConfigError(
            'stiffness',
            'softest and stiffest, above 0, in this order',
            f'{softest:g}, {stiffest:g}',
        )
    if not noise_variance > 0.0:
        raise ConfigError('noise_variance', 'a positive number', noise_variance)
    middle = math.sqrt(softest * stiffest)
    model = LoopModel(middle, damping_rate, input_delay, period)
    stiffest_model = replace(model, stiffness=stiffest)
    for speed in SPEEDS:
        values = _scale_gains(entry.speed_exponents, usual, speed)
        if entry.noise_gain:
            section, gain = entry.noise_gain
            values[section][gain] = noise_variance
        law = entry.design(model, validate(ForceConfig, {**values, **given}))
        if not isinstance(law, LinearLaw):
            law = make_steady_law(law, solve_steady_gain(law, noise_variance))
        smallest, largest = find_stable_ratios(law, stiffest_model)
        if smallest > softest / stiffest or largest < LEAST_GAIN_MARGIN:
            continue  # before the frequency response, which takes ten times as long
        margins = find_margins(law, stiffest_model)
        if margins.delay >= period:
            softest_model = replace(model, stiffness=softest)
            return DesignedLaw(
                {**given, 'input_delay': input_delay, **values},
                model.stiffness,
                margins,
                largest,
                find_rise_time(law, softest_model),
                find_rise_time(law, stiffest_model),
            )
    raise ConfigError(
        'stiffness',
        f'a range that `{name}` can be stable on with a gain margin of '
        f'{LEAST_GAIN_MARGIN:g} and a period of delay left',
        f'{softest:g} to {stiffest:g} N/m',
    )


def describe_design(design: DesignedLaw) -> str:
    """
    Return gains and margins as a few lines of text.

    The gains come first, as YAML that can be copied into a controller's parameter file below
    `force`; then the model's stiffness, the margins and the rise times.
    """
    margins = design.margins
    gains = yaml.safe_dump({'force': design.values}, sort_keys=False).rstrip()
    stiffest = _describe_time(design.rise_stiffest)
    softest = _describe_time(design.rise_softest)
    return f"""{gains}
model: {_describe_model(design)}
on the stiffest surface:
  phase margin     {math.degrees(margins.phase):.0f} deg
  delay margin     {1e3 * margins.delay:.1f} ms
  crossover        {margins.crossover:.1f} rad/s
  stable           up to {design.stiffest_ratio:.2f} times as stiff
  63 % of a step   after {stiffest}, on the softest after {softest}"""


def _describe_time(time: float) -> str:
    if math.isinf(time):
        return 'never'
    return f'{1e3 * time:.0f} ms'


def _describe_model(design: DesignedLaw) -> str:
    """Return the stiffness that the gains go with; contacts have names, which no law knows."""
    return (
        f'{design.stiffness:.0f} N/m '
        f"(--set 'controller.contacts.*.stiffness={design.stiffness:.0f}')"
    )


def write_design(design: DesignedLaw, path: Path) -> None:
    """
    Write gains as a parameter file, as `--preset` takes it.

    Only `force` is in it. The stiffness of the model belongs to the contacts, and so to another
    file: a comment at the head names it.
    """
    write_preset(
        {'controller': {'force': design.values}},
        path,
        f'designed with a model of {_describe_model(design)}, which is not in here',
    )


def write_preset(sections: Mapping[str, Any], path: Path, comment: str) -> None:
    """
    Write values of controller and noise estimator as a parameter file that `--preset` takes.

    Parameters
    ----------
    sections
        Nested values by `controller` and `noise_estimator`.
    path
        The file.
    comment
        A line at its head that says what it is.

    """
    by_node = {}
    for name, values in sections.items():
        by_node[PARAMETER_FILE_NODES[name]] = values
    write_parameters(path, by_node, f'# {comment}\n')
