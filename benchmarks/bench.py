"""
How fast everything is, each part beside its floor in the same run: `make bench`.

Options go in BENCH_ARGS. Ratios compare between machines; times do not. TSID needs an older
pinocchio: --tsid-python names the Python of its environment (docs/experiments.md).
"""

import argparse
from functools import partial
import json
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
from time import perf_counter_ns

from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.export.library import export_library
from multicontact_control.export.memory import copy_memory, make_memory_record
from multicontact_control.files import replace_json_file
from multicontact_control.force.noise import make_noise_estimator
from multicontact_control.loop import ControlLoop
from multicontact_control.process import settle_process
from multicontact_control.records import INPUT, record_dtype, Task
from multicontact_control.runs.closed_loop import (
    ClosedLoop,
    estimate_variance,
    run_in_process,
)
from multicontact_control.runs.compilation import ensure_compiled
from multicontact_control.runs.scenario import resolve
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
import numpy as np
import pandas as pd
import pinocchio as pin
import psutil
import pybullet
from sim_bridge.bullet_arm import BulletArm
from sim_bridge.plant import Plant

RATE = 500.0  # Hz
FALL = 250  # periods after which an arm that falls is put back
NOISY = 2.0  # p99 of a floor over its p50, from which on its ratio means nothing
# Six independent contacts: unit normals and points, both in world axes.
NORMALS = np.vstack([np.eye(3), -np.eye(3)])
POINTS = np.array(
    [
        [0.1, 0.2, -0.6],
        [-0.6, 0.1, 0.2],
        [0.6, 0.2, 0.1],
        [-0.2, 0.1, 0.6],
        [0.2, 0.6, -0.1],
        [0.1, -0.6, 0.2],
    ]
)


def resolve_setup(duration=None):
    """
    Return the setup of all measurements: the scenario `quick` on the rigid plant.

    `duration` is another length than its own [s].
    """
    return resolve('quick', plant='rigid', seed=0, duration=duration)


def time_beside_floor(work, floor, count, lap, restart):
    """
    Time something and, after each call, its floor, `count` times.

    Both are called with their place in a lap of `lap` calls; `restart` comes before each lap.
    Returns percentiles of both [us], the ratio of the medians, and whether the floor is noisy.
    """
    times = np.zeros((count, 2))
    for k in range(count):
        place = k % lap
        if place == 0:
            restart()
        start = perf_counter_ns()
        work(place)
        done = perf_counter_ns()
        floor(place)
        times[k] = done - start, perf_counter_ns() - done
    (work_p50, floor_p50), (work_p99, floor_p99) = np.percentile(
        1e-3 * times, (50.0, 99.0), axis=0
    ).tolist()
    return {
        'us': {'p50': work_p50, 'p99': work_p99},
        'floor_us': {'p50': floor_p50, 'p99': floor_p99},
        'ratio': work_p50 / floor_p50,
        'noisy': floor_p99 > NOISY * floor_p50,
    }


def bare_dynamics(setup):
    """Return a function that makes pinocchio's calls for M, C v + g, J and dJ/dt v."""
    robot = setup.controller.robot
    model = pin.buildModelFromUrdf(str(setup.urdf_dir / robot.urdf))
    data = model.createData()
    frame = model.getFrameId(robot.operational_frame)
    zero = np.zeros(model.nv)

    def compute(q, v):
        pin.forwardKinematics(model, data, q, v, zero)
        pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        pin.crba(model, data, q)
        pin.nonLinearEffects(model, data, q, v)
        pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)

    return compute


def bench_tick(count, *, supervised, estimated=True):
    """
    Time a tick of the loop beside the bare dynamics, on the samples of a recorded run.

    Contact states, watchdogs and limits are timed, too, if `supervised`; the noise estimator if
    `estimated`. The floor are the calls of pinocchio that no controller of the kind does without.
    """
    setup = resolve_setup()
    config = setup.controller
    samples = record_samples(setup, supervised)
    loop = ControlLoop(
        config,
        setup.reference(),
        CommandLimits(),
        setup.urdf_dir,
        supervised=supervised,
    )
    estimator = make_noise_estimator(setup.noise_estimator)
    compute = bare_dynamics(setup)
    variance = None

    def step(place):
        nonlocal variance
        time = place * config.period
        q, qd, wrench, effort = samples[place]
        joints = JointInput(time, q, qd, effort)
        loop.step(TickInputs(time, joints, WrenchInput(time, wrench), variance))
        if estimated and loop.output is not None:
            variance = VarianceInput(time, estimate_variance(estimator, loop.output))

    def compute_floor(place):
        q, qd, _, _ = samples[place]
        compute(q, qd)

    def restart():
        nonlocal variance
        loop.restart()
        estimator.reset()
        variance = None

    return time_beside_floor(step, compute_floor, count, len(samples), restart)


