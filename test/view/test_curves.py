from multicontact_control.view.curves import DRAWN, History
from multicontact_control.view.source import CurveLayout, POINTS, RATE
import numpy as np
import pytest

LAYOUT = CurveLayout(1, 1)
COUNT = round(60.0 * RATE * POINTS)


@pytest.fixture
def points():
    """Return a minute of ones, of which the first curve has a single peak."""
    points = np.ones((COUNT, LAYOUT.width))
    points[:, 0] = np.arange(COUNT) / (RATE * POINTS)
    points[1234, 1] = 9.0
    points[2000, 2] = np.nan
    return points


@pytest.mark.parametrize('window', [40.0, 60.0])
def test_history_keeps_a_peak_in_every_window(points, window):
    history = History(LAYOUT)
    for part in np.array_split(points, 100):
        history.add(part)
    drawn = history.last(window)
    assert len(drawn) <= 1.2 * DRAWN and (np.diff(drawn[:, 0]) > 0.0).all()
    assert drawn[drawn[:, 1].argmax(), 1] == 9.0
    assert abs(drawn[drawn[:, 1].argmax(), 0] - points[1234, 0]) < 0.5
    assert (drawn[:, 2:] == 1.0).all()
