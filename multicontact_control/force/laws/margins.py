"""How far a force law is from instability: margins of its loop on the model of the contact."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import control
from multicontact_control.arrays import Matrix
from multicontact_control.force.linear_law import LinearLaw, LoopModel
from multicontact_control.force.linear_loop import last_stable, spectral_radius
from multicontact_control.force.plant_model import delayed_plant
import numpy as np
from scipy.linalg import solve_discrete_lyapunov

POINTS = 4000  # of the frequency response
LOWEST = 0.1  # rad/s
LONGEST_RISE = 5.0  # s
READ = [0, 2]  # of a law's inputs: alpha, and the speed
RATIOS = tuple(np.geomspace(1.0, 1000.0, 121).tolist())


@dataclass(frozen=True)
class Margins:
    """
    Margins of a force loop, cut open at the input of P04 eq. 32.

    Attributes
    ----------
    gain
        Factor by which the loop's gain may grow; infinite if any.
    phase
        Lag that may be added [rad].
    delay
        Delay that may be added [s].
    crossover
        Frequency at which the loop's gain is 1 [rad/s].
    softest, stiffest
        Between which true stiffnesses the loop is stable, over that of the model.

    """

    gain: float
    phase: float
    delay: float
    crossover: float
    softest: float
    stiffest: float


def _readings(model: LoopModel) -> Matrix:
    """Return what of a plant's state a law reads: alpha, and the speed dalpha/dt / k."""
    outputs = np.zeros((2, len(model.plant.Gamma)))
    outputs[0, 0], outputs[1, 1] = 1.0, 1.0 / model.stiffness
    return outputs


def contact_loop(law: LinearLaw, model: LoopModel, ratio: float = 1.0) -> Matrix:
    """
    Return the matrix of one period of a law on a contact of P04 eq. 32, with no command.

    Of the state [x of the plant, x of the law].

    Parameters
    ----------
    law, model
        The law, and the contact that it is designed for.
    ratio
        True over modelled stiffness.

    """
    k = ratio * model.stiffness
    plant = delayed_plant(k, model.damping_rate, model.input_delay, model.period)
    rows = _readings(replace(model, plant=plant, stiffness=k))
    return np.block([
        [plant.Phi + np.outer(plant.Gamma, law.D[0, READ] @ rows),
         np.outer(plant.Gamma, law.C[0])],
        [law.B[:, READ] @ rows, law.A]])


def input_rms(law: LinearLaw, model: LoopModel, noise_variance: float) -> float:
    """Return the rms of u that white noise of a variance [N^2] in alpha causes [m/s^2]."""
    loop, plant = contact_loop(law, model), model.plant
    entering = np.concatenate([plant.Gamma * law.D[0, 0], law.B[:, 0]])
    if not entering.any():
        return 0.0
    P = solve_discrete_lyapunov(loop, noise_variance * np.outer(entering, entering))
    output = np.concatenate([law.D[0, READ] @ _readings(model), law.C[0]])
    return math.sqrt(float(output @ P @ output) + noise_variance * law.D[0, 0] ** 2)


def rise_time(law: LinearLaw, model: LoopModel, ratio: float = 1.0) -> float:
    """Return when the force first passes 63 % of a step of the command [s]; infinite if never."""
    loop = contact_loop(law, model, ratio)
    k = ratio * model.stiffness
    plant = delayed_plant(k, model.damping_rate, model.input_delay, model.period)
    entering = np.concatenate([plant.Gamma * law.D[0, 1], law.B[:, 1]])
    state = np.zeros(len(loop))
    for tick in range(round(LONGEST_RISE / model.period)):
        if state[0] > 0.63:
            return tick * model.period
        state = loop @ state + entering
    return math.inf


def margins_of(law: LinearLaw, model: LoopModel) -> Margins:
    """
    Return the margins of a force law on the contact that it is designed for.

    Parameters
    ----------
    law
        For an active observer, as from `steady_law`.
    model
        Contact, delay and damping.

    """
    plant = control.ss(
        model.plant.Phi, model.plant.Gamma[:, None], _readings(model), np.zeros((2, 1)),
        model.period)
    feedback = control.ss(law.A, law.B[:, READ], law.C[:1], law.D[:1, READ], model.period)
    frequencies = np.geomspace(LOWEST, math.pi / model.period, POINTS)
    response = control.frequency_response(-1.0 * feedback * plant, frequencies)
    gain, phase, _, _, crossover, _ = control.stability_margins(response)
    phase = math.radians(float(phase)) if np.isfinite(phase) else math.inf
    crossover = float(crossover) if np.isfinite(crossover) else 0.0

    softest, stiffest = stable_ratios(law, model)
    return Margins(
        gain=float(gain), phase=phase, delay=phase / crossover if crossover else math.inf,
        crossover=crossover, softest=softest, stiffest=stiffest)


def stable_ratios(law: LinearLaw, model: LoopModel) -> tuple[float, float]:
    """Return from which to which true over modelled stiffness a force law is stable."""
    def stable(ratio: float) -> bool:
        return spectral_radius(contact_loop(law, model, ratio)) < 1.0 + 1e-9

    down = last_stable(lambda ratio: stable(1.0 / ratio), RATIOS, 1e-3)[0]
    return 1.0 / down if down else math.inf, last_stable(stable, RATIOS, 1e-3)[0]
