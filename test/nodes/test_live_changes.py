"""What takes long beside samples: parameters that change, and diagnostics."""

from threading import Event

from fake_arm import FakeArm, PARAMETERS
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros_graph import wait_for

pytestmark = pytest.mark.ros

PARTS = [
    'life cycle',
    'loop',
    'inputs',
    'publishers',
    'contacts',
    'sensor',
    'messages',
    'supervisor',
]


class Asker:
    """Asks a controller that works for other parameters, and waits for no answer."""

    def __init__(self, host):
        context = host.node.context
        self.node = Node('asker', context=context, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)
        self._client = self.node.create_client(
            SetParameters, 'controller_node/set_parameters'
        )
        wait_for(lambda: host.pause() or self._client.service_is_ready(), 'the service')

    def ask(self, **values):
        return self._client.call_async(
            SetParameters.Request(
                parameters=[
                    Parameter(name.replace('__', '.'), value=value).to_parameter_msg()
                    for name, value in values.items()
                ]
            )
        )

    def answered(self, future):
        self._executor.spin_once(timeout_sec=0.0)
        return future.done()


@pytest.fixture
def controller(host):
    return host.activate(*PARAMETERS)


@pytest.fixture
def arm(host, controller):
    arm = FakeArm(host)
    arm.connect()
    return arm


@pytest.fixture
def asker(host, controller):
    asker = Asker(host)
    yield asker
    asker.node.destroy_node()


@pytest.fixture
def released(controller):
    """Let every change take as long as a test wants."""
    released = Event()
    design = controller.parameter_set.compute_design

    def design_late(configurations):
        released.wait()
        return design(configurations)

    controller.parameter_set.compute_design = design_late
    yield released
    released.set()


def test_samples_are_answered_while_a_change_is_computed_and_it_is_in_force_when_answered(
    arm, controller, asker, released
):
    future = asker.ask(
        force__time_constant=0.05, force__damping_rate=-1.0, force__law='pi'
    )
    for _ in range(50):
        arm.step()
        assert not asker.answered(future)
    assert controller.get_parameter('force.time_constant').value == 0.02
    released.set()
    wait_for(lambda: arm.step() is not None and asker.answered(future), 'the answer')
    assert [x.successful for x in future.result().results] == [True, False, True]
    assert (
        'force.damping_rate: expected greater than' in future.result().results[1].reason
    )
    force = controller._loop.config.force
    assert (force.time_constant, force.damping_rate, force.law) == (0.05, 100.0, 'pi')


def test_change_that_is_made_meanwhile_is_kept(arm, controller, asker, released):
    future = asker.ask(force__time_constant=0.05)
    for _ in range(50):
        arm.step()
    released.set()
    changed = controller.set_parameters(
        [Parameter('motion.natural_frequency', value=15.0)]
    )
    assert changed[0].successful
    wait_for(lambda: arm.step() is not None and asker.answered(future), 'the answer')
    config = controller._loop.config
    assert future.result().results[0].successful
    assert (config.force.time_constant, config.motion.natural_frequency) == (0.05, 15.0)


def test_diagnostics_collect_one_part_a_turn_and_are_one_report(
    arm, controller, monkeypatch
):
    diagnostics, collected, per_turn = controller._diagnostics, [], []
    collect, poll = diagnostics._collect, diagnostics.poll

    def collect_watched():
        for status in collect():
            collected.append(status)
            yield status

    def poll_watched():
        before = len(collected)
        poll()
        per_turn.append(len(collected) - before)

    monkeypatch.setattr(diagnostics, '_collect', collect_watched)
    monkeypatch.setattr(diagnostics, 'poll', poll_watched)
    wait_for(
        lambda: arm.step() is not None and sum(map(bool, collected)) >= len(PARTS),
        'a whole report',
    )
    assert max(per_turn) == 1
    assert list(arm.diagnostics(lambda parts: True)) == PARTS
