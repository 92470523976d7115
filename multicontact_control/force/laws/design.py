"""Gains of a force law for a range of stiffness, a delay and a noise, with their margins."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import Any

from multicontact_control.config import ForceConfig, validate
from multicontact_control.errors import ConfigError
from multicontact_control.force.laws import LAWS, LinearLaw, LoopModel, steady_law
from multicontact_control.force.laws.margins import (
    input_rms,
    Margins,
    margins_of,
    rise_time,
    stable_ratios,
)
from multicontact_control.force.linear_loop import steady_gain
from multicontact_control.force.plant_model import delayed_plant
import numpy as np

SPEEDS = tuple(np.geomspace(8.0, 1.0 / 64.0, 73).tolist())  # of the usual gains
GAIN_MARGIN = 2.0  # left on the stiffest surface

# What makes a law s times as fast as it usually is.
FASTER: Mapping[str, Callable[[ForceConfig, float], dict[str, Any]]] = {
    'aob': lambda force, s: {'time_constant': force.time_constant / s},
    'pi': lambda force, s: {'pi': {'bandwidth': force.pi.bandwidth * s}},
    'dob': lambda force, s: {'dob': {
        'bandwidth': force.dob.bandwidth * s,
        'observer_bandwidth': force.dob.observer_bandwidth * s}},
    'lqg': lambda force, s: {'lqg': {'input_weight': force.lqg.input_weight / s ** 2}},
    'admittance': lambda force, s: {'admittance': {
        'bandwidth': force.admittance.bandwidth * s}},
    'impedance': lambda force, s: {'impedance': {
        'natural_frequency': force.impedance.natural_frequency * s}},
    'feedforward': lambda force, s: {}}


@dataclass(frozen=True)
class DesignedLaw:
    """
    Gains, and what they lead to.

    Attributes
    ----------
    values
        Of `force` in a controller's configuration that differ from the defaults.
    stiffness
        Of the model [N/m].
    margins
        On the stiffest surface.
    rise_softest, rise_stiffest
        Of a step, on either end of the range [s].
    input_rms
        Of u on the stiffest surface under the noise [m/s^2].

    """

    values: dict[str, Any]
    stiffness: float
    margins: Margins
    rise_softest: float
    rise_stiffest: float
    input_rms: float


def design_for_range(
    name: str, *, input_delay: float, softest: float, stiffest: float, noise_variance: float,
    damping_rate: float = 100.0, period: float = 0.002,
) -> DesignedLaw:
    """
    Return the fastest gains with a gain margin of 2 and a period's delay left on every surface.

    Parameters
    ----------
    name
        Of the law, as in `LAWS`.
    input_delay
        T_d [s].
    softest, stiffest
        Range of the true stiffness [N/m]; the model is in the middle of it, by ratio.
    noise_variance
        Of the measured force [N^2]; that of the steady observer of `aob` and `lqg`, too.
    damping_rate
        K_2 [1/s].
    period
        h [s].

    Raises
    ------
    ConfigError
        If a value is out of range, or no gains have these margins.

    """
    if name not in LAWS:
        raise ConfigError('law', f'one of {", ".join(LAWS)}', f"'{name}'")
    if not 0.0 < softest <= stiffest:
        raise ConfigError('stiffness', 'softest and stiffest, above 0, in this order',
                          f'{softest:g}, {stiffest:g}')
    if not noise_variance > 0.0:
        raise ConfigError('noise_variance', 'a positive number', noise_variance)

    def model(stiffness: float) -> LoopModel:
        return LoopModel(delayed_plant(stiffness, damping_rate, input_delay, period), stiffness,
                         damping_rate, input_delay, period)

    middle = math.sqrt(softest * stiffest)
    usual = validate(ForceConfig, {'law': name, 'damping_rate': damping_rate})
    for speed in SPEEDS:
        values = FASTER[name](usual, speed)
        if name == 'lqg':
            values['lqg']['noise_variance'] = noise_variance
        force = validate(ForceConfig, {**values, 'law': name, 'damping_rate': damping_rate})
        law = LAWS[name](model(middle), force)
        if not isinstance(law, LinearLaw):
            law = steady_law(law, steady_gain(law, noise_variance))
        low, high = stable_ratios(law, model(stiffest))
        if low > softest / stiffest or high < GAIN_MARGIN:
            continue  # before the frequency response, which takes ten times as long
        margins = margins_of(law, model(stiffest))
        if margins.delay >= period:
            return DesignedLaw(
                {'law': name, 'damping_rate': damping_rate, 'input_delay': input_delay, **values},
                middle, margins, rise_time(law, model(softest)), rise_time(law, model(stiffest)),
                input_rms(law, model(stiffest), noise_variance))
    raise ConfigError(
        'stiffness', f'a range that `{name}` can be stable on with a gain margin of '
        f'{GAIN_MARGIN:g} and a period of delay left', f'{softest:g} to {stiffest:g} N/m')
