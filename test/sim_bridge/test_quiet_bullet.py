"""PyBullet does not tell when it was built, and nothing else is lost."""

import subprocess
import sys

from ros_graph import PATIENCE

IMPORTED = """
import ctypes, os, sys, threading
from sim_bridge.quiet_bullet import BANNER, bullet, without_line
libc = ctypes.CDLL(None)
libc.perror(b'as usual')
with without_line(b'no'):
    libc.perror(b'one')
    libc.perror(b'no')
    print('python', file=sys.stderr, flush=True)
    os.write(2, b'descriptor\\n')
    thread = threading.Thread(target=lambda: libc.perror(b'thread'))
    thread.start()
    thread.join()
try:
    with without_line(b'no'):
        libc.perror(b'no')
        libc.perror(b'kept')
        raise ImportError('not swallowed')
except ImportError as error:
    print(error)
libc.perror(b'no longer')
print(bullet.getPhysicsEngineParameters.__name__)
"""


def test_banner_alone_is_kept_out_of_the_error_stream():
    done = subprocess.run([sys.executable, '-c', IMPORTED], capture_output=True, text=True,
                          timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split('\n') == ['not swallowed', 'getPhysicsEngineParameters', '']
    first, *inside = [line.partition(':')[0] for line in done.stderr.splitlines()]
    assert first == 'as usual' and inside[-2:] == ['kept', 'no longer']
    assert sorted(inside[:-2]) == ['descriptor', 'one', 'python', 'thread']
