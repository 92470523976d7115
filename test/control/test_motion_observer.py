"""What disturbs the motion: found, taken off, bounded, and forgotten when the law pauses."""

from arms import controller_config, HOME, Law, Measurement, pressed_wrench
from multicontact_control.control.motion_observer import (
    feed_friction_forward,
    LARGEST_ERROR,
    LARGEST_FORCE,
    LARGEST_FRICTION,
    LARGEST_TORQUE,
    MOTION_SPACE,
    observe_motion,
    REST_ERROR,
)
from multicontact_control.control.tasks import CommandedTask
from multicontact_control.dynamics.operational_space import INERTIA_SPACE
from multicontact_control.records import CONTACT, CONTROL, JOINT
from multicontact_control.runs.closed_loop import ClosedLoop, run_in_process
from multicontact_control.runs.scenario import resolve
from multicontact_control.sensor.tool import predict_weight_reading
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

H = 0.002  # s
DELAY = 3  # periods
BANDWIDTH = 60.0  # rad/s
MASS = 5.0  # kg, in every direction
DISTURBANCE = np.array([1.0, -2.0, 0.5, 0.3, -0.4, 0.2])  # m/s^2, rad/s^2
UNOBSERVED = {'motion': {'observer_bandwidth': 0.0, 'friction_time': 0.0}}


class MovingBody:
    """A body that is accelerated by u(t - T_d) + p, and the observer that watches it."""

    def __init__(self, disturbance=DISTURBANCE):
        self.disturbance = disturbance
        self.control = np.zeros(1, dtype=CONTROL)
        self.control['law']['period'] = H
        self.control['frame']['rotation'] = self.control['task']['rotation'] = np.eye(3)
        self.control['task']['twist'][0, 0] = 0.1  # it moves
        pole = np.exp(-BANDWIDTH * H)
        self.observer = self.control['motion_observer'][0]
        config = self.observer['config']
        config['twist_gain'] = 1.0 - pole**2
        config['disturbance_gain'] = (1.0 - pole) ** 2 / H
        config['delay'] = DELAY
        self.joints = np.zeros(6, dtype=JOINT)
        self.inertia = np.zeros(1, dtype=INERTIA_SPACE)
        self.inertia['Lambda'] = MASS * np.eye(6)
        # M = 1 and J = 1: a joint for every direction.
        self.inertia['L'][0, :6, :6] = self.inertia['Y'][0, :6, :6] = np.eye(6)
        self.space = np.zeros(1, dtype=MOTION_SPACE)
        self.contacts = np.zeros(1, dtype=CONTACT)
        self.underway = [np.zeros(6)] * DELAY

    def tick(self, acceleration, added_torque=0.0):
        """Let the observer look, the law answer an acceleration, and a period pass."""
        observe_motion(
            self.control[0],
            self.joints,
            self.contacts,
            self.inertia[0],
            self.space[0],
        )
        self.observer['accelerations'][-1] = acceleration
        self.joints['gate']['commanded_torque'] = added_torque
        self.underway.append(acceleration + added_torque)
        rate = self.underway.pop(0) + self.disturbance
        self.control['frame']['twist'] += H * rate


def test_disturbance_is_found_whatever_the_law_asks_for():
    body = MovingBody()
    random = np.random.default_rng(1)
    for _ in range(300):
        body.tick(random.normal(size=6))
    assert_allclose(body.observer['disturbance'], DISTURBANCE, rtol=1e-6)


def test_disturbance_is_found_with_the_bandwidth_that_is_set():
    """After k looks it is found but for (1 + k (1 - z) / z) z^k, with two poles z = exp(-w h)."""
    body = MovingBody()
    found = []
    for _ in range(60):
        body.tick(np.zeros(6))
        found.append(body.observer['disturbance'][1] / DISTURBANCE[1])
    pole = np.exp(-BANDWIDTH * H)
    looks = np.arange(1, 61)
    left = (1.0 + looks * (1.0 - pole) / pole) * pole**looks
    assert_allclose(found, 1.0 - left, atol=1e-9)


