"""The walk of a sample from its callback to the published torque, beside the page about it."""

from pathlib import Path
import re
import sys

from fake_arm import FakeArm, PARAMETERS
import multicontact_control
import pytest

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(
        sys.version_info < (3, 11), reason='code objects have no qualified names'
    ),
]

PACKAGE = Path(multicontact_control.__file__).parent
PAGE = PACKAGE.parent / 'docs' / 'architecture.md'
HOP = re.compile(r'^\| `(\w+(?:\.\w+)?)` \| `(\w[\w/]*\.py)` \|', re.MULTILINE)
CALLBACK = 'ControllerNode._on_message'
KERNELS = ('check_inputs', 'tick')  # compiled functions that Python calls
STEADY = 400  # samples, after which nothing is left of the start
MOST_HOPS, MOST_FILES = 14, 9  # compiled functions aside


class Walk:
    """The functions with a name that run from a callback to what it publishes."""

    def __init__(self):
        self.hops, self.published = [], False

    def __call__(self, frame, event, argument):
        if self.published:
            return
        if (
            event == 'c_call'
            and argument.__name__ in ('publish', 'publish_raw')
            and self.hops
        ):
            self.published = True
        path, name = Path(frame.f_code.co_filename), frame.f_code.co_qualname
        if event == 'return' and name == CALLBACK:
            self.hops = []  # the first message of two publishes nothing; timers may come between
        if event == 'call' and path.is_relative_to(PACKAGE) and not name.endswith('>'):
            if name == CALLBACK:
                self.hops = []
            if name == CALLBACK or self.hops:
                self.hops.append((name, str(path.relative_to(PACKAGE))))


def test_sample_walks_as_the_page_describes(host):
    host.activate(*PARAMETERS)
    arm = FakeArm(host)
    arm.connect()
    for _ in range(STEADY):
        arm.step()
        arm.send_variance()
    arm.send()
    walk = Walk()
    for _ in range(100):
        sys.setprofile(walk)
        host.pause()
        sys.setprofile(None)
        if walk.published:
            break
    assert walk.published
    hops = list(dict.fromkeys(walk.hops))
    walk_of_page = PAGE.read_text(encoding='utf-8').partition('What `tick` calls')[0]
    assert hops == HOP.findall(walk_of_page)
    hops = [(name, file) for name, file in hops if name not in KERNELS]
    assert len(hops) <= MOST_HOPS
    assert len({file for _, file in hops}) <= MOST_FILES
