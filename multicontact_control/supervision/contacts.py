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

from typing import Protocol

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
RELEASE_SHARE = 0.3  # of the force held or asked for, below which a contact may be lost
ESCAPE_SPEED = (
    0.1  # m/s into the surface, beyond the task's, that only a lost contact reaches
)
IMPACT_TIME = 0.05  # s in contact from touch to holding, at least
LOSS_TIME = 0.004  # s below the release threshold until a contact is lost
BOUNCE_TIME = 0.01  # s, the same between touch and holding: a bounce is no loss
REBOUND_TIME = 0.1  # s, the same of a contact that held and is thrown back
LOST_TIME = 0.05  # s from loss to a new approach, at least
BRAKING = 5.0  # m/s^2, of a tip that has lost its surface, or is pulled back
RETRACT_SPEED = 0.05  # m/s
RETRACT_DISTANCE = 0.01  # m, way back from a surface that is left
SEARCH_DISTANCE = (
    0.01  # m beyond where a lost surface was, from where on it is given up
)
FORCE_RATE = (
    100.0  # N/s, rise of the desired force of a contact that was lost, from touch on
)
EXCESS = 1.5  # times that force, above which more is felt than it asks for
MEAN_FORCE_TIME = 0.1  # s, over which the force a contact is held with is averaged
TOUCH_SHARE = 0.5  # of the force before a loss, that counts as touch right after it
FORCE_STEP_TIME = 0.02  # s, in which a force step may be taken
REBOUND_SPEED = 2e-3  # m/s, away from the surface, from which on it is thrown back
REBOUNDS_APART = 0.5  # s
LOSS_PERIODS, BOUNCE_PERIODS = 2, 3  # the same, at least: one sample says nothing
POSITION_RATE = 20.0  # 1/s, of the way left: how a displacement settles
TARE_SHARE = (
    1.0 / 3.0
)  # of the contact threshold, from which on what is read freely is taken off
AVERAGE_TIME = 0.1  # s, over which that is averaged where the tip stands
AVERAGE_WAY = (
    0.02  # m, the same on the way: a sensor drifts, and a soft surface is no drift
)
FALL_TIME = 0.5  # s, the same of a fall, which is no touch; a flipped sign falls faster
AHEAD_TIME = 0.3  # s without an answer, from which on more than the threshold is asked beyond that
PRESSING_WAY = 5e-4  # m without a change, as of a preload on a surface
FREE_WAY = 3e-3  # m without a change, after which what is read is no force of a surface
ANSWER_SHARE = 0.5  # of the contact threshold, by which a force has to rise to answer
SOFTEST_SURFACE = 150.0  # N/m; what rises less on the way is no surface
SLIPPING = (
    2e-4  # m back, at which a force that rises still answers: drives and tools bend
)
ANSWER_TIME = 0.015  # s, over which a force that is to answer is averaged: drives let a tool swing
YIELDING, RETREATING = (
    0.01,
    5e-3,
)  # m forth and back without an answer, after which it is none
STAYING = 1e-3  # m out of a surface during a pause, at most, of a contact that stays
UNANSWERED_TIME = (
    1.0  # s of more force that is asked for, after which there is no answer
)
GENTLE = 0.9  # times the approach speed, at most, until a force has answered
IMPACT_FORCE = (
    10.0  # N, of a touch at the approach speed, at most, if the surface is as modelled
)
TOUCHING = 1.5  # the same at a touch, which comes down to that within `IMPACT_TIME`
SETTLING_PERIODS, SETTLING_DELAYS = (
    2,
    3,
)  # in which a step of what is read has passed the filters


class ContactState(Record, Protocol):
    """The supervised state of one contact."""

    state: int  # one of those above
    losses: int  # how often it was lost since it was first wanted
    retract_requested: (
        bool  # whether it is to be left, or was, for its force or for where it leads
    )
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
    surface_displacement: (
        float  # displacement at which the surface is, NaN if it was never met [m]
    )
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

    preload_time: (
        float  # until it has more than the preload, of one that has answered late [s]
    )


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
    """Give a contact back to the motion law, which leads the tip to where the surface was."""
    contact.displacement, contact.speed = place, 0.0
    if contact.state in PRESSED:
        contact.losses += 1
        contact.speed = speed
        contact.target_displacement = place
        if not np.isnan(contact.surface_displacement):
            contact.search_start = contact.target_displacement = (
                contact.surface_displacement
            )
        contact.state, contact.time_in_state = LOST, 0.0