def test_torque_that_the_gate_changes_is_no_disturbance():
    body = MovingBody(np.zeros(6))
    random = np.random.default_rng(2)
    for _ in range(200):
        body.tick(random.normal(size=6), added_torque=random.normal(size=6))
    assert_allclose(body.observer['disturbance'], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ('axes', 'largest'), [(slice(3), LARGEST_FORCE), (slice(3, 6), LARGEST_TORQUE)]
)
def test_disturbance_moves_the_arm_by_no_more_than_its_bound(axes, largest):
    body = MovingBody(np.zeros(6))
    body.disturbance[axes] = 100.0
    for _ in range(300):
        body.tick(np.zeros(6))
    wrench = MASS * body.observer['disturbance'][axes]
    assert_allclose(np.linalg.norm(wrench), largest, rtol=1e-9)


def test_disturbance_of_an_arm_at_rest_is_not_learnt():
    body = MovingBody()
    body.control['task']['twist'] = 0.0
    for _ in range(50):
        body.tick(np.zeros(6))
    assert_array_equal(body.observer['disturbance'], 0.0)


@pytest.mark.parametrize(('sought', 'learnt'), [(True, False), (False, True)])
def test_disturbance_is_learnt_unless_a_contact_is_sought(sought, learnt):
    """A contact that is given up is still wanted, but a touch is not to be expected."""
    body = MovingBody()
    body.contacts['wanted'] = True
    body.contacts['sought'] = sought
    for _ in range(50):
        body.tick(np.zeros(6))
    assert body.observer['disturbance'].any() == learnt


def test_disturbance_that_holds_an_arm_off_its_reference_is_learnt_at_rest():
    body = MovingBody()
    body.control['task']['twist'] = 0.0
    body.control['task']['position'][0, 2] = 1.5 * REST_ERROR
    for _ in range(300):
        body.tick(np.zeros(6))
    assert_allclose(body.observer['disturbance'], DISTURBANCE, rtol=1e-6)


def test_disturbance_of_an_arm_that_is_held_away_does_not_grow():
    body = MovingBody()
    body.control['task']['position'][0, 2] = 1.01 * LARGEST_ERROR
    for _ in range(50):
        body.tick(np.zeros(6))
    assert_array_equal(body.observer['disturbance'][:3], 0.0)
    assert np.abs(body.observer['disturbance'][3:]).min() > 0.1


def test_disturbance_goes_back_although_the_arm_is_held_away():
    body = MovingBody()
    for _ in range(300):
        body.tick(np.zeros(6))
    body.disturbance = np.zeros(6)
    body.control['task']['position'][0, 2] = 1.01 * LARGEST_ERROR
    for _ in range(300):
        body.tick(np.zeros(6))
    assert np.linalg.norm(body.observer['disturbance'][:3]) < 0.1


def make_law(**changes):
    config = controller_config(**changes)
    return Law(config, CommandedTask(config.column_names, config.leading_columns))


def fed_forward(law, sideways, ticks=200, **forces):
    """Return what is fed forward [N, N m] if a wrench goes sideways beside some forces."""
    state = law.robot.update(HOME, np.zeros(6))
    config = law.config
    rotation = state.sensor_pose.rotation_world
    gravity = np.array(config.robot.gravity_world)
    wrench = predict_weight_reading(rotation, config.tool, gravity)
    wrench = wrench + pressed_wrench(config, state, **forces)
    wrench[:3] += rotation.T @ sideways
    lever = state.pose.position_world - state.sensor_pose.position_world
    wrench[3:] += rotation.T @ np.cross(lever, sideways)
    for tick in range(ticks):
        sample = Measurement(tick * H, HOME.copy(), np.zeros(6), wrench)
        law.step(sample, np.full(2, 0.6))
        law.reference.set_forces(forces)
    force, held = np.zeros(6), np.zeros(6)
    space = np.zeros(1, dtype=MOTION_SPACE)[0]
    feed_friction_forward(law.controls[0], law.contacts, force, held, space)
    assert_array_equal(force, held)
    return force


