"""A wrench that is read in free space is no touch, and a single far one is no force."""

from contextlib import closing

from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest
from supervision.test_recovery import with_wrench, without_wrench

ROBOTS = ('puma', 'panda', 'iiwa', 'ur5', 'kinova')
APPROACH = 0.02  # m/s
SMOOTH = {'table': {'roughness_std': 0.0}}


class Biased:
    """An arm that is commanded to press, with something added to what its wrist sensor reads."""

    def __init__(self, robot, bias, *, scenario='quick', surfaces=SMOOTH, **setup):
        world = {'surfaces': surfaces}
        resolved = resolve(scenario, robot=robot, plant_overrides=world, **setup)
        self.loop = ClosedLoop(resolved, commanded=True)
        self.bias = bias
        self.period = resolved.controller.period
        self.true = []
        self.measured = []
        self.speed = []
        self.states = set()
        self.rejected = []
        self.reactions = set()

    def close(self):
        self.loop.close()

    @property
    def status(self):
        return self.loop.status

    def run(self, seconds, *, blind=False):
        """Go on, and keep the true and measured force of the first contact, and its speed."""
        add_bias = with_wrench(self._add_bias)
        for _ in range(round(seconds / self.period)):
            self.true.append(self.loop.sample.contact_force[0])
            output = self.loop.advance(without_wrench if blind else add_bias)
            twist = output.controls['frame']['twist'][0]
            self.measured.append(output.contacts['alpha_meas'][0])
            self.speed.append(output.contacts['N'][0] @ twist)
            self.states.add(self.status.contact_states[0])
            self.reactions.add(self.status.reaction)
            self.rejected += self.status.rejected

    def _add_bias(self, wrench):
        return wrench + np.array(self.bias(self.loop.tick * self.period), dtype=float)

    def press(self, seconds, **forces):
        self.loop.control.set_forces(forces)
        self.run(seconds)

    @property
    def last_force(self):
        """Return the mean true force of the last 0.2 s [N]."""
        return np.mean(self.true[-100:])

    @property
    def first(self):
        """Return the tick of the first true touch, or how many ticks there were."""
        for tick, force in enumerate(self.true):
            if force > 0.1:
                return tick
        return len(self.true)

    @property
    def fastest(self):
        """Return the largest speed to the surface before it is touched [m/s]."""
        return max(self.speed[: self.first])


def constant(*bias):
    return lambda time: bias


def step(size, begin, axis=2):
    return lambda time: size * np.eye(6)[axis] * (time >= begin)


@pytest.mark.parametrize('robot', ROBOTS)
@pytest.mark.parametrize(
    'bias',
    [(0, 0, 2.4, 0, 0, 0), (0, 0, -4.0, 0, 0, 0), (2.3, -2.3, 4.0, 0.1, -0.1, 0.1)],
)
def test_bias_is_no_touch_and_is_taken_off_the_force(robot, bias):
    with closing(Biased(robot, constant(*bias))) as arm:
        arm.run(0.2)
        arm.press(2.0, table=30.0)
        assert arm.fastest < 1.2 * APPROACH
        assert max(arm.true) < 36.0
        assert arm.last_force == pytest.approx(30.0, abs=0.3)
        assert arm.status.contact_states[0] == 'holding'
        line = arm.status.read_before[0]
        assert line.startswith(f'table reads {bias[2]:+.1f} N')
        assert line.endswith('tare')
        events = [event for _, event in arm.loop.control.events.events]
        assert line in ' '.join(events)


@pytest.mark.parametrize('robot', ROBOTS)
@pytest.mark.parametrize('size', [2.0, 2.4, 4.0])
def test_step_of_the_bias_on_the_way_is_no_touch(robot, size):
    """It is touched at the speed of an approach at most, whatever is commanded."""
    with closing(Biased(robot, step(size, 0.5))) as arm:
        arm.run(0.2)
        arm.press(1.3, table=30.0)
        assert 0.5 < arm.first * arm.period < 1.2
        assert arm.fastest < 1.2 * APPROACH
        assert max(arm.true) < 30.0 + 20.0


@pytest.mark.parametrize('robot', ['panda', 'iiwa'])
def test_drives_that_swing_answer_for_no_surface(robot):
    """Encoders on the motors do not tell how the tool is shaken."""
    with closing(Biased(robot, step(4.0, 0.5), plant='flexible')) as arm:
        arm.run(0.2)
        arm.press(2.0, table=30.0)
        assert arm.first * arm.period > 0.8
        assert arm.fastest < 1.5 * APPROACH
        assert arm.last_force == pytest.approx(30.0, abs=0.8)


def test_force_of_the_bias_is_commanded():
    """4 N that are read are not 4 N that are reached."""
    with closing(Biased('panda', constant(0, 0, 4.0, 0, 0, 0))) as arm:
        arm.run(0.2)
        arm.press(2.0, table=4.0)
        assert arm.last_force == pytest.approx(4.0, abs=0.2)
        assert 'lost' not in arm.states


def test_contact_that_yields_without_end_is_given_up_as_a_surface_that_is_not_met():
    """Two steps in free space are taken for touches, and the search goes on behind each."""
    away = {'table': {'point_world': [0.0, 0.55, -1.0], 'roughness_std': 0.0}}

    def two_steps(time):
        return step(2.0, 0.5)(time) + step(2.5, 2.5)(time)

    with closing(Biased('panda', two_steps, surfaces=away)) as arm:
        arm.run(0.2)
        arm.press(8.0, table=30.0)
        assert not any(arm.true)
        assert max(arm.speed) < 1.2 * APPROACH
        assert {'impact', 'lost', 'given up'} <= arm.states
        assert arm.reactions == {'none'}