def record_samples(setup, supervised):
    """
    Return position, velocity, wrench and measured torque of each sample of a run in process.

    The wrench is that of the configured series; each reading is an array of its own.
    """
    data = run_in_process(setup, supervised=supervised).data
    wrench = getattr(data, setup.controller.wrench_series)
    series = (data.q, data.qd, wrench, data.effort)
    return [[values[k].copy() for values in series] for k in range(data.ticks)]


def bench_plant(count):
    """
    Time a period of the plant beside `stepSimulation` of a bare arm, as often as its substeps.

    The arm falls, without control, and is put back every half second.
    """
    config = resolve_setup().plant
    plant = Plant(config, rate=RATE, seed=0)
    bare = BulletArm(plant.description, config.gravity_world, config.substep)
    substeps = range(config.substeps(RATE))

    def step_plant(_):
        plant.step(plant.initial_torque)

    def step_bare(_):
        for _ in substeps:
            pybullet.stepSimulation(physicsClientId=bare.client)

    def reset():
        plant.reset()
        bare.reset(np.array(config.home))

    times = time_beside_floor(step_plant, step_bare, count, FALL, reset)
    plant.close()
    bare.close()
    return times


def bench_contacts(count):
    """
    Return the median time of a tick of the bare law [us] by the number of contacts.

    The samples are random postures about home, with random wrenches, so that nothing is steady.
    """
    setup = resolve_setup()
    random = np.random.default_rng(0)
    home = np.array(setup.plant.home)
    rest = JointInput(0.0, home, 0.0 * home)
    medians = {}
    for contacts in range(1, len(NORMALS) + 1):
        config = configure_contacts(setup, contacts)
        loop = ControlLoop(
            config, None, CommandLimits(), setup.urdf_dir, supervised=False
        )
        loop.step(TickInputs(0.0, rest, WrenchInput(0.0, np.zeros(6))))
        loop.set_forces(dict.fromkeys(config.contact_names, 5.0))
        times = np.zeros(count)
        for k in range(count):
            move, speed, wrench = random.standard_normal((3, 6))
            time = (k + 1) * config.period
            joints = JointInput(time, home + 0.02 * move, 0.1 * speed)
            inputs = TickInputs(time, joints, WrenchInput(time, wrench))
            start = perf_counter_ns()
            loop.step(inputs)
            times[k] = perf_counter_ns() - start
        medians[contacts] = 1e-3 * float(np.median(times))
    return medians


def configure_contacts(setup, count):
    """
    Return the controller's configuration with the first `count` of the six contacts.

    They are parameters of the table but for normal and point, which are independent at home.
    """
    home = np.array(setup.plant.home)
    robot = RobotModel(setup.controller.robot, setup.urdf_dir)
    rotation = robot.update(home, 0.0 * home).pose.rotation_world
    contacts = {}
    for k in range(count):
        contacts[f'contact{k + 1}'] = setup.controller.contacts['table'].model_copy(
            update={
                'normal_world': tuple(NORMALS[k]),
                'point_operational': tuple(POINTS[k] @ rotation),
            }
        )
    return setup.controller.model_copy(
        update={'contact_names': tuple(contacts), 'contacts': contacts}
    )


