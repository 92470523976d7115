"""The force law of every contact: which one is at work, what it starts from, and what is fed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from functools import lru_cache
from types import SimpleNamespace
from typing import Annotated, Any, cast, get_args, Protocol

from multicontact_control.algebra import dot
from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig, FedForward, ForceConfig
from multicontact_control.config.contact import FORCE
from multicontact_control.errors import ConfigError
from multicontact_control.force.laws.aob import make_steady_law
from multicontact_control.force.laws.design import find_law, LoopModel
from multicontact_control.force.laws.linear import Linear, LinearLaw, LinearRow
from multicontact_control.force.margins import (
    closed_loop,
    find_last_stable,
    LinearArmPlant,
    spectral_radius,
)
from multicontact_control.force.observer import (
    command_acceleration,
    command_rest,
    continue_observer_after_pause,
    continue_observers_from,
    make_observers,
    observe_force,
    Observer,
    ObserverDesign,
    ObserverSpace,
    solve_steady_gain,
)
from multicontact_control.force.stiffness import (
    APPROACH_LIMIT,
    FitSpace,
    follow_stiffness,
    INPUT_LIMIT,
    LIMITS,
    set_up_stiffness,
    Stiffness,
    take_over_stiffness,
)
from multicontact_control.records import (
    Contact,
    Control,
    MAX_STATES,
    Record,
    record_dtype,
    Records,
)
from multicontact_control.registry import FORCE_LAWS
import numpy as np

ESTIMATE, DESIRED, MIXED, MEASURED = range(4)  # as in `FedForward`
# G, the gain that keeps a tip at its speed where no surface has answered: K_2 between these two,
# which the drives are known to bear; the integral has this share of its square.
SLOWEST_BOUND = 60.0  # 1/s
FASTEST_BOUND = 80.0  # 1/s
BOUND_SHARE = 0.125
BORNE_TIME = 0.05  # s, time constant in which the bearing of a surface is forgotten
# True over modelled stiffness, at which the limit of the loop is looked for.
STIFFNESS_RATIOS = tuple(np.geomspace(1.0, 100.0, 9).tolist())
Gains = tuple[tuple[str, Any], ...]  # fields of `ForceConfig`, and their values


class ForceLaw(Record, Protocol):
    """The force law of one contact, of which one part is at work."""

    kind: int  # place of the law in the registry
    is_linear: bool  # whether `linear` is at work, or `observer`
    fed: int  # what is fed forward: ESTIMATE, DESIRED, MIXED or MEASURED
    observer: Observer
    linear: Linear
    stiffness: Stiffness


FORCE_LAW = record_dtype(ForceLaw)


class ForceSpace(Record, Protocol):
    """What `answer_contact_forces` works in; one."""

    observer: ObserverSpace
    fit: FitSpace
    x_next: Annotated[Vector, MAX_STATES]  # of a linear law


FORCE_SPACE = record_dtype(ForceSpace)


def make_loop_model(config: ControllerConfig, stiffness: float) -> LoopModel:
    """Return the model that the force law of a contact of a stiffness [N/m] is designed for."""
    return LoopModel(
        stiffness, config.force.damping_rate, config.loop_delay, config.period
    )


def select_gains(name: str, force: ForceConfig) -> Gains:
    """Return the fields that the design of a law reads: equal gains share one design."""
    return tuple((field, getattr(force, field)) for field in find_law(name).reads)


def design_law(
    name: str, force: ForceConfig, model: LoopModel
) -> ObserverDesign | LinearLaw:
    """
    Return a law of the registry, designed for a model of the contact.

    Equal gains and models give the same object, whose arrays are not to be changed.

    Raises
    ------
    ConfigError
        If these gains and this model lead to no law, or to none of finite numbers.

    """
    return _design_cached(name, select_gains(name, force), model)


# Most contacts are alike, and most live changes are of gains that a design does not read.
@lru_cache(maxsize=64)
def _design_cached(
    name: str, gains: Gains, model: LoopModel
) -> ObserverDesign | LinearLaw:
    # Of the configuration the design sees these gains alone, on which the cache depends.
    force: Any = SimpleNamespace(**dict(gains))
    with _name_law_in_errors(name):
        design = find_law(name).design(model, force)
        for field in fields(design):
            value = getattr(design, field.name)
            if isinstance(value, np.ndarray) and not np.isfinite(value).all():
                raise ValueError(f'{field.name} that is not finite')
    return design


@contextmanager
def _name_law_in_errors(name: str) -> Iterator[None]:
    try:
        with np.errstate(all='ignore'):
            yield
    except (ArithmeticError, ValueError) as error:  # a LinAlgError is a ValueError
        raise ConfigError(
            f'force.{name}', 'values that a law can be designed for', error
        ) from None


def make_force_laws(config: ControllerConfig) -> Records[ForceLaw]:
    """
    Return the force law of every column of N before its first sample, shape (r,).

    Each is designed for the configured stiffness; adaptive laws start from the largest of their
    range.
    """
    laws: Records[ForceLaw] = np.zeros(len(config.columns), dtype=FORCE_LAW)
    names = list(FORCE_LAWS)
    adaptive = config.force.stiffness == 'adaptive'
    ratio_limits = find_ratio_limits(config) if adaptive else []
    for law, column in zip(laws, config.columns):
        name = config.force_law_of(column.contact)
        stiffness = config.force.adaptive.highest if adaptive else column.stiffness
        design = design_law(name, config.force, make_loop_model(config, stiffness))
        law['kind'] = names.index(name)
        law['fed'] = get_args(FedForward).index(config.force.fed_forward)
        law['stiffness']['k'] = stiffness
        if isinstance(design, LinearLaw):
            law['is_linear'] = True
            law['linear'] = design.record()[0]
            continue
        law['observer'] = make_observers([design])[0]
        if adaptive:
            # The prediction is that of the open loop, see `answer_contact_forces`.
            law['observer']['design']['Phi_c'] = law['observer']['design']['Phi_n']
            set_up_stiffness(
                law['stiffness'],
                design.loop.plant,
                stiffness,
                config.force,
                period=config.period,
                tool_mass=config.tool.mass,
            )
            settings = law['stiffness']['config']
            settings['ratio_limit'] = ratio_limits
            if column.kind != FORCE:
                leader = config.columns[column.leader]
                settings['share'] = column.stiffness / leader.stiffness
    return laws


def find_ratio_limits(config: ControllerConfig) -> list[float]:
    """
    Return how many times as stiff as its model a surface may be, over the adaptive range.

    One limit for each of `LIMITS` models from the softest to the stiffest, equal ratios apart.
    """
    adaptive = config.force.adaptive
    gains = select_gains('aob', config.force)
    limits = []
    for stiffness in np.geomspace(adaptive.lowest, adaptive.highest, LIMITS).tolist():
        model = make_loop_model(config, stiffness)
        limits.append(
            find_largest_stiffness_ratio(gains, model, config.initial_noise_variance)
        )
    return limits


@lru_cache(maxsize=64)  # neither the first sample nor a live change waits for it again
def find_largest_stiffness_ratio(
    gains: Gains, model: LoopModel, noise_variance: float
) -> float:
    """
    Return how many times as stiff as its model a surface may be, with a constant R [N^2].

    The loop is that of the active observer with these gains, see `select_gains`; the answer is at
    most the largest of `STIFFNESS_RATIOS`.
    """
    with _name_law_in_errors('aob'):
        design = cast(ObserverDesign, _design_cached('aob', gains, model))
        law = make_steady_law(design, solve_steady_gain(design, noise_variance))

        def is_stable(ratio: float) -> bool:
            plant = LinearArmPlant(
                mobility=np.zeros((1, 1)),
                stiffness=np.array([ratio * model.stiffness]),
                damping=np.zeros(1),
                tool_inertia=np.zeros((1, 1)),
                delay=model.input_delay,
            )
            loop = closed_loop(plant, law, model.damping_rate, model.period)
            return spectral_radius(loop) < 1.0

        last_stable, _ = find_last_stable(is_stable, STIFFNESS_RATIOS, 1e-2)
        return min(last_stable, STIFFNESS_RATIOS[-1])


def continue_laws(laws: Records[ForceLaw], others: Records[ForceLaw]) -> None:
    """
    Take over the states of others, records of `FORCE_LAW`, shape (r,).

    A law of the same kind and size goes on from where it is, another one from the estimated force
    and the disturbance that is compensated.
    """
    for i in range(len(laws)):
        # A slice of one: a record on its own would be a copy.
        if laws['is_linear'][i]:
            _continue_linear_law(laws[i : i + 1], others[i : i + 1])
        else:
            _continue_observer(laws[i : i + 1], others[i : i + 1])


def _continue_linear_law(
    new_law: Records[ForceLaw], old_law: Records[ForceLaw]
) -> None:
    """Let a linear law go on from the state of another law; both of shape (1,)."""
    new = new_law['linear']
    old = old_law['linear']
    design = new['design']
    if new_law['kind'] == old_law['kind'] and (
        design['states'] == old['design']['states']
    ):
        for name in ('x', 'extra', 'p_est', 'running'):
            new[name] = old[name]
        return
    estimates = read_estimates(old_law[0])
    if estimates is not None:
        force, disturbance = estimates
        new['alpha'] = force
        new['p_est'] = disturbance
        new['running'] = True
        new['x'] = (
            design['start_force'] * force + design['start_disturbance'] * disturbance
        )


def _continue_observer(new_law: Records[ForceLaw], old_law: Records[ForceLaw]) -> None:
    """Let an active observer go on from the state of another law; both of shape (1,)."""
    observer = new_law['observer'][0]
    design = observer['design']
    n = int(design['states'])
    order = int(design['order'])
    before = old_law['observer']['design'][0]
    same_kind = new_law['kind'] == old_law['kind']
    if same_kind and n == before['states'] and order == before['order']:
        # The stiffness before the state, which is one of that model.
        if new_law['stiffness']['config']['adaptive']:
            take_over_stiffness(new_law[0], old_law[0])
        continue_observers_from(new_law['observer'], old_law['observer'])
        return
    estimates = read_estimates(old_law[0])
    if estimates is not None:
        force, disturbance = estimates
        observer['x_est'][0] = force
        observer['x_est'][n - order : n] = disturbance
        observer['P'][:n, :n] = design['P_0'] * np.eye(n)
        observer['running'] = True
        command_rest(observer)


def read_estimates(law: ForceLaw) -> tuple[float, float] | None:
    """Return estimated force [N] and compensated disturbance [m/s^2]; None of a law at rest."""
    part = law['linear'] if law['is_linear'] else law['observer']
    if not part['running']:
        return None
    if law['is_linear']:
        return float(part['alpha']), float(part['p_est'])
    x_est = part['x_est']
    order = part['design']['order']
    disturbance = x_est[part['design']['states'] - order] if order else 0.0
    return float(x_est[0]), float(disturbance)


@compiled
def continue_law_after_pause(law: ForceLaw, held: bool, force: float) -> None:
    """
    Go on after a pause with the law of a contact, a record of `FORCE_LAW`.

    If it stayed pressed, `held`, its observer starts from the measured force [N], see
    `continue_observer_after_pause`; a linear law keeps its state. Any other begins anew.
    """
    continue_observer_after_pause(law.observer, held, force)
    law.linear.running = law.linear.running and held


@compiled
def add_extra_acceleration(law: ForceLaw, acceleration: float) -> None:
    """
    Tell a law of an acceleration along its normal that acts beyond its answer [m/s^2].

    These are limits and pulls that it has not asked for, and that its next prediction counts in.
    """
    law.observer.command += acceleration
    law.linear.extra += acceleration


@compiled
def step_linear_law(
    law: Linear, contact: Contact, speed: float, disturbance: float, x_next: Vector
) -> float:
    """
    Take one sample into a linear law, a record of `LINEAR`; return u [m/s^2].

    A law that has not run starts from the measured force and the disturbance of the motion. A
    force that was not measured in this sample is the one before.

    Parameters
    ----------
    law, contact
        Record of `LINEAR`, changed, and of `CONTACT`, whose `answer.alpha_est` is set.
    speed
        Speed of the contact point INTO the surface [m/s].
    disturbance
        What disturbed the motion INTO the surface [m/s^2].
    x_next
        Overwritten, at least n elements.

    """
    design = law.design
    x = law.x
    n = design.states
    if not law.running:
        for i in range(n):
            x[i] = design.start_force[i] * contact.alpha_meas
            x[i] += design.start_disturbance[i] * disturbance
        law.extra = 0.0
        law.running = True
    for i in range(n):
        x[i] += design.E[i] * law.extra
    law.extra = 0.0
    u = evaluate_linear_row(design.of_u, law, contact, speed)
    law.alpha = evaluate_linear_row(design.of_alpha, law, contact, speed)
    law.p_est = evaluate_linear_row(design.of_p, law, contact, speed)
    for i in range(n):
        x_next[i] = evaluate_linear_row(design.of_state[i], law, contact, speed)
    for i in range(n):
        x[i] = x_next[i]
    contact.answer.alpha_est = law.alpha
    return u


@compiled
def evaluate_linear_row(
    row: LinearRow, law: Linear, contact: Contact, speed: float
) -> float:
    """Return a row of A x + B y or C x + D y, a record of `LINEAR_ROW`, of state and inputs."""
    total = row.alpha_meas * contact.alpha_meas
    total += row.alpha_des * contact.answer.alpha_des
    total += row.speed * speed
    for j in range(law.design.states):
        total += row.x[j] * law.x[j]
    return total


@compiled
def choose_fed_force(law: ForceLaw, contact: Contact, K_2: float) -> float:
    """
    Return the contact force that is fed forward in P04 eq. 24 [N].

    The estimate, as published; or the desired force; or, mixed, as much of the desired one as the
    surface lets it act before the loop does, g = min(1, K_2^2 / (2 k N^T Lambda^-1 N)). The
    measured one where the contact says `use_measured_force`: what a surface that has gone does not
    bear would go to the other contacts.
    """
    if contact.use_measured_force or law.fed == MEASURED:
        if contact.config.kind == FORCE:
            return max(contact.alpha_meas, 0.0)
        return contact.alpha_meas
    if law.fed == ESTIMATE:
        return contact.answer.alpha_est
    desired = contact.answer.alpha_des
    if law.stiffness.config.adaptive:
        desired = law.stiffness.alpha_ref
    if law.fed == DESIRED:
        return desired
    share = min(K_2 * K_2 / (2.0 * law.stiffness.k * contact.mobility), 1.0)
    return contact.answer.alpha_est + share * (desired - contact.answer.alpha_est)


@compiled
def limit_approach_speed(
    contact: Contact,
    law: ForceLaw,
    control: Control,
    u: float,
    speed: float,
    disturbance: float,
) -> float:
    """
    Return u within what keeps the tip at `speed_bound` if nothing bears it [m/s^2].

    The tip accelerates by a = u + p - K_2 v + N^T Lambda^-1 N alpha_fed_forward into free space,
    with the disturbance p of the motion. It is kept at or below G (v_max - v) + b, where b is what
    a surface turns out to bear: it grows while the tip is slower than it may be although it is
    pushed, and is forgotten. The force law is told what acts. `speed` and `disturbance` are those
    of the contact point INTO the surface [m/s, m/s^2].
    """
    period = control.law.period
    damping = control.law.K_2 * speed
    fed = contact.answer.alpha_fed_forward * contact.mobility
    pushed = fed + disturbance
    slower = contact.speed_bound - speed
    rate = min(max(control.law.K_2, SLOWEST_BOUND), FASTEST_BOUND)
    largest = rate * slower + contact.borne_acceleration
    if u - damping + pushed <= largest:
        contact.borne_acceleration *= 1.0 - min(period / BORNE_TIME, 1.0)
        return u
    growth = BOUND_SHARE * rate * rate * slower * period
    contact.borne_acceleration = max(contact.borne_acceleration + growth, 0.0)
    bounded = largest + damping - pushed
    law.observer.command += bounded - u
    law.linear.extra += bounded - u
    return bounded


@compiled
def answer_contact_forces(
    laws: Records[ForceLaw],
    contacts: Records[Contact],
    control: Control,
    inputs: Vector,
    space: ForceSpace,
) -> None:
    """
    Let the force law of every active contact answer its sample.

    A contact that has just become active starts from its measured force, and from what disturbed
    the motion along its normal: where drives push the arm off the surface by more than the law
    presses with, it would lose the contact before it has found that out.

    Parameters
    ----------
    laws, contacts
        Records of `FORCE_LAW` and `CONTACT`, shape (r,), changed.
    control
        Record of `CONTROL` with the frame of this sample.
    inputs
        Filled with u, shape (r,) [m/s^2]; 0 of contacts that are not active.
    space
        Record of `FORCE_SPACE`, overwritten.

    """
    for i in range(contacts.shape[0]):
        contact = contacts[i]
        law = laws[i]
        answer = contact.answer
        answer.innovation = 0.0
        answer.prior_variance = 0.0
        answer.variance_used = 0.0
        # Of the contact point into the surface, minus what is known of the surface's own motion.
        speed = dot(contact.N, control.frame.twist) - (
            contact.config.surface_speed + contact.surface_speed_est
        )
        if contact.borne_acceleration > 0.0:
            # Something bears the tip beside the force law: its motion tells of no stiffness.
            law.stiffness.felt = False
        elif law.stiffness.config.adaptive:
            follow_stiffness(laws, contacts, i, control, speed, space.fit)
        if not answer.active:
            law.observer.running = False
            law.linear.running = False
            answer.alpha_est = 0.0
            answer.alpha_rate_est = 0.0
            answer.alpha_fed_forward = 0.0
            inputs[i] = 0.0
            continue
        disturbance = dot(contact.N, control.motion_observer.disturbance)
        if law.is_linear:
            inputs[i] = step_linear_law(
                law.linear, contact, speed, disturbance, space.x_next
            )
            answer.alpha_rate_est = law.stiffness.k * speed
        elif law.stiffness.config.adaptive:
            inputs[i] = answer_adaptively(
                law, contact, control, speed, disturbance, space
            )
        else:
            observe_force(
                law.observer,
                contact,
                control.measured,
                0.0,
                disturbance,
                space.observer,
            )
            inputs[i] = command_acceleration(law.observer, answer.alpha_des)
        answer.alpha_fed_forward = choose_fed_force(law, contact, control.law.K_2)
        if contact.speed_bound > 0.0:
            inputs[i] = limit_approach_speed(
                contact, law, control, inputs[i], speed, disturbance
            )
        else:
            contact.borne_acceleration = 0.0


@compiled
def answer_adaptively(
    law: ForceLaw,
    contact: Contact,
    control: Control,
    speed: float,
    disturbance: float,
    space: ForceSpace,
) -> float:
    """
    Take one sample into an observer whose model follows the surface; return u [m/s^2].

    It predicts with the open loop, under the input that was asked for, since its feedback changes
    with the model. It follows the desired force no faster than the contact point may move into
    the surface. `speed` and `disturbance` are those of the contact point INTO the surface [m/s,
    m/s^2].
    """
    stiffness = law.stiffness
    observer = law.observer
    begins = not observer.running
    rate = stiffness.k * speed
    observe_force(
        observer, contact, control.measured, rate, disturbance, space.observer
    )
    if begins:
        stiffness.alpha_ref = contact.alpha_meas
        if stiffness.config.share == 0.0:
            stiffness.alpha_ref = max(contact.alpha_meas, 0.0)
    step = stiffness.k * APPROACH_LIMIT * stiffness.config.period
    missing = contact.answer.alpha_des - stiffness.alpha_ref
    stiffness.alpha_ref += min(max(missing, -step), step)
    u = command_acceleration(observer, stiffness.alpha_ref)
    observer.command = min(max(u, -INPUT_LIMIT), INPUT_LIMIT)
    return observer.command