def test_friction_of_a_contact_is_fed_forward():
    """What goes sideways at the operational point has no share of the contacts' forces."""
    law = make_law()
    friction = np.array([6.0, 0.0, 0.0])
    force = fed_forward(law, friction, table=10.0, board=5.0)
    assert_allclose(force, [6.0, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-3)


def test_friction_is_not_more_than_its_share_of_what_is_pressed_with():
    law = make_law()
    force = fed_forward(law, np.array([60.0, 0.0, 0.0]), table=10.0, board=5.0)
    assert_allclose(np.linalg.norm(force[:3]), LARGEST_FRICTION * 15.0, rtol=1e-2)


def test_wrench_in_free_space_is_not_fed_forward():
    assert_array_equal(fed_forward(make_law(), np.array([6.0, 0.0, 0.0])), 0.0)


def test_law_as_published_feeds_no_friction_forward():
    law = make_law(**UNOBSERVED)
    force = fed_forward(law, np.array([6.0, 0.0, 0.0]), table=10.0, board=5.0)
    assert_array_equal(force, 0.0)


def motion_error(plant_overrides, controller):
    """Return the largest error along x of a slide once it has begun [m]."""
    setup = resolve(
        'one_contact',
        robot='panda',
        controller=controller,
        plant_overrides=plant_overrides,
        duration=8.0,
    )
    data = run_in_process(setup, supervised=True).data
    sliding = data.time > setup.scenario.reference.motion.start_time + 0.3
    return np.abs(data.position_des - data.position)[sliding, 0].max()


@pytest.mark.parametrize(
    'plant',
    [
        {'surfaces': {'table': {'friction': 0.5}}},
        {'joint_friction_scale': 1.0, 'joint_friction_speed': 0.1},
    ],
    ids=['friction of the surface', 'friction of the joints'],
)
def test_slide_keeps_to_its_path_in_spite_of(plant):
    with_observer = motion_error(plant, {})
    assert with_observer < 0.3 * motion_error(plant, UNOBSERVED)
    assert with_observer < 3e-4


def test_touch_lasts_although_the_drives_push_the_arm_off_the_surface():
    """Against 2 N m of each joint the law asks for more than it presses with at first."""
    setup = resolve(
        'one_contact',
        duration=2.0,
        plant_overrides={'actuation': {'bias_range': [-2.0, -2.0]}},
    )
    result = run_in_process(setup, supervised=True)
    assert 'lost' not in str(result.events)
    assert result.data.alpha_true[-1] == pytest.approx(2.0, abs=0.3)  # the preload


def test_law_that_resumes_knows_of_no_disturbance():
    """What a hand does to an arm that is held is not there any more when control resumes."""
    setup = resolve('quick', robot='panda')
    loop = ClosedLoop(setup, commanded=True)
    for _ in range(100):
        loop.advance()
    loop.plant.push(np.array([30.0, 0.0, 0.0]), 0.3)
    while loop.control.status is None or loop.status.reaction != 'hold':
        loop.advance()
    observer = loop.control.supervisor.controller.controls['motion_observer']
    observer['disturbance'] = 5.0
    while loop.status.reaction == 'hold':
        output = loop.advance()
    resumed = output.controls['motion_observer']['disturbance']
    loop.close()
    assert np.abs(resumed).max() < 0.2


def test_change_of_the_observer_makes_no_jump_of_the_torque():
    setup = resolve('quick', robot='panda', controller=UNOBSERVED)
    loop = ClosedLoop(setup, commanded=True)
    changed = {100: 60.0, 400: 0.0}
    largest = 0.0
    for tick in range(600):
        if tick in changed:
            motion = setup.controller.motion.model_copy(
                update={'observer_bandwidth': changed[tick]}
            )
            config = loop.control.config.model_copy(update={'motion': motion})
            loop.control.reconfigure(config)
        before = loop.command
        loop.advance()
        if tick > 50:
            largest = max(largest, np.abs(loop.command - before).max())
    loop.close()
    assert largest < 0.2  # N m
