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

NODES = {
    'controller': '/**/controller_node',
    'noise_estimator': '/**/noise_estimator_node',
}
LOWEST, POINTS = 0.1, 4000  # rad/s, of the frequency response
LONGEST_RISE = 5.0  # s
READ = [ALPHA_MEAS, SPEED]  # of a law's inputs
RATIOS = tuple(np.geomspace(1.0, 1000.0, 121).tolist())
SPEEDS = np.geomspace(8.0, 1.0 / 64.0, 73).tolist()  # of the usual gains
GAIN_MARGIN = 2.0  # left on the stiffest surface


@dataclass(frozen=True)
class Margins:
    """Margins of a force loop, cut open at the input of P04 eq. 32."""

    gain: float  # factor by which the loop's gain may grow
    phase: float  # that may be added [rad]
    delay: float  # that may be added [s]
    crossover: float  # frequency at which the loop's gain is 1 [rad/s]


def _readings(model: LoopModel) -> Matrix:
    """Return what of a plant's state a law reads: alpha, and the speed dalpha/dt / k."""
    outputs = np.zeros((2, len(model.plant.Gamma)))
    outputs[0, 0], outputs[1, 1] = 1.0, 1.0 / model.stiffness
    return outputs


def contact_loop(law: LinearLaw, model: LoopModel, ratio: float = 1.0) -> Matrix:
    """
    Return the matrix of one period of a law on a contact of P04 eq. 32, with no command.

    Of the state [x of the plant, x of the law]; `ratio` is true over modelled stiffness.
    """
    real = replace(model, stiffness=ratio * model.stiffness)
    plant, rows = real.plant, _readings(real)
    return np.block(
        [
            [
                plant.Phi + np.outer(plant.Gamma, law.D[U, READ] @ rows),
                np.outer(plant.Gamma, law.C[U]),
            ],
            [law.B[:, READ] @ rows, law.A],
        ]
    )


def rise_time(law: LinearLaw, model: LoopModel) -> float:
    """Return when the force first passes 63 % of a step of the command [s]; infinite if never."""
    loop, plant = contact_loop(law, model), model.plant
    entering = np.concatenate([plant.Gamma * law.D[U, ALPHA_DES], law.B[:, ALPHA_DES]])
    state = np.zeros(len(loop))
    for tick in range(round(LONGEST_RISE / model.period)):
        if state[0] > 0.63:
            return tick * model.period
        state = loop @ state + entering
    return math.inf


def margins_of(law: LinearLaw, model: LoopModel) -> Margins:
    """Return the margins of a force law on its model; of an observer's `make_steady_law`."""
    import control  # takes a second

    plant = control.ss(
        model.plant.Phi,
        model.plant.Gamma[:, None],
        _readings(model),
        np.zeros((2, 1)),
        model.period,
    )
    feedback = control.ss(
        law.A, law.B[:, READ], law.C[[U]], law.D[[U]][:, READ], model.period
    )
    frequencies = np.geomspace(LOWEST, math.pi / model.period, POINTS)
    response = control.frequency_response(-1.0 * feedback * plant, frequencies)
    gain, phase, _, _, crossover, _ = control.stability_margins(response)
    phase = math.radians(float(phase)) if np.isfinite(phase) else math.inf
    crossover = float(crossover) if np.isfinite(crossover) else 0.0
    return Margins(
        float(gain), phase, phase / crossover if crossover else math.inf, crossover
    )


def stable_ratios(law: LinearLaw, model: LoopModel) -> tuple[float, float]:
    """Return from which to which true over modelled stiffness a force law is stable."""

    def stable(ratio: float) -> bool:
        return spectral_radius(contact_loop(law, model, ratio)) < 1.0 + 1e-9

    down = find_last_stable(lambda ratio: stable(1.0 / ratio), RATIOS, 1e-3)[0]
    return 1.0 / down if down else math.inf, find_last_stable(stable, RATIOS, 1e-3)[0]


def _faster(exponents: Mapping[str, Any], usual: Any, speed: float) -> dict[str, Any]:
    """Return the gains of a law that is so many times as fast, with four digits."""
    return {
        name: _faster(part, getattr(usual, name), speed)
        if isinstance(part, Mapping)
        else float(f'{getattr(usual, name) * speed**part:.4g}')
        for name, part in exponents.items()
    }


