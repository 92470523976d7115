"""
How fast everything is, each part beside its floor in the same run: `make bench`.

Options go in BENCH_ARGS. Ratios compare between machines; times do not. TSID needs an older
pinocchio: --tsid-python names the Python of its environment (docs/experiments.md).
"""

import argparse
import json
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
from time import perf_counter_ns

from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.files import replace_json_file
from multicontact_control.force.noise import make_noise_estimator
from multicontact_control.loop import ControlLoop
from multicontact_control.process import settle_process
from multicontact_control.runs.closed_loop import (
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


def setup_of(duration=None):
    """Return the scenario of all measurements."""
    return resolve('quick', plant='rigid', seed=0, duration=duration)


def race(work, floor, count, lap, restart):
    """Time something and, after each call, its floor [us]; `restart` comes before each `lap`."""
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
    taken, bare = (
        dict(zip(('p50', 'p99'), np.percentile(1e-3 * each, (50.0, 99.0)).tolist()))
        for each in times.T
    )
    return {
        'us': taken,
        'floor_us': bare,
        'ratio': taken['p50'] / bare['p50'],
        'noisy': bare['p99'] > NOISY * bare['p50'],
    }


def bare_dynamics(setup):
    """Return a function that makes pinocchio's calls for M, C v + g, J and dJ/dt v."""
    robot = setup.controller.robot
    model = pin.buildModelFromUrdf(str(setup.urdf_dir / robot.urdf))
    data, frame = model.createData(), model.getFrameId(robot.operational_frame)
    zero = np.zeros(model.nv)

    def compute(q, v):
        pin.forwardKinematics(model, data, q, v, zero)
        pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        pin.crba(model, data, q)
        pin.nonLinearEffects(model, data, q, v)
        pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)

    return compute


def bench_tick(count, *, supervised, estimated=True):
    """Time a tick, with the noise estimator if `estimated`, and the bare dynamics."""
    setup = setup_of()
    config, data = setup.controller, run_in_process(setup, supervised=supervised).data
    series = data.q, data.qd, getattr(data, config.wrench_series), data.effort
    samples = [[x[k].copy() for x in series] for k in range(data.ticks)]
    loop = ControlLoop(
        config,
        setup.reference(),
        CommandLimits(),
        setup.urdf_dir,
        supervised=supervised,
    )
    estimator, compute = (
        make_noise_estimator(setup.noise_estimator),
        bare_dynamics(setup),
    )
    variance = None

    def step(place):
        nonlocal variance
        time, (q, qd, wrench, effort) = place * config.period, samples[place]
        loop.step(
            TickInputs(
                time,
                JointInput(time, q, qd, effort),
                WrenchInput(time, wrench),
                variance,
            )
        )
        if estimated and loop.output is not None:
            variance = VarianceInput(time, estimate_variance(estimator, loop.output))

    def restart():
        nonlocal variance
        loop.restart()
        estimator.reset()
        variance = None

    return race(
        step, lambda place: compute(*samples[place][:2]), count, len(samples), restart
    )


def bench_plant(count):
    """Time a period of the plant, and `stepSimulation` of a bare arm as often as its substeps."""
    config = setup_of().plant
    plant = Plant(config, rate=RATE, seed=0)
    bare = BulletArm(plant.description, config.gravity_world, config.substep)
    substeps = range(config.substeps(RATE))

    def floor(_):
        for _ in substeps:
            pybullet.stepSimulation(physicsClientId=bare.client)

    def reset():
        plant.reset()
        bare.reset(np.array(config.home))

    times = race(lambda _: plant.step(plant.initial_torque), floor, count, FALL, reset)
    plant.close()
    bare.close()
    return times


def bench_contacts(count):
    """Return the median time of a tick of the bare law [us] by the number of contacts."""
    setup, random, medians = setup_of(), np.random.default_rng(0), {}
    home = np.array(setup.plant.home)
    pose = (
        RobotModel(setup.controller.robot, setup.urdf_dir).update(home, 0.0 * home).pose
    )
    table, points = setup.controller.contacts['table'], POINTS @ pose.rotation_world
    for contacts in range(1, len(NORMALS) + 1):
        names = [f'contact{k + 1}' for k in range(contacts)]
        config = setup.controller.model_copy(
            update={
                'contact_names': tuple(names),
                'contacts': {
                    name: table.model_copy(
                        update={'normal_world': (*n,), 'point_operational': (*p,)}
                    )
                    for name, n, p in zip(names, NORMALS, points)
                },
            }
        )
        loop = ControlLoop(
            config, None, CommandLimits(), setup.urdf_dir, supervised=False
        )
        rest = JointInput(0.0, home, 0.0 * home)
        loop.step(TickInputs(0.0, rest, WrenchInput(0.0, np.zeros(6))))
        loop.set_forces(dict.fromkeys(names, 5.0))
        times = np.zeros(count)
        for k in range(count):
            move, speed, wrench = random.standard_normal((3, 6))
            time, q = (k + 1) * config.period, home + 0.02 * move
            inputs = TickInputs(
                time, JointInput(time, q, 0.1 * speed), WrenchInput(time, wrench)
            )
            start = perf_counter_ns()
            loop.step(inputs)
            times[k] = perf_counter_ns() - start
        medians[contacts] = 1e-3 * float(np.median(times))
    return medians


