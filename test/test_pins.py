"""What a redesign must not change; see `pins.py`."""

import json

from numpy.testing import assert_allclose
from pins import (
    differences,
    FILE,
    SETUPS,
    STUDIES,
    study,
    SUMMARIES,
    summary,
    trajectory,
)
import pytest

PINNED = json.loads(FILE.read_text())


@pytest.mark.slow
@pytest.mark.parametrize('name', SETUPS)
def test_trajectory_is_pinned(name):
    """Bit for bit; on a processor that rounds otherwise, within 1e-6 of the torque limits."""
    pinned = PINNED['trajectories'][name]
    now = trajectory(name)
    if pinned['sha256'] != now['sha256']:
        assert_allclose(
            now['torque_share'], pinned['torque_share'], rtol=0.0, atol=1e-6
        )


@pytest.mark.slow
@pytest.mark.parametrize('name', SUMMARIES)
def test_summary_is_pinned(name):
    assert differences(PINNED['summaries'][name], summary(name)) == []


@pytest.mark.nightly
@pytest.mark.parametrize('name', STUDIES)
def test_study_table_is_pinned(name):
    assert differences(PINNED['studies'][name], study(name)) == []