def bench_graph(duration):
    """
    Run the graph in lockstep and in real time, each for a duration [s]; needs ROS.

    Returns for both how fast time passed, the latency from sample to command, the deadlines that
    were missed, and how much of a core each node took.
    """
    from multicontact_control.runs.graph.run import run_graph  # needs ROS
    from multicontact_control.runs.graph.spec import GraphSpec, START_ORDER

    setup = resolve_setup(duration)
    results = {}
    for mode in ('lockstep', 'real_time'):
        spent = []  # times of the wall and the nodes [s], a few times a second

        def note_times(_progress, spent=spent):
            spent.append(read_processor_times(START_ORDER))

        with TemporaryDirectory() as folder:
            out = Path(folder)
            spec = GraphSpec(
                out=out,
                ticks=setup.ticks,
                rate=RATE,
                free_running=mode == 'real_time',
                reference_file=out / 'config/reference.yaml',
                parameter_files=setup.write(out / 'config'),
            )
            sim = run_graph(spec, note_times).timing['sim_node']
        first = spent[0]
        last = spent[-1]
        wall = last['wall'] - first['wall']
        cores = {}
        for name in START_ORDER:
            if name in first and name in last:
                cores[name] = (last[name] - first[name]) / wall
        results[mode] = {
            'realtime_factor': duration / sim['wall_s'],
            'latency_us': sim['latency_us'],
            'deadline_misses': sim['deadline_misses'],
            'ticks': sim['ticks'],
            'cores': cores,
        }
    return results


def read_processor_times(nodes):
    """
    Return the time of the wall, and what each node has computed until now [s].

    Nodes are children of this process, and are known by their command; an absent one is left out.
    """
    times = {'wall': 1e-9 * perf_counter_ns()}
    for process in psutil.Process().children(recursive=True):
        # NODE, or python -m MODULE.
        command = ' '.join(process.cmdline()).split()[:3]
        for node in nodes:
            if any(word.endswith(node) for word in command):
                used = process.cpu_times()
                times[node] = used.user + used.system
    return times


def bench_c_tick(count):
    """
    Return the times of a supervised tick of the C library [us], with pinocchio and without.

    The inputs are those of a run in Python, whose torques and terms of the model it compares with
    its own. Needs g++, cmake and pinocchio's headers. Raises RuntimeError if it cannot be built.
    """
    with TemporaryDirectory() as place:
        folder = Path(place)
        tick = folder / 'tick'
        record_c_inputs(tick, folder / 'inputs')
        build = folder / 'build'
        prefix = Path(pin.__file__).parents[4]
        source = Path(__file__).with_name('c_tick')
        settings = (f'-DEXPORT={tick}', f'-DCMAKE_PREFIX_PATH={prefix}')
        for command in (
            ('cmake', '-S', source, '-B', build, *settings),
            ('cmake', '--build', build, '--target', 'c_tick'),
            (build / 'c_tick', tick, folder / 'inputs', str(count)),
        ):
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                raise RuntimeError((done.stderr or done.stdout).splitlines()[-1])
    answer = json.loads(done.stdout.splitlines()[-1])
    if answer['unlike_torques'] or answer['unlike_terms']:
        raise RuntimeError(f'the C library differs from Python: {answer}')
    return answer


def record_c_inputs(tick, path):
    """Export the controller of all measurements to `tick`; write what it is given to a file."""
    loop = ClosedLoop(resolve_setup())
    export_library(loop.control, tick)
    memory = np.zeros(1, record_dtype(make_memory_record(loop.control)))
    fields = memory.dtype.fields
    columns = len(memory['contacts'][0])
    ticks = np.zeros(
        loop.setup.ticks,
        np.dtype(
            [
                ('sample', INPUT),
                ('wanted', record_dtype(Task)),
                ('alpha_wanted', 'f8', columns),
                ('contact_wanted', '?', columns),
                ('terms', fields['terms'][0]),
                ('torque', 'f8', len(memory['joints'][0])),
            ],
            align=True,
        ),
    )
    for row in ticks:
        output = loop.answer()
        copy_memory(loop.control, memory)
        row['sample'] = memory['stages'][0, 0]['sample']
        row['wanted'] = memory['controls'][0, 0]['wanted']
        row['alpha_wanted'] = memory['contacts'][0]['alpha_wanted']
        row['contact_wanted'] = memory['contacts'][0]['wanted']
        row['terms'] = memory['terms'][0]
        row['torque'] = output.torque
        loop.act()
    loop.close()
    ticks.tofile(path)


