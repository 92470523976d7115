"""What users of other systems have met and told in public, and is answered rightly here."""

from contextlib import closing, contextmanager

from multicontact_control.config import ControllerConfig, merge, validate
from multicontact_control.control.tasks import MotionReading
from multicontact_control.judging.oscillation import find_oscillations
from multicontact_control.registry import FORCE_LAWS
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import preset_values, resolve
import numpy as np
from numpy.testing import assert_allclose
import pytest

FORCE = 10.0  # N
SURFACES = ('table', 'board')
TOUCHED = 600  # ticks, after which both contacts are pressed


class Pressing:
    """A loop that presses on both surfaces, and what it did since."""

    def __init__(self, loop, corrupt=None):
        self.loop = loop
        self._corrupt = corrupt
        self.forces = []
        self.reactions = set()
        self.advance(20)
        loop.control.set_forces(dict.fromkeys(SURFACES, FORCE))

    def advance(self, ticks=1):
        """Return the true forces of so many ticks, shape (ticks, 2) [N]."""
        for _ in range(ticks):
            self.loop.advance(self._corrupt)
            self.forces.append(self.loop.sample.contact_force)
            self.reactions.add(self.loop.status.reaction)
        return np.array(self.forces[-ticks:])

    def slide(self, speed, ticks):
        """Slide along x with a speed [m/s]; return the true forces."""
        pose = self.loop.control.output.pose_des
        twist = np.array([speed, 0, 0, 0, 0, 0])
        forces = []
        for k in range(ticks):
            way = k * self.loop.setup.controller.period * twist[:3]
            position = pose.position_world + way
            motion = MotionReading(position, pose.quaternion_xyzw, twist, np.zeros(6))
            self.loop.control.set_motion(motion)
            forces.append(self.advance()[0])
        return np.array(forces)


@contextmanager
def pressing(plant, corrupt=None, **arguments):
    """Press on both surfaces for `TOUCHED` ticks, then do what a test does; without reactions."""
    setup = resolve('quick', plant=plant, **arguments)
    with closing(ClosedLoop(setup, commanded=True)) as loop:
        run = Pressing(loop, corrupt)
        run.advance(TOUCHED)
        yield run
        assert run.reactions == {'none'}


@pytest.mark.parametrize('plant', ['rigid', 'puma'])
def test_wrench_at_a_fifth_of_the_rate_presses_and_slides(plant):
    """The readings between are missing, as of a sensor of 100 Hz."""

    def seldom(inputs):
        if round(inputs.time * 500.0) % 5 == 0:
            return inputs
        return inputs._replace(wrench=None)

    with pressing(plant, seldom) as run:
        assert_allclose(run.advance(100), FORCE, atol=0.3)
        assert_allclose(run.slide(0.05, 300), FORCE, atol=3.0)
    assert np.max(run.forces) < 1.3 * FORCE


@pytest.mark.parametrize('plant', ['rigid', 'puma'])
def test_encoders_of_12_bits_beside_measured_speeds_press_and_slide(plant):
    """Steps of 1.5 mrad are 1 mm at the tip: what is pressed does not move by as much."""
    step = 2.0 * np.pi / 2**12

    def coarse(inputs):
        q = np.round(inputs.joints.q / step) * step
        return inputs._replace(joints=inputs.joints._replace(q=q))

    watchdog = {'frozen_joint_ticks': 0}
    with pressing(plant, coarse, controller={'watchdog': watchdog}) as run:
        assert_allclose(run.advance(100), FORCE, atol=0.5)
        assert_allclose(run.slide(0.05, 300), FORCE, atol=3.0)
    assert np.max(run.forces) < 1.3 * FORCE


def test_slow_slide_with_friction_in_joints_and_on_surfaces_does_not_stick_and_slip():
    surface = {'friction': 0.4, 'slip_speed': 1e-3}
    surfaces = {'surfaces': dict.fromkeys(SURFACES, surface)}
    with pressing('puma', plant_overrides=surfaces) as run:
        run.advance(150)  # friction makes the last newtons slow
        forces = run.slide(0.005, 1500)
    assert_allclose(forces, FORCE, atol=3.0)
    for error in (forces - FORCE).T:
        everywhere = np.ones(len(error), dtype=bool)
        assert not find_oscillations(error, FORCE * everywhere, everywhere, 500.0)


def test_every_law_takes_over_while_it_presses():
    """As `ros2 param set` of gains and law does, one after the other and back."""
    with pressing('rigid') as run:
        loop = run.loop
        config = loop.setup.controller
        rate = np.array(config.limits.torque_rate) * config.period
        for law in (*FORCE_LAWS, 'aob'):
            values = merge(config.model_dump(), {'force': {'law': law}})
            if law != 'aob':
                values = merge(values, preset_values(f'laws/{law}')['controller'])
            loop.control.reconfigure(validate(ControllerConfig, values))
            assert loop.control.config.force.law == law
            before = loop.command
            forces = run.advance(150)
            assert (np.abs(loop.command - before) < rate).all()
            assert np.abs(forces - FORCE).max() < 2.0, law


@pytest.mark.parametrize('force', [0.0, FORCE])
def test_arm_that_was_moved_while_inactive_begins_where_it_is(force):
    """It is pushed to another place after a deactivation; nothing leads it back, or jumps."""
    with pressing('rigid') as run:
        loop = run.loop
        loop.control.set_forces(dict.fromkeys(SURFACES, force))
        run.advance(50)
        start = loop.sample.q
        loop.command = loop.control.stop()
        loop.plant.push(np.array([-40.0, -30.0, 30.0]), 0.6)
        for _ in range(700):
            loop.act()
            loop.command = loop.control.step(loop.inputs())
        moved = loop.sample.q
        assert np.abs(moved - start).max() > 0.02
        loop.control.restart()
        before = loop.command
        measured = loop.sample.effort
        loop.advance()
        change = np.abs(loop.command - before).max()
        change_to_measured = np.abs(loop.command - measured).max()
        assert min(change, change_to_measured) < 1e-6
        assert not any(loop.control.commanded_forces.values())
        run.advance(400)
        assert np.abs(loop.sample.q - moved).max() < 2e-3
