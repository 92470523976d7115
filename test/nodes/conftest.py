"""Real middleware for the tests of the nodes, in a ROS domain of their own."""

from multicontact_control.nodes import diagnostics, lifecycle
from multicontact_control.nodes.controller_node import ControllerNode
from multicontact_control.nodes.link import ServiceClientNode
from multicontact_control.nodes.runtime import Spinner
from multicontact_control.paths import find_config_folder
from multicontact_control.runs.graph.domain import reserve_domain
import pytest
from ros_graph import Middleware


@pytest.fixture(scope='session')
def domain_id():
    """Reserve a domain that nothing else on this machine uses."""
    with (
        reserve_domain() as number,
        ServiceClientNode('keeper', number),
    ):  # one participant for all tests
        yield number


@pytest.fixture
def middleware(domain_id):
    with Middleware(domain_id) as handle:
        yield handle


@pytest.fixture(scope='module')
def module_middleware(domain_id):
    with Middleware(domain_id) as handle:
        yield handle


@pytest.fixture(scope='module')
def driver(domain_id):
    with ServiceClientNode('driver', domain_id) as handle:
        yield handle


class Host(Middleware):
    """
    A controller in this process: its callbacks run whenever a test waits for something.

    It is in the context of the test's own node: participants of one process that come and go can
    make Fast DDS 2.14 wait for itself.
    """

    def __init__(self, domain_id):
        super().__init__(domain_id)
        self.hosted = None

    def make(self, *parameters):
        """Make a controller of the PUMA, unconfigured."""
        options = [part for text in parameters for part in ('-p', text)]
        self.hosted = ControllerNode(
            context=self.node.context,
            cli_args=[
                '--ros-args',
                '--params-file',
                str(find_config_folder() / 'controller.yaml'),
                *options,
            ],
        )
        self.spinner = Spinner(self.hosted, [])
        return self.hosted

    def activate(self, *parameters):
        """Make it, active."""
        node = self.make(*parameters)
        assert node.trigger_configure() == node.trigger_activate() == lifecycle.SUCCESS
        return node

    def __exit__(self, *error):
        if self.hosted is not None:
            self.spinner.close()
            self.hosted.destroy_node()
        super().__exit__(*error)

    def pause(self, duration=0.002):
        self.hosted.spin_once(self.spinner)

    def take(self, subscription):
        self.pause()
        return super().take(subscription)


@pytest.fixture(scope='module')
def host_domain():
    """Reserve a domain for hosted nodes: what is left of them answers no other test."""
    with (
        reserve_domain() as number,
        ServiceClientNode('keeper', number),
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr(lifecycle, 'SPIN_TIMEOUT', 0.001)
        patch.setattr(diagnostics, 'PERIOD', 200_000_000)
        yield number


@pytest.fixture(scope='module')
def make_host(host_domain):
    return lambda: Host(host_domain)


@pytest.fixture
def host(make_host):
    with make_host() as handle:
        yield handle
