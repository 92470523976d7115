"""
How fast the environment for learning is, where its time goes, and what coarser steps cost.

``python benchmarks/bench_learning.py`` prints tables. Rates are per second of processor time on
one core, and per second of the wall over all cores.
"""

import argparse
import os
from pathlib import Path
import sys
from time import perf_counter, process_time

from distributed import Client, LocalCluster
import gymnasium
from gymnasium.vector import AsyncVectorEnv
from multicontact_control.files import replace_json_file
from multicontact_control.learning.registration import ENVIRONMENT_NAME
from multicontact_control.process import settle_process
from multicontact_control.runs.compilation import ensure_compiled
import numpy as np
import pandas as pd

PLANTS = ('rigid', 'puma')
ENGINES = ('pybullet', 'mujoco')
SUBSTEPS = (1.25e-4, 2.5e-4, 5e-4, 1e-3, 2e-3)  # s, the first one is the reference
SLIDING = {'actions': ['force'], 'begin': 6.5, 'duration': 8.0}
PRESSURE = -1.0 / 3.0  # the action of 10 N
TEN_NEWTONS = {'time': 0.0, 'forces': {'table': 10.0, 'board': 10.0}}
FORCE_ERROR = 10.0  # N, that a reward of force of -1 means
WARM_UP = 20  # steps


def make_env(**options):
    """Return an environment that slides on two surfaces, without gymnasium's checks."""
    env = gymnasium.make(ENVIRONMENT_NAME, **{**SLIDING, **options})
    return env.unwrapped


def rest(env):
    """Return the action that presses with 10 N everywhere, and moves nothing besides."""
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    for place, name in enumerate(env.action_names):
        if name.startswith('force'):
            action[place] = PRESSURE
    return action


def take_steps(env, count):
    """Take steps, over as many episodes as they fill; return the processor time [s]."""
    action = rest(env)
    spent = 0.0
    ended = True
    for _ in range(count):
        if ended:
            env.reset(seed=0)
        start = process_time()
        _, _, terminated, truncated, _ = env.step(action)
        spent += process_time() - start
        ended = terminated or truncated
    return spent


def bench_core(plant, count):
    """Return steps per second of one core, and the shares of its time."""
    env = make_env(plant=plant, actions=['force', 'motion'])
    take_steps(env, WARM_UP)
    rate = count / take_steps(env, count)
    env.reset(seed=0)
    times = {'controller': 0.0, 'engine': 0.0}
    loop = env.loop

    def advance():
        begin = process_time()
        output = loop.answer()
        answered = process_time()
        loop.act()
        times['controller'] += answered - begin
        times['engine'] += process_time() - answered
        return output

    loop.advance = advance
    action = rest(env)
    begin = process_time()
    for _ in range(min(count, 300)):
        env.step(action)
    whole = process_time() - begin
    start = process_time()
    env.reset(seed=0)
    reset = process_time() - start
    env.close()
    shares = {name: time / whole for name, time in times.items()}
    shares['commands and observation'] = 1.0 - sum(shares.values())
    return {'steps/s': rate, 'reset s': reset, **shares}


def bench_vector(plant, count, cores):
    """Return steps per second of the wall, of one environment in a process on each core."""
    envs = AsyncVectorEnv([lambda: make_env(plant=plant)] * cores)
    envs.reset(seed=list(range(cores)))
    actions = np.full(envs.action_space.shape, PRESSURE, dtype=np.float32)
    for _ in range(WARM_UP):
        envs.step(actions)
    begin = perf_counter()
    for _ in range(count):
        envs.step(actions)
    wall = perf_counter() - begin
    envs.close()
    return cores * count / wall


def collect_steps(plant, count, seed):
    """Take steps as a job of Dask, whose worker makes an environment of its own."""
    env = make_env(plant=plant)
    env.reset(seed=seed)
    action = rest(env)
    for _ in range(count):
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
    env.close()
    return count


def bench_dask(plant, count, cores):
    """Return steps per second of the wall, of jobs on a local cluster; resets are counted in."""
    with (
        LocalCluster(
            n_workers=cores, threads_per_worker=1, dashboard_address=None
        ) as of,
        Client(of) as client,
    ):
        warm = [
            client.submit(collect_steps, plant, WARM_UP, k, pure=False)
            for k in range(cores)
        ]
        client.gather(warm)
        begin = perf_counter()
        jobs = [
            client.submit(collect_steps, plant, count, k, pure=False)
            for k in range(cores)
        ]
        taken = sum(client.gather(jobs))
        return taken / (perf_counter() - begin)


def bench_substep(plant, engine, substep):
    """
    Return the mean force error of a slide [N] and steps per second of a setting of the engine.

    The error is that of `track_force`, of the same 10 N that are commanded.
    """
    settings = {
        'plant.substep': substep,
        'plant.engine': engine,
        'scenario.reference.force_steps': [TEN_NEWTONS],
    }
    env = make_env(plant=plant, settings=settings)
    env.reset(seed=0)
    action = rest(env)
    errors = []
    ended = False
    begin = process_time()
    while not ended:
        _, _, terminated, truncated, info = env.step(action)
        errors.append(-FORCE_ERROR * info['rewards']['track_force'])
        ended = terminated or truncated
    rate = len(errors) / (process_time() - begin)
    env.close()
    error = np.nan if terminated else float(np.mean(errors))
    return {'error N': error, 'steps/s': rate}


def bench_substeps(substeps):
    """Return the errors and rates of all settings, a row each."""
    rows = []
    for plant in PLANTS:
        for engine in ENGINES:
            for substep in substeps:
                measured = bench_substep(plant, engine, substep)
                setting = {
                    'plant': plant,
                    'engine': engine,
                    'substep ms': 1e3 * substep,
                }
                rows.append({**setting, **measured})
    return rows


def main(arguments=None):
    """Measure, print tables, write JSON if asked to; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        '--steps', type=int, default=1000, help='of each part (%(default)s)'
    )
    parser.add_argument(
        '--cores', type=int, default=os.cpu_count(), help='to use (%(default)s)'
    )
    parser.add_argument('--json', type=Path, help='write all numbers to this file')
    options = parser.parse_args(arguments)
    ensure_compiled()
    settle_process()
    rates = []
    for plant in PLANTS:
        row = {'plant': plant, **bench_core(plant, options.steps)}
        row['vector'] = bench_vector(plant, options.steps, options.cores)
        row['dask'] = bench_dask(plant, options.steps, options.cores)
        rates.append(row)
    print(f'steps of 20 ms on one core, and on {options.cores} by vector and Dask:')
    print(pd.DataFrame(rates).round(3).to_string(index=False))
    settings = bench_substeps(SUBSTEPS)
    print('force error while sliding, by the step of the engine:')
    print(pd.DataFrame(settings).round(3).to_string(index=False))
    if options.json:
        replace_json_file(options.json, {'rates': rates, 'settings': settings})
    return 0


if __name__ == '__main__':
    sys.exit(main())
