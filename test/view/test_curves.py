"""What the curves of the live page are drawn from."""

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
    return points


@pytest.mark.parametrize('window', [40.0, 60.0])
def test_a_peak_is_drawn_in_every_window_that_holds_it(points, window):
    history = History(LAYOUT)
    for part in np.array_split(points, 100):
        history.add(part)
    drawn = history.last(window)
    assert len(drawn) <= DRAWN + 2
    assert drawn[drawn[:, 1].argmax(), 1] == 9.0
    assert abs(drawn[drawn[:, 1].argmax(), 0] - points[1234, 0]) < 0.5
    assert (drawn[:, 2:] == 1.0).all()


def test_few_points_are_drawn_as_they_are(points):
    history = History(LAYOUT)
    history.add(points[:100])
    np.testing.assert_array_equal(history.last(60.0), points[:100])
    history.add(points[:10])  # time goes back: anew
    assert len(history.last(60.0)) == 10
