"""One force loop in simulation: the plant, an observer on it, and the estimator that feeds it."""

from __future__ import annotations

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.force import observer as aob
from multicontact_control.force.noise import Innovation, make_noise_estimator
from multicontact_control.force.plant import delayed_plant, place_poles
import numpy as np

H = 0.002


def estimator_of(name, contacts=1, **values):
    names = tuple(f'contact{i}' for i in range(contacts))
    return make_noise_estimator(
        NoiseEstimatorConfig(estimator=name, contact_names=names, **values))


def design_force_loop(
    stiffness=6000.0, damping_rate=20.0, input_delay=0.006, period=H, time_constant=0.02,
):
    return place_poles(delayed_plant(stiffness, damping_rate, input_delay, period), period,
                       time_constant=time_constant)


class ActiveObserver:
    """The compiled observer of one contact, as the controller runs it."""

    def __init__(self, loop, **options):
        self.design = aob.design_observer(loop, **options)
        self.records = aob.make_observers([self.design])
        self.n = len(self.design.Gamma)
        self.reset()

    def __getattr__(self, name):
        return getattr(self.design, name)

    @property
    def x_est(self):
        return self.records['x_est'][0, :self.n]

    @property
    def P(self):
        return self.records['P'][0, :self.n, :self.n]

    def reset(self, force=0.0):
        self.records['x_est'], self.records['P'] = 0.0, 0.0
        self.records['x_est'][0, 0] = force
        self.P[:] = self.design.P_0 * np.eye(self.n)
        self.records['running'], self.records['command'] = False, 0.0
        self.innovation = self.prior_variance = self.variance_used = 0.0

    def update(self, force, noise_variance):
        observer = self.records[0]
        if not observer['running']:
            observer['running'] = True
            return
        aob.predict(observer)
        self.prior_variance = self.P[0, 0]
        self.innovation = force - observer['x_1'][0]
        self.variance_used = noise_variance
        aob.correct(observer, self.innovation, noise_variance)

    def command(self, force_des):
        return aob.command(self.records[0], force_des)

    def continue_from(self, other):
        aob.continue_from(self.records, other.records)


def observer_of(order=1, damping_rate=20.0):
    return ActiveObserver(design_force_loop(damping_rate=damping_rate), order=order)


def run_force_loop(estimator, noise=0.0, leak=0.0, command=10.0):
    """
    Hold a force with the R of the tick before, as the controller does; return R [N^2] by tick.

    Starts at rest at the commanded force. `noise` adds to the measurement, `leak` to the true and
    the measured force, as that of another contact does.
    """
    observer, plant, x = observer_of(), delayed_plant(6000.0, 20.0, 0.006, H), np.zeros(5)
    x[0] = command
    observer.reset(command)
    variances = [0.6]
    for each in np.asarray(noise) + leak:
        measured = x[0] + each
        observer.update(measured, variances[-1])
        u = observer.command(command)
        variances.append(estimator.update(np.array([measured]), Innovation(*(
            np.array([value]) for value in (
                observer.innovation, observer.prior_variance, observer.variance_used))))[0])
        x = plant.Phi @ x + plant.Gamma * u
    return np.array(variances[1:])
