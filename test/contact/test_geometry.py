"""N, T and k_s against the paper's example and their defining properties."""

from contact_space import contact_coordinates, contact_normals
import equations
from equations import free_motions
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from multicontact_control.contact.geometry import operational_stiffness
import numpy as np
import pytest

vectors = arrays(float, (3,), elements=st.floats(-2.0, 2.0, allow_subnormal=False))
directions = vectors.filter(lambda v: np.linalg.norm(v) > 0.1).map(
    lambda v: v / np.linalg.norm(v))


@settings(deadline=None)
@given(st.data(), st.integers(0, 4))
def test_contact_normals_are_those_of_the_equation(data, count):
    normals = np.array([data.draw(directions) for _ in range(count)]).reshape(-1, 3)
    levers = np.array([data.draw(vectors) for _ in range(count)]).reshape(-1, 3)
    np.testing.assert_allclose(contact_normals(normals, levers),
                               equations.contact_normals(normals, levers), atol=1e-14)


def test_operational_stiffness_of_the_planar_example():
    """k_s = k_env (1 + l^2 sin^2 gamma) (P04 eq. 21)."""
    l, gamma = 0.7, 0.6
    normal = np.array([0.0, 1.0, 0.0])
    lever = l * np.array([np.sin(gamma), np.cos(gamma), 0.0])
    expected = 6000.0 * (1.0 + (l * np.sin(gamma)) ** 2)
    assert operational_stiffness(6000.0, normal, lever) == pytest.approx(expected, rel=1e-14)


def test_contact_coordinates_recovers_forces_whatever_the_free_part():
    """N^+ (N alpha + T beta) = alpha (P04 eq. 7)."""
    rng = np.random.default_rng(0)
    normals = rng.standard_normal((3, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    N = contact_normals(normals, rng.standard_normal((3, 3)))
    alpha = rng.standard_normal(3)
    wrench = N @ alpha + free_motions(N) @ rng.standard_normal(3)
    np.testing.assert_allclose(contact_coordinates(N, wrench), alpha, atol=1e-12)
