"""An arm that adds gravity itself: everything that commands it commands that much less."""

from contextlib import closing
from xml.etree import ElementTree

from arms import HOME
from multicontact_control.dynamics.robot import load_model
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
from multicontact_control.paths import config_dir
from multicontact_control.supervision.inputs import TickInputs
import numpy as np
import pinocchio as pin
import pytest
from sim_bridge.actuator_delay import ActuatorDelay

ADDED = {'adds_gravity': True}
TOOL = ('ft_face', 'tool')  # links beyond the sensor


def gravity_of_the_arm(with_tool):
    """Return g(q) of what the arm's own controller knows of it, from its URDF."""
    urdf = ElementTree.fromstring((config_dir() / 'puma560.urdf').read_text())
    for link in urdf.findall('link'):
        inertial = link.find('inertial')
        if not with_tool and link.get('name') in TOOL and inertial is not None:
            link.remove(inertial)
    model = load_model(ElementTree.tostring(urdf, encoding='unicode'))
    data = model.createData()
    return lambda q: pin.computeGeneralizedGravity(model, data, q).copy()


class SelfCarryingLoop(ClosedLoop):
    """A loop around the simulated arm, to whose drives its own gravity torque is added."""

    def __init__(self, setup, *, with_tool=True, **options):
        super().__init__(setup, **options)
        self._gravity = gravity_of_the_arm(with_tool)
        own = self._gravity(HOME)
        self.command = self.plant.initial_torque - own
        self._delay = ActuatorDelay(setup.plant.actuator_delay_ticks, self.command)
        self.sample = self.sample._replace(effort=self.sample.effort - own)

    def act(self):
        own = self._gravity(self.sample.q)
        self._delay.command(self.tick, self.command)
        sample = self.plant.step(self._delay.torque_for(self.tick) + own)
        self.sample = sample._replace(effort=sample.effort - own)
        self.tick += 1


@pytest.mark.parametrize(('with_tool', 'supervised'), [(True, True), (False, True), (True, False)])
def test_arm_that_carries_itself_is_held_and_presses(with_tool, supervised):
    """
    No sag at the start, 10 N on both contacts, and limits that are less than its weight.

    Before its joints are known the torque is zero, which lets this arm stand.
    """
    limit, blind = [60.0, 25.0, 40.0, 24.2, 20.1, 21.3], 5 * (with_tool and supervised)
    assert (np.abs(gravity_of_the_arm(True)(HOME)) > limit).any()
    with closing(SelfCarryingLoop(resolve('quick', plant='rigid', controller={
            'robot': {**ADDED, 'adds_tool_gravity': with_tool}, 'torque_limit': limit}),
            with_tool=with_tool, supervised=supervised, commanded=True)) as loop:
        for k in range(200):
            loop.advance(lambda inputs, k=k: TickInputs(inputs.time) if k < blind else inputs)
            assert np.abs(loop.sample.q - HOME).max() < 1e-4
            assert np.abs(loop.command).max() < (1e-9 if k < blind else 3.0)
        loop.control.set_forces({'table': 10.0, 'board': 10.0})
        forces = []
        for _ in range(1300 if supervised else 1):
            loop.advance()
            assert (np.abs(loop.command) <= limit).all()
            forces.append(loop.true_forces)
        if supervised:
            np.testing.assert_allclose(np.mean(forces[-100:], axis=0), 10.0, atol=0.3)
            assert set(loop.control.events.reactions) <= {'none', 'float'}


@pytest.mark.parametrize('kind', ['gravity_compensation', 'hold_position', 'zero_torque'])
def test_reactions_and_safe_behaviour_leave_out_gravity_that_the_arm_adds(kind):
    """Two loops get the same inputs; the one of an arm that adds gravity commands less by it."""
    own = gravity_of_the_arm(True)
    changes = {'safe_behaviour': kind, 'torque_limit': []}
    setup = resolve('quick', plant='rigid', controller=changes)
    plain, source = ClosedLoop(setup).control, ClosedLoop(setup)
    added = ClosedLoop(resolve(
        'quick', plant='rigid', controller={**changes, 'robot': ADDED})).control
    seen, reactions = HOME, set()
    for k in range(420):
        inputs = source.inputs()
        source.advance()
        if k == 200:
            plain.stop()
            added.stop()
        if 140 <= k < 160:  # float
            inputs = of_added = inputs._replace(joints=None)
        else:
            joints, seen = inputs.joints, inputs.joints.q
            of_added = inputs._replace(
                joints=joints._replace(effort=joints.effort - own(joints.q)))
        if 40 <= k < 70:  # hold
            inputs, of_added = (each._replace(wrench=None) for each in (inputs, of_added))
        command, less = plain.step(inputs), added.step(of_added)
        if kind == 'zero_torque' and k > 400:
            np.testing.assert_allclose(less, 0.0, atol=1e-9)
        elif k < 200 or kind != 'zero_torque':
            # Where joints come back, it goes over from the command and not from what acted: for
            # some ticks g differs by what the arm has moved unseen, 1e-3 rad of 20 N m/rad.
            np.testing.assert_allclose(less, command - own(seen), atol=0.03)
        reactions.add(plain.status.reaction)
    assert {'none', 'hold', 'float'} <= reactions