@compiled
def _set_untared_force(
    contact: ContactState, settings: ContactSettings, baseline: float
) -> None:
    """Take what is read without a touch off the measured force, if it is worth it [N]."""
    contact.baseline = baseline
    least = TARE_SHARE * settings.contact_threshold
    contact.untared = baseline if abs(baseline) >= least else 0.0


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
    """Average what is read where a contact is not sought, over `AVERAGE_TIME`."""
    longest = max(1.0, np.round(AVERAGE_TIME / settings.period))
    contact.averaged_samples = min(contact.averaged_samples + 1.0, longest)
    contact.baseline += (
        alpha + contact.untared - contact.baseline
    ) / contact.averaged_samples


@compiled
def follow_free_reading(
    contact: ContactState,
    settings: ContactSettings,
    alpha: float,
    way: float,
) -> None:
    """Follow what is read on a way towards a surface [m], and take it off."""
    seen = TARE_SHARE * settings.contact_threshold
    if contact.averaged_samples * settings.period < AVERAGE_TIME and abs(alpha) < seen:
        average_free_reading(contact, settings, alpha)
    else:
        share = abs(way) / AVERAGE_WAY
        if alpha < -seen:
            share = max(share, settings.period / FALL_TIME)
        contact.baseline += min(share, 1.0) * (
            alpha + contact.untared - contact.baseline
        )
    _set_untared_force(contact, settings, contact.baseline)


@compiled
def resume_contact(contact: ContactState, alpha: float, place: float) -> None:
    """
    Go on with a contact that was pressed before a pause.

    It has to answer anew unless it is where the surface was, with a good part of the force.
    """
    contact.displacement = place
    contact.answered = contact.answered and (
        place > contact.surface_displacement - STAYING
        and alpha > TOUCH_SHARE * contact.mean_force
    )
    contact.resumed = True
    contact.observed_time = contact.resting_force = contact.shortfall_time = 0.0


@compiled
def restart_free_reading(
    contact: ContactState, settings: ContactSettings, alpha: float
) -> None:
    """Take what is read after a pause for what a search begins with."""
    if (
        contact.state == FREE
        or contact.state == APPROACHING
        or contact.state == GIVEN_UP
    ):
        contact.averaged_samples = 0.0
        average_free_reading(contact, settings, alpha)
    if contact.state == APPROACHING:
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
    if contact.observed_time <= settings.settling_time + 1e-9:
        contact.smoothed_force = contact.least_force = force
        contact.smoothed_reading = contact.least_reading = alpha
        contact.least_force_place = place
        return
    share = settings.period / (ANSWER_TIME + settings.period)
    contact.smoothed_force += share * (force - contact.smoothed_force)
    contact.smoothed_reading += share * (alpha - contact.smoothed_reading)
    contact.least_reading = min(contact.least_reading, contact.smoothed_reading)
    if contact.smoothed_force < contact.least_force:
        contact.least_force = contact.smoothed_force
        contact.least_force_place = place
    changed = TARE_SHARE * settings.contact_threshold
    if contact.smoothed_force < contact.least_force + changed:
        contact.flat_force_place = place
    # What the tip is said to rest on has to let go of it, too.
    if contact.smoothed_force < contact.resting_force - changed:
        contact.resting_force = 0.0
    way = place - contact.least_force_place
    needed = max(ANSWER_SHARE * settings.contact_threshold, SOFTEST_SURFACE * way)
    missing = min(contact.alpha_task, contact.force_limit) - contact.smoothed_force
    asks = missing > ANSWER_SHARE * settings.contact_threshold
    contact.shortfall_time = contact.shortfall_time + settings.period if asks else 0.0
    rise = min(
        contact.smoothed_force - contact.least_force,
        contact.smoothed_reading - contact.least_reading,
    )
    contact.answered = (
        contact.resting_force == 0.0 and way > -SLIPPING and rise >= needed
    )


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
    """Return what is asked of a contact as far as it may have it [N]."""
    desired = min(contact.alpha_task, contact.force_limit)
    if contact.answered:
        return min(desired, settings.preload) if contact.preload_time > 0.0 else desired
    # No more than is needed to find out: what is fed forward moves a tool that nothing bears.
    if contact.resting_force > 0.0:
        return min(desired, settings.preload)
    ahead = settings.contact_threshold * max(1.0, contact.observed_time / AHEAD_TIME)
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
        return (
            contact.approach_speed + fall_speed
            if contact.time_below_threshold != 0.0
            else 0.0
        )
    times = GENTLE
    if contact.state == IMPACT:
        times += (TOUCHING - GENTLE) * max(
            0.0, 1.0 - contact.time_in_state / IMPACT_TIME
        )
    return times * contact.approach_speed


