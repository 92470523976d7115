"""
The states of all contacts, their passivity observers, and the reference they make, compiled.

Every contact is one record of `CONTACT`; what is set for all of them is the one record of
`CONTACT_SETTINGS`. `ContactMachine` and `ContactReference` say what it is for.
"""

from __future__ import annotations

from typing import Any

from multicontact_control.compiled import compiled
import numpy as np

# States in the order of `ContactState`; below LOST and above APPROACHING the force law acts.
FREE, APPROACHING, IMPACT, HOLDING, LOST, RETRACTING, GIVEN_UP = range(7)
LEVEL_TIME = 0.1  # s, over which the force a contact is held with is averaged
TOUCH_SHARE = 0.5  # of the force before a loss, that counts as touch right after it
POSITION_RATE = 20.0  # 1/s, of the way left: how a displacement settles

# One contact: what `ContactMachine` and `PassivityObserver` call so; `origin` is where the
# surface was, NaN if it was never met.
CONTACT = np.dtype([('state', np.int64), ('losses', np.int64), *((name, np.float64) for name in (
    'displacement', 'speed', 'acceleration', 'force_limit', 'in_state', 'below', 'level',
    'origin', 'start', 'target', 'energy', 'stored', 'stiffness'))])
# What is set for all contacts: the fields of `ContactStateConfig` of the same name, the period,
# and the share of the energy that is kept from tick to tick.
CONTACT_SETTINGS = np.dtype([(name, np.float64) for name in (
    'period', 'approach_speed', 'approach_ramp_time', 'approach_distance', 'search_distance',
    'contact_threshold', 'release_threshold', 'release_fraction', 'escape_speed', 'preload',
    'force_rate', 'impact_time', 'bounce_time', 'loss_time', 'lost_time', 'braking',
    'force_ceiling', 'retract_distance', 'retract_speed', 'energy_limit', 'injected_damping',
    'energy_keep')])


@compiled
def is_active(contact: Any) -> bool:
    """Return whether the force law drives a contact."""
    return contact.state == IMPACT or contact.state == HOLDING


@compiled
def enter(contact: Any, state: int) -> None:
    """Begin a state."""
    contact.state = state
    contact.in_state = 0.0


@compiled
def leave_surface(contact: Any, place: float, speed: float) -> None:
    """Give a contact back to the motion law, that is to lead it to where the surface was."""
    contact.displacement = place
    contact.speed = speed
    contact.start = place if np.isnan(contact.origin) else contact.origin
    contact.target = contact.start


@compiled
def watch_search(contact: Any, settings: Any, alpha: float) -> None:
    """Touch, or give up, or begin to look for a lost surface."""
    threshold = settings.contact_threshold
    if contact.state == LOST:  # a tool that is being braked reads its own inertia
        threshold = max(2.0 * threshold, TOUCH_SHARE * contact.level)
    met_before = not np.isnan(contact.origin)
    if alpha > threshold:
        contact.force_limit = max(alpha, settings.preload) if met_before else settings.preload
        contact.below = 0.0
        contact.level = 0.0
        enter(contact, IMPACT)
    elif contact.state == LOST:
        if contact.in_state >= settings.lost_time and (
                abs(contact.target - contact.displacement) < 2e-4 and abs(contact.speed) < 2e-3):
            contact.start = contact.displacement
            enter(contact, APPROACHING)
    elif contact.displacement - contact.start > (
            settings.search_distance if met_before else settings.approach_distance):
        contact.target = contact.start
        enter(contact, GIVEN_UP)


@compiled
def watch_hold(
    contact: Any, settings: Any, alpha: float, alpha_des: float, place: float, speed: float,
) -> None:
    """Notice a loss, or that a touch has lasted."""
    h = settings.period
    threshold = max(settings.release_threshold, settings.release_fraction * min(
        contact.level, alpha_des, contact.force_limit))
    if alpha >= threshold:
        contact.below = 0.0
        contact.origin = place - alpha / contact.stiffness  # where it would not press any more
        contact.level += h / (LEVEL_TIME + h) * (alpha - contact.level)
    else:
        contact.below += h
    patience = settings.loss_time
    if contact.state == IMPACT:  # a bounce is no loss
        patience = max(patience, settings.bounce_time)
    if contact.below > patience + 1e-9 or speed > settings.escape_speed:
        contact.losses += 1
        leave_surface(contact, place, speed)
        enter(contact, LOST)
    elif contact.state == IMPACT and contact.below == 0.0 and (
            contact.in_state >= settings.impact_time):
        enter(contact, HOLDING)


