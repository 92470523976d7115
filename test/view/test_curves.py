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
    points[peak, 1], points[2000, 2] = 9.0, np.nan
    history = PointHistory(7)
    for part in np.array_split(points, 100):
        history.add_points(part)
    drawn = history.select_last_seconds(window)
    assert len(drawn) <= 1.2 * MOST_POINTS and (np.diff(drawn[:, 0]) > 0.0).all()
    assert drawn[drawn[:, 1].argmax(), 1] == 9.0
    assert abs(drawn[drawn[:, 1].argmax(), 0] - points[peak, 0]) < 0.5
    assert (drawn[:, 2:] == 1.0).all()
