"""The compiled pass of a sample as a whole."""

import inspect

from multicontact_control.dynamics.terms import ModelTerms
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
from multicontact_control.supervision.input_checks import check_inputs
from multicontact_control.supervision.tick_records import TickRecords
from numba.core.runtime import _nrt_python, rtsys
import pytest

PRESSED = 2500  # ticks, after which both contacts are


@pytest.mark.parametrize(
    ('scenario', 'preset'), [('quick', 'best'), ('quick', 'adaptive'), ('edge', 'best')]
)
def test_tick_allocates_nothing_but_what_hands_over_its_arguments(scenario, preset):
    """Of each array that Python hands over, numba makes a header; also near a singular posture."""
    loop = ClosedLoop(resolve(scenario, preset=preset, plant='rigid'))
    for _ in range(PRESSED):
        loop.advance()
    assert loop.control.output.answer['active'].all()
    arrays = (
        len(inspect.signature(check_inputs).parameters)
        + len(TickRecords._fields)
        + len(ModelTerms._fields)
        + 1  # the motion
    )
    _nrt_python.memsys_enable_stats()
    for _ in range(20):
        inputs = loop.inputs()
        before = rtsys.get_allocation_stats().alloc
        loop.command = loop.control.step(inputs)
        assert rtsys.get_allocation_stats().alloc - before == arrays
        loop.act()
    loop.close()
