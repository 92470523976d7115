"""
The state of each contact: looked for, touched, held, lost, given up.

The force law drives the operational point along a contact's normal from touch to loss, the motion
law before and after: there the tip advances by a displacement that is ramped, bounded and braked.

free -> approaching -> impact -> holding -> lost -> approaching ..., given up once the tip has
gone too far without a surface, until it is time for another search. Beyond the force ceiling, and
where it leads out of the workspace: retracting, then given up until it is commanded again. It is
free as long as the task does not ask for it.

A touch is a change since the approach began: what a sensor reads in free space is no force. That
is averaged before the approach, followed on the way, and taken off (`untared`). A touch is proven
once the force answers the motion: it rises while the tip advances, as on any surface of
`SOFTEST_SURFACE` and more. Until then the tip is no faster than an approach, and a contact that
yields farther is released: all that it reads is no force, and the search goes on.

A `contact` is a record of `CONTACT_STATE`, changed, `settings` are one of `CONTACT_SETTINGS`;
`alpha` is the measured force without what is taken off [N], `place` and `speed` are those of the
tip along the normal, relative to the task without displacement [m, m/s].
"""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.config.supervision import ContactStateConfig, RELEASE_FORCE
from multicontact_control.records import (
    Record,
    record_dtype,
    Records,
)
import numpy as np
from numpy.typing import NDArray

STATE_NAMES = (
    'free',
    'approaching',
    'impact',
    'holding',
    'lost',
    'retracting',
    'given up',
)
FREE, APPROACHING, IMPACT, HOLDING, LOST, RETRACTING, GIVEN_UP = range(len(STATE_NAMES))
PRESSED = IMPACT, HOLDING  # where the force law drives it
SOUGHT = APPROACHING, LOST, RETRACTING  # where its displacement does

# Loss of a contact.
RELEASE_SHARE = 0.3  # of the force held or asked for, below which it may be lost
# m/s into the surface, beyond the task's, that only a lost contact reaches.
ESCAPE_SPEED = 0.1
FORCE_STEP_TIME = 0.02  # s, in which a force step may be taken
LOSS_TIME = 0.004  # s below the release threshold until a contact is lost
BOUNCE_TIME = 0.01  # s, the same between touch and holding: a bounce is no loss
REBOUND_TIME = 0.1  # s, the same of a contact that held and is thrown back
LOSS_PERIODS = 2  # the first of these, at least: one sample says nothing
BOUNCE_PERIODS = 3  # the second, at least
REBOUND_SPEED = 2e-3  # m/s, away from the surface, from which on it is thrown back
REBOUNDS_APART = 0.5  # s
MEAN_FORCE_TIME = 0.1  # s, over which the force a contact is held with is averaged

# The tip without contact.
BRAKING = 5.0  # m/s^2, of a tip that has lost its surface, or is pulled back
POSITION_RATE = 20.0  # 1/s, of the way that remains: how a displacement settles
LOST_TIME = 0.05  # s from loss to a new approach, at least
BACK_DISTANCE = 2e-4  # m from its target, within which a lost tip may approach again
BACK_SPEED = 2e-3  # m/s, the same
RETRACTED_DISTANCE = 1e-4  # m, the same of a tip that has retracted
SEARCH_DISTANCE = 0.01  # m beyond where a lost surface was, from where it is given up
RETRACT_SPEED = 0.05  # m/s
RETRACT_DISTANCE = 0.01  # m, way back from a surface that is left

# The touch, and the force after it.
TOUCH_SHARE = 0.5  # of the force before a loss, that counts as touch right after it
IMPACT_TIME = 0.05  # s in contact from touch to holding, at least
# N, of a touch at the approach speed on the modelled surface, at most.
IMPACT_FORCE = 10.0
# N/s, rise of the desired force of a contact that was lost, from touch on.
FORCE_RATE = 100.0
EXCESS = 1.5  # times that force, above which more is felt than it asks for

# What is read in free space.
TARE_SHARE = 1.0 / 3.0  # of the contact threshold, from which on it is taken off
AVERAGE_TIME = 0.1  # s, over which it is averaged where the tip stands
# m, the same on the way: a sensor drifts, and a soft surface is no drift.
AVERAGE_WAY = 0.02
# s, the same of a fall, which is no touch; a flipped sign falls faster.
FALL_TIME = 0.5
PRESSING_WAY = 5e-4  # m without a change, as of a preload on a surface
# m without a change, after which what is read is no force of a surface.
FREE_WAY = 3e-3