def bench_graph(duration):
    """Run the graph [s] in lockstep and in real time: latency, misses, load of each node."""
    from multicontact_control.runs.graph.run import run_graph  # needs ROS
    from multicontact_control.runs.graph.spec import GraphSpec, START_ORDER

    setup, results = setup_of(duration), {}
    for mode in ('lockstep', 'real_time'):
        spent = []  # times of the wall and the nodes [s], a few times a second

        def look(_progress, spent=spent):
            now = {'wall': 1e-9 * perf_counter_ns()}
            for process in psutil.Process().children(recursive=True):
                command = ' '.join(process.cmdline()).split()[
                    :3
                ]  # NODE, or python -m MODULE
                now |= {
                    x: sum(process.cpu_times()[:2])
                    for x in START_ORDER
                    if any(word.endswith(x) for word in command)
                }
            spent.append(now)

        with TemporaryDirectory() as folder:
            out = Path(folder)
            sim = run_graph(
                GraphSpec(
                    out=out,
                    ticks=setup.ticks,
                    rate=RATE,
                    free_running=mode == 'real_time',
                    reference_file=out / 'config/reference.yaml',
                    parameter_files=setup.write(out / 'config'),
                ),
                look,
            ).timing['sim_node']
        first, last = spent[0], spent[-1]
        results[mode] = {
            'realtime_factor': duration / sim['wall_s'],
            **{name: sim[name] for name in ('latency_us', 'deadline_misses', 'ticks')},
            'cores': {
                name: (last[name] - first[name]) / (last['wall'] - first['wall'])
                for name in START_ORDER
                if name in first and name in last
            },
        }
    return results


def bench_tsid(python, law):
    """Return TSID's times on the samples beside the `law`'s; RuntimeError if it cannot be run."""
    setup = setup_of()
    config, data = setup.controller, run_in_process(setup).data
    with TemporaryDirectory() as folder:
        path = Path(folder) / 'problem.npz'
        np.savez(
            path,
            urdf=str((setup.urdf_dir / config.robot.urdf).resolve()),
            frame=config.robot.operational_frame,
            torque_limit=config.torque_limit,
            tips=[setup.plant.surfaces[name].tip_link for name in config.contact_names],
            normals=[
                config.contacts[name].normal_world for name in config.contact_names
            ],
            q=data.q,
            qd=data.qd,
        )
        script = Path(__file__).with_name('tsid_tick.py')
        done = subprocess.run(
            [python, '-I', script, path], capture_output=True, text=True
        )
    if done.returncode:
        raise RuntimeError(done.stderr.rpartition('\n')[0].rpartition('\n')[2])
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
    count, result = options.ticks, {}
    ensure_compiled()
    settle_process()
    graph = [('graph', lambda: bench_graph(options.seconds))] if options.seconds else []
    for name, measure in (
        ('bare tick', lambda: bench_tick(count, supervised=False)),
        ('supervised tick', lambda: bench_tick(count, supervised=True)),
        ('law alone', lambda: bench_tick(count, supervised=False, estimated=False)),
        ('plant', lambda: bench_plant(min(count, 5000))),
        ('contacts', lambda: bench_contacts(max(200, count // 10))),
        *graph,
        ('law over TSID', lambda: bench_tsid(options.tsid_python, result['law alone'])),
    ):
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
    """Print the figures [us], and those of the graph."""
    print(
        pd.DataFrame(
            [
                {
                    'part': name,
                    'p50': part['us']['p50'],
                    'p99': part['us']['p99'],
                    'floor p50': part['floor_us']['p50'],
                    'ratio': part['ratio'],
                    'noisy': part['noisy'],
                }
                for name, part in result.items()
                if 'us' in part
            ]
        )
        .round(2)
        .to_string(index=False)
    )
    print('law, 1 to 6 contacts:', *(f'{x:.0f}' for x in result['contacts'].values()))
    if graph := result.get('graph'):
        print(
            pd.json_normalize(list(graph.values())).set_axis(list(graph)).T.to_string()
        )


if __name__ == '__main__':
    sys.exit(main())
