"""
The state of each contact: looked for, touched, held, lost, given up.

One machine per contact decides which law drives the operational point along that contact's
normal: the force law from touch to loss, the motion law before and after. In the motion law the
tip advances along the normal by a displacement that is ramped, bounded and braked.

free -> approaching -> impact -> holding -> lost -> approaching ..., given up once the tip has
gone too far without a surface, until it is time for another search. Beyond the force ceiling, and
where it leads out of the workspace: retracting, then given up until it is commanded again.
Touch and loss have thresholds apart and least times, so that a bounce or a spike changes nothing.

In every function `contact` is a record of `CONTACT_STATE`, changed, and `settings` one of
`CONTACT_SETTINGS`; `alpha` is the measured force [N], `place` and `speed` are those of the tip
along the normal, relative to the task without displacement [m, m/s].
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
import math
from typing import Any

from multicontact_control.arrays import Mask
from multicontact_control.compiled import compiled
from multicontact_control.config import ContactStateConfig
from multicontact_control.records import CONTACT_SETTINGS, CONTACT_STATE, Records
import numpy as np

# States in the order of `ContactState`; below LOST and above APPROACHING the force law acts.
FREE, APPROACHING, IMPACT, HOLDING, LOST, RETRACTING, GIVEN_UP = range(7)
RELEASE_SHARE = 0.3  # of the force held or asked for, below which a contact may be lost: a tool
# that falls after its surface reads its own inertia
ESCAPE_SPEED = 0.1  # m/s into the surface, beyond the task's, that only a lost contact reaches
IMPACT_TIME = 0.05  # s in contact from touch to holding, at least
LOSS_TIME = 0.004  # s below the release threshold until a contact is lost
BOUNCE_TIME = 0.01  # s, the same between touch and holding
REBOUND_TIME = 0.1  # s, the same of a contact that held and is thrown back
LOST_TIME = 0.05  # s from loss to a new approach, at least
BRAKING = 5.0  # m/s^2, of a tip that has lost its surface, or is pulled back
RETRACT_SPEED = 0.05  # m/s
LEVEL_TIME = 0.1  # s, over which the force a contact is held with is averaged
TOUCH_SHARE = 0.5  # of the force before a loss, that counts as touch right after it
GUARD_SHARE = 0.3  # of the force held; below it the measured force is fed forward, so that the
# other contacts are not pressed with what a surface that has gone does not bear
GUARD_TIME = 0.3  # s after holding has begun; before, a guard would prolong bounces
STEP_TIME = 0.02  # s, in which a force step may be taken
REBOUND_SPEED = 2e-3  # m/s, away from the surface, from which on it is thrown back
REBOUNDS_APART = 0.5  # s
LONGEST_WAIT = 4  # doublings of the time between two searches
# Periods: one sample, or two between touch and holding, say nothing of a surface.
LOSS_PERIODS, BOUNCE_PERIODS = 2, 3
POSITION_RATE = 20.0  # 1/s, of the way left: how a displacement settles


class ContactState(Enum):
    """What is known of a contact."""

    FREE = 'free'
    APPROACHING = 'approaching'
    IMPACT = 'impact'
    HOLDING = 'holding'
    LOST = 'lost'
    RETRACTING = 'retracting'
    GIVEN_UP = 'given up'


STATES = tuple(ContactState)


def contact_settings(config: ContactStateConfig, period: float) -> Records:
    """Return what is set for all contacts as one record of `CONTACT_SETTINGS`; h in [s]."""
    settings = np.zeros(1, dtype=CONTACT_SETTINGS)
    values = config.model_dump() | {
        'period': period, 'loss_time': max(LOSS_TIME, LOSS_PERIODS * period),
        'bounce_time': max(BOUNCE_TIME, BOUNCE_PERIODS * period)}
    for name in settings.dtype.names or ():
        settings[name] = values[name]
    return settings


def contact_states(stiffness: Sequence[float], couples: Sequence[bool] = ()) -> Records:
    """Return free contacts: stiffness of the surfaces [N/m], and which are couples, shape (r,)."""
    states = np.zeros(len(stiffness), dtype=CONTACT_STATE)
    states['stiffness'] = stiffness
    if couples:
        states['couple'] = couples
    states['origin'] = math.nan
    return states


def reset(states: Records, which: Mask | None = None) -> None:
    """Let contacts, all or those of a mask of shape (r,), start anew, free."""
    chosen = np.ones(states.shape, dtype=bool) if which is None else which
    for name in states.dtype.names or ():
        if name not in ('stiffness', 'couple'):
            states[name][chosen] = math.nan if name == 'origin' else 0


@compiled
def is_active(contact: Any) -> bool:
    """Return whether the force law drives a contact."""
    return contact.state == IMPACT or contact.state == HOLDING


@compiled
def is_falling(contact: Any, alpha: float) -> bool:
    """Return whether a contact that has long held is felt far less than it was."""
    return contact.state == HOLDING and contact.in_state > GUARD_TIME and (
        alpha < GUARD_SHARE * min(contact.level, contact.asked))


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
def retreat(contact: Any, settings: Any, place: float, speed: float) -> None:
    """Leave a surface for its force, or for where it leads, until it is commanded again."""
    contact.displacement = place
    contact.speed = speed
    contact.target = place - settings.retract_distance
    contact.left = True
    enter(contact, RETRACTING)


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
        if contact.in_state >= LOST_TIME and (
                abs(contact.target - contact.displacement) < 2e-4 and abs(contact.speed) < 2e-3):
            contact.start = contact.displacement
            enter(contact, APPROACHING)
    elif contact.displacement - contact.start > (
            settings.search_distance if met_before else settings.approach_distance):
        contact.target = contact.start
        contact.searches += 1
        enter(contact, GIVEN_UP)


@compiled
def watch_hold(
    contact: Any, settings: Any, alpha: float, place: float, speed: float, escape: float,
) -> None:
    """Notice a loss, or that a touch has lasted."""
    h = settings.period
    threshold = max(settings.release_threshold, RELEASE_SHARE * min(
        contact.level, contact.asked, contact.force_limit))
    if alpha >= threshold:
        contact.below = 0.0
        contact.origin = place - alpha / contact.stiffness  # where it would not press any more
        contact.level += h / (LEVEL_TIME + h) * (alpha - contact.level)
    else:
        if contact.below == 0.0 and contact.state == HOLDING and (
                speed - contact.surface_speed < -REBOUND_SPEED and contact.shaken <= 0.0):
            # Thrown back by a surface that is stiffer than its model: it returns by itself,
            # once; one that is thrown back again and again swings, and is better let go.
            contact.below = min(0.0, settings.loss_time - REBOUND_TIME)
            contact.shaken = REBOUNDS_APART
        contact.below += h
    contact.shaken = max(0.0, contact.shaken - h)
    patience = settings.loss_time
    if contact.state == IMPACT:  # a bounce is no loss
        patience = max(patience, settings.bounce_time)
    # A step of the force is a motion, too: into a surface that yields as its model.
    step = abs(min(contact.asked, contact.force_limit) - contact.level)
    fastest = ESCAPE_SPEED + step / (contact.stiffness * STEP_TIME)
    if contact.below > patience + 1e-9 or escape > fastest:
        contact.losses += 1
        leave_surface(contact, place, speed)
        enter(contact, LOST)
    elif contact.state == IMPACT and contact.below == 0.0 and (
            contact.in_state >= IMPACT_TIME):
        contact.searches = 0
        enter(contact, HOLDING)


@compiled
def wait_to_search(contact: Any, settings: Any) -> None:
    """Seek a contact that was given up once it is time, or wanted."""
    wait = settings.retry_time * 2.0 ** min(max(contact.searches - 1, 0), LONGEST_WAIT)
    due = settings.retry_time > 0.0 and not contact.left and contact.in_state >= wait
    if due or contact.again:
        contact.left = False
        # As far as before, wherever the tip has come to meanwhile.
        contact.start = contact.target if np.isnan(contact.origin) else contact.origin
        enter(contact, APPROACHING)


@compiled
def has_retracted(contact: Any) -> bool:
    """Return whether a contact that retracts has come to where it is led."""
    return abs(contact.target - contact.displacement) < 1e-4


@compiled
def stays_away(contact: Any) -> bool:
    """
    Return whether a contact that is not asked for is led away from its surface all the same.

    It retracts from a force beyond the ceiling, and stays away if it was not asked for before:
    the motion would press it again, and again.
    """
    uncalled = np.isnan(contact.origin)
    if contact.state == RETRACTING:
        return uncalled or not has_retracted(contact)
    return contact.state == GIVEN_UP and contact.left and uncalled and not contact.again


@compiled
def switch_state(
    contact: Any, settings: Any, alpha: float, place: float, speed: float, escape: float,
) -> None:
    """Go to another state if it is time; see `advance_contact`."""
    if alpha > settings.force_ceiling and contact.state != RETRACTING:
        retreat(contact, settings, place, speed)
    elif not contact.wanted and not stays_away(contact):
        if is_active(contact):
            leave_surface(contact, place, speed)
        if contact.state != FREE:
            enter(contact, FREE)
        contact.left = False
        contact.searches = 0
        contact.losses = 0
        contact.origin = np.nan
        contact.target = 0.0
    elif contact.state == FREE:
        contact.start = contact.displacement
        enter(contact, APPROACHING)
    elif is_active(contact):
        watch_hold(contact, settings, alpha, place, speed, escape)
    elif contact.state == RETRACTING:
        if has_retracted(contact):
            enter(contact, GIVEN_UP)
    elif contact.state == GIVEN_UP:
        wait_to_search(contact, settings)
    else:
        watch_search(contact, settings, alpha)


@compiled
def raise_force_limit(contact: Any, settings: Any) -> None:
    """Let a contact that holds have what is asked for, at a bounded rate after a loss."""
    if contact.state == HOLDING and contact.losses == 0:
        contact.force_limit = max(contact.force_limit, contact.asked)
    elif contact.state == HOLDING or not np.isnan(contact.origin) and contact.losses > 0:
        step = settings.force_rate * settings.period
        contact.force_limit += min(max(contact.asked - contact.force_limit, -step), step)


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
            limit = RETRACT_SPEED
        wanted = min(max(
            POSITION_RATE * (contact.target - contact.displacement), -limit), limit)
        change = BRAKING
    if abs(contact.speed) > settings.approach_speed:
        change = max(change, BRAKING)
    contact.acceleration = min(max((wanted - contact.speed) / h, -change), change)
    contact.speed += contact.acceleration * h
    contact.displacement += contact.speed * h


@compiled
def advance_contact(
    contact: Any, settings: Any, alpha: float, place: float, speed: float, escape: float,
) -> None:
    """
    Take one tick into the state machine of a contact.

    `wanted` and `asked` of the contact say what the task wants; `escape` is the speed into the
    surface, less that of the surface, by which a contact is known to be lost [m/s].
    """
    contact.in_state += settings.period
    contact.again = contact.again and contact.state == GIVEN_UP
    switch_state(contact, settings, alpha, place, speed, escape)
    if is_active(contact):
        contact.acceleration = 0.0
        raise_force_limit(contact, settings)
    else:
        move(contact, settings)


@compiled
def follow_leader(couple: Any, leader: Any) -> None:
    """Let a couple of a contact be in the state of its normal force; both `CONTACT_STATE`."""
    couple.state = leader.state
    couple.in_state = leader.in_state


@compiled
def let_go(contact: Any, place: float, speed: float) -> None:
    """Give a contact back to the motion law, from where the tip is."""
    if is_active(contact):
        contact.losses += 1
        leave_surface(contact, place, speed)
        enter(contact, LOST)
    else:
        contact.displacement = place
        contact.speed = 0.0
