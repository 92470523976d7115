"""
A simulated arm in real time, controlled over UDP by the C example and by the Python controller.

``python benchmarks/realtime_loop.py --rate 1000 --seconds 60``, after `multicontact compile`. The
simulator has one processor, the controller another. In each period a sample goes out; a cycle is
lost if the torque that answers it has not come a period later. Latencies are those of
the simulator, from sending a sample to having its torque. Simulator and controllers run with
SCHED_RR and without; what is asked for and not granted is said.
"""

import argparse
from contextlib import contextmanager
import os
from pathlib import Path
import select
import socket
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

from multicontact_control.export.library import export_library
from multicontact_control.files import replace_json_file
from multicontact_control.loop import ControlLoop
from multicontact_control.process import settle_process
from multicontact_control.runs.compilation import ensure_compiled
from multicontact_control.runs.scenario import resolve
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    WrenchInput,
)
import numpy as np
import pandas as pd
import pinocchio
from sim_bridge.actuator_delay import ActuatorDelay
from sim_bridge.plant import Plant

HERE = Path(__file__).resolve().parent
PRIORITY = 60  # of SCHED_RR
FORCE = 5.0  # N, on every surface
SUBSTEP = 1e-3  # s, at most, of the engine
DELAY_TICKS = 2  # periods from a sample to the torque that answers it
SIMULATOR_CPU, CONTROLLER_CPU = 0, 1
START_TIME = 0.5  # s, of cycles that are not counted
SPIN = 2e-4  # s before a period ends, in which the simulator waits awake


def sample_dtype(joint_count):
    """Return what a sample is on the wire, as in control_loop.cpp."""
    joints = ('f8', joint_count)
    fields = [('time', 'f8'), ('q', *joints), ('velocity', *joints)]
    return np.dtype([*fields, ('effort', *joints), ('wrench', 'f8', 6)])


def command_dtype(joint_count):
    """Return what a command is on the wire."""
    return np.dtype([('time', 'f8'), ('torque', 'f8', joint_count)])


def become_real_time(priority):
    """Ask for SCHED_RR, if a priority is given; say if it is not granted."""
    if not priority:
        return
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
    except OSError as error:
        print(f'SCHED_RR is not granted: {error}', file=sys.stderr)


def resolve_setup(rate, robot):
    """Return the setup of the arm, before its surfaces, at a rate [Hz]."""
    controller = {'rate': rate, 'force': {'input_delay': DELAY_TICKS / rate}}
    return resolve(
        'quick',
        robot=robot,
        plant='rigid',
        preset='best',
        controller=controller,
        noise_estimator={'rate': rate},
        plant_overrides={
            'actuator_delay_ticks': DELAY_TICKS,
            'substep': min(SUBSTEP, 1.0 / rate),
        },
    )


def control(setup, port, priority):
    """Control over UDP in Python as control_loop.cpp does, until an empty message ends it."""
    config = setup.controller
    loop = ControlLoop(config, None, CommandLimits(), setup.urdf_dir)
    forces = dict.fromkeys(config.contact_names, FORCE)
    count = len(config.robot.joint_names)
    sample = np.zeros(1, sample_dtype(count))
    command = np.zeros(1, command_dtype(count))
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(('127.0.0.1', port))
    settle_process()
    become_real_time(priority)
    print('ready', flush=True)
    pressing = False
    while True:
        size, peer = link.recvfrom_into(sample)
        if size != sample.nbytes:
            return
        now = float(sample['time'][0])
        joints = JointInput(
            now, sample['q'][0], sample['velocity'][0], sample['effort'][0]
        )
        torque = loop.step(
            TickInputs(now, joints, WrenchInput(now, sample['wrench'][0]))
        )
        if not pressing and loop.supervisor.started:
            loop.set_forces(forces)
            pressing = True
        command['time'] = now
        command['torque'] = torque
        link.sendto(command, peer)


@contextmanager
def started(command, cpu):
    """Start a controller on a processor; it says when it is ready, and ends with its block."""
    pinned = ['taskset', '-c', str(cpu), *map(str, command)]
    process = subprocess.Popen(pinned, stdout=subprocess.PIPE, text=True)
    try:
        if process.stdout.readline() != 'ready\n':
            raise RuntimeError(f'{command[0]} does not start')
        yield process
    finally:
        process.terminate()
        process.wait()