@compiled
def refute_contact(
    contact: ContactState, settings: ContactSettings, place: float, speed: float
) -> bool:
    """
    Let a contact go if it is none; return whether it was let go.

    It is none, and all that is read is no force, once the tip has gone too far, or too long,
    without an answer of a surface.
    """
    if contact.state not in PRESSED or contact.answered:
        return False
    if contact.observed_time <= settings.settling_time:
        return False
    way = place - contact.least_force_place
    if contact.resumed:  # it may slide along a slope meanwhile
        refuted = way > settings.approach_distance
    else:
        # A law that goes on by a way of its own, as an impedance does, may stand in free space.
        refuted = (
            way > YIELDING
            or way < -RETREATING
            or contact.shortfall_time > UNANSWERED_TIME
        )
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
            contact.answered, contact.resting_force = False, contact.untared
        contact.baseline = contact.untared = 0.0
    elif contact.untared != 0.0:
        _set_untared_force(contact, settings, contact.free_baseline)
    taken = reading - contact.untared
    contact.smoothed_force += taken - alpha
    contact.least_force += taken - alpha
    contact.smoothed_reading += taken - alpha
    contact.least_reading += taken - alpha
    return taken


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
    threshold = settings.contact_threshold
    nothing_seen = alpha < TARE_SHARE * threshold
    if contact.state == LOST or nothing_seen:  # an answer is waited for from now on
        contact.answered = contact.resumed = False
        contact.observed_time = contact.resting_force = contact.shortfall_time = 0.0
    else:
        _watch_surface_answer(contact, settings, alpha, place, speed)
    if contact.state == LOST:  # a tool that is being braked reads its own inertia
        threshold = max(2.0 * threshold, TOUCH_SHARE * contact.mean_force)
    elif nothing_seen:
        contact.free_way = max(
            contact.free_way, contact.displacement - contact.search_start
        )
        contact.free_baseline = contact.baseline
    if alpha > threshold:
        if contact.state == APPROACHING:
            alpha = _begin_contact(contact, settings, alpha)
        contact.force_limit = (
            max(alpha, settings.preload) if met_before else settings.preload
        )
        contact.time_below_threshold = contact.mean_force = contact.preload_time = 0.0
        contact.touch_place = contact.flat_force_place = place
        contact.state = IMPACT
    elif contact.state == LOST:
        stands = (
            abs(contact.target_displacement - contact.displacement) < 2e-4
            and abs(contact.speed) < 2e-3
        )
        if contact.time_in_state >= LOST_TIME and stands:
            if met_before:
                contact.search_start = contact.displacement
            contact.state = APPROACHING
    else:
        farthest = settings.approach_distance
        if met_before:
            farthest = min(SEARCH_DISTANCE + contact.surface_fall, farthest)
        if contact.displacement - contact.search_start > farthest:
            contact.target_displacement = contact.search_start
            contact.state = GIVEN_UP


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
    unanswered = not contact.answered
    if unanswered:
        _watch_surface_answer(contact, settings, alpha, place, speed)
        if contact.answered and contact.state == HOLDING and not contact.resumed:
            _begin_with_preload(contact, settings)
    threshold = max(
        RELEASE_FORCE,
        RELEASE_SHARE
        * min(contact.mean_force, contact.alpha_task, contact.force_limit),
    )
    held = contact.state == HOLDING and contact.preload_time == 0.0
    if alpha >= threshold:
        contact.time_below_threshold = 0.0
        contact.preload_time = max(0.0, contact.preload_time - h)
        if contact.answered or contact.resumed:  # where it would not press any more
            contact.surface_displacement = place - alpha / contact.stiffness
        contact.mean_force += h / (MEAN_FORCE_TIME + h) * (alpha - contact.mean_force)
    else:
        if (
            contact.time_below_threshold == 0.0
            and held
            and (
                speed - contact.surface_speed < -REBOUND_SPEED
                and contact.rebound_lockout <= 0.0
            )
        ):
            # Thrown back by a surface that is stiffer than its model: it returns by itself,
            # once; one that is thrown back again and again swings, and is better let go.
            contact.time_below_threshold = min(0.0, settings.loss_time - REBOUND_TIME)
            contact.rebound_lockout = REBOUNDS_APART
        contact.time_below_threshold += h
    contact.rebound_lockout = max(0.0, contact.rebound_lockout - h)
    patience = settings.loss_time if held else settings.bounce_time
    # A step of the force is a motion, too: into a surface that yields as its model.
    step = abs(min(contact.alpha_task, contact.force_limit) - contact.mean_force)
    fastest = ESCAPE_SPEED + step / (contact.stiffness * FORCE_STEP_TIME)
    if contact.time_below_threshold > patience + 1e-9 or escape > fastest:
        release_contact(contact, place, speed)
    elif (
        contact.state == IMPACT
        and contact.time_below_threshold == 0.0
        and contact.time_in_state >= IMPACT_TIME
    ):
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
    due = (
        0.0 < settings.retry_time <= contact.time_in_state
        and not contact.retract_requested
    )
    if due or contact.retry_requested:
        contact.retract_requested = False
        # As far as before, wherever the tip has come to meanwhile.
        contact.search_start = (
            contact.target_displacement
            if np.isnan(contact.surface_displacement)
            else contact.surface_displacement
        )
        _begin_search(contact, settings)


