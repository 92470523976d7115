"""The PUMA's motors and limits against the published table; its dynamics: test/dynamics."""

from pathlib import Path

from multicontact_control.config import read_yaml
import numpy as np
import pytest

TABLE = read_yaml(Path(__file__).parents[1] / 'data' / 'puma560.yaml')


def test_motors_and_limits_are_the_published_ones_at_the_joint(puma):
    """Jm G^2, b G^2 and F |G|; the armature is published rounded, too."""
    for number, (link, motor) in enumerate(zip(puma.links, TABLE['motors'], strict=True)):
        gear = abs(motor['gear'])
        positive, negative = motor['coulomb']
        np.testing.assert_allclose(
            [link.armature, link.viscous, link.coulomb_positive, link.coulomb_negative],
            [motor['rotor_inertia'] * gear ** 2, motor['viscous'] * gear ** 2,
             positive * gear, -negative * gear], rtol=1e-12)
        assert link.armature == pytest.approx(TABLE['armature'][number], abs=6e-4)
        assert link.torque_limit == TABLE['torque_limit'][number]
        assert link.speed_limit == TABLE['speed_limit'][number]
        np.testing.assert_allclose(
            np.degrees([link.lower, link.upper]), TABLE['position_limit_deg'][number])
