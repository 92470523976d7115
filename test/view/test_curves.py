from multicontact_control.view.curves import MOST_POINTS, PointHistory
from multicontact_control.view.source import POINTS, RATE
import numpy as np
import pytest


@pytest.mark.parametrize('window', [40.0, 60.0])
def test_history_keeps_a_peak_in_every_window(window):
    count = round(60.0 * RATE * POINTS)
    points = np.ones((count, 7))
    points[:, 0] = np.arange(count) / (RATE * POINTS)
    peak = count - 1766
    points[peak, 1] = 9.0
    points[2000, 2] = np.nan
    history = PointHistory(7)
    for part in np.array_split(points, 100):
        history.add_points(part)
    drawn = history.select_last_seconds(window)
    times = drawn[:, 0]
    values = drawn[:, 1]
    place = times[values.argmax()]
    assert len(drawn) <= 1.2 * MOST_POINTS
    assert (np.diff(times) > 0.0).all()
    assert values.max() == 9.0
    assert place == pytest.approx(points[peak, 0], abs=0.5)
    assert (drawn[:, 2:] == 1.0).all()