# The answer of a surface.
ANSWER_SHARE = 0.5  # of the contact threshold, by which a force has to rise to answer
SOFTEST_SURFACE = 150.0  # N/m; what rises less on the way is no surface
# m back, at which a force that rises still answers: drives and tools bend.
SLIPPING = 2e-4
# s, over which a force that is to answer is averaged: drives let a tool swing.
ANSWER_TIME = 0.015
YIELDING = 0.01  # m forth without an answer, after which there is none
RETREATING = 5e-3  # m back, the same
UNANSWERED_TIME = 1.0  # s of more force that is asked for, the same
# s without an answer, from which on more than the threshold is asked for beyond what is felt.
AHEAD_TIME = 0.3
STAYING = 1e-3  # m out of a surface during a pause, at most, of a contact that stays
GENTLE = 0.9  # times the approach speed, at most, until a force has answered
TOUCHING = 1.5  # the same at a touch, which falls to that within `IMPACT_TIME`
# In which a step of what is read has passed the filters: periods, and delays of the low-pass.
SETTLING_PERIODS = 2
SETTLING_DELAYS = 3
ROUNDING_TIME = 1e-9  # s, below which a duration is not exceeded


class ContactState(Record, Protocol):
    """
    The supervised state of one contact.

    What the task asks for, where the tip is led while it does not press, what is read without a
    touch, and how the force has answered the motion since it is seen; see the module for the
    states. A couple shares the state of its normal force and uses few of the fields.
    """

    state: int  # one of those above
    losses: int  # how often it was lost since it was first wanted

    # Whether it is to be left, or was, for its force or for where it leads.
    retract_requested: bool

    retry_requested: bool  # whether it is to be sought although it was given up
    wanted: bool  # whether the task asks for it
    alpha_task: float  # force the task asks for [N]
    alpha_task_age: float  # since when it is the same [s]
    displacement: float  # of the reference along the normal, relative to the task [m]
    displacement_before: float  # the same when the tick began [m]

    # Of that displacement [m/s], [m/s^2].
    speed: float
    acceleration: float

    force_limit: float  # upper limit of the desired force [N]
    time_in_state: float  # since when in this state [s]

    # For how long less is felt than by one that holds; < 0 if thrown back [s].
    time_below_threshold: float

    rebound_lockout: float  # until it may be thrown back again without being lost [s]
    mean_force: float  # force it is held with, averaged [N]

    # Displacement at which the surface is, NaN if it was never met [m].
    surface_displacement: float

    search_start: float  # displacement at which the search began [m]

    # By which a surface may be lower where the tip has slid to since a loss [m].
    surface_fall: float

    target_displacement: float  # displacement to go to [m]
    stiffness: float  # modelled, of the surface [N/m]
    surface_speed: float  # along the normal, as far as it is known [m/s]
    approach_speed: float  # largest one towards a surface that is not felt [m/s]
    averaged_samples: float  # samples in `baseline`, up to as many as are averaged
    baseline: float  # what is read without a touch [N]
    untared: float  # of that, what is taken off the measured force [N]
    free_way: float  # of the search, on which nothing was felt [m]
    free_baseline: float  # `baseline` at its end [N]
    answered: bool  # whether a force has risen with the way into the surface
    resumed: bool  # whether it was pressed before a pause, and has not answered since

    # Force that the tip is said to rest on before a search, 0 if not [N].
    resting_force: float

    last_speed: float  # of the tip along the normal, at the sample before [m/s]
    observed_time: float  # for how long a force is seen that has not answered [s]
    smoothed_force: float  # that force without the tool's inertia, smoothed [N]

    # The same with it, and its minimum [N].
    smoothed_reading: float
    least_reading: float

    shortfall_time: float  # for how long clearly more than that is asked for [s]

    # Minimum of `felt`, and where the tip was then [N], [m].
    least_force: float
    least_force_place: float

    # Of the touch, and of the last force near that [m].
    touch_place: float
    flat_force_place: float

    # Until it has more than the preload, of one that has answered late [s].
    preload_time: float

    # By which it turns the tool out of the task about its point: a rotation vector in world axes
    # [rad], and its rate [rad/s].
    turn: Annotated[Vector, 3]
    turn_rate: Annotated[Vector, 3]

    kept: bool  # whether it stays pressed while the arm stays, or goes on after a pause


