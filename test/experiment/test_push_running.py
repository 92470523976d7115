"""The push test of a controller that runs, with other nodes that report as it does."""

import itertools
import threading

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.srv import GetState
from multicontact_control.experiment.push_running import push_running
from multicontact_control.nodes import topics
from multicontact_control.nodes.graph_node import create_publisher
from multicontact_control.nodes.link import GuestNode
import pytest
from rclpy.executors import SingleThreadedExecutor
from ros_graph import own_domain, PATIENCE
from std_srvs.srv import Trigger

pytestmark = pytest.mark.ros

SAID = ('push in x', 'push in y', 'push test passed: all six channels')


def report(name, text):
    return DiagnosticArray(status=[DiagnosticStatus(
        name=f'{name}: sensor', values=[KeyValue(key='push_test', value=text)])])


@pytest.fixture
def controller():
    """Stand in for a controller, and for nodes that report right after it."""
    with own_domain() as domain_id, GuestNode('controller_node', domain_id) as guest:
        node, asked = guest.node, threading.Event()
        publisher, told = create_publisher(node, topics.DIAGNOSTICS), itertools.count()

        def state(_request, response):
            response.current_state.label = 'active'
            return response

        def begin(_request, response):
            asked.set()
            response.success, response.message = True, 'push'
            return response

        def tell():
            text = SAID[min(next(told), len(SAID) - 1)] if asked.is_set() else 'push test failed'
            publisher.publish(report('controller_node', text))
            for other in range(3):
                publisher.publish(report(f'other{other}', 'nothing'))

        node.create_service(GetState, '~/get_state', state)
        node.create_service(Trigger, '~/push_test', begin)
        node.create_timer(0.3, tell)
        executor = SingleThreadedExecutor(context=guest.context)
        executor.add_node(node)
        thread = threading.Thread(target=executor.spin)
        thread.start()
        yield domain_id
        executor.shutdown()
        thread.join()


def test_what_a_controller_says_is_heard_among_others(controller):
    instructions = []
    assert push_running(domain_id=controller, timeout=PATIENCE, on_instruction=instructions.append)
    assert instructions[0] == 'push'
    assert instructions[-1] == SAID[-1]
    assert set(SAID[1:]) <= set(instructions)  # the first may be of before the answer
