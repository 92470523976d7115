"""Simulated arms do not fall: what carries them through every fault, their drives included."""

from contextlib import closing
from functools import partial
from xml.etree import ElementTree

from arms import controller_config, HOME, still_config
from multicontact_control.config import ToolConfig
from multicontact_control.dynamics.robot import load_model, RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.loop import ControlLoop
from multicontact_control.paths import find_config_folder
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.inputs import TickInputs
import numpy as np
import pinocchio as pin
import pytest
from sim_bridge.actuator_delay import ActuatorDelay

REST = np.zeros(6)
ROBOT = RobotModel(controller_config().robot, find_config_folder())
FEET = {
    'a': [0.05, 0.05, 0.24],
    'b': [-0.05, 0.05, 0.24],
    'c': [-0.05, -0.05, 0.24],
    'd': [0.05, -0.05, 0.24],
}
LINE = {'a': [0.0, 0.0, 0.24], 'b': [0.05, 0.0, 0.24], 'c': [0.1, 0.0, 0.24]}


def aligned():
    """Return two points of which, at the first posture, one is straight above the other."""
    rotation = ROBOT.update(HOME, REST).pose.rotation_world
    table = np.array([0.0, 0.0, 0.24])
    return {
        'table': table.tolist(),
        'board': (table + 0.05 * rotation.T @ np.array([0.0, 0.0, -1.0])).tolist(),
    }


def pressing_down(points):
    """Return changes of a configuration with a contact at each point, all normals downwards."""
    return {
        'contact_names': list(points),
        'contacts': {
            name: {'normal_world': [0.0, 0.0, -1.0], 'point_operational': point}
            for name, point in points.items()
        },
    }


@pytest.mark.parametrize(
    'points', [FEET, LINE], ids=['four coplanar feet', 'three in a line']
)
def test_contacts_that_depend_in_any_orientation_are_refused(points):
    with pytest.raises(ConfigError, match=f'got {", ".join(points)}, which depend'):
        ControlLoop(
            still_config(**pressing_down(points)),
            None,
            CommandLimits(),
            find_config_folder(),
        )


def carried(loop, ticks, sag=0.02):
    """Advance a loop, and assert that the arm stays where it is."""
    start = loop.sample.q.copy()
    limit = np.array(loop.setup.controller.torque_limit)
    for _ in range(ticks):
        loop.advance()
        assert np.isfinite(loop.command).all() and (np.abs(loop.command) <= limit).all()
        assert np.abs(loop.sample.q - start).max() < sag


@pytest.mark.parametrize('plant', ['rigid', 'puma'])
def test_law_without_an_answer_leaves_the_arm_where_it_is(plant):
    changes = {'contacts': pressing_down(aligned())['contacts']}
    with closing(ClosedLoop(resolve('quick', plant=plant, controller=changes))) as loop:
        carried(loop, 500)
        assert (loop.status.reaction, loop.status.causes) == ('hold', ('latched',))
        assert any(
            'law_ContactGeometryError' in what for _, what in loop.control.events.events
        )


def test_arm_that_starts_outside_its_limits_is_held_until_it_is_moved_inside():
    """The limits would have led it inside at once; joint 3 is moved by hand."""
    third = np.eye(6)[2]
    limits = {'joint_upper': [2.793, 3.927, 2.9, 2.967, 1.745, 4.643]}
    with closing(
        ClosedLoop(
            resolve(
                'quick',
                plant='rigid',
                controller={
                    'limits': limits,
                    'sensor': {'frozen_ticks': 0},
                    'watchdog': {'frozen_joint_ticks': 0},
                },
            )
        )
    ) as loop:
        carried(loop, 500, sag=1e-4)
        assert (loop.status.reaction, loop.status.causes) == (
            'hold',
            ('start_outside',),
        )
        assert loop.control.supervisor.findings[0].startswith('joint3: ')
        assert loop.sample.contact_force.max() == 0.0
        for k in range(400):
            q = HOME - 0.05 * min(k / 300, 1.0) * third
            qd = -0.05 / 0.6 * (k < 300) * third
            inputs = loop.inputs()
            loop.control.step(
                inputs._replace(joints=inputs.joints._replace(q=q, qd=qd))
            )
            assert loop.control.supervisor.findings or k > 100
            loop.tick += 1
        assert loop.status.reaction == 'none' and not loop.control.supervisor.findings


TOOL = ('ft_face', 'tool')  # links beyond the sensor