CONTACT_STATE = record_dtype(ContactState)


class ContactSettings(Record, Protocol):
    """
    What is set for all contacts; one.

    `ContactStateConfig`, h, times of at least some periods, and the mass whose inertia the wrench
    has in it [kg].
    """

    period: float
    loss_time: float
    bounce_time: float
    approach_speed: float
    approach_ramp_time: float
    approach_distance: float
    contact_threshold: float
    preload: float
    force_ceiling: float
    retry_time: float
    settling_time: float
    tool_mass: float


CONTACT_SETTINGS = record_dtype(ContactSettings)


FREE_CONTACT: NDArray[np.void] = np.zeros((), dtype=CONTACT_STATE)
FREE_CONTACT['surface_displacement'] = np.nan


def contact_settings(
    config: ContactStateConfig,
    period: float,
    delay: float = 0.0,
) -> Records[ContactSettings]:
    """
    Return what is set for all contacts as one record of `CONTACT_SETTINGS`.

    h and the delay of what low-passes the wrench in [s]; `tool_mass` is left at 0.
    """
    values = config.model_dump() | {
        'period': period,
        'loss_time': max(LOSS_TIME, LOSS_PERIODS * period),
        'bounce_time': max(BOUNCE_TIME, BOUNCE_PERIODS * period),
        'tool_mass': 0.0,
        'settling_time': SETTLING_PERIODS * period + SETTLING_DELAYS * delay,
    }
    return np.array(
        [tuple(values[name] for name in CONTACT_SETTINGS.names or ())],
        dtype=CONTACT_SETTINGS,
    )


@compiled
def release_contact(contact: ContactState, place: float, speed: float) -> None:
    """
    Give a contact back to the motion law, which leads the tip to where the surface was.

    A contact that is not pressed stays in its state, and its tip at the place, at rest.
    """
    contact.displacement = place
    contact.speed = 0.0
    if contact.state not in PRESSED:
        return
    contact.state = LOST
    contact.time_in_state = 0.0
    contact.losses += 1
    contact.speed = speed
    contact.target_displacement = place
    if not np.isnan(contact.surface_displacement):
        contact.target_displacement = contact.surface_displacement
        contact.search_start = contact.surface_displacement


@compiled
def _set_untared_force(
    contact: ContactState, settings: ContactSettings, baseline: float
) -> None:
    """Take what is read without a touch off the measured force, if it is worth it [N]."""
    contact.baseline = baseline
    contact.untared = 0.0
    if abs(baseline) >= TARE_SHARE * settings.contact_threshold:
        contact.untared = baseline


@compiled
def _begin_search(contact: ContactState, settings: ContactSettings) -> None:
    """Go to a surface, and take off what is read before."""
    contact.free_way = 0.0
    _set_untared_force(contact, settings, contact.baseline)
    contact.state = APPROACHING


@compiled
def average_free_reading(
    contact: ContactState, settings: ContactSettings, alpha: float
) -> None:
    """
    Average what is read where a contact is not sought, over `AVERAGE_TIME`.

    `alpha` is the measured force [N], off which `untared` has been taken.
    """
    longest = max(1.0, np.round(AVERAGE_TIME / settings.period))
    reading = alpha + contact.untared
    contact.averaged_samples = min(contact.averaged_samples + 1.0, longest)
    contact.baseline += (reading - contact.baseline) / contact.averaged_samples


@compiled
def follow_free_reading(
    contact: ContactState,
    settings: ContactSettings,
    alpha: float,
    way: float,
) -> None:
    """
    Follow what is read on a way towards a surface [m], and take it off.

    The first readings are averaged over time, as long as nothing is felt; then drift is followed
    by the way, so that a soft surface is not taken for it. A force that falls is no touch.
    """
    noticeable = TARE_SHARE * settings.contact_threshold
    averages = contact.averaged_samples * settings.period < AVERAGE_TIME
    if averages and abs(alpha) < noticeable:
        average_free_reading(contact, settings, alpha)
    else:
        share = abs(way) / AVERAGE_WAY
        if alpha < -noticeable:
            share = max(share, settings.period / FALL_TIME)
        reading = alpha + contact.untared
        contact.baseline += min(share, 1.0) * (reading - contact.baseline)
    _set_untared_force(contact, settings, contact.baseline)


