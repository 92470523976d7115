"""The active observer (AOB) of one contact: a Kalman filter with an input-disturbance state."""

from __future__ import annotations

from math import comb

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.errors import ConfigError
from multicontact_control.force.kalman import kalman_update
from multicontact_control.force.plant_model import ForceLoop
import numpy as np

MAX_ORDER = 3


class ActiveObserver:
    """
    State estimate and feedback of one force loop (P04 eqs 34-41).

    The state is [x_r, p_k, p_{k-1}, ...]: that of the delayed plant and `order` active states,
    the newest of which is the disturbance p that adds to the input. Order 1 is the paper's; in
    general p_k = sum_j (-1)^(j+1) binom(n, j) p_{k-j} + noise, a polynomial of degree n - 1.
    Order 0 leaves plain pole placement on the Kalman estimate.

    Parameters
    ----------
    loop
        The plant and its state feedback.
    order
        Order of the active state, 0 to 3.
    process_noise
        Q = process_noise I over x_r and the newest p; older copies of p are exact.
    initial_covariance
        P_0 = initial_covariance I.

    Attributes
    ----------
    x_est, P
        State estimate, shape (n + order,), and its covariance; each update overwrites them.
    innovation, prior_variance, variance_used
        Of the last update: y - C x_1 [N], C P_1 C^T and R [N^2]. All 0 after a reset and for
        the sample that follows it, from which nothing could be predicted.

    Raises
    ------
    ConfigError
        If `order` is out of range or a covariance is not positive.

    """

    def __init__(
        self, loop: ForceLoop, *, order: int = 1, process_noise: float = 1e-3,
        initial_covariance: float = 1e-3,
    ) -> None:
        if not 0 <= order <= MAX_ORDER:
            raise ConfigError('active_state_order', f'0 to {MAX_ORDER}', order)
        for name, value in (('process_noise', process_noise),
                            ('initial_covariance', initial_covariance)):
            if not value > 0.0:
                raise ConfigError(name, 'a positive number', value)
        self.loop = loop
        self.order = order
        n = loop.plant.Phi.shape[0]
        size = n + order
        Phi_p = active_state_matrix(order)
        self.Phi_n = np.zeros((size, size))  # open loop, eq. 41
        self.Phi_n[:n, :n] = loop.plant.Phi
        self.Phi_n[n:, n:] = Phi_p
        if order:
            self.Phi_n[:n, n] = loop.plant.Gamma
        self.Phi_c = np.zeros((size, size))  # closed loop, eq. 37
        self.Phi_c[:n, :n] = loop.closed_loop
        self.Phi_c[n:, n:] = Phi_p
        self.Gamma = np.concatenate([loop.plant.Gamma, np.zeros(order)])
        self.feedback = np.concatenate([loop.L, np.zeros(order)])  # [L_r 1] of eq. 36
        if order:
            self.feedback[n] = 1.0
        self.Q = np.zeros(size)  # diagonal of Q
        self.Q[:n + min(order, 1)] = process_noise
        self._P_0 = np.full(size, initial_covariance)
        self.reset()

    def reset(self, force: float = 0.0) -> None:
        """
        Forget everything and start from a force at rest.

        Parameters
        ----------
        force
            Measured force to start from [N].

        """
        self.x_est: Vector = np.zeros(self.Gamma.shape[0])
        self.x_est[0] = force
        self.P: Matrix = np.diag(self._P_0)
        self._command = 0.0
        self._fresh = True
        self.innovation = 0.0
        self.prior_variance = 0.0
        self.variance_used = 0.0

    def update(self, force: float, noise_variance: float) -> None:
        """
        Take in the force of this tick.

        Predicts from the tick before with the closed loop (eqs 37-38) and the covariance with
        the open one (eqs 40-41), then corrects by the Kalman gain (eq. 39).

        Parameters
        ----------
        force
            Measured alpha [N].
        noise_variance
            R_k [N^2].

        """
        if self._fresh:  # no prediction leads to the first sample
            self._fresh = False
            return
        self.innovation, self.prior_variance = kalman_update(
            self.x_est, self.P, self.Phi_c, self.Phi_n, self.Gamma, self.Q, self._command,
            force, noise_variance)
        self.variance_used = noise_variance

    def command(self, force_des: float) -> float:
        """
        Return the input that leads to the desired force.

        u_k = L_1 f_des - [L_r 1] [x_est; p_est] (P04 eq. 36).

        Parameters
        ----------
        force_des
            Desired alpha [N].

        Returns
        -------
        float
            Acceleration along the contact normal, without the damping K_2 [m/s^2].

        """
        self._command = float(self.feedback[0] * force_des)
        return self._command - float(self.feedback @ self.x_est)

    @property
    def force_est(self) -> float:
        """Estimated force alpha [N]."""
        return float(self.x_est[0])

    @property
    def force_rate_est(self) -> float:
        """Estimated rate of the force [N/s]."""
        return float(self.x_est[1])

    @property
    def disturbance_est(self) -> float:
        """Estimated input disturbance p [m/s^2], 0 without an active state."""
        return float(self.x_est[-self.order]) if self.order else 0.0


def active_state_matrix(order: int) -> Matrix:
    """
    Return the transition of [p_{k-1}, ..., p_{k-n}] to [p_k, ..., p_{k-n+1}].

    Parameters
    ----------
    order
        n; 1 gives the random walk of P04 eq. 34.

    Returns
    -------
    Matrix
        Shape (n, n).

    """
    matrix = np.zeros((order, order))
    for j in range(1, order + 1):
        matrix[0, j - 1] = (-1.0) ** (j + 1) * comb(order, j)
    for j in range(1, order):
        matrix[j, j - 1] = 1.0
    return matrix