@compiled
def _advance_displacement(contact: ContactState, settings: ContactSettings) -> None:
    """Go on by a displacement that is ramped, bounded and braked."""
    h, wanted, change = settings.period, contact.approach_speed, BRAKING
    if contact.state != APPROACHING:
        limit = RETRACT_SPEED if contact.state == RETRACTING else wanted
        wanted = min(
            max(
                POSITION_RATE * (contact.target_displacement - contact.displacement),
                -limit,
            ),
            limit,
        )
    elif abs(contact.speed) <= contact.approach_speed:
        change = contact.approach_speed / settings.approach_ramp_time
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

    `escape` is the speed into the surface, less that of the surface, of a lost contact [m/s].
    """
    h, before = settings.period, contact.state
    contact.time_in_state += h
    contact.retry_requested = contact.retry_requested and before == GIVEN_UP
    if before == FREE or before == GIVEN_UP:
        average_free_reading(contact, settings, alpha)
    elif before == APPROACHING:
        follow_free_reading(contact, settings, alpha, contact.speed * h)
    too_hard = alpha > settings.force_ceiling and before != RETRACTING
    if not contact.wanted:
        _forget_contact(contact, place, speed)
    elif too_hard or (contact.retract_requested and before in PRESSED):
        contact.displacement, contact.speed = place, speed
        contact.target_displacement = place - RETRACT_DISTANCE
        contact.retract_requested = True
        contact.state = RETRACTING
    elif before == FREE:
        contact.search_start = contact.displacement
        _begin_search(contact, settings)
    elif before in PRESSED:
        _advance_hold(contact, settings, alpha, place, speed, escape)
    elif before == RETRACTING:
        if abs(contact.target_displacement - contact.displacement) < 1e-4:
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
    if contact.state not in PRESSED:
        _advance_displacement(contact, settings)
        return
    contact.acceleration = 0.0
    found_again = contact.losses > 0 and not np.isnan(contact.surface_displacement)
    # It has what is asked for once it holds; after a loss at a bounded rate.
    if contact.state == HOLDING and contact.losses == 0:
        contact.force_limit = max(contact.force_limit, contact.alpha_task)
    elif contact.state == HOLDING or found_again:
        change = min(
            max(contact.alpha_task - contact.force_limit, -FORCE_RATE * h),
            FORCE_RATE * h,
        )
        # After a bounce, which looks like noise, a law is blind for a while.
        if change < 0.0 or alpha <= EXCESS * contact.force_limit:
            contact.force_limit += change