def gravity_of_the_arm(with_tool):
    """Return g(q) of what the arm's own controller knows of it, from its URDF."""
    urdf = ElementTree.fromstring((find_config_folder() / 'puma560.urdf').read_text())
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
        self._delay.enter_command(self.tick, self.command)
        sample = self.plant.step(self._delay.torque_for(self.tick) + own)
        self.sample = sample._replace(effort=sample.effort - own)
        self.tick += 1


@pytest.mark.parametrize(
    ('with_tool', 'supervised', 'kind'),
    [
        (True, True, 'zero_torque'),
        (False, True, 'hold_position'),
        (True, True, 'gravity_compensation'),
        (True, False, 'zero_torque'),
    ],
)
def test_arm_that_carries_itself_presses_and_stays_in_every_reaction(
    with_tool, supervised, kind
):
    """
    No sag at the start, 10 N on both contacts, and limits that are less than its weight.

    Before its joints are known the torque is zero, which lets this arm stand.
    """
    limit = [60.0, 25.0, 40.0, 24.2, 20.1, 21.3]
    blind = 5 * (with_tool and supervised)
    assert (np.abs(gravity_of_the_arm(True)(HOME)) > limit).any()
    with closing(
        SelfCarryingLoop(
            resolve(
                'quick',
                plant='rigid',
                controller={
                    'robot': {'adds_gravity': True, 'adds_tool_gravity': with_tool},
                    'torque_limit': limit,
                    'safe_behaviour': kind,
                },
            ),
            with_tool=with_tool,
            supervised=supervised,
            commanded=True,
        )
    ) as loop:
        for k in range(200):
            loop.advance(
                lambda inputs, k=k: TickInputs(inputs.time) if k < blind else inputs
            )
            assert np.abs(loop.sample.q - HOME).max() < 1e-4
            assert np.abs(loop.command).max() < (1e-9 if k < blind else 3.0)
        if supervised:
            loop.control.set_forces({'table': 10.0, 'board': 10.0})
            carried(loop, 1300, sag=0.1)
            np.testing.assert_allclose(loop.sample.contact_force, 10.0, atol=0.5)
            assert set(loop.control.events.reaction_counts) <= {'none', 'float'}
            for part, reaction in (('wrench', 'hold'), ('joints', 'float')):
                for _ in range(30):
                    loop.advance(
                        lambda inputs, part=part: inputs._replace(**{part: None})
                    )
                assert loop.status.reaction == reaction
                carried(loop, 200)
        start = loop.sample.q
        loop.command = loop.control.stop()
        for _ in range(400):
            loop.act()
            loop.command = loop.control.step(loop.inputs())
            # Without any torque, a push by the surfaces that let go is not braked.
            assert kind == 'zero_torque' or np.abs(loop.sample.q - start).max() < 0.05
        if kind == 'zero_torque':
            np.testing.assert_allclose(loop.command, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ('plant', 'force', 'carries_itself'),
    [
        ('rigid', 0.0, False),
        ('puma', 0.0, False),
        ('puma', 10.0, False),
        ('rigid', 10.0, True),
    ],
)
def test_announced_tool_that_is_picked_up_is_borne_without_a_jump(
    plant, force, carries_itself
):
    """1.2 kg, at rest and while pressing; also by an arm that carries itself without a tool."""
    robot = {'adds_gravity': carries_itself, 'adds_tool_gravity': False}
    make = partial(SelfCarryingLoop, with_tool=False) if carries_itself else ClosedLoop
    setup = resolve('quick', plant=plant, controller={'robot': robot})
    with closing(make(setup, commanded=True)) as loop:
        carried(loop, 50)
        loop.control.set_forces({'table': force, 'board': force})
        carried(loop, 1200, sag=0.1)
        config, tool = setup.controller, loop.plant.description.tool
        for payload in (1.2, 0.0):
            loop.plant.payload = payload
            mass = config.tool.mass + payload
            com = tuple((tool.mass + payload) / mass * np.array(tool.com.position))
            loop.control.reconfigure(
                config.model_copy(
                    update={'tool': ToolConfig(mass=mass, com_sensor=com)}
                )
            )
            for most in (5.0,) * 250 + (1.0,) * 150:  # N, up to 0.5 s and after
                before = loop.command
                loop.advance()
                assert np.abs(loop.command - before).max() < 1.0
                assert loop.status.reaction == 'none'
                assert np.abs(loop.sample.contact_force - force).max() < most
