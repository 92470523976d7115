"""The state machine of a contact: transitions, bounds, what noise and bounces must not do."""

from arms import controller_config
from contact_machine import ContactMachine
from multicontact_control.config import ContactStateConfig, LimitsConfig, validate
from multicontact_control.control.reference import CommandedReference
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.paths import config_dir
from multicontact_control.records import REFERENCE_LIMITS, TASK
from multicontact_control.supervision.contacts import contact_settings, ContactState, STATES
from multicontact_control.supervision.reference_limits import follow_contacts
from multicontact_control.supervision.supervisor import Supervisor
import numpy as np
import pytest

H = 0.002


class Surface:
    """A machine whose tip is where it wants to be, in front of a spring."""

    def __init__(self, depth=0.005, stiffness=6000.0, **config):
        self.config = ContactStateConfig(**config)
        self.machine = ContactMachine(self.config, H)
        self.depth, self.stiffness = depth, stiffness
        self.place, self.speed = 0.0, 0.0
        self.states = [ContactState.FREE]

    def run(self, seconds, wanted=True, alpha=None, alpha_des=15.0, speed=None):
        trace = []
        for _ in range(round(seconds / H)):
            machine = self.machine
            force = alpha if alpha is not None else self.stiffness * max(
                self.place - self.depth, 0.0)
            machine.update(wanted, force, alpha_des, self.place,
                           self.speed if speed is None else speed)
            if not machine.active:
                self.place, self.speed = machine.displacement, machine.speed
            if machine.state is not self.states[-1]:
                self.states.append(machine.state)
            trace.append((machine.displacement, machine.speed, machine.acceleration, force))
        return np.array(trace)


def holding(**config):
    surface = Surface(**config)
    surface.run(1.0)
    surface.run(0.3, alpha=15.0)
    assert surface.machine.state is ContactState.HOLDING
    return surface


def test_way_from_free_to_holding():
    surface = Surface()
    trace = surface.run(1.0)
    assert surface.states == [ContactState.FREE, ContactState.APPROACHING, ContactState.IMPACT,
                              ContactState.HOLDING]
    assert trace[:, 1].max() <= 0.02 + 1e-12
    assert np.abs(trace[:, 2]).max() <= 0.02 / 0.5 + 1e-9
    assert trace[:, 3].max() < 2.0


def test_impact_lasts_its_least_time_and_asks_for_the_preload():
    surface = Surface()
    surface.run(2.0, alpha=0.0)
    surface.run(0.04, alpha=3.0)
    assert surface.machine.state is ContactState.IMPACT
    assert surface.machine.force_limit == 2.0
    surface.run(0.02, alpha=3.0)
    assert surface.machine.state is ContactState.HOLDING
    assert surface.machine.force_limit == 15.0


def test_short_dip_is_no_loss_and_a_long_one_is():
    surface = holding()
    surface.run(0.004, alpha=0.0)
    assert surface.machine.state is ContactState.HOLDING
    surface.run(0.01, alpha=15.0)
    surface.run(0.006, alpha=0.0)
    assert surface.machine.state is ContactState.LOST
    assert surface.machine.losses == 1


def test_contact_that_is_thrown_back_is_waited_for():
    surface = holding()
    surface.run(0.004, alpha=1.0, speed=-0.01)
    surface.run(0.09, alpha=0.0, speed=0.01)
    assert surface.machine.state is ContactState.HOLDING
    surface.run(1.0, alpha=15.0)
    surface.run(0.004, alpha=1.0, speed=-0.01)
    surface.run(0.1, alpha=0.0, speed=0.01)
    assert surface.machine.state is ContactState.LOST
    assert surface.machine.losses == 1


def test_contact_that_is_thrown_back_again_at_once_is_lost():
    surface = holding()
    surface.run(0.004, alpha=1.0, speed=-0.01)
    surface.run(0.4, alpha=15.0)
    assert surface.machine.state is ContactState.HOLDING
    surface.run(0.006, alpha=1.0, speed=-0.01)
    assert surface.machine.state is ContactState.LOST