@compiled
def switch_state(
    contact: Any, settings: Any, wanted: bool, alpha: float, alpha_des: float, place: float,
    speed: float,
) -> None:
    """Go to another state if it is time; see `advance_contact`."""
    if alpha > settings.force_ceiling and contact.state != RETRACTING:
        contact.displacement = place
        contact.speed = speed
        contact.target = place - settings.retract_distance
        enter(contact, RETRACTING)
    elif not wanted:
        if is_active(contact):
            leave_surface(contact, place, speed)
        if contact.state != FREE:
            enter(contact, FREE)
        contact.origin = np.nan
        contact.target = 0.0
    elif contact.state == FREE:
        contact.start = contact.displacement
        enter(contact, APPROACHING)
    elif is_active(contact):
        watch_hold(contact, settings, alpha, alpha_des, place, speed)
    elif contact.state == RETRACTING:
        if abs(contact.target - contact.displacement) < 1e-4:
            enter(contact, GIVEN_UP)
    elif contact.state != GIVEN_UP:
        watch_search(contact, settings, alpha)


@compiled
def raise_force_limit(contact: Any, settings: Any, alpha_des: float) -> None:
    """Let a contact that holds have what is asked for, at a bounded rate after a loss."""
    if contact.state == HOLDING and contact.losses == 0:
        contact.force_limit = max(contact.force_limit, alpha_des)
    elif contact.state == HOLDING or not np.isnan(contact.origin) and contact.losses > 0:
        step = settings.force_rate * settings.period
        contact.force_limit += min(max(alpha_des - contact.force_limit, -step), step)


@compiled
def move(contact: Any, settings: Any) -> None:
    """Advance the displacement by one period, its speed and acceleration bounded."""
    h = settings.period
    if contact.state == APPROACHING:
        wanted = settings.approach_speed
        change = settings.approach_speed / settings.approach_ramp_time
    else:
        limit = settings.approach_speed
        if contact.state == RETRACTING:
            limit = settings.retract_speed
        wanted = min(max(
            POSITION_RATE * (contact.target - contact.displacement), -limit), limit)
        change = settings.braking
    if abs(contact.speed) > settings.approach_speed:
        change = max(change, settings.braking)
    contact.acceleration = min(max((wanted - contact.speed) / h, -change), change)
    contact.speed += contact.acceleration * h
    contact.displacement += contact.speed * h


@compiled
def advance_contact(
    contact: Any, settings: Any, wanted: bool, alpha: float, alpha_des: float, place: float,
    speed: float,
) -> None:
    """
    Take one tick into the state machine of a contact; see `ContactMachine.update`.

    Parameters
    ----------
    contact, settings
        Records of `CONTACT`, changed, and `CONTACT_SETTINGS`.
    wanted, alpha, alpha_des, place, speed
        As for `ContactMachine.update`.

    """
    contact.in_state += settings.period
    switch_state(contact, settings, wanted, alpha, alpha_des, place, speed)
    if is_active(contact):
        contact.acceleration = 0.0
        raise_force_limit(contact, settings, alpha_des)
    else:
        move(contact, settings)


@compiled
def let_go(contact: Any, place: float, speed: float) -> None:
    """Give a contact back to the motion law, from where the tip is; see `ContactMachine`."""
    if is_active(contact):
        contact.losses += 1
        leave_surface(contact, place, speed)
        enter(contact, LOST)
    else:
        contact.displacement = place
        contact.speed = 0.0


@compiled
def watch_energy(contact: Any, settings: Any, alpha: float, speed: float) -> float:
    """
    Take one tick into the passivity observer of a contact; see `PassivityObserver`.

    Parameters
    ----------
    contact, settings
        Records of `CONTACT`, changed, and `CONTACT_SETTINGS`.
    alpha, speed
        Measured force [N], and speed of the contact point INTO the surface [m/s].

    Returns
    -------
    float
        Force to take from the command [N].

    """
    pressed = max(alpha, 0.0)
    stored = pressed * pressed / (2.0 * contact.stiffness)
    work = alpha * speed * settings.period
    contact.energy = settings.energy_keep * contact.energy + work - (stored - contact.stored)
    contact.stored = stored
    return 0.0 if contact.energy <= settings.energy_limit else settings.injected_damping * speed


@compiled
def advance_one(
    contacts: Any, settings: Any, wanted: bool, alpha: float, alpha_des: float, place: float,
    speed: float,
) -> None:
    """Call `advance_contact` for the first contact of an array."""
    advance_contact(contacts[0], settings[0], wanted, alpha, alpha_des, place, speed)


@compiled
def let_one_go(contacts: Any, place: float, speed: float) -> None:
    """Call `let_go` for the first contact of an array."""
    let_go(contacts[0], place, speed)


@compiled
def watch_energy_of_one(contacts: Any, settings: Any, alpha: float, speed: float) -> float:
    """Call `watch_energy` for the first contact of an array."""
    return watch_energy(contacts[0], settings[0], alpha, speed)
