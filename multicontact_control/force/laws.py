"""The designs of the force laws, behind one registry: an active observer, and linear laws."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import Annotated, NamedTuple, Protocol

from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.config import ForceConfig
from multicontact_control.errors import ConfigError
from multicontact_control.force.observer import (
    design_observer,
    ObserverDesign,
    steady_gain,
)
from multicontact_control.force.plant import (
    delayed_plant,
    DelayedPlant,
    ForceLoop,
    place_poles,
)
from multicontact_control.records import (
    MAX_STATES,
    Record,
    record_dtype,
    Records,
)
import numpy as np
from scipy.linalg import solve, solve_discrete_are

INPUTS = ('alpha_meas', 'alpha_des', 'speed')  # y of a linear law, see `LinearLaw`
OUTPUTS = ('of_u', 'of_alpha', 'of_p')


class LinearRow(Record, Protocol):
    """What one state or output of a linear law has of its states and inputs: A or C, B or D."""

    x: Annotated[Vector, MAX_STATES]
    alpha_meas: float
    alpha_des: float
    speed: float


LINEAR_ROW = record_dtype(LinearRow)


class LinearDesign(Record, Protocol):
    """What a linear law works by."""

    states: int  # n
    of_state: Annotated[Records[LinearRow], MAX_STATES]  # x_(k+1) = A x_k + B y_k

    # C x_k + D y_k.
    of_u: LinearRow
    of_alpha: LinearRow
    of_p: LinearRow

    E: Annotated[Vector, MAX_STATES]  # added to x_(k+1) for 1 m/s^2 beyond the answer
    start_force: Annotated[Vector, MAX_STATES]  # state at touch, for 1 N that is felt

    # And for a known disturbance of 1 m/s^2.
    start_disturbance: Annotated[Vector, MAX_STATES]


LINEAR_DESIGN = record_dtype(LinearDesign)


class Linear(Record, Protocol):
    """
    A linear force law.

    From alpha_meas, alpha_des and the contact's speed to u, alpha_est and p_est.
    """

    design: LinearDesign

    # Acceleration that acted beyond the answer of the sample before [m/s^2].
    extra: float

    running: bool  # whether there was a sample before
    x: Annotated[Vector, MAX_STATES]  # state
    alpha: float  # estimated force [N]
    p_est: float  # disturbance that the law compensates [m/s^2]


LINEAR = record_dtype(Linear)


@dataclass(frozen=True, slots=True)
class LoopModel:
    """What a force law is designed for (P04 eq. 32)."""

    stiffness: float  # k [N/m]
    damping_rate: float  # K_2 [1/s]
    input_delay: float  # T_d [s]
    period: float  # h [s]

    @property
    def plant(self) -> DelayedPlant:
        """Return the delayed plant, discretised."""
        return delayed_plant(
            self.stiffness, self.damping_rate, self.input_delay, self.period
        )


@dataclass(frozen=True)
class LinearLaw:
    """
    A force law x_(k+1) = A x_k + B y_k + E extra_k, outputs = C x_k + D y_k.

    Its inputs y are the measured force alpha [N], the desired one [N] and the speed of the contact
    point INTO the surface [m/s]; `extra` acts beyond the answer [m/s^2]. Its outputs are the
    acceleration u [m/s^2], without the damping K_2, the estimate of alpha [N], and that of the
    disturbance p that it compensates [m/s^2]. The state at a touch is `start_force` for a felt
    force of 1 N, `start_disturbance` for a known disturbance of 1 m/s^2.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    E: Vector
    start_force: Vector
    start_disturbance: Vector

    def __post_init__(self) -> None:
        n = self.A.shape[0]
        if n > MAX_STATES:
            raise ConfigError('force law', f'at most {MAX_STATES} states', n)
        shapes = {
            'A': (n, n),
            'B': (n, 3),
            'C': (3, n),
            'D': (3, 3),
            'E': (n,),
            'start_force': (n,),
            'start_disturbance': (n,),
        }
        for name, shape in shapes.items():
            require_shape(name, getattr(self, name), shape)

    @property
    def states(self) -> int:
        """Return n."""
        return int(self.A.shape[0])

    def record(self) -> Records[Linear]:
        """Return it as one record of `LINEAR`, with no state."""
        law, n = np.zeros(1, dtype=LINEAR), self.states
        design = law['design'][0]
        design['states'] = n
        rows = design['of_state'][:n]
        rows['x'][:, :n] = self.A
        for name, column in zip(INPUTS, self.B.T):
            rows[name] = column
        for output, of_states, of_inputs in zip(OUTPUTS, self.C, self.D):
            row = design[output]
            row['x'][:n] = of_states
            for name, value in zip(INPUTS, of_inputs):
                row[name] = value
        for name in ('E', 'start_force', 'start_disturbance'):
            design[name][:n] = getattr(self, name)
        return law


