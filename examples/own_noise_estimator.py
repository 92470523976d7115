"""
A noise estimator of your own beside that of the paper, simulated in this process.

``python examples/own_noise_estimator.py`` prints the R that each finds, and the errors of force.
A package of yours makes it known to every command and node by an entry point instead::

    [project.entry-points.'multicontact_control.noise_estimators']
    median_deviation = 'own_noise_estimator:MedianDeviation'
"""

from collections import deque

from multicontact_control.arrays import Vector
from multicontact_control.force.noise import Innovation, NoiseEstimator
from multicontact_control.force.noise.base import usable
from multicontact_control.registry import register_noise_estimator
from multicontact_control.runs.closed_loop import run_in_process
from multicontact_control.runs.scenario import resolve
import numpy as np


class MedianDeviation(NoiseEstimator):
    """
    R from the median distance of the last forces to their median, which single outliers leave.

    Of normal noise that distance is 0.6745 times the standard deviation. R is known when the
    window of forces is full.
    """

    def _forget(self) -> None:
        self._forces: deque[Vector] = deque(maxlen=self.config.window)

    def _take(self, innovation: Innovation | None) -> bool:
        if not usable(self._alpha):
            return False
        self._forces.append(self._alpha.copy())
        if len(self._forces) == self.config.window:
            forces = np.array(self._forces)
            distance = np.abs(forces - np.median(forces, axis=0))
            deviation = np.median(distance, axis=0) / 0.6745
            self._variance[:] = self.config.variance_scale * deviation**2
        return True


register_noise_estimator('median_deviation', f'{__name__}:MedianDeviation')


def main(duration: float = 15.0) -> None:
    """Run `quick` for a duration [s] with either estimator; print R at rest and while sliding."""
    print('estimator         contact  R at rest  sliding [N^2]  error [N]')
    # The lead filter of the first makes its R some 300 times as large as the variance at rest.
    for name, scale in (('lead_window', 1.0), ('median_deviation', 300.0)):
        setup = resolve(
            'quick',
            preset='best',
            duration=duration,
            noise_estimator={'estimator': name, 'variance_scale': scale},
        )
        data = run_in_process(setup, supervised=True).data
        rest = (data.time >= 5.0) & (data.time < 6.5)
        sliding = data.time >= 8.5
        at_rest = np.median(data.noise_variance[rest], axis=0)
        in_motion = np.median(data.noise_variance[sliding], axis=0)
        error = (data.alpha_true - data.alpha_des)[sliding]
        rms = np.sqrt((error**2).mean(axis=0))
        rows = zip(data.contact_names, at_rest, in_motion, rms)
        for contact, quiet, moving, off in rows:
            print(f'{name:17} {contact:8} {quiet:8.3f} {moving:14.3f} {off:10.3f}')


if __name__ == '__main__':
    main()
