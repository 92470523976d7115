"""
The one way of a reading from the wrist sensor into the loop: watched, then low-passed.

A live sensor repeats itself, too: two readings may fall on the same step of its converter. All
six axes of a 14-bit JR3 with 0.047 N and 0.004 N m of noise do so with a probability of 6e-8, five
times in a row with 5e-28. A sensor whose noise is far below a step repeats for ever while it is at
rest: `frozen_ticks` must be 0 for it.
"""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.butterworth import butterworth
from multicontact_control.compiled import compile_for, compiled
from multicontact_control.config import SensorFrontEndConfig
from multicontact_control.errors import ConfigError
from multicontact_control.records import FRONT_END
import numpy as np

SATURATED_SHARE = 0.99  # of full scale, from which on a reading counts as saturated
KEPT = 100  # readings, for a tare
FAULTS = ('', 'frozen', 'saturated')  # by what `watch_wrench` returns
FINE, FROZEN, SATURATED = range(3)


@compiled
def watch_wrench(front: Any) -> int:
    """Return FROZEN or SATURATED if a raw reading is, otherwise FINE; `front` is `FRONT_END`."""
    same, saturated = front.equal > 0, False
    for i in range(6):
        raw, last = front.raw[i], front.last[i]
        same = same and (raw == last or (np.isnan(raw) and np.isnan(last)))
        saturated = saturated or abs(raw) >= front.full_scale[i]
        front.last[i] = raw
    front.equal = front.equal + 1 if same else 1
    if 0 < front.frozen_ticks <= front.equal:
        return FROZEN
    return SATURATED if saturated else FINE


@compiled
def low_pass(front: Any) -> None:
    """
    Filter a reading (transposed direct form II, gain 1 at rest), settled on the first one.

    A reading that is not finite passes and is not remembered: the watchdog must see it, and the
    readings after it must not suffer.
    """
    a, b, memory = front.a, front.b, front.memory
    finite = True
    for i in range(6):
        front.filtered[i] = front.raw[i]
        finite = finite and np.isfinite(front.raw[i])
    if front.order == 0 or not finite:
        return
    for i in range(6):
        raw = front.raw[i]
        if not front.begun:
            memory[0, i] = raw * ((b[1] + b[2]) - (a[1] + a[2]))
            memory[1, i] = raw * (b[2] - a[2])
        filtered = b[0] * raw + memory[0, i]
        memory[0, i] = b[1] * raw - a[1] * filtered + memory[1, i]
        memory[1, i] = b[2] * raw - a[2] * filtered
        front.filtered[i] = filtered
    front.begun = True


@compiled
def take_wrench(fronts: Any, raw: Vector, kept: Matrix) -> int:
    """Filter and watch a reading, and keep it in a ring of the newest ones, shape (k, 6)."""
    front = fronts[0]
    for i in range(6):
        front.raw[i] = kept[front.count % kept.shape[0], i] = raw[i]
    front.count += 1
    low_pass(front)
    return watch_wrench(front)


class SensorFrontEnd:
    """
    Watch and filter the readings of a wrist sensor, one per tick.

    Parameters
    ----------
    config
        What to do.
    rate
        Rate of the readings [Hz].

    Attributes
    ----------
    raw, filtered
        The newest reading, and what has become of it, overwritten by the next, shape (6,)
        [N, N m].

    Raises
    ------
    ConfigError
        If the low-pass does not fit the rate.

    """

    def __init__(self, config: SensorFrontEndConfig, rate: float) -> None:
        self._front: Any = np.zeros(1, dtype=FRONT_END)
        self._kept: Matrix = np.zeros((KEPT, 6))
        front = self._front[0]
        front['full_scale'] = (
            SATURATED_SHARE * np.array(config.full_scale or (np.inf,) * 6))
        front['frozen_ticks'] = config.frozen_ticks
        order = front['order'] = config.filter_order
        if order:
            if config.filter_cutoff >= 0.5 * rate:
                raise ConfigError(
                    'sensor.filter_cutoff', f'below the Nyquist frequency {0.5 * rate:g} Hz',
                    f'{config.filter_cutoff:g} Hz')
            front['b'][:order + 1], front['a'][:order + 1] = butterworth(
                order, config.filter_cutoff, rate)
        self.raw: Vector = front['raw']
        self.filtered: Vector = front['filtered']
        compile_for(take_wrench, self._front, self.raw, self._kept)
        self.reset()

    def reset(self) -> None:
        """Forget the readings so far."""
        self._front['equal'], self._front['begun'] = 0, False
        self.forget()

    def forget(self) -> None:
        """Keep no reading so far for a tare."""
        self._front['count'] = 0

    @property
    def kept(self) -> Matrix:
        """Return the newest readings as they came, 100 at most, oldest first, shape (k, 6)."""
        count = int(self._front['count'][0])
        kept: Matrix = np.roll(self._kept, -count, axis=0) if count > KEPT else self._kept[:count]
        return kept.copy()

    def take(self, raw: Vector) -> str:
        """
        Take in the next reading, and leave it low-passed, with bias and weight, in `filtered`.

        Parameters
        ----------
        raw
            Contiguous, shape (6,) [N, N m].

        Returns
        -------
        str
            ``frozen`` if the last `frozen_ticks` readings were the same in all axes,
            ``saturated`` if an axis is at full scale, empty if nothing is wrong.

        """
        return FAULTS[take_wrench(self._front, raw, self._kept)]
