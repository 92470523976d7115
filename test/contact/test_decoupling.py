"""Three contacts with overlapping lever arms: what couples them, what a unit of length does."""

from dataclasses import dataclass

from contact_space import allocate_force, contact_normals
from contact_space import projections as projections_of
from multicontact_control.contact.geometry import operational_stiffness
import numpy as np
import pytest

STIFFNESS = np.array([6000.0, 4000.0, 9000.0])  # of the three surfaces [N/m]
INPUTS = np.array([0.7, -0.4, 1.1])  # a_i [m/s^2]


@dataclass(frozen=True)
class World:
    """The same contacts and the same body, with lengths in metres or in 1/scale of them."""

    scale: float

    @property
    def N(self):
        """Return N of a floor and two slopes, all pushed by one tool: N_i^T N_j is nowhere 0."""
        normals = np.array([[0.0, 0.0, -1.0], [0.0, 0.8, -0.6], [0.6, 0.0, -0.8]])
        levers = np.array([[0.05, -0.02, 0.24], [0.03, -0.16, 0.19], [-0.1, 0.06, 0.2]])
        return contact_normals(normals, self.scale * levers)

    @property
    def Lambda(self):
        """Task inertia, so that a^T Lambda a / scale^2 is the same number in every unit."""
        root = np.random.default_rng(26).standard_normal((6, 6))
        metric = np.diag([4.0] * 3 + [0.1] * 3) + 0.02 * root @ root.T
        inverse = np.diag([1.0 / self.scale] * 3 + [1.0] * 3)  # of twists in this unit
        return self.scale ** 2 * inverse @ metric @ inverse


METRES, MILLIMETRES = World(1.0), World(1000.0)


@pytest.fixture(params=['euclidean', 'inertia'])
def projections(request):
    world = METRES
    if request.param == 'euclidean':
        return projections_of(world.N)
    return projections_of(world.N, world.Lambda)


def _force_acceleration(projections, allocation):
    """Return d^2 alpha / dt^2 of springs at rest whose tool begins to accelerate."""
    N = METRES.N
    return STIFFNESS * (N.T @ projections.Omega_c @ allocate_force(N, INPUTS, allocation))


def test_decoupled_allocation_gives_every_force_its_own_acceleration(projections):
    """alpha_ddot_i = k_i a_i to 1e-9, whatever the geometry and the metric."""
    np.testing.assert_allclose(
        _force_acceleration(projections, 'decoupled'), STIFFNESS * INPUTS, rtol=1e-9)


def test_paper_allocation_couples_the_forces(projections):
    """alpha_ddot = K_env N^T N alpha*: not k_s,i alpha*_i of P04 eq. 31, by tens of percent."""
    found = _force_acceleration(projections, 'paper')
    N = METRES.N
    np.testing.assert_allclose(found, STIFFNESS * (N.T @ N @ INPUTS), rtol=1e-9)
    k_s = STIFFNESS * np.diag(N.T @ N)
    assert (np.abs(found - k_s * INPUTS) > 0.1 * np.abs(k_s * INPUTS)).all()


def test_paper_allocation_decouples_orthogonal_contacts():
    """With N^T N diagonal eq. 31 holds: the paper's own two contacts, arranged so."""
    normals = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    levers = np.array([[0.0, 0.0, 0.24], [0.0, -0.16, 0.19]])
    N = contact_normals(normals, levers)
    k_s = [operational_stiffness(6000.0, n, l) for n, l in zip(normals, levers)]
    np.testing.assert_allclose(
        6000.0 * N.T @ allocate_force(N, INPUTS[:2], 'paper'), k_s * INPUTS[:2], rtol=1e-12)


@pytest.mark.parametrize('metric', ['euclidean', 'inertia'])
def test_unit_of_length_leaves_decoupled_contact_accelerations(metric):
    accelerations = {}
    for world in (METRES, MILLIMETRES):
        projections = (projections_of(world.N) if metric == 'euclidean'
                       else projections_of(world.N, world.Lambda))
        for allocation in ('decoupled', 'paper'):
            f_c = allocate_force(world.N, world.scale * INPUTS, allocation)
            accelerations[allocation, world] = (
                world.N.T @ projections.Omega_c @ f_c / world.scale)  # back in m/s^2
    for world in (METRES, MILLIMETRES):
        np.testing.assert_allclose(accelerations['decoupled', world], INPUTS, rtol=1e-9)
    assert np.abs(
        accelerations['paper', MILLIMETRES] / accelerations['paper', METRES] - 1.0).min() > 1.0
