"""Real middleware for the tests of the nodes, in a ROS domain of their own."""

from multicontact_control.nodes.link import GuestNode, LifecycleDriver
import pytest
from ros_graph import Middleware, own_domain


@pytest.fixture(scope='session')
def domain_id():
    """Reserve a domain that nothing else on this machine uses."""
    with own_domain() as number:
        keeper = GuestNode('keeper', number)  # so that one participant serves all tests
        yield number
        keeper.close()


@pytest.fixture
def middleware(domain_id, tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'ros'))
    with Middleware(domain_id) as handle:
        yield handle


@pytest.fixture
def driver(domain_id, middleware):
    with LifecycleDriver(domain_id) as handle:
        yield handle