def test_noise_around_the_touch_threshold_does_not_make_it_chatter():
    """Between release and touch threshold nothing changes, however often."""
    surface = Surface()
    surface.run(0.7, alpha=0.0)
    generator = np.random.default_rng(0)
    for _ in range(500):
        surface.run(H, alpha=generator.uniform(0.6, 2.4), alpha_des=2.0)
    assert surface.states[2:] == [ContactState.IMPACT, ContactState.HOLDING]


def test_escaping_tip_is_a_loss_whatever_its_inertia_reads():
    surface = holding()
    surface.run(H, alpha=14.0, speed=0.2)
    assert surface.machine.state is ContactState.LOST


def test_lost_contact_returns_brakes_searches_and_gives_up():
    surface = holding(search_distance=0.008)
    origin = surface.place
    surface.speed = 0.1
    trace = surface.run(3.0, alpha=0.0)
    assert surface.states[-3:] == [
        ContactState.LOST, ContactState.APPROACHING, ContactState.GIVEN_UP]
    late = trace[60:]
    assert np.abs(late[:, 1]).max() <= 0.02 + 1e-9
    assert np.abs(trace[:, 2]).max() <= 5.0 + 1e-9
    assert late[:, 0].max() < origin + 0.0085
    assert abs(trace[-1, 1]) < 1e-3


def test_first_approach_gives_up_after_its_distance():
    surface = Surface(depth=1.0, approach_distance=0.03)
    trace = surface.run(4.0)
    assert surface.machine.state is ContactState.GIVEN_UP
    assert trace[:, 0].max() < 0.0305


def test_bounce_after_touch_is_no_loss():
    surface = Surface()
    surface.run(1.0)
    surface.machine.reset()
    surface.run(2.0, alpha=0.0)
    surface.run(0.01, alpha=3.0)
    surface.run(0.01, alpha=0.0)
    assert surface.machine.state is ContactState.IMPACT
    surface.run(H, alpha=0.0)
    assert surface.machine.state is ContactState.LOST


def test_lost_contact_waits_where_it_would_touch_and_not_where_it_pressed():
    machine = ContactMachine(ContactStateConfig(search_distance=0.001), H, 6000.0)
    for alpha, ticks in ((0.0, 300), (15.0, 100), (0.0, 10)):
        for _ in range(ticks):
            machine.update(True, alpha, 15.0, 0.005, 0.0)
    assert machine.state is ContactState.LOST
    while machine.state is ContactState.LOST:
        machine.update(True, 0.0, 15.0, 0.005, 0.0)
    assert machine.displacement == pytest.approx(0.005 - 15.0 / 6000.0, abs=3e-4)


def test_given_up_contact_stays_so_until_asked_for_anew():
    surface = Surface(depth=1.0, approach_distance=0.01)
    surface.run(3.0)
    assert surface.machine.state is ContactState.GIVEN_UP
    surface.run(0.1, wanted=False)
    surface.run(0.1)
    assert surface.machine.state is ContactState.APPROACHING


def test_force_beyond_the_ceiling_makes_it_retract_for_good():
    surface = holding()
    surface.run(H, alpha=70.0)
    assert surface.machine.state is ContactState.RETRACTING
    start = surface.place
    trace = surface.run(2.0, alpha=0.0)
    assert surface.machine.state is ContactState.GIVEN_UP
    assert trace[-1, 0] == pytest.approx(start - 0.01, abs=2e-4)
    assert np.abs(trace[:, 1]).max() <= 0.05 + 1e-9


def test_retry_after_a_retreat_reaches_where_the_surface_was():
    surface = holding(retract_distance=0.02, search_distance=0.01)
    surface.run(H, alpha=70.0)
    surface.run(2.0, alpha=0.0)
    assert surface.machine.state is ContactState.GIVEN_UP
    surface.machine.again = True
    surface.run(3.0)
    assert surface.machine.state is ContactState.HOLDING


def test_retries_of_a_search_in_vain_do_not_lead_ever_farther():
    """However soon they come: before the tip has come back."""
    surface = Surface(depth=1.0, approach_distance=0.05)
    surface.run(3.5)
    assert surface.machine.state is ContactState.GIVEN_UP
    for _ in range(1500):
        surface.machine.again = True
        surface.run(H)
    assert surface.states.count(ContactState.GIVEN_UP) > 2
    assert surface.place < 0.06