@dataclass(frozen=True)
class DesignedLaw:
    """Gains, and what they lead to."""

    values: dict[
        str, Any
    ]  # of `force` in a controller's configuration, beside the defaults
    stiffness: float  # of the model [N/m]
    margins: Margins  # on the stiffest surface
    stiffest_ratio: float  # up to which the loop of the stiffest surface is stable
    rise_softest: float  # of a step, on either end of the range [s]
    rise_stiffest: float


def design_for_range(
    name: str,
    *,
    input_delay: float,
    softest: float,
    stiffest: float,
    noise_variance: float,
    damping_rate: float = 100.0,
    period: float = 0.002,
) -> DesignedLaw:
    """
    Return the fastest gains with a gain margin of 2 and a period's delay left on every surface.

    `name` is that of a registered law; `input_delay` and `period` are T_d and h [s]; the true
    stiffness is from `softest` to `stiffest` [N/m], and modelled as their geometric mean;
    `noise_variance` is R [N^2], `damping_rate` K_2 [1/s]. Raises ConfigError if no gains have
    these margins.
    """
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
    model, soft, stiff = (
        LoopModel(stiffness, damping_rate, input_delay, period)
        for stiffness in (math.sqrt(softest * stiffest), softest, stiffest)
    )
    entry = find_law(name)
    for speed in SPEEDS:
        values = _faster(entry.speed_exponents, usual, speed)
        if entry.noise_gain:
            section, gain = entry.noise_gain
            values[section][gain] = noise_variance
        law = entry.design(model, validate(ForceConfig, {**values, **given}))
        if not isinstance(law, LinearLaw):
            law = make_steady_law(law, solve_steady_gain(law, noise_variance))
        low, high = stable_ratios(law, stiff)
        if low > softest / stiffest or high < GAIN_MARGIN:
            continue  # before the frequency response, which takes ten times as long
        margins = margins_of(law, stiff)
        if margins.delay >= period:
            return DesignedLaw(
                {**given, 'input_delay': input_delay, **values},
                model.stiffness,
                margins,
                high,
                rise_time(law, soft),
                rise_time(law, stiff),
            )
    raise ConfigError(
        'stiffness',
        f'a range that `{name}` can be stable on with a gain margin of '
        f'{GAIN_MARGIN:g} and a period of delay left',
        f'{softest:g} to {stiffest:g} N/m',
    )


def show_design(design: DesignedLaw) -> str:
    """Return gains and margins as a few lines of text."""
    margins = design.margins
    stiffest, softest = (
        'never' if math.isinf(time) else f'{1e3 * time:.0f} ms'
        for time in (design.rise_stiffest, design.rise_softest)
    )
    return f"""{yaml.safe_dump({'force': design.values}, sort_keys=False).rstrip()}
model: {_model(design)}
on the stiffest surface:
  phase margin     {math.degrees(margins.phase):.0f} deg
  delay margin     {1e3 * margins.delay:.1f} ms
  crossover        {margins.crossover:.1f} rad/s
  stable           up to {design.stiffest_ratio:.2f} times as stiff
  63 % of a step   after {stiffest}, on the softest after {softest}"""


def _model(design: DesignedLaw) -> str:
    """Return the stiffness that the gains go with; contacts have names, which no law knows."""
    return (
        f'{design.stiffness:.0f} N/m '
        f"(--set 'controller.contacts.*.stiffness={design.stiffness:.0f}')"
    )


def write_design(design: DesignedLaw, path: Path) -> None:
    """Write gains as a parameter file, as `--preset` takes it."""
    write_preset(
        {'controller': {'force': design.values}},
        path,
        f'designed with a model of {_model(design)}, which is not in here',
    )


def write_preset(sections: Mapping[str, Any], path: Path, what: str) -> None:
    """Write values of controller and noise estimator as a parameter file that `--preset` takes."""
    write_parameters(
        path,
        {NODES[section]: values for section, values in sections.items()},
        f'# {what}\n',
    )
