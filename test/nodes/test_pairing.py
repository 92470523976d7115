"""Pairing joint state and wrench by stamp."""

from multicontact_control.nodes.messages import JointReading, WrenchReading
from multicontact_control.nodes.pairing import SamplePairing
import numpy as np
import pytest


def joints(stamp):
    return JointReading(stamp, np.full(2, float(stamp)), np.zeros(2))


def wrench(stamp):
    return WrenchReading(stamp, np.full(6, float(stamp)))


@pytest.mark.parametrize('joints_first', [True, False])
def test_pairing_gives_each_pair_once_in_either_order(joints_first):
    pairing = SamplePairing()
    for stamp in (1, 2, 3):
        if joints_first:
            assert pairing.add_joints(joints(stamp)) is None
            pair = pairing.add_wrench(wrench(stamp))
        else:
            assert pairing.add_wrench(wrench(stamp)) is None
            pair = pairing.add_joints(joints(stamp))
        assert pair is not None
        assert (pair.stamp, pair.q[0], pair.wrench_sensor[0]) == (stamp, stamp, stamp)
    assert pairing.unpaired == 0


def test_pairing_never_mixes_stamps():
    pairing = SamplePairing()
    assert pairing.add_joints(joints(1)) is None
    assert pairing.add_wrench(wrench(2)) is None
    assert pairing.add_wrench(wrench(3)) is None
    pair = pairing.add_joints(joints(3))
    assert pair is not None
    assert pair.stamp == 3
    assert pairing.unpaired == 2
