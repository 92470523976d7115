"""A wrench that comes late: it reads what the torques have shown before."""

from __future__ import annotations

from multicontact_control.control.arm import WRENCH
from multicontact_control.records import Joint, Records
import numpy as np

LIKENESS = 0.95  # how much of what passed is alike over the joints, at least
LEAST_CHANGE = 0.2  # of J^T f over a threshold
LEAST_LAG = 0.01  # s


def explain_lag(joints: Records[Joint]) -> str:
    """
    Return what says that the wrench comes late, once a collision has passed; else empty.

    A residual is then J^T (f(t) - f(t - tau)), which passes when the force stays; the integral of
    it is tau times the change of J^T f, with the same tau in every joint. `joints` are records of
    `JOINT`, shape (n,).
    """
    watch = joints['watch']
    statistics = watch['residual_statistics']
    weights = 1.0 / watch['threshold']
    areas = statistics['residual_integral'] * weights
    changes = (
        statistics['regressor'][:, WRENCH] - statistics['calm_wrench_torque']
    ) * weights
    if not np.abs(changes).max() > LEAST_CHANGE:
        return ''
    lag = (areas @ changes) / (changes @ changes)
    likeness = lag * (areas @ changes) / (areas @ areas)
    if lag < LEAST_LAG or likeness < LIKENESS:
        return ''
    return (
        f'the wrench reads what the torques have shown about {1e3 * lag:.0f} ms before: check '
        'what delays or filters it on its way, and what its stamps are of'
    )