def bench_tsid(python, result):
    """
    Return TSID's times on the samples, beside those of the law alone in `result`.

    `python` is that of TSID's environment. Raises RuntimeError if it cannot be run.
    """
    law = result['law alone']
    setup = resolve_setup()
    config = setup.controller
    data = run_in_process(setup).data
    names = config.contact_names
    with TemporaryDirectory() as folder:
        path = Path(folder) / 'problem.npz'
        np.savez(
            path,
            urdf=str((setup.urdf_dir / config.robot.urdf).resolve()),
            frame=config.robot.operational_frame,
            torque_limit=config.torque_limit,
            tips=[setup.plant.surfaces[name].tip_link for name in names],
            normals=[config.contacts[name].normal_world for name in names],
            q=data.q,
            qd=data.qd,
        )
        script = Path(__file__).with_name('tsid_tick.py')
        done = subprocess.run(
            [python, '-I', script, path], capture_output=True, text=True
        )
    if done.returncode:
        raise RuntimeError(done.stderr.splitlines()[-1])
    answer = json.loads(done.stdout.splitlines()[-1])
    floor = float(np.median(answer.pop('tick_us')))
    return {
        **law,
        **answer,
        'floor_us': {'p50': floor},
        'ratio': law['us']['p50'] / floor,
    }


def main(arguments=None):
    """Measure, print a table, write JSON if asked to; return the exit code."""
    parser = argparse.ArgumentParser(
        prog='make bench',
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        '--ticks', type=int, default=20_000, help='of each part (%(default)s)'
    )
    parser.add_argument(
        '--seconds',
        type=float,
        default=10.0,
        help='of each graph, 0 for none (%(default)s)',
    )
    parser.add_argument('--json', type=Path, help='write all numbers to this file')
    parser.add_argument(
        '--tsid-python', default=sys.executable, help='Python that has TSID'
    )
    options = parser.parse_args(arguments)
    count = options.ticks
    result = {}
    ensure_compiled()
    settle_process()
    measurements = {
        'bare tick': partial(bench_tick, count, supervised=False),
        'supervised tick': partial(bench_tick, count, supervised=True),
        'law alone': partial(bench_tick, count, supervised=False, estimated=False),
        'plant': partial(bench_plant, min(count, 5000)),
        'contacts': partial(bench_contacts, max(200, count // 10)),
    }
    measurements['C tick'] = partial(bench_c_tick, count)
    if options.seconds:
        measurements['graph'] = partial(bench_graph, options.seconds)
    measurements['law over TSID'] = partial(bench_tsid, options.tsid_python, result)
    for name, measure in measurements.items():
        print(name, '...', flush=True)
        try:
            result[name] = measure()
        except (ImportError, OSError, RuntimeError) as error:
            print(f'{name}: skipped, {error}')
    print_tables(result)
    if options.json:
        replace_json_file(options.json, result)
    return 0


def print_tables(result):
    """
    Print the figures of each part beside its floor [us], and those of the graph.

    A part that was skipped is not in the table.
    """
    rows = []
    for name, part in result.items():
        if 'us' in part:
            rows.append(
                {
                    'part': name,
                    'p50': part['us']['p50'],
                    'p99': part['us']['p99'],
                    'floor p50': part['floor_us']['p50'],
                    'ratio': part['ratio'],
                    'noisy': part['noisy'],
                }
            )
    print(pd.DataFrame(rows).round(2).to_string(index=False))
    medians = ' '.join(f'{median:.0f}' for median in result['contacts'].values())
    print('law, 1 to 6 contacts:', medians)
    if 'C tick' in result:
        rows = {name: result['C tick'][name] for name in ('with pinocchio', 'without')}
        print('C tick [us]:')
        print(pd.DataFrame(rows).T.round(2).to_string())
    if 'C tick' in result and 'law over TSID' in result:
        tsid = result['law over TSID']['floor_us']['p50']
        p50 = result['C tick']['with pinocchio']['p50']
        print(f'C tick with pinocchio over TSID: {p50 / tsid:.2f}')
    if 'graph' in result:
        graph = pd.json_normalize(list(result['graph'].values()))
        print(graph.set_axis(list(result['graph'])).T.to_string())


if __name__ == '__main__':
    sys.exit(main())
