"""Areas of a certified region, its strips, and the ranges it may be asked for."""

import math

from multicontact_control.commissioning.certified_region import (
    CertifiedBox,
    CertifiedStrip,
    measure_share,
    require_range,
    SimulatedEdges,
    split_delays,
)
from multicontact_control.errors import ConfigError
from multicontact_control.force.certificate import Certificate
import numpy as np
from numpy.testing import assert_allclose
import pytest


def test_share_is_that_of_the_areas_by_the_logarithm_of_the_ratio():
    certificate = Certificate(np.zeros(1), np.eye(1)[None], 0.99)
    box = CertifiedBox((0.1, 1.0), (0.0, 0.001), certificate)
    strips = [
        CertifiedStrip(box.delay, [box], SimulatedEdges(10.0, 1.0)),
        CertifiedStrip((0.001, 0.002), [], SimulatedEdges(0.0, 0.0)),
    ]
    share = measure_share(strips)
    assert_allclose(share.of_held, 0.5)
    assert_allclose(share.of_attacked, 1.0)


def test_strips_of_delays_cover_a_range_and_cross_no_period():
    strips = split_delays((0.0015, 0.0061), 0.002)
    assert strips[0][0] == 0.0015
    assert strips[-1][1] == 0.0061
    for (_, last), (first, _) in zip(strips[:-1], strips[1:]):
        assert last == first
    for first, last in strips:
        assert math.floor(first / 0.002 + 1e-9) == math.ceil(last / 0.002 - 1e-9) - 1


@pytest.mark.parametrize(
    'limits', [(2.0, 1.0), (-1.0, 1.0), (0.0, math.inf), (math.nan, 1.0)]
)
def test_range_that_does_not_rise_from_0_is_refused(limits):
    with pytest.raises(ConfigError):
        require_range('delay', limits)


def test_range_from_0_is_refused_where_0_is_impossible():
    require_range('tool', (0.0, 1.0))
    with pytest.raises(ConfigError):
        require_range('mobility', (0.0, 1.0), positive=True)