@compiled
def resume_contact(contact: ContactState, alpha: float, place: float) -> None:
    """
    Go on with a contact that was pressed before a pause.

    It has to answer anew unless it is where the surface was, with a good part of the force.
    """
    stays = place > contact.surface_displacement - STAYING
    presses = alpha > TOUCH_SHARE * contact.mean_force
    contact.displacement = place
    contact.answered = contact.answered and stays and presses
    contact.resumed = True
    contact.observed_time = 0.0
    contact.resting_force = 0.0
    contact.shortfall_time = 0.0


@compiled
def restart_free_reading(
    contact: ContactState, settings: ContactSettings, alpha: float
) -> None:
    """
    Let a search begin with what is read after a pause, `alpha` [N].

    A search that was under way begins anew from where the tip is now.
    """
    approaches = contact.state == APPROACHING
    if approaches or contact.state == FREE or contact.state == GIVEN_UP:
        contact.averaged_samples = 0.0
        average_free_reading(contact, settings, alpha)
    if approaches:
        contact.free_way = 0.0
        contact.search_start = contact.displacement
        _set_untared_force(contact, settings, contact.baseline)


@compiled
def _watch_surface_answer(
    contact: ContactState,
    settings: ContactSettings,
    alpha: float,
    place: float,
    speed: float,
) -> None:
    """
    Notice whether a force that is seen answers the motion.

    What a step of the reading brings is seen at once, at the place where it was: what counts is
    by how much the force rises after that, from where it was least, and how far the tip goes.
    The inertia of the tool is no force; behind flexible drives the encoders do not tell it, so
    that what is read has to rise both with and without it.
    """
    contact.observed_time += settings.period
    force = alpha - settings.tool_mass * (speed - contact.last_speed) / settings.period
    if contact.observed_time <= settings.settling_time + ROUNDING_TIME:
        contact.smoothed_force = force
        contact.least_force = force
        contact.smoothed_reading = alpha
        contact.least_reading = alpha
        contact.least_force_place = place
        return
    share = settings.period / (ANSWER_TIME + settings.period)
    contact.smoothed_force += share * (force - contact.smoothed_force)
    contact.smoothed_reading += share * (alpha - contact.smoothed_reading)
    contact.least_reading = min(contact.least_reading, contact.smoothed_reading)
    if contact.smoothed_force < contact.least_force:
        contact.least_force = contact.smoothed_force
        contact.least_force_place = place
    noticeable = TARE_SHARE * settings.contact_threshold
    if contact.smoothed_force < contact.least_force + noticeable:
        contact.flat_force_place = place
    # What the tip is said to rest on has to fall, too.
    if contact.smoothed_force < contact.resting_force - noticeable:
        contact.resting_force = 0.0
    least_rise = ANSWER_SHARE * settings.contact_threshold
    desired = min(contact.alpha_task, contact.force_limit)
    contact.shortfall_time += settings.period
    if desired - contact.smoothed_force <= least_rise:
        contact.shortfall_time = 0.0
    way = place - contact.least_force_place
    rise = min(
        contact.smoothed_force - contact.least_force,
        contact.smoothed_reading - contact.least_reading,
    )
    rises = rise >= max(least_rise, SOFTEST_SURFACE * way)
    contact.answered = contact.resting_force == 0.0 and way > -SLIPPING and rises


@compiled
def _begin_with_preload(contact: ContactState, settings: ContactSettings) -> None:
    """
    Begin with the preload where the tip has gone on before a force that held has answered.

    It may touch the surface only now; after a longer way it does, and what it has read until then
    is no force.
    """
    way = contact.flat_force_place - contact.touch_place
    if way > PRESSING_WAY:
        contact.preload_time = IMPACT_TIME
    if way > FREE_WAY:
        contact.free_way = FREE_WAY
        _set_untared_force(contact, settings, contact.untared + contact.least_force)


