"""States of a contact and the task around a source: transitions, bounds, hold and lock."""

from types import SimpleNamespace

from arms import controller_config
from equations import rotation_error
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.config.supervision import ContactStateConfig
from multicontact_control.contact.geometry import configure_contacts
from multicontact_control.control.motions import SineConfig
from multicontact_control.control.tasks import (
    ApproachConfig,
    CommandedTask,
    MotionReading,
    ReferenceConfig,
    ScenarioTask,
)
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.records import CONTACT, CONTROL
from multicontact_control.supervision import contacts
from multicontact_control.supervision.contact_task import ContactTask
from multicontact_control.supervision.task_limits import limit_task, resume_task
from numba import njit
from numba.core.runtime import _nrt_python, rtsys
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

H = 0.002
FREE, APPROACHING, IMPACT, HOLDING, LOST, RETRACTING, GIVEN_UP = contacts.STATE_NAMES
# Every transition there is, as docs/architecture.md has them.
GRAPH = {
    FREE: {APPROACHING, RETRACTING},
    APPROACHING: {IMPACT, GIVEN_UP, RETRACTING, FREE},
    IMPACT: {HOLDING, LOST, RETRACTING, FREE},
    HOLDING: {LOST, RETRACTING, FREE},
    LOST: {IMPACT, APPROACHING, RETRACTING, FREE},
    RETRACTING: {GIVEN_UP, FREE},
    GIVEN_UP: {APPROACHING, RETRACTING, FREE},
}


TRACED = ['displacement', 'speed', 'acceleration', 'force_limit']


class Surface:
    """A contact whose tip is where it is to be, in front of a spring."""

    def __init__(self, depth=0.005, stiffness=6000.0, **config):
        self.config = ContactStateConfig(**config)
        self.records = np.array([contacts.FREE_CONTACT])
        self.records['stiffness'] = stiffness
        self.records['approach_speed'] = self.config.approach_speed
        self.settings = contacts.contact_settings(self.config, H)[0]
        self.depth = depth
        self.stiffness = stiffness
        self.place = 0.0
        self.speed = 0.0
        self.states = [FREE]

    @property
    def contact(self):
        return self.records[0]

    @property
    def state(self):
        return contacts.STATE_NAMES[self.contact['state']]

    @property
    def pressed(self):
        return self.contact['state'] in contacts.PRESSED

    def advance(self, wanted, alpha, asked, place, speed, escape):
        self.records['wanted'] = wanted
        self.records['alpha_task'] = asked
        contacts.advance_contact(
            self.contact, self.settings, alpha, place, speed, escape
        )
        if self.state is not self.states[-1]:
            self.states.append(self.state)

    def run(self, seconds, wanted=True, alpha=None, asked=15.0, speed=None):
        """Return displacement, speed, acceleration and force limit of each tick."""
        trace = []
        for _ in range(round(seconds / H)):
            force = alpha
            if alpha is None:
                force = self.stiffness * max(self.place - self.depth, 0.0)
            speed_now = speed
            if speed is None:
                speed_now = self.speed
            self.advance(wanted, force, asked, self.place, speed_now, speed_now)
            trace.append(self.records[TRACED].tolist()[0])
            if not self.pressed:
                self.place, self.speed = trace[-1][:2]
        return np.array(trace)


def holding(**config):
    surface = Surface(**config)
    surface.run(1.0)
    surface.run(0.3, alpha=15.0)
    assert surface.state is HOLDING
    return surface


HISTORY = st.lists(
    st.tuples(
        st.integers(1, 60),
        st.booleans() | st.just(True),
        st.floats(-3.0, 25.0) | st.sampled_from([0.0, 1.0, 15.0, 70.0]),
        st.floats(3.0, 20.0),
        st.floats(-0.03, 0.03),
        st.floats(-0.05, 0.05),
        st.floats(-0.05, 0.05) | st.just(0.2),
        st.sampled_from(['', '', '', 'release', 'retry']),
    ),
    min_size=1,
    max_size=25,
)


# Samples with too little force: more than 4 and 10 ms.
LOW_BEFORE_LOSS = {HOLDING: 3, IMPACT: 6}


@settings(max_examples=200, deadline=None)
@given(history=HISTORY)
def test_transitions_keep_to_the_graph_and_its_times_for_any_history_of_forces(history):
    surface = Surface(approach_distance=0.02, retry_time=0.05)
    state = FREE
    ticks = 0
    too_low = []
    for length, wanted, alpha, asked, place, speed, escape, event in history:
        if event == 'release':
            contacts.release_contact(surface.contact, place, speed)
        elif event == 'retry':
            surface.contact['retry_requested'] = True
        if event == 'release':
            ticks = 0
        state = surface.state
        for _ in range(length):
            surface.advance(wanted, alpha, asked, place, speed, escape)
            before = state
            state = surface.state
            contact = surface.contact
            ticks += 1
            too_low.append(alpha < max(0.5, 0.3 * asked))
            if alpha > 60.0 and wanted:
                assert RETRACTING in (before, state)
            assert surface.pressed == (state in (IMPACT, HOLDING))
            assert wanted or state is FREE
            if state is not before:
                assert state in GRAPH[before]
                if state is IMPACT:
                    assert alpha > 1.5
                if state is HOLDING:
                    assert ticks * H >= 0.05
                    assert alpha >= 0.5
                if state is LOST and escape < 0.1:
                    low = LOW_BEFORE_LOSS[before]
                    assert too_low[-low:] == [True] * low
                if before is APPROACHING and state is GIVEN_UP:
                    searched = contact['displacement'] - contact['search_start']
                    assert searched > 0.0099
                ticks = 0
            if state in (IMPACT, HOLDING):
                assert contact['acceleration'] == 0.0
            assert abs(contact['acceleration']) <= 5.0 + 1e-9


