"""One force loop in simulation: the plant, an observer on it, and the estimator that feeds it."""

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.force import observer as aob
from multicontact_control.force.noise import Innovation, make_noise_estimator
from multicontact_control.force.plant import make_delayed_plant, place_poles
from multicontact_control.records import CONTACT
import numpy as np

H = 0.002


def estimator_of(name, contacts=1, **values):
    names = tuple(f'contact{i}' for i in range(contacts))
    return make_noise_estimator(
        NoiseEstimatorConfig(estimator=name, contact_names=names, **values)
    )


def design_force_loop(
    stiffness=6000.0,
    damping_rate=20.0,
    input_delay=0.006,
    period=H,
    time_constant=0.02,
):
    plant = make_delayed_plant(stiffness, damping_rate, input_delay, period)
    return place_poles(plant, period, time_constant=time_constant)


class ActiveObserver:
    """The compiled observer of one contact, as the controller runs it."""

    def __init__(self, loop, **options):
        self.design = aob.design_observer(loop, **options)
        self.records = aob.make_observers([self.design])
        self.contact = np.zeros(1, CONTACT)
        self.space = np.zeros(1, aob.OBSERVER_SPACE)
        n = len(self.design.Gamma)
        self.x_est = self.records['x_est'][0, :n]
        self.P = self.records['P'][0, :n, :n]

    def update(self, force, noise_variance, measured=True, disturbance=0.0):
        contact = self.contact[0]
        contact['alpha_meas'] = force
        contact['noise_variance'] = noise_variance
        aob.observe_force(
            self.records[0], contact, measured, 0.0, disturbance, self.space[0]
        )

    def command(self, force_des):
        return aob.command_acceleration(self.records[0], force_des)

    @property
    def innovation(self):
        """Return what a noise estimator gets, arrays of one contact."""
        answer = self.contact['answer']
        return Innovation(
            answer['innovation'], answer['prior_variance'], answer['variance_used']
        )


def observer_of(order=1, damping_rate=20.0):
    return ActiveObserver(design_force_loop(damping_rate=damping_rate), order=order)


def run_force_loop(estimator, noise=0.0, leak=0.0, command=10.0):
    """
    Hold a force with the R of the tick before, as the controller does; return R [N^2] by tick.

    Starts at rest at the commanded force. `noise` adds to the measurement, `leak` to the true and
    the measured force, as that of another contact does.
    """
    observer = observer_of()
    plant = make_delayed_plant(6000.0, 20.0, 0.006, H)
    x = np.zeros(5)
    x[0] = command
    R = 0.6
    variances = []
    for error in np.asarray(noise) + leak:
        observer.update(x[0] + error, R)
        u = observer.command(command)
        alpha_meas = observer.contact['alpha_meas']
        R = estimator.update(alpha_meas, observer.innovation)[0]
        variances.append(R)
        x = plant.Phi @ x + plant.Gamma * u
    return np.array(variances)
