"""
The state of each contact: looked for, touched, held, lost, given up.

The force law drives the operational point along a contact's normal from touch to loss, the motion
law before and after: there the tip advances by a displacement that is ramped, bounded and braked.

free -> approaching -> impact -> holding -> lost -> approaching ..., given up once the tip has
gone too far without a surface, until it is time for another search. Beyond the force ceiling, and
where it leads out of the workspace: retracting, then given up until it is commanded again. It is
free as long as the task does not ask for it.

A `contact` is a record of `CONTACT_STATE`, changed, `settings` are one of `CONTACT_SETTINGS`;
`alpha` is the measured force [N], `place` and `speed` are those of the tip along the normal,
relative to the task without displacement [m, m/s].
"""

from __future__ import annotations

from typing import Any

from multicontact_control.compiled import compiled
from multicontact_control.config.supervision import ContactStateConfig
from multicontact_control.records import CONTACT_SETTINGS, CONTACT_STATE, Records
import numpy as np

NAMES = ('free', 'approaching', 'impact', 'holding', 'lost', 'retracting', 'given up')
FREE, APPROACHING, IMPACT, HOLDING, LOST, RETRACTING, GIVEN_UP = range(len(NAMES))
RELEASE_SHARE = 0.3  # of the force held or asked for, below which a contact may be lost
ESCAPE_SPEED = 0.1  # m/s into the surface, beyond the task's, that only a lost contact reaches
IMPACT_TIME = 0.05  # s in contact from touch to holding, at least
LOSS_TIME = 0.004  # s below the release threshold until a contact is lost
BOUNCE_TIME = 0.01  # s, the same between touch and holding: a bounce is no loss
REBOUND_TIME = 0.1  # s, the same of a contact that held and is thrown back
LOST_TIME = 0.05  # s from loss to a new approach, at least
BRAKING = 5.0  # m/s^2, of a tip that has lost its surface, or is pulled back
RETRACT_SPEED = 0.05  # m/s
RETRACT_DISTANCE = 0.01  # m, way back from a surface that is left
SEARCH_DISTANCE = 0.01  # m beyond where a lost surface was, from where on it is given up
FORCE_RATE = 100.0  # N/s, rise of the desired force of a contact that was lost, from touch on
LEVEL_TIME = 0.1  # s, over which the force a contact is held with is averaged
TOUCH_SHARE = 0.5  # of the force before a loss, that counts as touch right after it
STEP_TIME = 0.02  # s, in which a force step may be taken
REBOUND_SPEED = 2e-3  # m/s, away from the surface, from which on it is thrown back
REBOUNDS_APART = 0.5  # s
LOSS_PERIODS, BOUNCE_PERIODS = 2, 3  # the same, at least: one sample says nothing
POSITION_RATE = 20.0  # 1/s, of the way left: how a displacement settles

FREE_CONTACT: Records = np.zeros((), dtype=CONTACT_STATE)
FREE_CONTACT['origin'] = np.nan


def contact_settings(config: ContactStateConfig, period: float) -> Records:
    """Return what is set for all contacts as one record of `CONTACT_SETTINGS`; h in [s]."""
    values = config.model_dump() | {
        'period': period, 'loss_time': max(LOSS_TIME, LOSS_PERIODS * period),
        'bounce_time': max(BOUNCE_TIME, BOUNCE_PERIODS * period)}
    return np.array([tuple(values[name] for name in CONTACT_SETTINGS.names or ())],
                    dtype=CONTACT_SETTINGS)


@compiled
def is_active(contact: Any) -> bool:
    """Return whether the force law drives a contact."""
    return contact.state == IMPACT or contact.state == HOLDING


@compiled
def let_go(contact: Any, place: float, speed: float) -> None:
    """Give a contact back to the motion law, which leads the tip to where the surface was."""
    contact.displacement, contact.speed = place, 0.0
    if is_active(contact):
        contact.losses += 1
        contact.speed = speed
        contact.start = place if np.isnan(contact.origin) else contact.origin
        contact.target = contact.start
        contact.state, contact.in_state = LOST, 0.0


