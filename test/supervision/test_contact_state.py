"""The state machine of a contact: transitions, bounds, noise and bounces."""

from arms import controller_config
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.config import ContactStateConfig
from multicontact_control.control.controller import Controller
from multicontact_control.control.tasks import CommandedTask
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.paths import config_dir
from multicontact_control.supervision import contacts
from multicontact_control.supervision.contact_task import ContactTask
import numpy as np
import pytest

H = 0.002
FREE, APPROACHING, IMPACT, HOLDING, LOST, RETRACTING, GIVEN_UP = contacts.NAMES
# Every transition there is, as docs/architecture.md has them.
GRAPH = {
    FREE: {APPROACHING, RETRACTING}, APPROACHING: {IMPACT, GIVEN_UP, RETRACTING, FREE},
    IMPACT: {HOLDING, LOST, RETRACTING, FREE}, HOLDING: {LOST, RETRACTING, FREE},
    LOST: {IMPACT, APPROACHING, RETRACTING, FREE}, RETRACTING: {GIVEN_UP, FREE},
    GIVEN_UP: {APPROACHING, RETRACTING, FREE}}


class Surface:
    """A contact whose tip is where it is to be, in front of a spring."""

    def __init__(self, depth=0.005, stiffness=6000.0, **config):
        self.config = ContactStateConfig(**config)
        self.records = np.array([contacts.FREE_CONTACT])
        self.records['stiffness'] = stiffness
        self.settings = contacts.contact_settings(self.config, H)[0]
        self.depth, self.stiffness = depth, stiffness
        self.place, self.speed = 0.0, 0.0
        self.states = [FREE]

    @property
    def contact(self):
        return self.records[0]

    @property
    def state(self):
        return contacts.NAMES[self.contact['state']]

    def advance(self, wanted, alpha, asked, place, speed, escape=None):
        self.records['wanted'], self.records['asked'] = wanted, asked
        contacts.advance_contact(self.contact, self.settings, alpha, place, speed,
                                 speed if escape is None else escape)
        if self.state is not self.states[-1]:
            self.states.append(self.state)

    def run(self, seconds, wanted=True, alpha=None, asked=15.0, speed=None):
        """Return displacement, speed, acceleration and force of each tick."""
        trace = []
        for _ in range(round(seconds / H)):
            force = alpha if alpha is not None else self.stiffness * max(
                self.place - self.depth, 0.0)
            self.advance(wanted, force, asked, self.place, self.speed if speed is None else speed)
            contact = self.contact
            if not contacts.is_active(contact):
                self.place, self.speed = float(contact['displacement']), float(contact['speed'])
            trace.append((*(float(contact[name]) for name in (
                'displacement', 'speed', 'acceleration')), force))
        return np.array(trace)


def holding(**config):
    surface = Surface(**config)
    surface.run(1.0)
    surface.run(0.3, alpha=15.0)
    assert surface.state is HOLDING
    return surface


HISTORY = st.lists(st.tuples(
    st.integers(1, 60), st.booleans() | st.just(True),
    st.floats(-3.0, 25.0) | st.sampled_from([0.0, 1.0, 15.0, 70.0]), st.floats(3.0, 20.0),
    st.floats(-0.03, 0.03), st.floats(-0.05, 0.05), st.floats(-0.05, 0.05) | st.just(0.2),
    st.sampled_from(['', '', '', 'let_go', 'again'])), min_size=1, max_size=25)


@settings(max_examples=200, deadline=None)
@given(history=HISTORY)
def test_transitions_keep_to_the_graph_and_its_times_for_any_history_of_forces(history):
    surface = Surface(approach_distance=0.02, retry_time=0.05)
    state, ticks, felt, commanded = FREE, 0, [], False
    for length, wanted, alpha, asked, place, speed, escape, event in history:
        if event == 'let_go':
            contacts.let_go(surface.contact, place, speed)
        elif event == 'again':
            surface.contact['again'] = True
        state, ticks = surface.state, 0 if event == 'let_go' else ticks
        for _ in range(length):
            surface.advance(wanted, alpha, asked, place, speed, escape)
            before, state, contact = state, surface.state, surface.contact
            ticks = ticks + 1
            felt = [*felt[-5:], (alpha, max(0.5, 0.3 * asked))]
            commanded = commanded or wanted
            if alpha > 60.0:  # moves no contact that was never commanded
                assert RETRACTING in (before, state) if commanded else state is FREE
            assert contacts.is_active(contact) == (state in (IMPACT, HOLDING))
            if not wanted and alpha <= 60.0 and before in (APPROACHING, IMPACT, HOLDING, LOST):
                assert state is FREE
            if state is not before:
                assert state in GRAPH[before]
                if state is IMPACT:
                    assert alpha > 1.5
                if state is HOLDING:
                    assert ticks * H >= 0.05 and alpha >= 0.5
                if state is LOST and escape < 0.1:
                    below = 3 if before is HOLDING else 6  # samples: more than 4 and 10 ms
                    assert len(felt) >= below and all(x < limit for x, limit in felt[-below:])
                if (before, state) == (APPROACHING, GIVEN_UP):
                    assert contact['displacement'] - contact['start'] > 0.0099
                ticks = 0
            if state in (IMPACT, HOLDING):
                assert contact['acceleration'] == 0.0
            assert abs(contact['acceleration']) <= 5.0 + 1e-9