def simulate(setup, port, seconds):
    """
    Simulate an arm in real time; return what became of its cycles.

    Lost ones, ones that began late because the simulator itself was, latencies [us], and the
    forces at the end [N].
    """
    config = setup.controller
    plant = Plant(setup.plant, rate=config.rate, seed=setup.seed)
    delay = ActuatorDelay(setup.plant.actuator_delay_ticks, plant.initial_torque)
    count = len(config.robot.joint_names)
    message = np.zeros(1, sample_dtype(count))
    command = np.zeros(1, command_dtype(count))
    command['torque'] = plant.initial_torque
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.connect(('127.0.0.1', port))
    link.setblocking(False)
    period = config.period
    first = round(START_TIME / period)
    ticks = first + round(seconds / period)
    latencies = np.full(ticks, np.nan)
    late = np.zeros(ticks, dtype=bool)
    sample = plant.reset()
    due = time.perf_counter() + period
    for tick in range(ticks):
        message['time'] = tick * period
        message['q'] = sample.q
        message['velocity'] = sample.qd
        message['effort'] = sample.effort
        message['wrench'] = sample.wrench
        sent = time.perf_counter()
        link.send(message)
        while True:
            left = sent + period - time.perf_counter()
            if left <= 0.0:
                break
            if not select.select([link], [], [], left)[0]:
                continue
            link.recv_into(command)
            if command['time'][0] == message['time'][0]:
                latencies[tick] = time.perf_counter() - sent
                break
        delay.enter_command(tick, command['torque'][0])
        sample = plant.step(delay.torque_for(tick))
        time.sleep(max(due - time.perf_counter() - SPIN, 0.0))
        late[tick] = time.perf_counter() > due
        while time.perf_counter() < due:
            pass
        due = max(due, time.perf_counter() - period) + period
    link.send(b'')
    forces = sample.contact_force.tolist()
    plant.close()
    counted = latencies[first:]
    answered = counted[~np.isnan(counted)]
    p50, p99, p999 = np.percentile(1e6 * answered, (50.0, 99.0, 99.9)).tolist()
    return {
        'cycles': len(counted),
        'lost': int(np.isnan(counted).sum()),
        'simulator late': int(late[first:].sum()),
        'p50 us': p50,
        'p99 us': p99,
        'p99.9 us': p999,
        'worst us': 1e6 * float(answered.max()),
        'forces N': [round(force, 2) for force in forces],
    }


def build_example(folder):
    """Build the C++ example of an export; return its program."""
    prefix = Path(pinocchio.__file__).parents[4]
    build = folder / 'build'
    for command in (
        ['cmake', '-S', folder, '-B', build, f'-DCMAKE_PREFIX_PATH={prefix}'],
        ['cmake', '--build', build],
    ):
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(done.stderr or done.stdout)
    return build / 'control_loop'


def measure(options):
    """Return what became of the cycles, by controller and scheduling."""
    setup = resolve_setup(options.rate, options.robot)
    results = {}
    with TemporaryDirectory() as place:
        folder = Path(place) / 'tick'
        loop = ControlLoop(setup.controller, None, CommandLimits(), setup.urdf_dir)
        export_library(loop, folder)
        program = build_example(folder)
        os.sched_setaffinity(0, {SIMULATOR_CPU})
        settle_process()
        become_real_time(PRIORITY)
        port = options.port
        for name, priority in (('SCHED_RR', PRIORITY), ('ordinary', 0)):
            python = [sys.executable, __file__, '--rate', options.rate]
            python += ['--robot', options.robot, '--control', port + 1]
            python += ['--priority', priority]
            in_c = [program, folder, port, FORCE]
            if priority:
                in_c.append(priority)
            for kind, command in (('C', in_c), ('Python', python)):
                print(f'{kind}, {name} ...', flush=True)
                at = port if kind == 'C' else port + 1
                with started(command, CONTROLLER_CPU):
                    result = simulate(setup, at, options.seconds)
                print(result, flush=True)
                results[f'{kind}, {name}'] = result
    return results


def main():
    """Measure, print a table, write JSON if asked to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--rate', type=float, default=1000.0, help='[Hz] (%(default)s)')
    parser.add_argument(
        '--seconds', type=float, default=60.0, help='of each run (%(default)s)'
    )
    parser.add_argument('--robot', default='puma', help='(%(default)s)')
    parser.add_argument('--port', type=int, default=47_100, help='(%(default)s)')
    parser.add_argument('--json', type=Path, help='write all numbers to this file')
    parser.add_argument('--control', type=int, help=argparse.SUPPRESS)
    parser.add_argument('--priority', type=int, default=0, help=argparse.SUPPRESS)
    options = parser.parse_args()
    ensure_compiled()
    if options.control:
        control(
            resolve_setup(options.rate, options.robot),
            options.control,
            options.priority,
        )
        return
    results = measure(options)
    print(pd.DataFrame(results).to_string())
    if options.json:
        replace_json_file(options.json, results)


if __name__ == '__main__':
    main()
