"""
All force loops of an arm together: linear, sampled, with what the paper's model leaves out.

`linear_loop` is about one contact. Here the contacts act on each other through the arm, and the
sensor weighs the tool, which on the PUMA decides as much as the rest.

P04 eq. 32 takes the contact for k e^(-s T_d) / (s (s + K_2)). On the arm of eqs 23-26 more is
added to it: the contact force itself accelerates the arm, and only its delayed estimate
is fed forward against it (eq. 24); the damping K_2 acts on the measured motion, and so is delayed
too; the surface damps; and the wrist sensor weighs the inertia of the tool with the contact force.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.errors import ConfigError
from multicontact_control.force.observer import ObserverDesign
import numpy as np
from scipy.linalg import block_diag, expm


@dataclass(frozen=True)
class LinearArmPlant:
    """
    The plant that the force loops meet.

    Attributes
    ----------
    mobility
        B = N^T Lambda^-1 N: acceleration of the contact points along their normals for a unit
        of contact force, shape (r, r) [1/kg]. Zeros give the plant of the paper.
    stiffness, damping
        Of the surfaces, shape (r,) [N/m], [N s/m].
    tool_inertia
        What the sensor reads along the normals for a unit of acceleration of the contact points,
        shape (r, r) [kg].
    delay_ticks
        Periods from a sample to the torque that answers it.

    """

    mobility: Matrix
    stiffness: Vector
    damping: Vector
    tool_inertia: Matrix
    delay_ticks: int = 1
    contacts: int = field(init=False)

    def __post_init__(self) -> None:
        square = (len(self.stiffness), len(self.stiffness))
        require_shape('mobility', self.mobility, square)
        require_shape('tool_inertia', self.tool_inertia, square)
        require_shape('damping', self.damping, (len(self.stiffness),))
        if self.delay_ticks < 0:
            raise ConfigError('delay_ticks', 'a whole number >= 0', self.delay_ticks)
        object.__setattr__(self, 'contacts', len(self.stiffness))


def closed_loop(
    surroundings: LinearArmPlant, observer: ObserverDesign, kalman_gain: Vector,
    damping_rate: float, period: float,
) -> Matrix:
    """
    Return the matrix of one period of all force loops together.

    The state holds depth and speed of every contact, the accelerations under way, and each
    contact's observer after its correction; the commanded forces are 0.

    Parameters
    ----------
    surroundings
        What the loops meet.
    observer
        Model and feedback, the same for every contact.
    kalman_gain
        K, held, as from `linear_loop.steady_gain`.
    damping_rate
        K_2 on the measured motion [1/s].
    period
        h [s].

    Returns
    -------
    Matrix
        Square; the loops are stable if all its eigenvalues are inside the unit circle.

    """
    r, d, n = surroundings.contacts, surroundings.delay_ticks, observer.Gamma.shape[0]
    stiffness, damping = np.diag(surroundings.stiffness), np.diag(surroundings.damping)
    A = np.block([
        [np.zeros((r, r)), np.eye(r)],
        [-surroundings.mobility @ stiffness, -surroundings.mobility @ damping]])
    exponential = expm(np.block([
        [A, np.vstack([np.zeros((r, r)), np.eye(r)])],
        [np.zeros((r, 3 * r))]]) * period)
    motion, drive = exponential[:2 * r, :2 * r], exponential[:2 * r, 2 * r:]
    force = np.hstack([stiffness, damping])  # alpha of depth and speed
    speed = np.hstack([np.zeros((r, r)), np.eye(r)])
    gain = kalman_gain[:, None]
    C = np.zeros((1, n))
    C[0, 0] = 1.0
    predict = block_diag(*[(np.eye(n) - gain @ C) @ observer.Phi_c] * r)
    correct = block_diag(*[gain] * r)
    estimate = block_diag(*[C] * r)
    feedback = block_diag(*[observer.feedback[None, :]] * r)
    # What answers a sample: w = -L x_est - K_2 v + B alpha_est.
    answer = np.hstack([-damping_rate * speed, np.zeros((r, d * r)),
                        -feedback + surroundings.mobility @ estimate])
    size = 2 * r + d * r + n * r
    now = answer if d == 0 else np.eye(size)[2 * r:3 * r]
    loop = np.zeros((size, size))
    loop[:2 * r] = drive @ now
    loop[:2 * r, :2 * r] += motion
    for i in range(d - 1):
        loop[2 * r + i * r:2 * r + (i + 1) * r] = np.eye(size)[2 * r + (i + 1) * r:
                                                               2 * r + (i + 2) * r]
    if d:
        loop[2 * r + (d - 1) * r:2 * r + d * r] = answer
    inertia = surroundings.tool_inertia
    reading = (force - inertia @ surroundings.mobility @ force) @ loop[:2 * r] + inertia @ now
    loop[2 * r + d * r:] = correct @ reading
    loop[2 * r + d * r:, 2 * r + d * r:] += predict
    return loop


def spectral_radius(matrix: Matrix) -> float:
    """Return the largest magnitude of the eigenvalues."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())