def test_way_from_free_to_holding():
    """Slowly to the surface; an impact lasts its least time and asks for the preload."""
    surface = Surface()
    trace = surface.run(1.0)
    assert surface.states == [FREE, APPROACHING, IMPACT, HOLDING]
    assert trace[:, 1].max() <= 0.02 + 1e-12
    assert np.abs(trace[:, 2]).max() <= 0.02 / 0.5 + 1e-9
    assert trace[:, 3].max() < 2.0
    surface = Surface()
    surface.run(2.0, alpha=0.0)
    for state, limit in ((IMPACT, 2.0), (HOLDING, 15.0)):
        surface.run(0.04, alpha=3.0)
        assert (surface.state, surface.contact['force_limit']) == (state, limit)


@pytest.mark.parametrize(('touched', 'dip', 'before'), [
    (0.3, 0.004, HOLDING), (0.01, 0.01, IMPACT)])
def test_short_dip_is_no_loss_and_a_sample_more_is_one(touched, dip, before):
    """Nor is a bounce after a touch."""
    surface = Surface()
    surface.run(2.0, alpha=0.0)
    surface.run(touched, alpha=15.0)
    surface.run(dip, alpha=0.0)
    assert surface.state is before
    surface.run(H, alpha=0.0)
    assert (surface.state, surface.contact['losses']) == (LOST, 1)


def test_contact_does_not_chatter_with_noise_around_the_touch_threshold():
    """Between release and touch threshold nothing changes, however often."""
    surface = Surface()
    surface.run(0.7, alpha=0.0)
    generator = np.random.default_rng(0)
    for _ in range(500):
        surface.run(H, alpha=generator.uniform(0.6, 2.4), asked=2.0)
    assert surface.states[2:] == [IMPACT, HOLDING]


def test_lost_contact_returns_brakes_searches_and_gives_up():
    surface = holding()
    origin = surface.place
    surface.run(H, alpha=14.0, speed=0.2)  # escapes: a loss, whatever its inertia reads
    assert surface.state is LOST
    surface.speed = 0.1
    trace = surface.run(3.0, alpha=0.0)
    assert surface.states[-3:] == [LOST, APPROACHING, GIVEN_UP]
    late = trace[60:]
    assert np.abs(late[:, 1]).max() <= 0.02 + 1e-9
    assert late[:, 0].max() < origin + 0.0105
    assert abs(trace[-1, 1]) < 1e-3


def test_first_approach_gives_up_after_its_distance_until_asked_for_anew():
    surface = Surface(depth=1.0, approach_distance=0.03)
    trace = surface.run(4.0)
    assert surface.state is GIVEN_UP
    assert 0.03 < trace[:, 0].max() < 0.0305
    surface.run(0.1, wanted=False)
    surface.run(0.1)
    assert surface.state is APPROACHING


def test_force_beyond_the_ceiling_makes_it_retract_and_a_retry_reaches_the_surface_again():
    surface = holding()
    surface.run(H, alpha=70.0)
    assert surface.state is RETRACTING
    start = surface.place
    trace = surface.run(7.0, alpha=0.0)  # beyond retry_time
    assert surface.state is GIVEN_UP
    assert trace[-1, 0] == pytest.approx(start - contacts.RETRACT_DISTANCE, abs=2e-4)
    assert np.abs(trace[:, 1]).max() <= 0.05 + 1e-9
    surface.contact['again'] = True
    surface.run(3.0)
    assert surface.state is HOLDING


def test_force_after_a_loss_rises_at_its_rate():
    surface = holding()
    surface.run(0.3, alpha=0.0)
    limits = []
    for _ in range(150):
        surface.run(H, alpha=3.0)
        limits.append(float(surface.contact['force_limit']))
    assert np.diff(limits).max() <= 100.0 * H + 1e-9
    assert limits[-1] == 15.0


def test_force_that_is_not_wanted_is_left_once():
    surface = Surface()
    surface.contact['commanded'] = True
    surface.run(0.1, wanted=False, alpha=100.0)
    trace = surface.run(5.0, wanted=False, alpha=50.0)
    assert surface.states == [FREE, RETRACTING, GIVEN_UP]
    assert trace[-1, 0] == pytest.approx(-contacts.RETRACT_DISTANCE, abs=2e-4)
    surface.contact['again'] = True
    surface.run(2.0, wanted=False, alpha=0.0)
    assert surface.states[3:] == [FREE]
    assert abs(surface.place) < 1e-3


@pytest.mark.parametrize('away', [0.15, -0.05])
def test_contact_of_a_moving_surface_is_not_lost_for_its_speed(away):
    """Faster away than a tip escapes, or towards the robot as if it threw the tip back."""
    values = {name: contact.model_dump() for name, contact in controller_config().contacts.items()}
    values['table']['surface_speed'] = away
    config = controller_config(contacts=values)
    source = CommandedTask(config.contact_names)
    controller = Controller(config, RobotModel(config.robot, config_dir()))
    task, columns = ContactTask(config, source, controller), controller.contacts
    frame = controller.controls['frame'][0]
    frame['rotation'], frame['twist'] = np.eye(3), [0.0, 0.0, -away, 0.0, 0.0, 0.0]
    task.start(Pose(np.zeros(3), np.eye(3)))
    source.set_forces({'table': 15.0})
    task.states['state'] = contacts.NAMES.index(HOLDING)
    task.states['level'] = columns['alpha_meas'] = 15.0
    for k in range(500):
        task.ask(k * H)
    assert task.state_names[0] is HOLDING
