"""
The state of each contact: looked for, touched, held, lost, given up.

One machine per contact decides which law drives the operational point along that contact's
normal: the force law from touch to loss, the motion law before and after. In the motion law the
tip advances along the normal by a displacement that this module ramps, bounds and brakes.
"""

from __future__ import annotations

from enum import Enum

from multicontact_control.config import ContactStateConfig


class ContactState(Enum):
    """What is known of a contact."""

    FREE = 'free'
    APPROACHING = 'approaching'
    IMPACT = 'impact'
    HOLDING = 'holding'
    LOST = 'lost'
    RETRACTING = 'retracting'
    GIVEN_UP = 'given up'


ACTIVE = (ContactState.IMPACT, ContactState.HOLDING)
LEVEL_TIME = 0.1  # s, over which the force a contact is held with is averaged
TOUCH_SHARE = 0.5  # of the force before a loss, that counts as touch right after it
POSITION_RATE = 20.0  # 1/s, of the way left: how a displacement settles


class ContactMachine:
    """
    The state machine of one contact.

    free -> approaching -> impact -> holding -> lost -> approaching ..., given up once the tip has
    gone too far without a surface, retracting (then given up) beyond the force ceiling. Touch
    and loss have thresholds apart and least times, so that a bounce or a spike changes nothing.

    Parameters
    ----------
    config
        Thresholds, times, speeds.
    period
        h [s].

    Attributes
    ----------
    state
        Present state.
    displacement, speed, acceleration
        How the motion law is to move along the normal, relative to the task [m, m/s, m/s^2].
    force_limit
        Upper limit of the desired force in this tick [N].
    losses
        How often the contact was lost since it was first wanted.

    """

    def __init__(self, config: ContactStateConfig, period: float) -> None:
        self._config = config
        self._period = period
        self.reset()

    def reset(self) -> None:
        """Start anew, free."""
        self.state = ContactState.FREE
        self.displacement = self.speed = self.acceleration = 0.0
        self.force_limit = 0.0
        self.losses = 0
        self._in_state = 0.0
        self._below = self._level = 0.0
        self._origin: float | None = None  # where the surface was, if it was ever met
        self._start = 0.0
        self._target = 0.0

    @property
    def active(self) -> bool:
        """Whether the force law drives this contact."""
        return self.state in ACTIVE

    @property
    def approach_speed(self) -> float:
        """Largest speed towards the surface in this state [m/s]."""
        return self._config.approach_speed

    def retry(self) -> None:
        """Look again for a surface that was given up."""
        if self.state is ContactState.GIVEN_UP:
            self._enter(ContactState.FREE)
            self._origin = None

    def let_go(self, place: float, speed: float = 0.0) -> None:
        """
        Give a contact back to the motion law, from where the tip is.

        Parameters
        ----------
        place, speed
            Of the tip along the normal, relative to the task [m, m/s].

        """
        if self.active:
            self.losses += 1
            self._leave_surface(place, speed)
            self._enter(ContactState.LOST)
        else:
            self.displacement, self.speed = place, 0.0

    def update(self, wanted: bool, alpha: float, alpha_des: float, place: float,
               speed: float) -> None:
        """
        Take in one tick.

        Parameters
        ----------
        wanted
            Whether the task asks for this contact.
        alpha, alpha_des
            Measured and asked for force [N].
        place, speed
            Of the tip along the normal, relative to the task without displacement [m, m/s].

        """
        self._in_state += self._period
        self._switch(wanted, alpha, alpha_des, place, speed)
        if self.active:
            self.acceleration = 0.0
            self._raise_force_limit(alpha_des)
        else:
            self._move()

    def _switch(
        self, wanted: bool, alpha: float, alpha_des: float, place: float, speed: float,
    ) -> None:
        config, state = self._config, self.state
        if alpha > config.force_ceiling and state is not ContactState.RETRACTING:
            self._retract(place, speed)
        elif not wanted:
            self._stop_wanting(place, speed)
        elif state is ContactState.FREE:
            self._approach(self.displacement)
        elif self.active:
            self._watch_hold(alpha, alpha_des, place, speed)
        elif state is ContactState.RETRACTING:
            if abs(self._target - self.displacement) < 1e-4:
                self._enter(ContactState.GIVEN_UP)
        elif state is not ContactState.GIVEN_UP:
            self._watch_search(alpha)

    def _watch_search(self, alpha: float) -> None:
        config, threshold = self._config, self._config.contact_threshold
        if self.state is ContactState.LOST:  # a tool that is being braked reads its own inertia
            threshold = max(2.0 * threshold, TOUCH_SHARE * self._level)
        if alpha > threshold:
            again = self._origin is not None
            self.force_limit = max(alpha, config.preload) if again else config.preload
            self._below = self._level = 0.0
            self._enter(ContactState.IMPACT)
        elif self.state is ContactState.LOST:
            if self._in_state >= config.lost_time and (
                    abs(self._target - self.displacement) < 2e-4 and abs(self.speed) < 2e-3):
                self._approach(self.displacement)
        elif self.displacement - self._start > (
                config.approach_distance if self._origin is None else config.search_distance):
            self._target = self._start
            self._enter(ContactState.GIVEN_UP)

    def _watch_hold(
        self, alpha: float, alpha_des: float, place: float, speed: float,
    ) -> None:
        config, h = self._config, self._period
        threshold = max(config.release_threshold,
                        config.release_fraction * min(self._level, alpha_des, self.force_limit))
        if alpha >= threshold:
            self._below = 0.0
            self._origin = place
            self._level += h / (LEVEL_TIME + h) * (alpha - self._level)
        else:
            self._below += h
        if self._below > config.loss_time + 1e-9 or speed > config.escape_speed:
            self.losses += 1
            self._leave_surface(place, speed)
            self._enter(ContactState.LOST)
        elif self.state is ContactState.IMPACT and self._below == 0.0 and (
                self._in_state >= config.impact_time):
            self._enter(ContactState.HOLDING)

    def _stop_wanting(self, place: float, speed: float) -> None:
        """Go back to where the task is, if the contact was sought or held."""
        if self.active:
            self._leave_surface(place, speed)
        if self.state is not ContactState.FREE:
            self._enter(ContactState.FREE)
        self._origin = None
        self._target = 0.0

    def _leave_surface(self, place: float, speed: float) -> None:
        self.displacement, self.speed = place, speed
        self._target = self._start = place if self._origin is None else self._origin

    def _approach(self, start: float) -> None:
        self._start = start
        self._enter(ContactState.APPROACHING)

    def _retract(self, place: float, speed: float) -> None:
        self.displacement, self.speed = place, speed
        self._target = place - self._config.retract_distance
        self._enter(ContactState.RETRACTING)

    def _enter(self, state: ContactState) -> None:
        self.state = state
        self._in_state = 0.0

    def _raise_force_limit(self, alpha_des: float) -> None:
        """Let a contact that holds have what is asked for, at a bounded rate after a loss."""
        if self.state is ContactState.HOLDING and self.losses == 0:
            self.force_limit = max(self.force_limit, alpha_des)
        elif self.state is ContactState.HOLDING or self._origin is not None and self.losses:
            step = self._config.force_rate * self._period
            self.force_limit += min(max(alpha_des - self.force_limit, -step), step)

    def _move(self) -> None:
        """Advance the displacement by one period, its speed and acceleration bounded."""
        config, h = self._config, self._period
        if self.state is ContactState.APPROACHING:
            wanted = config.approach_speed
            change = config.approach_speed / config.approach_ramp_time
        else:
            limit = config.retract_speed if self.state is ContactState.RETRACTING else (
                config.approach_speed)
            wanted = min(max(POSITION_RATE * (self._target - self.displacement), -limit), limit)
            change = config.braking
        if abs(self.speed) > config.approach_speed:
            change = max(change, config.braking)
        self.acceleration = min(max((wanted - self.speed) / h, -change), change)
        self.speed += self.acceleration * h
        self.displacement += self.speed * h