def sampled(
    A: Matrix,
    B: Matrix,
    C: Matrix,
    D: Matrix,
    period: float,
    *,
    E: Vector | None = None,
    start_force: Vector | None = None,
    start_disturbance: Vector | None = None,
) -> LinearLaw:
    """
    Return the law dx/dt = A x + B y + E extra, discretised by the bilinear transformation.

    The other arguments are as of `LinearLaw`, with the continuous state at a touch, and zero by
    default. The discrete state is (1 - A h / 2) x - B y h / 2.
    """
    # As scipy.signal.cont2discrete, which takes 0.7 s to import while an arm waits.
    change = np.eye(len(A)) - 0.5 * period * A
    A_d = solve(change, np.eye(len(A)) + 0.5 * period * A)
    B_d = solve(change, period * B)
    C_d = solve(change.T, C.T).T
    D_d = D + 0.5 * (C @ B_d)
    extra, force, disturbance = (
        np.zeros(len(A)) if vector is None else vector
        for vector in (E, start_force, start_disturbance)
    )
    return LinearLaw(
        A_d,
        B_d,
        C_d,
        D_d,
        period * extra,
        change @ force - 0.5 * period * B[:, 0],
        change @ disturbance,
    )


def design_aob(model: LoopModel, config: ForceConfig) -> ObserverDesign:
    """Design the active observer (P04 eqs 34-37, 41)."""
    loop = place_poles(
        model.plant,
        model.period,
        time_constant=config.time_constant,
        second_pole_ratio=config.second_pole_ratio,
    )
    return design_observer(
        loop, order=config.active_state_order, process_noise=config.process_noise
    )


def steady_law(observer: ObserverDesign, gain: Vector) -> LinearLaw:
    """
    Return an observer whose gain no longer changes as a linear law, its state the prediction x_1.

    u = L_1 alpha_des - [L_r 1] x_est with x_est = x_1 + K (alpha - C x_1), and the next
    prediction is Phi_c x_est + Gamma (L_1 alpha_des + extra) (P04 eqs 36-39); K as from
    `steady_gain`.
    """
    n = len(observer.Gamma)
    correction = np.eye(n)
    correction[:, 0] -= gain
    outputs = np.zeros((3, n))  # of x_est
    outputs[0], outputs[1, 0] = -observer.feedback, 1.0
    if observer.order:
        outputs[2, n - observer.order] = 1.0
    L_1 = observer.feedback[0]
    B, D = np.zeros((n, 3)), np.zeros((3, 3))
    B[:, 0], B[:, 1] = observer.Phi_c @ gain, L_1 * observer.Gamma
    D[:, 0], D[0, 1] = outputs @ gain, L_1
    start_force, start_disturbance = np.zeros(n), np.zeros(n)
    start_force[0] = 1.0
    if observer.order:
        start_disturbance[n - observer.order :] = 1.0
    return LinearLaw(
        observer.Phi_c @ correction,
        B,
        outputs @ correction,
        D,
        observer.Gamma,
        start_force,
        start_disturbance,
    )