@compiled
def desired_force(contact: ContactState, settings: ContactSettings) -> float:
    """
    Return what is asked of a contact as far as it may have it [N].

    Until a surface answers, no more than is needed to find out: what is fed forward moves a tool
    that nothing bears. The longer that takes, the more is asked for beyond what is felt.
    """
    desired = min(contact.alpha_task, contact.force_limit)
    if contact.answered:
        if contact.preload_time > 0.0:
            return min(desired, settings.preload)
        return desired
    if contact.resting_force > 0.0:
        return min(desired, settings.preload)
    times = max(1.0, contact.observed_time / AHEAD_TIME)
    ahead = settings.contact_threshold * times
    return min(desired, max(contact.smoothed_force + ahead, settings.preload))


@compiled
def limit_approach_speed(
    contact: ContactState, settings: ContactSettings, mobility: float
) -> float:
    """
    Return the speed of an approach [m/s].

    A mass m that meets a surface of stiffness k at a speed v is stopped by a force v sqrt(k m),
    whatever is commanded meanwhile. `mobility` is 1 / m along the normal [1/kg], 0 until the
    control law has been asked.
    """
    if mobility <= 0.0:
        return settings.approach_speed
    return min(
        settings.approach_speed, IMPACT_FORCE * np.sqrt(mobility / contact.stiffness)
    )


@compiled
def bound_contact_speed(contact: ContactState, fall_speed: float) -> float:
    """
    Return the largest speed into a surface that does not answer, 0 for none [m/s].

    A contact that holds, but is not felt any more, has been thrown back, or its surface falls away
    by `fall_speed` at most: it returns no faster than it may touch.
    """
    if contact.state not in PRESSED:
        return 0.0
    if contact.answered:
        if contact.time_below_threshold == 0.0:
            return 0.0
        return contact.approach_speed + fall_speed
    times = GENTLE
    if contact.state == IMPACT:
        remaining = max(0.0, 1.0 - contact.time_in_state / IMPACT_TIME)
        times += (TOUCHING - GENTLE) * remaining
    return times * contact.approach_speed


@compiled
def refute_contact(
    contact: ContactState, settings: ContactSettings, place: float, speed: float
) -> bool:
    """
    Release a contact if it is none; return whether it was released.

    It is none, and all that is read is no force, once the tip has gone too far, or too long,
    without an answer of a surface. A contact that resumes may slide along a slope meanwhile; a law
    that goes on by a way of its own, as an impedance does, may stand in free space.
    """
    if contact.answered or contact.state not in PRESSED:
        return False
    if contact.observed_time <= settings.settling_time:
        return False
    way = place - contact.least_force_place
    if contact.resumed:
        refuted = way > settings.approach_distance
    else:
        too_long = contact.shortfall_time > UNANSWERED_TIME
        refuted = way > YIELDING or way < -RETREATING or too_long
    if refuted:
        _set_untared_force(contact, settings, contact.untared + contact.smoothed_force)
        contact.free_way = FREE_WAY
        contact.surface_displacement = np.nan
        contact.mean_force = 0.0
        release_contact(contact, place, speed)
    return refuted


@compiled
def _begin_contact(
    contact: ContactState, settings: ContactSettings, alpha: float
) -> float:
    """
    Begin to press; return the measured force without what was read before [N].

    What was read from the first moment on, without a way in free space, may be the force of a
    surface that the tip rests on; it stays in, unless it pulls.
    """
    reading = alpha + contact.untared
    if contact.free_way < FREE_WAY and contact.untared > 0.0:
        if contact.untared > settings.preload:
            contact.answered = False
            contact.resting_force = contact.untared
        contact.baseline = 0.0
        contact.untared = 0.0
    elif contact.untared != 0.0:
        _set_untared_force(contact, settings, contact.free_baseline)
    force = reading - contact.untared
    added = force - alpha
    contact.smoothed_force += added
    contact.least_force += added
    contact.smoothed_reading += added
    contact.least_reading += added
    return force


