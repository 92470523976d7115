"""What comes before the first test, and who runs which, with several workers (`pytest -n 3`)."""

import os
import signal

from browser import chromium  # noqa: F401 - a fixture
from hypothesis import settings
from multicontact_control.registry import FORCE_LAWS, NOISE_ESTIMATORS
from multicontact_control.runs.compilation import ensure_compiled
from multicontact_control.runs.graph.domain import reserve_domain
import pytest

# In one worker, one after the other: graphs in real time would take each other's processor.
REAL_TIME = (
    'test/campaign/test_campaign.py',
    'test/runs/graph/test_external.py',
    'test/nodes/test_survival.py',
)

# A machine that is busy for a moment makes no example wrong.
settings.register_profile('no deadline', deadline=None)
settings.load_profile('no deadline')


def pytest_sessionstart(session):
    """Compile what no test should wait for; of several workers that start at once, one does."""
    if os.environ.get('MULTICONTACT_COMPILE') != 'lazily':
        ensure_compiled()


def pytest_configure(config):
    """Keep ROS on this machine, the files below in order, and let signals end processes."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_LOG_DIR', str(config.rootpath / '.pytest_cache/ros'))
    # What `nohup` or a shell in the background has ignored, all processes of the tests would.
    for number, handler in (
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGHUP, signal.SIG_DFL),
    ):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, handler)
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items):
    """Put what takes longest first, file by file, so that no worker begins it last."""
    longest = {item.path for item in items if item.get_closest_marker('slow')}
    items.sort(
        key=lambda item: (group(item.nodeid) != REAL_TIME[0], item.path not in longest)
    )


def group(nodeid):
    """Return what a test is run together with: its file, or the first of several."""
    path = nodeid.split('::')[0]
    return REAL_TIME[0] if path in REAL_TIME else path


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Give every worker whole files, so that their fixtures are made once."""
    from xdist.scheduler import LoadScopeScheduling

    scheduler = LoadScopeScheduling(config, log)
    scheduler._split_scope = group
    return scheduler


@pytest.fixture(name='registries')
def fixture_registries():
    """Let a test register what it wants: later tests know nothing of it."""
    before = [(registry, {**registry}) for registry in (FORCE_LAWS, NOISE_ESTIMATORS)]
    yield
    for registry, names in before:
        registry.clear()
        registry.update(names)


@pytest.fixture(name='domain_id')
def fixture_domain_id():
    with reserve_domain() as number:
        yield number
