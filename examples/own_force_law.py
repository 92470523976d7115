"""
A force law of your own beside the active observer (aob), simulated in this process.

``python examples/own_force_law.py`` prints how well each holds 10 and 15 N, at rest and sliding.
A package of yours makes the law known to every command and node by an entry point instead::

    [project.entry-points.'multicontact_control.force_laws']
    placed = 'own_force_law:LAW'
"""

from multicontact_control.config import ForceConfig
from multicontact_control.force.laws.design import LawDesign, LoopModel
from multicontact_control.force.laws.linear import (
    ALPHA_DES,
    ALPHA_EST,
    ALPHA_MEAS,
    discretise_law,
    LinearLaw,
    make_zero_law,
    P_EST,
    SPEED,
    U,
)
from multicontact_control.registry import register_force_law
from multicontact_control.runs.closed_loop import run_in_process
from multicontact_control.runs.scenario import resolve
import numpy as np


def design_placed(model: LoopModel, force: ForceConfig) -> LinearLaw:
    """
    Place the three poles of force, speed and integral at -w, with w = 1 / (2 time_constant).

    alpha = k z and z'' = u - K_2 z', with u = a int e dt + b e - c z' and e = alpha_des - alpha,
    has the poles of s^3 + (K_2 + c) s^2 + k b s + k a = (s + w)^3.
    """
    w = 0.5 / force.time_constant
    a = w**3 / model.stiffness
    b = 3.0 * w**2 / model.stiffness
    c = 3.0 * w - model.damping_rate
    integral = 0  # the only state: a int e dt [m/s^2]
    law = make_zero_law(1)
    law.B[integral, [ALPHA_DES, ALPHA_MEAS]] = a, -a
    law.C[U, integral] = 1.0
    law.D[U, [ALPHA_DES, ALPHA_MEAS, SPEED]] = b, -b, -c
    law.D[ALPHA_EST, ALPHA_MEAS] = 1.0
    # At rest the integral is what compensates a disturbance.
    law.C[P_EST, integral] = -1.0
    law.start_disturbance[integral] = -1.0
    return discretise_law(law, model.period)


LAW = LawDesign(
    design_placed, reads=('time_constant',), speed_exponents={'time_constant': -1}
)
register_force_law('placed', f'{__name__}:LAW')


def main(duration: float = 15.0) -> None:
    """Run the scenario `quick` for a duration [s] with either law, and print its errors."""
    print('law     contact  rest [N]  sliding [N]')
    for name in ('aob', 'placed'):
        setup = resolve(
            'quick',
            preset='best',
            duration=duration,
            controller={'force': {'law': name}},
        )
        data = run_in_process(setup, supervised=True).data
        square = (data.alpha_true - data.alpha_des) ** 2
        rest = (data.time >= 5.0) & (data.time < 6.5)
        at_rest = np.sqrt(square[rest].mean(axis=0))
        sliding = np.sqrt(square[data.time >= 8.5].mean(axis=0))
        for contact, *errors in zip(data.contact_names, at_rest, sliding):
            print(f'{name:7} {contact:8} {errors[0]:8.3f}  {errors[1]:11.3f}')


if __name__ == '__main__':
    main()