@compiled
def _advance_search(
    contact: ContactState,
    settings: ContactSettings,
    alpha: float,
    place: float,
    speed: float,
) -> None:
    """Touch, or give up, or begin to look for a lost surface."""
    met_before = not np.isnan(contact.surface_displacement)
    lost = contact.state == LOST
    threshold = settings.contact_threshold
    nothing_felt = alpha < TARE_SHARE * threshold
    if lost or nothing_felt:
        contact.answered = False
        contact.resumed = False
        contact.observed_time = 0.0
        contact.resting_force = 0.0
        contact.shortfall_time = 0.0
    else:
        _watch_surface_answer(contact, settings, alpha, place, speed)
    if lost:  # a tool that is being braked reads its own inertia
        threshold = max(2.0 * threshold, TOUCH_SHARE * contact.mean_force)
    elif nothing_felt:
        way = contact.displacement - contact.search_start
        contact.free_way = max(contact.free_way, way)
        contact.free_baseline = contact.baseline
    if alpha > threshold:
        if not lost:
            alpha = _begin_contact(contact, settings, alpha)
        contact.state = IMPACT
        contact.force_limit = settings.preload
        if met_before:
            contact.force_limit = max(alpha, settings.preload)
        contact.time_below_threshold = 0.0
        contact.mean_force = 0.0
        contact.preload_time = 0.0
        contact.touch_place = place
        contact.flat_force_place = place
    elif lost:
        way = abs(contact.target_displacement - contact.displacement)
        stands = way < BACK_DISTANCE and abs(contact.speed) < BACK_SPEED
        if stands and contact.time_in_state >= LOST_TIME:
            contact.state = APPROACHING
            if met_before:
                contact.search_start = contact.displacement
    else:
        farthest = settings.approach_distance
        if met_before:
            farthest = min(SEARCH_DISTANCE + contact.surface_fall, farthest)
        if contact.displacement - contact.search_start > farthest:
            contact.state = GIVEN_UP
            contact.target_displacement = contact.search_start


@compiled
def _advance_hold(
    contact: ContactState,
    settings: ContactSettings,
    alpha: float,
    place: float,
    speed: float,
    escape: float,
) -> None:
    """Notice a loss, or that a touch has lasted."""
    h = settings.period
    waits_for_answer = not contact.answered
    if waits_for_answer:
        _watch_surface_answer(contact, settings, alpha, place, speed)
        if contact.answered and contact.state == HOLDING and not contact.resumed:
            _begin_with_preload(contact, settings)
    desired = min(contact.alpha_task, contact.force_limit)
    threshold = max(RELEASE_FORCE, RELEASE_SHARE * min(contact.mean_force, desired))
    patience = settings.bounce_time
    held = contact.state == HOLDING and contact.preload_time == 0.0
    if held:
        patience = settings.loss_time
    if alpha >= threshold:
        contact.time_below_threshold = 0.0
        contact.preload_time = max(0.0, contact.preload_time - h)
        if contact.answered or contact.resumed:  # where it would not press any more
            contact.surface_displacement = place - alpha / contact.stiffness
        share = h / (MEAN_FORCE_TIME + h)
        contact.mean_force += share * (alpha - contact.mean_force)
    else:
        # A surface that is stiffer than its model throws a contact back, which returns by itself,
        # once; one that is thrown back again and again swings, and is better released.
        begins = held and contact.time_below_threshold == 0.0
        thrown_back = speed - contact.surface_speed < -REBOUND_SPEED
        if begins and thrown_back and contact.rebound_lockout <= 0.0:
            contact.time_below_threshold = min(0.0, settings.loss_time - REBOUND_TIME)
            contact.rebound_lockout = REBOUNDS_APART
        contact.time_below_threshold += h
    contact.rebound_lockout = max(0.0, contact.rebound_lockout - h)
    # A step of the force is a motion, too: into a surface that yields as its model.
    step = abs(desired - contact.mean_force)
    fastest = ESCAPE_SPEED + step / (contact.stiffness * FORCE_STEP_TIME)
    if contact.time_below_threshold > patience + ROUNDING_TIME or escape > fastest:
        release_contact(contact, place, speed)
    elif contact.state == IMPACT and contact.time_below_threshold == 0.0:
        if contact.time_in_state >= IMPACT_TIME:
            contact.state = HOLDING


@compiled
def _forget_contact(contact: ContactState, place: float, speed: float) -> None:
    """Forget a contact that the task does not ask for."""
    if contact.state in PRESSED:
        release_contact(contact, place, speed)
    contact.state = FREE
    contact.retract_requested = False
    contact.losses = 0
    contact.surface_displacement = np.nan
    contact.target_displacement = 0.0
    contact.untared = 0.0


