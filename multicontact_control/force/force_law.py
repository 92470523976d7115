"""The force law of every contact: which one is at work, what it starts from, and what is fed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from functools import lru_cache
from types import SimpleNamespace
from typing import Annotated, Any, cast, get_args, Protocol

from multicontact_control.algebra import dot
from multicontact_control.arrays import Mask, Vector
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
    command,
    command_rest,
    continue_observers_after_pause,
    continue_observers_from,
    make_observers,
    observe,
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
# G, by which a tip is kept at the speed it may have where no surface has answered: K_2 between
# these, which the drives are known to bear; and what of its square the integral has.
SLOWEST_BOUND, FASTEST_BOUND, BOUND_SHARE = 60.0, 80.0, 0.125  # 1/s, 1/s, -
BORNE_TIME = 0.05  # s, in which it is forgotten what a surface bears
RATIOS = tuple(
    np.geomspace(1.0, 100.0, 9).tolist()
)  # where the loop's limit is looked for
Gains = tuple[tuple[str, Any], ...]  # fields of `ForceConfig`, and their values


class ForceLaw(Record, Protocol):
    """The force law of one contact, of which one part is at work."""

    kind: int  # number of the law in the registry, see `force.laws`
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
    """Return what the force law of a contact of a stiffness [N/m] is designed for."""
    return LoopModel(
        stiffness, config.force.damping_rate, config.loop_delay, config.period
    )


def select_gains(name: str, force: ForceConfig) -> Gains:
    """Return what the design of a law reads, by name: the same gains are designed for once."""
    return tuple((field, getattr(force, field)) for field in find_law(name).reads)


def design_law(
    name: str, force: ForceConfig, model: LoopModel
) -> ObserverDesign | LinearLaw:
    """
    Return a force law of the registry; its arrays are not to be changed.

    Raises
    ------
    ConfigError
        If there is none, or none of finite numbers.

    """
    return _design_of(name, select_gains(name, force), model)


@lru_cache(
    maxsize=64
)  # most contacts are alike, and most live changes are of other gains
def _design_of(name: str, gains: Gains, model: LoopModel) -> ObserverDesign | LinearLaw:
    # A design has what it says that it reads, and nothing that the key is without.
    force: Any = SimpleNamespace(**dict(gains))
    with _designing(name):
        design = find_law(name).design(model, force)
        for field in fields(design):
            value = getattr(design, field.name)
            if isinstance(value, np.ndarray) and not np.isfinite(value).all():
                raise ValueError(f'{field.name} that is not finite')
    return design


@contextmanager
def _designing(name: str) -> Iterator[None]:
    try:
        with np.errstate(all='ignore'):
            yield
    except (ArithmeticError, ValueError) as error:  # a LinAlgError is a ValueError
        raise ConfigError(
            f'force.{name}', 'values that a law can be designed for', error
        ) from None


def make_force_laws(config: ControllerConfig) -> Records[ForceLaw]:
    """
    Return the force law of every contact, which knows nothing yet, shape (r,).

    Each is for the configured stiffness; adaptive laws start from the largest of their range.
    """
    laws: Records[ForceLaw] = np.zeros(len(config.columns), dtype=FORCE_LAW)
    names, force = list(FORCE_LAWS), config.force
    adaptive = force.stiffness == 'adaptive'
    limits = []
    if adaptive:
        stiffnesses = np.geomspace(
            force.adaptive.lowest, force.adaptive.highest, LIMITS
        )
        gains = select_gains('aob', force)
        limits = [
            find_largest_stiffness_ratio(
                gains, make_loop_model(config, k), config.initial_noise_variance
            )
            for k in stiffnesses.tolist()
        ]
    for law, column in zip(laws, config.columns):
        name = config.force_law_of(column.contact)
        stiffness = force.adaptive.highest if adaptive else column.stiffness
        design = design_law(name, force, make_loop_model(config, stiffness))
        law['kind'] = names.index(name)
        law['fed'] = get_args(FedForward).index(force.fed_forward)
        law['stiffness']['k'] = stiffness
        if isinstance(design, LinearLaw):
            law['is_linear'], law['linear'] = True, design.record()[0]
            continue
        law['observer'] = make_observers([design])[0]
        if adaptive:
            of_observer = law['observer']['design']
            of_observer['Phi_c'] = of_observer['Phi_n']  # see `answer_contact_forces`
            set_up_stiffness(
                law['stiffness'],
                design.loop.plant,
                stiffness,
                force,
                period=config.period,
                tool_mass=config.tool.mass,
                ratio_limits=limits,
            )
            if column.kind != FORCE:
                law['stiffness']['config']['share'] = (
                    column.stiffness / config.columns[column.leader].stiffness
                )
    return laws


@lru_cache(
    maxsize=64
)  # the first sample and a live change are not to wait for it once more
def find_largest_stiffness_ratio(
    gains: Gains, model: LoopModel, noise_variance: float
) -> float:
    """
    Return how many times as stiff as its model a surface may be, with a constant R [N^2].

    `gains` are those of the observer, see `select_gains`.
    """
    none = np.zeros((1, 1))
    with _designing('aob'):
        design = cast(ObserverDesign, _design_of('aob', gains, model))
        law = make_steady_law(design, solve_steady_gain(design, noise_variance))

        def stable(ratio: float) -> bool:
            plant = LinearArmPlant(
                none,
                np.array([ratio * model.stiffness]),
                np.zeros(1),
                none,
                model.input_delay,
            )
            return (
                spectral_radius(
                    closed_loop(plant, law, model.damping_rate, model.period)
                )
                < 1.0
            )

        return min(find_last_stable(stable, RATIOS, 1e-2)[0], RATIOS[-1])


def continue_laws(laws: Records[ForceLaw], others: Records[ForceLaw]) -> None:
    """
    Take over the states of others, records of `FORCE_LAW`, shape (r,).

    A law of the same kind and size goes on from where it is, another one from the estimated force
    and the disturbance that is compensated.
    """
    for i in range(len(laws)):
        law, other = laws[i : i + 1], others[i : i + 1]
        taken, part = known(other[0]), 'linear' if law['is_linear'][0] else 'observer'
        same = law['kind'][0] == other['kind'][0] and (
            law[part]['design']['states'][0] == other[part]['design']['states'][0]
        )
        if law['is_linear'][0]:
            new, old = law['linear'], other['linear']
            if same:
                for name in ('x', 'extra', 'p_est', 'running'):
                    new[name] = old[name]
            elif taken is not None:
                new['alpha'], new['p_est'], new['running'] = *taken, True
                start = new['design']
                new['x'] = (
                    start['start_force'] * taken[0]
                    + start['start_disturbance'] * taken[1]
                )
        elif (
            same
            and law['observer']['design']['order'][0]
            == (other['observer']['design']['order'][0])
        ):
            if law['stiffness']['config']['adaptive'][0]:
                take_over_stiffness(
                    law[0], other[0]
                )  # before the state, which is of that model
            continue_observers_from(law['observer'], other['observer'])
        elif taken is not None:
            observer = law['observer'][0]
            observer['x_est'][0], p = taken
            design = observer['design']
            n, order = int(design['states']), int(design['order'])
            observer['x_est'][n - order : n] = p
            observer['P'][:n, :n] = design['P_0'] * np.eye(n)
            observer['running'] = True
            command_rest(law['observer'])


def known(law: ForceLaw) -> tuple[float, float] | None:
    """Return the estimated force [N] and the compensated disturbance [m/s^2], None at rest."""
    part = law['linear'] if law['is_linear'] else law['observer']
    if not part['running']:
        return None
    if law['is_linear']:
        return float(part['alpha']), float(part['p_est'])
    x, states, order = part['x_est'], part['design']['states'], part['design']['order']
    return float(x[0]), float(x[states - order]) if order else 0.0


def continue_laws_after_pause(
    laws: Records[ForceLaw], held: Mask, force: Vector
) -> None:
    """
    Go on after a pause with the laws of contacts that stayed pressed.

    Their observers start from the measured force [N], shape (r,), see
    `continue_observers_after_pause`; their linear laws keep their state. Laws of contacts that are
    not `held`, shape (r,), begin anew.
    """
    continue_observers_after_pause(laws['observer'], held, force)
    laws['linear']['running'] &= held


def add_extra_acceleration(
    laws: Records[ForceLaw], which: Mask, acceleration: Vector
) -> None:
    """Add an acceleration along the normals [m/s^2] to what these laws, (r,), predict with."""
    laws['observer']['command'][which] += acceleration
    laws['linear']['extra'][which] += acceleration


@compiled
def step_linear_law(
    law: Linear, contact: Contact, speed: float, x_next: Vector
) -> float:
    """
    Take one sample into a record of `LINEAR`; return u [m/s^2].

    `speed` is that of the contact point INTO the surface [m/s], `x_next` of at least n elements is
    overwritten. A force that was not measured is the one before.
    """
    design, x = law.design, law.x
    n = design.states
    if not law.running:
        for i in range(n):
            x[i] = design.start_force[i] * contact.alpha_meas
        law.extra, law.running = 0.0, True
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
    """Return what a record of `LINEAR_ROW` makes of a law's state and inputs."""
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
        return (
            contact.alpha_meas
            if contact.config.kind != FORCE
            else max(contact.alpha_meas, 0.0)
        )
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
) -> float:
    """
    Return u within what keeps the tip at `speed_bound` if nothing bears it [m/s^2].

    The tip accelerates by a = u - K_2 v + N^T Lambda^-1 N alpha_fed_forward into free space. It is
    kept at or below G (v_max - v) + b, where b is what a surface turns out to bear: it grows while
    the tip is slower than it may be although it is pushed, and is forgotten. The force law
    is told what acts. `speed` is that of the contact point INTO the surface [m/s].
    """
    period = control.law.period
    damping = control.law.K_2 * speed
    fed = contact.answer.alpha_fed_forward * contact.mobility
    slower = contact.speed_bound - speed
    rate = min(max(control.law.K_2, SLOWEST_BOUND), FASTEST_BOUND)
    largest = rate * slower + contact.borne_acceleration
    if u - damping + fed <= largest:
        contact.borne_acceleration *= 1.0 - min(period / BORNE_TIME, 1.0)
        return u
    contact.borne_acceleration = max(
        contact.borne_acceleration + BOUND_SHARE * rate * rate * slower * period, 0.0
    )
    bounded = largest + damping - fed
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

    A contact that has just become active starts from its measured force. Records of `FORCE_LAW`
    and `CONTACT`, shape (r,), are changed, `inputs`, shape (r,), is filled with u, 0 where not
    active [m/s^2]. `space` is a record of `FORCE_SPACE`.
    """
    for i in range(contacts.shape[0]):
        contact, law, answer = contacts[i], laws[i], contacts[i].answer
        answer.innovation = answer.prior_variance = answer.variance_used = 0.0
        # Of the contact point into the surface, as far as it is known how that moves itself.
        speed = dot(contact.N, control.frame.twist) - (
            contact.config.surface_speed + contact.surface_speed_est
        )
        if (
            contact.borne_acceleration > 0.0
        ):  # what does not answer the motion says nothing of a surface
            law.stiffness.felt = False
        elif law.stiffness.config.adaptive:
            follow_stiffness(laws, contacts, i, control, speed, space.fit)
        if not answer.active:
            law.observer.running = law.linear.running = False
            answer.alpha_est = answer.alpha_rate_est = (
                answer.alpha_fed_forward
            ) = inputs[i] = 0.0
            continue
        stiffness, observer = law.stiffness, law.observer
        if law.is_linear:
            inputs[i] = step_linear_law(law.linear, contact, speed, space.x_next)
            answer.alpha_rate_est = stiffness.k * speed
        elif stiffness.config.adaptive:
            # The prediction is that of the open loop, under the input that was asked for.
            begins = not observer.running
            observe(
                observer, contact, control.measured, stiffness.k * speed, space.observer
            )
            if begins:
                stiffness.alpha_ref = contact.alpha_meas
                if stiffness.config.share == 0.0:
                    stiffness.alpha_ref = max(contact.alpha_meas, 0.0)
            # No faster than the contact point may move into the surface.
            step = stiffness.k * APPROACH_LIMIT * stiffness.config.period
            stiffness.alpha_ref += min(
                max(answer.alpha_des - stiffness.alpha_ref, -step), step
            )
            u = command(observer, stiffness.alpha_ref)
            inputs[i] = observer.command = min(max(u, -INPUT_LIMIT), INPUT_LIMIT)
        else:
            observe(observer, contact, control.measured, 0.0, space.observer)
            inputs[i] = command(observer, answer.alpha_des)
        answer.alpha_fed_forward = choose_fed_force(law, contact, control.law.K_2)
        if contact.speed_bound > 0.0:
            inputs[i] = limit_approach_speed(contact, law, control, inputs[i], speed)
        else:
            contact.borne_acceleration = 0.0
