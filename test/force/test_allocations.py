"""Nothing is allocated between a sample and its answer."""

from multicontact_control.force.force_law import (
    answer_contact_forces,
    FORCE_SPACE,
    make_force_laws,
)
from multicontact_control.records import CONTACT, CONTROL
from multicontact_control.runs.scenario import resolve
from numba import njit
from numba.core.runtime import _nrt_python, rtsys
import numpy as np
import pytest


@njit
def answer_again(count, laws, contacts, controls, inputs, spaces):
    for k in range(count):
        contacts[0].alpha_meas = 5.0 + k % 20
        answer_contact_forces(laws, contacts, controls[0], inputs, spaces[0])


@pytest.mark.parametrize('preset', ['paper', 'adaptive', 'laws/dob'])
def test_force_laws_allocate_nothing(preset):
    """As much for one answer as for many: what their arguments take."""
    config = resolve('quick', preset=preset).controller
    laws = make_force_laws(config)
    contacts = np.zeros(len(config.columns), dtype=CONTACT)
    control = np.zeros(1, dtype=CONTROL)
    space = np.zeros(1, dtype=FORCE_SPACE)
    contacts['answer']['active'], control['measured'] = True, True
    contacts['alpha_meas'] = 5.0
    contacts['noise_variance'] = 0.6
    contacts['mobility'] = 1.0
    contacts['N'] = np.eye(6)[2]
    control['frame']['twist'] = [0.01, 0.0, 0.02, 0.0, 0.0, 0.0]
    control['law']['period'] = config.period
    control['law']['K_2'] = config.force.damping_rate
    inputs = np.zeros(len(contacts))
    allocations = []
    _nrt_python.memsys_enable_stats()
    for count in (1, 1, 100):  # the first compiles
        before = rtsys.get_allocation_stats().alloc
        answer_again(count, laws, contacts, control, inputs, space)
        allocations.append(rtsys.get_allocation_stats().alloc - before)
    assert allocations[1] == allocations[2]
    assert np.isfinite(inputs).all()