def test_way_from_free_to_holding():
    """Slowly to the surface; an impact lasts its least time and asks for the preload."""
    surface = Surface()
    trace = surface.run(1.0)
    assert surface.states == [FREE, APPROACHING, IMPACT, HOLDING]
    _, speed, acceleration, _ = trace.T
    assert speed.max() <= 0.02 + 1e-12
    assert np.abs(acceleration).max() <= 0.02 / 0.5 + 1e-9
    surface = Surface()
    surface.run(2.0, alpha=0.0)
    for state, limit in ((IMPACT, 2.0), (HOLDING, 15.0)):
        surface.run(0.04, alpha=3.0)
        assert surface.state is state
        assert surface.contact['force_limit'] == limit


@pytest.mark.parametrize(
    ('touched', 'dip', 'before'), [(0.3, 0.004, HOLDING), (0.01, 0.01, IMPACT)]
)
def test_short_dip_is_no_loss_and_a_sample_more_is_one(touched, dip, before):
    """Nor is a bounce after a touch."""
    surface = Surface()
    surface.run(2.0, alpha=0.0)
    surface.run(touched, alpha=15.0)
    surface.run(dip, alpha=0.0)
    assert surface.state is before
    surface.run(H, alpha=0.0)
    assert surface.state is LOST
    assert surface.contact['losses'] == 1


def test_lost_contact_returns_brakes_searches_and_gives_up():
    surface = holding()
    origin = surface.place
    surface.run(H, alpha=14.0, speed=0.2)  # escapes: a loss, whatever its inertia reads
    assert surface.state is LOST
    surface.speed = 0.1
    trace = surface.run(3.0, alpha=0.0)
    assert surface.states[-3:] == [LOST, APPROACHING, GIVEN_UP]
    place, speed, _, _ = trace[60:].T
    assert np.abs(speed).max() <= 0.02 + 1e-9
    assert place.max() < origin + 0.0105
    assert abs(speed[-1]) < 1e-3


def test_force_beyond_the_ceiling_makes_it_retract_and_a_retry_reaches_the_surface_again():
    surface = holding()
    start = surface.place
    surface.run(0.1, alpha=70.0)
    assert surface.state is RETRACTING
    trace = surface.run(7.0, alpha=0.0)  # beyond retry_time
    place, speed, _, _ = trace.T
    retracted = start - contacts.RETRACT_DISTANCE
    assert surface.state is GIVEN_UP
    assert place[-1] == pytest.approx(retracted, abs=2e-4)
    assert np.abs(speed).max() <= 0.05 + 1e-9
    surface.contact['retry_requested'] = True
    surface.run(3.0)
    assert surface.state is HOLDING


POSE = Pose(np.array([0.0, 0.55, 0.64]), np.eye(3))


class Asked:
    """A task and the records that it is written into, at a pose."""

    def __init__(self, source=None, **limits):
        config = controller_config(limits=limits)
        self.source = source or CommandedTask(
            config.column_names, config.leading_columns
        )
        self.controls = np.zeros(1, CONTROL)
        self.contacts = np.zeros(2, CONTACT)
        configure_contacts(config, self.contacts)
        self.task = ContactTask(config, self.source, self)
        self.stay(POSE)
        self.task.start_task(POSE)

    def stay(self, pose):
        self.controls['frame']['position'], self.controls['frame']['rotation'] = pose

    def ask(self, time):
        """Return what is asked for where nothing is felt."""
        self.task.update_wanted_task(time)
        self.limited = limit_task(
            self.task.limits[0], self.controls[0], self.contacts, self.task.states
        )
        task = self.controls['task'][0].copy()
        answer = self.contacts['answer'].copy()
        return SimpleNamespace(
            pose=Pose(task['position'], task['rotation']),
            twist=task['twist'],
            acceleration=task['acceleration'],
            active=answer['active'],
            alpha_des=answer['alpha_des'],
        )


def gap(pose):
    """Return way and turn from the first pose, shape (6,)."""
    way = pose.position_world - POSE.position_world
    turn = rotation_error(pose.rotation_world, POSE.rotation_world)
    return np.concatenate([way, turn])


def command_motion(asked, position, quaternion, twist):
    reading = MotionReading(
        np.array(position), np.array(quaternion), twist, np.zeros(6)
    )
    asked.source.set_motion(reading, ())


