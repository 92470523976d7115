"""A simulator that waits for its answers, and lossy ways between it and a controller's timing."""

from collections import deque

from multicontact_control.sampling import Action
from multicontact_control.supervision.inputs import JointInput, WrenchInput
import numpy as np

PERIOD = 2_000_000  # ns
STEP = PERIOD // 4  # ns, between two looks
RESEND = 100 * PERIOD
QUEUE = 10  # messages
ANSWERED = (
    Action.STEP,
    Action.STEP_ANEW,
    Action.STEP_BY_HALF,
    Action.STEP_WITHOUT_SAMPLE,
    Action.REPEAT_TORQUE,
)


class Way:
    """Brings messages after a step; a `share` of them never, as many twice, as many late."""

    def __init__(self, random):
        self._random, self._travelling, self.share = random, [], 0.0

    def send(self, now, message):
        fate = self._random.random()
        if fate < self.share:
            return
        late = self.share <= fate < 2.0 * self.share
        delay = STEP * self._random.integers(1, 200) if late else STEP
        copies = 2 if fate > 1.0 - self.share else 1
        self._travelling += [(now + delay, message)] * copies

    def arrived(self, now):
        """Return what has arrived."""
        here = [message for time, message in self._travelling if time <= now]
        self._travelling = [each for each in self._travelling if each[0] > now]
        return here


class Exchange:
    """A waiting simulator, whose wrench is read `apart` from its joints [ns], and the timing."""

    def __init__(self, timing, random, apart=0):
        self._timing, self._apart = timing, apart
        self._samples, self._commands = self._ways = Way(random), Way(random)
        self._queue = deque(maxlen=QUEUE)
        self._now, self._published, self.sample = 0, -RESEND, 1

    @property
    def _stamp(self):
        return self.sample * PERIOD

    def _publish(self):
        self._published = self._now
        self._samples.send(
            self._now, WrenchInput(self._stamp + self._apart, np.zeros(6))
        )
        self._samples.send(self._now, JointInput(self._stamp, np.zeros(2), np.zeros(2)))

    def _simulate(self):
        if self._queue and self._queue.popleft() == self._stamp:
            self.sample += 1
            self._publish()
        if self._now >= self._published + RESEND:
            self._publish()

    def _control(self):
        for reading in self._samples.arrived(self._now):
            self._timing.add_reading(reading)
            self._answer(self._timing.decide_on_message(self._now))
        self._answer(self._timing.decide_on_silence(self._now))

    def _answer(self, decision):
        if decision.action in ANSWERED:
            self._commands.send(self._now, self._timing.answered_stamp)

    def run(self, periods, *, halted=False):
        """Let time pass."""
        for _ in range(4 * periods):
            self._now += STEP
            self._control()
            self._queue.extend(self._commands.arrived(self._now))
            if not halted:
                self._simulate()

    def set_share(self, share):
        """Set which share of the messages is lost, doubled and late."""
        for way in self._ways:
            way.share = share

    def goes_on(self, *, samples, within):
        """Return whether so many samples are answered within some periods."""
        wanted = self.sample + samples
        left = within
        while left > 0 and self.sample < wanted:
            self.run(samples)
            left -= samples
        return self.sample >= wanted
