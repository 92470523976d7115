"""Threads and scheduling."""

import os
import subprocess
import sys

from multicontact_control.process import (
    claim_processor,
    limit_threads,
    THREAD_VARIABLES,
)
from ros_graph import ROOT


def output_of(code):
    return subprocess.run(
        [sys.executable, '-c', code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()


def test_threads_are_limited_before_numpy_is_loaded(monkeypatch):
    for name in THREAD_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv('OMP_NUM_THREADS', '3')
    limit_threads()
    assert os.environ['OPENBLAS_NUM_THREADS'] == '1'
    assert os.environ['OMP_NUM_THREADS'] == '3'  # as the user has it
    heavy = ('numpy', 'numba', 'pinocchio', 'pybullet', 'rclpy', 'matplotlib')
    assert (
        output_of(
            f'import sys, multicontact_control.cli; print(sys.modules.keys() & {heavy})'
        )
        == 'set()'
    )


def test_processor_is_claimed_or_refused():
    cpu = max(os.sched_getaffinity(0))
    assert (
        output_of(
            'import os; from multicontact_control.process import claim_processor; print('
            f'claim_processor(cpus=({cpu},)), os.sched_getaffinity(0))'
        )
        == f'[] {{{cpu}}}'
    )
    assert claim_processor() == []
    (problem,) = claim_processor(cpus=(4095,))
    assert 'processors [4095]' in problem and '\n' not in problem