def design_pi(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = K_p e + K_i int e dt with e = alpha_des - alpha, alpha low-passed.

    K_p = bandwidth K_2 / k gives the loop that bandwidth on a surface of the stiffness k. What
    acts beyond u is integrated at the same rate, so that a limit does not wind the integral up.
    """
    pi = config.pi
    gain = pi.bandwidth * model.damping_rate / model.stiffness
    integral = gain * pi.integral_rate
    if not pi.filter_cutoff:  # int e dt alone
        return sampled(
            np.zeros((1, 1)),
            np.array([[-integral, integral, 0.0]]),
            np.array([[1.0], [0.0], [-1.0]]),
            np.array([[-gain, gain, 0.0], [1.0, 0.0, 0.0], [0.0] * 3]),
            model.period,
            E=np.array([pi.integral_rate]),
            start_disturbance=np.array([-1.0]),
        )
    cutoff = 2.0 * math.pi * pi.filter_cutoff
    return sampled(  # low-passed alpha, and K_i int e dt
        np.array([[-cutoff, 0.0], [-integral, 0.0]]),
        np.array([[cutoff, 0.0, 0.0], [0.0, integral, 0.0]]),
        np.array([[-gain, 1.0], [1.0, 0.0], [0.0, -1.0]]),
        np.array([[0.0, gain, 0.0], [0.0] * 3, [0.0] * 3]),
        model.period,
        E=np.array([0.0, pi.integral_rate]),
        start_force=np.array([1.0, 0.0]),
        start_disturbance=np.array([0.0, -1.0]),
    )


def design_dob(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = K_p (alpha_des - alpha) - d with d = Q (G_n^-1 alpha - e^(-s T_d) u).

    G_n = k / (s (s + K_2)) is the nominal plant and Q = omega^2 / (s + omega)^2. The inputs under
    way are kept in whole periods, at least one.
    """
    values, h = config.dob, model.period
    omega, K_2, k = values.observer_bandwidth, model.damping_rate, model.stiffness
    gain = values.bandwidth * K_2 / k
    delay = max(1, round(model.input_delay / h))
    # Q alpha, in controllable form; of it s (s + K_2) / k makes Q G_n^-1 alpha.
    A = np.array([[0.0, 1.0], [-(omega**2), -2.0 * omega]])
    force = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    C, D = np.zeros((3, 2)), np.zeros((3, 3))
    still = np.array([1.0 / omega**2, 0.0])  # of a filter whose input is constantly 1
    C[2], D[2, 0] = (
        omega**2 / k * np.array([-(omega**2), K_2 - 2.0 * omega]),
        omega**2 / k,
    )
    inverse = sampled(A, force, C, D, h, start_force=still)
    C[2], D[2, 0] = [omega**2, 0.0], 0.0
    acted = sampled(A, force, C, D, h, start_force=still)  # Q u
    # States: of Q G_n^-1 alpha, of Q u, and u of the last periods, oldest first.
    n, line = 4 + delay, 4
    A_all, B_all = np.zeros((n, n)), np.zeros((n, 3))
    C_all, D_all = np.zeros((3, n)), np.zeros((3, 3))
    A_all[:2, :2], B_all[:2] = inverse.A, inverse.B
    A_all[2:4, 2:4], A_all[2:4, line] = acted.A, acted.B[:, 0]
    for j in range(line, n - 1):
        A_all[j, j + 1] = 1.0
    C_all[2, :2], C_all[2, 2:4], C_all[2, line] = (
        inverse.C[2],
        -acted.C[2],
        -acted.D[2, 0],
    )
    D_all[1, 0], D_all[2] = 1.0, inverse.D[2]
    C_all[0] = -C_all[2]
    D_all[0] = gain * np.array([-1.0, 1.0, 0.0]) - D_all[2]
    A_all[n - 1], B_all[n - 1] = C_all[0], D_all[0]
    E, start_force, start_disturbance = np.zeros(n), np.zeros(n), np.zeros(n)
    E[n - 1] = 1.0
    start_force[:2] = inverse.start_force
    start_disturbance[2:4], start_disturbance[line:] = -acted.start_force, -1.0
    return LinearLaw(A_all, B_all, C_all, D_all, E, start_force, start_disturbance)


def design_lqg(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design the AOB's model with constant gains, both from Riccati equations.

    The filter settles at R = `noise_variance`; the feedback minimises sum alpha^2 + rho u^2.
    """
    Phi, Gamma = model.plant.Phi, model.plant.Gamma[:, None]
    weight = np.zeros_like(Phi)
    weight[0, 0] = 1.0
    rho = config.lqg.input_weight
    S = solve_discrete_are(Phi, Gamma, weight, np.array([[rho]]))
    L = (Gamma.T @ S @ Phi / (rho + Gamma.T @ S @ Gamma))[0]
    observer = design_observer(
        ForceLoop(model.plant, L), process_noise=config.process_noise
    )
    return steady_law(observer, steady_gain(observer, config.lqg.noise_variance))


def design_admittance(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = K_2 v_ref, with M dv/dt = e - D v and v_ref = v + K_i int e dt.

    The damping K_2 makes that a speed controller, u - K_2 v_contact. D = k / bandwidth.
    """
    values, K_2 = config.admittance, model.damping_rate
    compliance = values.bandwidth / model.stiffness  # 1 / D
    rate, integral = 1.0 / values.inertia_time, compliance * values.integral_rate
    extra = values.integral_rate / max(
        K_2, 1.0
    )  # per input, so that a limit does not wind it up
    return sampled(  # v, and K_i int e dt
        np.array([[-rate, 0.0], [0.0, 0.0]]),
        np.array(
            [[-rate * compliance, rate * compliance, 0.0], [-integral, integral, 0.0]]
        ),
        np.array([[K_2, K_2], [0.0, 0.0], [0.0, -K_2]]),
        np.array([[0.0] * 3, [1.0, 0.0, 0.0], [0.0] * 3]),
        model.period,
        E=np.array([0.0, extra]),
        start_disturbance=np.array([0.0, -1.0 / K_2 if K_2 else 0.0]),
    )


def design_impedance(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = omega^2 (alpha_des / k - z), z the way into the surface since the touch.

    At the touch z = alpha / k. Nothing integrates a force error away: the force is as exact as the
    stiffness k of the model and what is fed forward.
    """
    spring = config.impedance.natural_frequency**2
    return sampled(
        np.zeros((1, 1)),
        np.array([[0.0, 0.0, 1.0]]),
        np.array([[-spring], [0.0], [0.0]]),
        np.array([[0.0, spring / model.stiffness, 0.0], [1.0, 0.0, 0.0], [0.0] * 3]),
        model.period,
        start_force=np.array([1.0 / model.stiffness]),
    )


def design_feedforward(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """Return u = 0: what is fed forward, and the damping K_2, are all that acts."""
    nothing = np.zeros((3, 3))
    nothing[1, 0] = 1.0  # alpha_est = alpha
    none = np.zeros(0)
    return LinearLaw(
        np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((3, 0)), nothing, none, none, none
    )


Design = Callable[[LoopModel, ForceConfig], ObserverDesign | LinearLaw]


class LawEntry(NamedTuple):
    """A force law of the registry."""

    design: Design
    reads: tuple[
        str, ...
    ]  # fields of `ForceConfig`: the design has these, and no others


LAWS: Mapping[str, LawEntry] = {
    'aob': LawEntry(
        design_aob,
        ('time_constant', 'second_pole_ratio', 'active_state_order', 'process_noise'),
    ),
    'pi': LawEntry(design_pi, ('pi',)),
    'dob': LawEntry(design_dob, ('dob',)),
    'lqg': LawEntry(design_lqg, ('lqg', 'process_noise')),
    'admittance': LawEntry(design_admittance, ('admittance',)),
    'impedance': LawEntry(design_impedance, ('impedance',)),
    'feedforward': LawEntry(design_feedforward, ()),
}
