"""When the control law takes over again after a reaction: later each time it has to give up."""

from __future__ import annotations

from multicontact_control.config import WatchdogConfig

RECOVERING, LATCHED = 'recovering', 'latched'
RELAPSE_TIME = 5.0  # s after control has resumed, in which a reaction is a relapse
RELAPSES = 3  # in a row, of what the arm does or meets, after which control waits for an operator
LONGEST_RECOVERY = 2.0  # s that all must be well, at most
GROWTH = 3.0  # of the time that all must be well, from relapse to relapse
# What comes from what the arm does and meets, and not from readings that are missing.
PHYSICAL = ('motion', 'law', 'internal', 'wrench_pull', 'wrench_sideways', 'wrench_saturated',
            'collision')
SOON = 1.0  # s; missing readings come and go by chance, and are no relapse after this


def is_physical(causes: tuple[str, ...]) -> bool:
    """Return whether a reaction comes from what the arm does or meets."""
    return any(cause.startswith(PHYSICAL) for cause in causes)


class Recovery:
    """
    Counts relapses, so that holding and resuming do not alternate for ever.

    Control resumes once all inputs have been good for `recovery_time`. A reaction within 5 s after
    that (within 1 s if readings are missing) is a relapse, as is a law that cannot resume: each
    makes the time three times as long, up to 2 s. After three in a row of what the arm does or
    meets (a side wall, a collision, a speed, a posture without a torque) it is latched: the
    posture is held until an operator says otherwise. Missing readings are never latched.

    Parameters
    ----------
    config
        `recovery_time`.
    period
        h [s].

    Attributes
    ----------
    latched
        Whether control waits for an operator.

    """

    def __init__(self, config: WatchdogConfig, period: float) -> None:
        self._config, self._period = config, period
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.latched = False
        self._relapses = 0
        self._wait = self._config.recovery_time
        self._resumed_at: int | None = None

    def allow(self) -> None:
        """Let control resume although it is latched; the next relapse is the first."""
        self.latched, self._relapses = False, 0

    def resumed(self, tick: int) -> None:
        """Take note that control has resumed at a tick of its own count."""
        self._resumed_at = tick

    def stopped(self, causes: tuple[str, ...], tick: int) -> None:
        """Take note that a reaction has begun at a tick of control's count."""
        since, soon = self._resumed_at, RELAPSE_TIME if is_physical(causes) else SOON
        if since is None or (tick - since) * self._period > soon:
            self._relapses, self._wait = 0, self._config.recovery_time
        else:
            self.relapsed(causes)

    def relapsed(self, causes: tuple[str, ...]) -> None:
        """Take note that control has stopped too soon, or could not even resume."""
        self._wait = min(
            GROWTH * self._wait, max(LONGEST_RECOVERY, self._config.recovery_time))
        if is_physical(causes):
            self._relapses += 1
            self.latched = self._relapses >= RELAPSES

    def missing(self, good_ticks: int) -> tuple[str, ...]:
        """Return what control still waits for after so many good ticks, if anything."""
        if self.latched:
            return (LATCHED,)
        return (RECOVERING,) if good_ticks * self._period < self._wait else ()