@compiled
def _watch_search(contact: Any, settings: Any, alpha: float) -> None:
    """Touch, or give up, or begin to look for a lost surface."""
    threshold = settings.contact_threshold
    if contact.state == LOST:  # a tool that is being braked reads its own inertia
        threshold = max(2.0 * threshold, TOUCH_SHARE * contact.level)
    met_before = not np.isnan(contact.origin)
    if alpha > threshold:
        contact.force_limit = max(alpha, settings.preload) if met_before else settings.preload
        contact.below = 0.0
        contact.level = 0.0
        contact.state = IMPACT
    elif contact.state == LOST:
        if contact.in_state >= LOST_TIME and (
                abs(contact.target - contact.displacement) < 2e-4 and abs(contact.speed) < 2e-3):
            contact.start = contact.displacement
            contact.state = APPROACHING
    elif contact.displacement - contact.start > (
            min(SEARCH_DISTANCE + contact.fall, settings.approach_distance) if met_before
            else settings.approach_distance):
        contact.target = contact.start
        contact.state = GIVEN_UP


@compiled
def _watch_hold(
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
    patience = settings.bounce_time if contact.state == IMPACT else settings.loss_time
    # A step of the force is a motion, too: into a surface that yields as its model.
    step = abs(min(contact.asked, contact.force_limit) - contact.level)
    fastest = ESCAPE_SPEED + step / (contact.stiffness * STEP_TIME)
    if contact.below > patience + 1e-9 or escape > fastest:
        let_go(contact, place, speed)
    elif contact.state == IMPACT and contact.below == 0.0 and contact.in_state >= IMPACT_TIME:
        contact.state = HOLDING


@compiled
def _switch_state(
    contact: Any, settings: Any, alpha: float, place: float, speed: float, escape: float,
) -> None:
    """Go to another state if it is time; see `advance_contact`."""
    met_before = not np.isnan(contact.origin)
    if not contact.wanted:
        if is_active(contact):
            let_go(contact, place, speed)
        contact.state = FREE
        contact.left = False
        contact.losses = 0
        contact.origin = np.nan
        contact.target = 0.0
    elif (alpha > settings.force_ceiling and contact.state != RETRACTING) or (
            contact.left and is_active(contact)):
        contact.displacement = place
        contact.speed = speed
        contact.target = place - RETRACT_DISTANCE
        contact.left = True
        contact.state = RETRACTING
    elif contact.state == FREE:
        contact.start = contact.displacement
        contact.state = APPROACHING
    elif is_active(contact):
        _watch_hold(contact, settings, alpha, place, speed, escape)
    elif contact.state == RETRACTING:
        if abs(contact.target - contact.displacement) < 1e-4:
            contact.state = GIVEN_UP
    elif contact.state == GIVEN_UP:
        due = 0.0 < settings.retry_time <= contact.in_state and not contact.left
        if due or contact.again:
            contact.left = False
            # As far as before, wherever the tip has come to meanwhile.
            contact.start = contact.origin if met_before else contact.target
            contact.state = APPROACHING
    else:
        _watch_search(contact, settings, alpha)


@compiled
def advance_contact(
    contact: Any, settings: Any, alpha: float, place: float, speed: float, escape: float,
) -> None:
    """
    Take one tick into the state machine of a contact, and bound the force or the way it goes.

    `escape` is the speed into the surface, less that of the surface, of a lost contact [m/s].
    """
    h = settings.period
    contact.in_state += h
    contact.again = contact.again and contact.state == GIVEN_UP
    before = contact.state
    _switch_state(contact, settings, alpha, place, speed, escape)
    if contact.state != before:
        contact.in_state = 0.0
    if is_active(contact):
        contact.acceleration = 0.0
        # It has what is asked for once it holds; after a loss at a bounded rate.
        if contact.state == HOLDING and contact.losses == 0:
            contact.force_limit = max(contact.force_limit, contact.asked)
        elif contact.state == HOLDING or not np.isnan(contact.origin) and contact.losses > 0:
            contact.force_limit += min(max(
                contact.asked - contact.force_limit, -FORCE_RATE * h), FORCE_RATE * h)
        return
    wanted, change = settings.approach_speed, BRAKING
    if contact.state != APPROACHING:
        limit = RETRACT_SPEED if contact.state == RETRACTING else wanted
        wanted = min(max(
            POSITION_RATE * (contact.target - contact.displacement), -limit), limit)
    elif abs(contact.speed) <= settings.approach_speed:
        change = settings.approach_speed / settings.approach_ramp_time
    contact.acceleration = min(max((wanted - contact.speed) / h, -change), change)
    contact.speed += contact.acceleration * h
    contact.displacement += contact.speed * h