def test_task_keeps_the_pose_in_the_box_and_within_reach():
    asked = Asked(operational_speed=10.0, operational_turn=1.0)
    command_motion(asked, [0.0, 5.0, -5.0], [1.0, 0.0, 0.0, 0.0], np.ones(6))
    for tick in range(3000):
        before = asked.controls['frame'][0].copy()
        out = asked.ask(H * tick)
        x, y, z = out.pose.position_world
        assert -0.6 <= x <= 0.6
        assert 0.2 <= y <= 0.9
        assert 0.3 <= z <= 1.2
        turn = rotation_error(out.pose.rotation_world, before['rotation'])
        assert np.linalg.norm(turn) <= 2.0 / 30.0 * (1.0 + 1e-9)
        assert asked.limited
        asked.stay(out.pose)
    np.testing.assert_allclose(out.pose.position_world[1:], [0.9, 0.3])


@pytest.mark.parametrize(
    ('away', 'speed'),
    [
        (Pose(POSE.position_world + [0.05, 0.0, 0.0], np.eye(3)), 0.1),
        (
            Pose(
                POSE.position_world, Rotation.from_rotvec([0.0, 0.3, 0.0]).as_matrix()
            ),
            0.4,
        ),
    ],
)
def test_task_is_caught_up_with_slowly_after_a_pause(away, speed):
    """It starts where the arm is, and comes back below a fifth of the speed limit."""
    asked = Asked()
    asked.ask(0.0)
    asked.stay(away)
    resume_task(asked.task.limits[0], asked.contacts, asked.task.states)
    gaps = []
    for k in range(1, 2500):
        pose = asked.ask(k * H).pose
        asked.stay(pose)
        gaps.append(gap(pose))
    np.testing.assert_allclose(gaps[0], gap(away), atol=2e-3)
    steps = np.diff(gaps, axis=0)
    assert np.abs(steps).max() <= speed * H + 1e-9
    assert np.abs(gaps[-1]).max() < 1e-4


def test_task_that_is_held_stands_still_and_then_goes_on_where_it_was():
    reference = ReferenceConfig(
        approach=ApproachConfig(start_time=100.0),
        motion=SineConfig(start_time=0.0, amplitude=0.02),
    )
    motion = ScenarioTask(
        reference, rate=1.0 / H, names=('table', 'board'), leading_columns=(0, 1)
    )
    asked = Asked(motion)
    here = Pose(np.array([0.1, 0.2, 0.3]), np.eye(3))
    for tick in range(501):
        before = asked.ask(H * tick).pose.position_world
    asked.stay(here)
    asked.task.set_hold(True)
    for time in (1.1, 1.6):
        out = asked.ask(time)
        np.testing.assert_array_equal(out.pose.position_world, here.position_world)
        assert not out.twist.any()
        assert not out.acceleration.any()
        assert not out.active.any()
        assert not out.alpha_des.any()
    asked.stay(Pose(before, np.eye(3)))
    asked.task.set_hold(False)
    # From rest, with a bounded acceleration.
    np.testing.assert_allclose(asked.ask(1.6).pose.position_world, before, atol=1e-5)


def test_what_is_wanted_stands_beside_what_is_controlled():
    """A pose beyond the box, and a force of a contact that is not felt yet."""
    asked = Asked()
    asked.source.set_forces({'table': 5.0})
    command_motion(asked, [0.0, 5.0, 0.6], [0.0, 0.0, 0.0, 1.0], np.zeros(6))
    out = asked.ask(0.0)
    assert asked.controls['wanted'][0]['position'][1] == 5.0
    assert out.pose.position_world[1] < 0.9
    np.testing.assert_array_equal(asked.contacts['alpha_wanted'], [5.0, 0.0])
    np.testing.assert_array_equal(asked.contacts['wanted'], [True, False])
    assert not out.active.any()
    assert not out.alpha_des.any()


def test_states_are_told_anew_only_when_one_has_changed():
    asked = Asked()
    asked.ask(0.0)
    first = asked.task.state_names
    asked.ask(H)
    assert asked.task.state_names is first == (FREE, FREE)
    asked.source.set_forces({'table': 5.0})
    asked.ask(2.0 * H)
    assert asked.task.state_names == (APPROACHING, FREE)
    asked.task.set_lock(True)
    assert asked.task.state_names == (FREE, FREE)


@njit
def limit_again(count, limits, controls, columns, states):
    for k in range(count):
        limits[0].catching_up = k % 2 == 0  # it is caught up with, or followed
        columns[0].alpha_meas = 5.0 - columns[0].untared
        limit_task(limits[0], controls[0], columns, states)


def test_task_is_limited_without_allocating():
    """As much for one tick as for many: what their arguments take."""
    asked = Asked()
    allocations = []
    asked.source.set_forces({'table': 5.0, 'board': 5.0})
    asked.ask(0.0)
    _nrt_python.memsys_enable_stats()
    for count in (1, 1, 100):  # the first compiles
        before = rtsys.get_allocation_stats().alloc
        limit_again(
            count, asked.task.limits, asked.controls, asked.contacts, asked.task.states
        )
        allocations.append(rtsys.get_allocation_stats().alloc - before)
    assert allocations[1] == allocations[2]
    assert asked.task.state_names == (HOLDING, APPROACHING)
