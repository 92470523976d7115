"""The simulation in a process of its own: commanded, refused, killed."""

from __future__ import annotations

import os
import signal

from multicontact_control.errors import MulticontactError, RunError
from multicontact_control.experiment.scenario import resolve
from multicontact_control.view import source
from multicontact_control.view.embedded import EmbeddedSource
import numpy as np
import pytest
from ros_graph import wait_for


def until(shown, condition, what):
    """Return the first snapshot of which a condition is true."""
    return wait_for(lambda: next(filter(condition, shown.poll()), None), what)


def test_embedded_simulation_presses_refuses_and_reports_its_death():
    shown = EmbeddedSource(resolve('paper', plant='rigid'))
    try:
        until(shown, lambda _: True, 'samples')
        shown.command(source.FORCES, table=8.0, board=6.0)
        snapshot = until(shown, lambda found: set(found.states) == {'holding'} and (
            np.abs(found.measured - (8.0, 6.0)) < 0.5).all(), 'the forces')
        assert snapshot.commanded == {'table': 8.0, 'board': 6.0}
        with pytest.raises(MulticontactError, match='0 or 3 to 30 N, found 40 N'):
            shown.command(source.FORCES, table=40.0)
        with pytest.raises(MulticontactError, match='a recording'):
            shown.command(source.SEEK, time=1.0)
        os.kill(shown.pid, signal.SIGKILL)
        with pytest.raises(RunError, match='the simulation has ended: killed by signal 9'):
            until(shown, lambda _: False, 'the end')
        with pytest.raises(RunError, match='killed by signal 9'):
            shown.command(source.STOP)
    finally:
        shown.close()