@pytest.mark.parametrize(
    ('stiffness', 'damping', 'most', 'seconds'),
    [(300.0, 5.0, 15.0, 6.0), (6000.0, 30.0, 11.0, 2.0), (1e6, 100.0, 60.0, 3.0)],
)
@pytest.mark.parametrize('size', [0.0, 3.0])
def test_surface_answers_however_stiff_it_is(stiffness, damping, most, seconds, size):
    """A loop that is designed for 6000 N/m is slow on a soft one."""
    table = {'roughness_std': 0.0, 'stiffness': stiffness, 'damping': damping}
    bias = constant(0, 0, size, 0, 0, 0)
    with closing(Biased('panda', bias, surfaces={'table': table})) as arm:
        arm.run(0.2)
        arm.press(seconds, table=10.0)
        assert arm.last_force == pytest.approx(10.0, abs=0.5)
        assert max(arm.true) < most


@pytest.mark.parametrize(('depth', 'force'), [(1e-3, 10.0), (5e-4, 4.0), (1e-3, 3.0)])
def test_tip_that_rests_on_a_surface_presses_with_what_is_commanded(depth, force):
    """What is read there is its force: there is no way in free space."""
    setup = resolve('quick', robot='puma')
    table = setup.plant.surfaces['table']
    higher = (0.007 + depth) * np.array(table.normal_world)
    point = np.array(table.point_world) - higher
    resting = {'table': {'point_world': point.tolist(), 'roughness_std': 0.0}}
    with closing(Biased('puma', constant(*np.zeros(6)), surfaces=resting)) as arm:
        arm.run(0.3)
        assert arm.true[-1] > 1.5
        arm.press(1.5, table=force)
        assert arm.last_force == pytest.approx(force, abs=0.2)
        assert max(arm.true) < max(force, arm.true[149]) + 3.0


@pytest.mark.parametrize(('scenario', 'name'), [('edge', 'edge'), ('plane', 'face')])
def test_bias_of_a_couple_does_not_turn_the_tool_in_free_space(scenario, name):
    def step_beside_a_couple(time):
        return step(2.5, 0.5)(time) + [0, 0, 0, 0.2, 0.2, 0]

    with closing(
        Biased('puma', step_beside_a_couple, scenario=scenario, surfaces={})
    ) as arm:
        arm.run(0.2)
        turns = []
        arm.loop.control.set_forces({name: 10.0})
        for _ in range(100):
            arm.run(0.02)
            twist = arm.loop.control.output.controls['frame']['twist'][0]
            turns.append(np.abs(twist[3:]).max())
        assert arm.fastest < 1.2 * APPROACH
        assert max(turns[: arm.first // 10 - 10]) < 0.05
        assert np.mean(arm.measured[-100:]) == pytest.approx(10.0, abs=0.3)
        assert arm.status.contact_states[0] == 'holding'


def test_surface_that_goes_while_control_pauses_has_to_be_met_again():
    """A bias beyond the threshold does not stand for it."""
    leaving = {'table': {'roughness_std': 0.0, 'velocity': 0.1, 'motion_start': 1.5}}
    with closing(Biased('panda', step(2.4, 1.6), surfaces=leaving)) as arm:
        arm.run(0.2)
        arm.press(1.29, table=10.0)
        assert arm.true[-1] > 9.0
        arm.run(0.3, blind=True)
        assert arm.status.reaction == 'hold'
        arm.run(1.0)
        assert arm.status.reaction == 'none'
        assert not any(arm.true[-400:])
        assert max(arm.speed[-450:]) < 1.2 * APPROACH


def spikes(size, rate, seed=0):
    random = np.random.default_rng(seed)
    struck = random.random(10_000) < rate / 500.0
    signs = random.choice([-1.0, 1.0], 10_000)
    forces = size * signs * struck
    return lambda time: np.eye(6)[2] * forces[round(time * 500)]


@pytest.mark.parametrize('robot', ['puma', 'panda'])
@pytest.mark.parametrize('size', [8.0, 40.0])
def test_single_wrenches_far_from_the_others_cost_no_force(robot, size):
    with closing(Biased(robot, spikes(size, 2.0))) as arm:
        arm.run(0.2)
        arm.press(2.0, table=10.0)
        arm.run(2.0)
        assert arm.reactions == {'none'}
        last = arm.true[-1000:]
        assert np.mean(last) == pytest.approx(10.0, abs=0.2)
        np.testing.assert_allclose(last, 10.0, rtol=0.0, atol=0.5)
        assert set(arm.rejected) == {'wrench_outlier'}
        counts = arm.loop.control.events.rejected_counts
        assert counts['wrench_outlier'] == len(arm.rejected)


def test_wrench_with_many_outliers_is_a_fault_of_the_sensor():
    with closing(Biased('panda', spikes(40.0, 25.0))) as arm:
        arm.run(0.2)
        arm.press(2.5, table=10.0)
        assert 'hold' in arm.reactions
        assert max(arm.true) < 15.0


@pytest.mark.parametrize(
    'changes',
    [
        {'controller': {'force': {'law': 'pi'}}},
        {'controller': {'force': {'law': 'admittance'}}},
        {'controller': {'force': {'law': 'impedance'}}},
        {'controller': {'force': {'law': 'feedforward'}}},
        {'preset': 'adaptive'},
    ],
)
def test_step_of_the_bias_is_no_touch_for_any_force_law(changes):
    """An impedance stands still in free space, and an adaptive law must not learn from it."""
    with closing(Biased('puma', step(2.4, 0.5), plant='rigid', **changes)) as arm:
        arm.run(0.2)
        arm.press(3.5, table=30.0)
        assert 0.5 < arm.first * arm.period < 3.0
        assert arm.fastest < 1.2 * APPROACH
        assert max(arm.true) < 30.0 + 20.0
        assert arm.last_force > 20.0