def test_contact_no_longer_wanted_goes_back_to_the_task():
    surface = holding()
    trace = surface.run(2.0, wanted=False)
    assert surface.machine.state is ContactState.FREE
    assert abs(trace[-1, 0]) < 1e-4


def test_force_after_a_loss_rises_at_its_rate():
    surface = holding()
    surface.run(0.3, alpha=0.0)
    limits = []
    for _ in range(150):
        surface.run(H, alpha=3.0)
        limits.append(surface.machine.force_limit)
    assert np.diff(limits).max() <= 100.0 * H + 1e-9
    assert limits[-1] == 15.0


def test_smallest_force_must_be_one_that_can_be_held():
    with pytest.raises(ConfigError, match='contact_state.smallest_force: expected at least '
                       'contact_threshold 4 N, or it cannot be held, found 3 N'):
        validate(ContactStateConfig, {'contact_threshold': 4.0}, 'contact_state')


def test_margin_must_leave_the_joints_some_range():
    with pytest.raises(ConfigError, match='limits.joint_margin: expected below half of the '
                       'narrowest joint range 0.03 rad, found 0.02 rad'):
        validate(LimitsConfig, {'joint_lower': [-1.0, 0.0], 'joint_upper': [1.0, 0.03]}, 'limits')


def test_thresholds_must_be_in_order():
    with pytest.raises(ConfigError, match='contact_threshold'):
        ContactStateConfig(contact_threshold=0.3)


def test_force_that_nobody_asks_for_is_left_once_and_not_again_and_again():
    """Above the ceiling it went from free to retracting and back at every tick."""
    surface = Surface()
    surface.run(0.1, wanted=False, alpha=100.0)
    assert surface.states == [ContactState.FREE, ContactState.RETRACTING]
    trace = surface.run(5.0, wanted=False, alpha=50.0)
    assert surface.states[2:] == [ContactState.GIVEN_UP]
    assert trace[-1, 0] == pytest.approx(-surface.config.retract_distance, abs=2e-4)
    surface.machine.again = True
    surface.run(2.0, wanted=False, alpha=0.0)
    assert surface.states[3:] == [ContactState.FREE]
    assert abs(surface.place) < 1e-3


def test_contact_that_is_let_go_while_it_retracts_does_so_to_the_end():
    surface = holding()
    surface.run(0.004, alpha=100.0)
    start = surface.place
    surface.run(0.05, wanted=False, alpha=30.0)
    assert surface.machine.state is ContactState.RETRACTING
    surface.run(3.0, wanted=False, alpha=0.0)
    assert surface.machine.state is ContactState.FREE
    assert start > 1e-3 > abs(surface.place)


@pytest.mark.parametrize('away', [0.15, -0.05])
def test_surface_that_is_known_to_move_is_not_lost_for_its_speed(away):
    """Faster than `escape_speed` away, or towards the robot as if it threw the tip back."""
    config = controller_config()
    config = controller_config(contacts={**{
        name: contact.model_dump() for name, contact in config.contacts.items()}, 'table': {
            **config.contacts['table'].model_dump(), 'surface_speed': away}})
    robot = RobotModel(config.robot, config_dir())
    supervisor = Supervisor(config, robot, CommandedReference(config.contact_names))
    states, contacts = supervisor.reference.contact_states, supervisor.controller.contacts
    frame, wanted = supervisor.controller.controls['frame'][0], np.zeros(1, dtype=TASK)[0]
    frame['rotation'], frame['twist'] = np.eye(3), [0.0, 0.0, -away, 0.0, 0.0, 0.0]
    states['state'], states['wanted'], states['asked'] = 3, True, 15.0  # holding
    states['level'] = contacts['alpha_meas'] = 15.0
    states['stored'] = 15.0 ** 2 / (2.0 * states['stiffness'])
    contacts['N'][0] = [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]
    settings = contact_settings(config.contact_state, config.period)[0]
    limits = np.zeros(1, dtype=REFERENCE_LIMITS)[0]
    for _ in range(500):
        follow_contacts(limits, wanted, frame, contacts, states, settings, np.empty(2))
    assert STATES[states['state'][0]] is ContactState.HOLDING
    assert states['energy'][0] == pytest.approx(0.0, abs=1e-9)
