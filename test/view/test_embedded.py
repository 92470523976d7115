"""The simulation in a process of its own: commanded, refused, killed."""

from __future__ import annotations

import os
import signal
import time

from multicontact_control.errors import MulticontactError, RunError
from multicontact_control.experiment.scenario import resolve
from multicontact_control.view import source
from multicontact_control.view.embedded import EmbeddedSource
import numpy as np
import pytest

PATIENCE = 120.0  # s; a slow machine may be late


def until(shown, condition, what):
    """Return the first snapshot of which a condition is true."""
    give_up = time.monotonic() + PATIENCE
    while time.monotonic() < give_up:
        for snapshot in shown.poll():
            if condition(snapshot):
                return snapshot
        time.sleep(0.01)
    raise AssertionError(f'{what}: did not happen')


def test_it_presses_refuses_with_words_and_its_death_is_told():
    shown = EmbeddedSource(resolve('paper', plant='rigid'))
    try:
        until(shown, lambda _: True, 'samples')
        assert shown.command(source.FORCES, table=8.0, board=6.0) == 'table 8 N, board 6 N'
        snapshot = until(shown, lambda found: set(found.states) == {'holding'} and (
            np.abs(found.measured - (8.0, 6.0)) < 0.5).all(), 'the forces')
        assert snapshot.commanded == {'table': 8.0, 'board': 6.0}
        with pytest.raises(MulticontactError, match='0 or 3 to 30 N, found 40 N'):
            shown.command(source.FORCES, table=40.0)
        with pytest.raises(MulticontactError, match='a recording'):
            shown.command(source.SEEK, time=1.0)
        # Whoever does not look keeps nothing waiting, and finds the newest.
        late = shown.poll()[-1:] or [snapshot]
        time.sleep(4.0)
        found = shown.poll()
        assert found[-1].time > late[0].time + 1.0
        os.kill(shown.pid, signal.SIGKILL)
        with pytest.raises(RunError, match='the simulation has ended: killed by signal 9'):
            until(shown, lambda _: False, 'the end')
        with pytest.raises(RunError, match='killed by signal 9'):
            shown.command(source.STOP)
    finally:
        shown.close()