@compiled
def _repeat_search(contact: ContactState, settings: ContactSettings) -> None:
    """Look again for a surface that was given up, if it is time or asked for."""
    due = 0.0 < settings.retry_time <= contact.time_in_state
    if contact.retry_requested or (due and not contact.retract_requested):
        contact.retract_requested = False
        # As far as before, wherever the tip has come to meanwhile.
        contact.search_start = contact.target_displacement
        if not np.isnan(contact.surface_displacement):
            contact.search_start = contact.surface_displacement
        _begin_search(contact, settings)


@compiled
def _advance_displacement(contact: ContactState, settings: ContactSettings) -> None:
    """Go on by a displacement that is ramped, bounded and braked."""
    h, change = settings.period, BRAKING
    if contact.state == APPROACHING:
        wanted = contact.approach_speed
        if abs(contact.speed) <= wanted:
            change = wanted / settings.approach_ramp_time
    else:
        limit = contact.approach_speed
        if contact.state == RETRACTING:
            limit = RETRACT_SPEED
        way = contact.target_displacement - contact.displacement
        wanted = min(max(POSITION_RATE * way, -limit), limit)
    contact.acceleration = min(max((wanted - contact.speed) / h, -change), change)
    contact.speed += contact.acceleration * h
    contact.displacement += contact.speed * h


@compiled
def advance_contact(
    contact: ContactState,
    settings: ContactSettings,
    alpha: float,
    place: float,
    speed: float,
    escape: float,
) -> None:
    """
    Take one tick into the state machine of a contact, and bound the force or the way it goes.

    Parameters
    ----------
    contact, settings
        A record of `CONTACT_STATE`, changed, and one of `CONTACT_SETTINGS`.
    alpha
        Measured force, without what was read before the touch [N].
    place, speed
        Of the tip along the normal, relative to the task without displacement [m], [m/s].
    escape
        Speed into the surface, less that of the surface, of a lost contact [m/s].

    """
    before = contact.state
    contact.time_in_state += settings.period
    contact.retry_requested = contact.retry_requested and before == GIVEN_UP
    if before == FREE or before == GIVEN_UP:
        average_free_reading(contact, settings, alpha)
    elif before == APPROACHING:
        way = contact.speed * settings.period
        follow_free_reading(contact, settings, alpha, way)
    too_hard = alpha > settings.force_ceiling and before != RETRACTING
    if not contact.wanted:
        _forget_contact(contact, place, speed)
    elif too_hard or (contact.retract_requested and before in PRESSED):
        contact.state = RETRACTING
        contact.retract_requested = True
        contact.displacement = place
        contact.speed = speed
        contact.target_displacement = place - RETRACT_DISTANCE
    elif before == FREE:
        contact.search_start = contact.displacement
        _begin_search(contact, settings)
    elif before in PRESSED:
        _advance_hold(contact, settings, alpha, place, speed, escape)
    elif before == RETRACTING:
        way = abs(contact.target_displacement - contact.displacement)
        if way < RETRACTED_DISTANCE:
            contact.state = GIVEN_UP
    elif before == GIVEN_UP:
        _repeat_search(contact, settings)
    else:
        _advance_search(contact, settings, alpha, place, speed)
    contact.last_speed = speed
    if contact.state != before:
        contact.time_in_state = 0.0
        if contact.state == FREE or contact.state == GIVEN_UP:
            contact.averaged_samples = 0.0
    if contact.state in PRESSED:
        contact.acceleration = 0.0
        _advance_force_limit(contact, settings, alpha)
    else:
        _advance_displacement(contact, settings)


@compiled
def _advance_force_limit(
    contact: ContactState, settings: ContactSettings, alpha: float
) -> None:
    """
    Let a contact have what is asked for once it holds; after a loss at a bounded rate.

    After a bounce, which looks like noise, a law is blind for a while: the limit does not rise
    while clearly more is felt.
    """
    holds = contact.state == HOLDING
    found_again = contact.losses > 0 and not np.isnan(contact.surface_displacement)
    if holds and contact.losses == 0:
        contact.force_limit = max(contact.force_limit, contact.alpha_task)
    elif holds or found_again:
        largest = FORCE_RATE * settings.period
        missing = contact.alpha_task - contact.force_limit
        change = min(max(missing, -largest), largest)
        if change < 0.0 or alpha <= EXCESS * contact.force_limit:
            contact.force_limit += change
