"""Threads and scheduling."""

import os
from pathlib import Path
import subprocess
import sys

from multicontact_control.process import claim_processor, limit_threads, THREAD_VARIABLES

ROOT = Path(__file__).parents[1]


def test_threads_are_limited_unless_the_user_says_otherwise(monkeypatch):
    for name in THREAD_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv('OMP_NUM_THREADS', '3')
    limit_threads()
    assert os.environ['OPENBLAS_NUM_THREADS'] == '1'
    assert os.environ['OMP_NUM_THREADS'] == '3'


def test_command_line_does_not_load_numpy_before_that():
    code = 'import sys, multicontact_control.cli; print("numpy" in sys.modules)'
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == 'False'


def test_processor_that_is_not_there_gives_one_clear_line():
    assert claim_processor() == []
    (problem,) = claim_processor(cpus=(4095,))
    assert 'CPU affinity [4095]' in problem and '\n' not in problem


def test_processors_are_those_of_every_thread():
    code = """
import os, threading
from multicontact_control.process import claim_processor
end = threading.Event()
threads = [threading.Thread(target=end.wait) for _ in range(3)]
for thread in threads: thread.start()
cpu = max(os.sched_getaffinity(0))
assert claim_processor(cpus=(cpu,)) == []
late = threading.Thread(target=end.wait)
late.start()
found = [os.sched_getaffinity(int(x)) for x in os.listdir('/proc/self/task')]
print(len(found) >= 5 and all(each == {cpu} for each in found))
end.set()
"""
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == 'True'


def test_missing_permission_gives_one_clear_line(monkeypatch):
    def refuse(*_arguments):
        raise PermissionError(1, 'Operation not permitted')
    monkeypatch.setattr(os, 'sched_setscheduler', refuse)
    (problem,) = claim_processor(fifo_priority=50)
    assert 'SCHED_FIFO 50 is not permitted' in problem and '\n' not in problem
