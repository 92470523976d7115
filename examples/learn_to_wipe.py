"""
Learn how hard to press while wiping a table of unknown friction and tilt, by a linear policy.

``python examples/learn_to_wipe.py curve.png`` searches it by the cross-entropy method.
"""

from pathlib import Path
import sys
from typing import Any

import gymnasium
from joblib import delayed, Parallel
import matplotlib.pyplot as plt
import numpy as np

NODES = ('controller', 'noise_estimator', 'plant')
WORLD: dict[str, Any] = {
    'scenario': 'one_contact',
    'plant': 'rigid',
    'settings': {f'{node}.contact_names': ['table'] for node in NODES},
    'randomise': {'plant.surfaces.table.friction': (0.1, 0.6)},
    'tilt': 0.1,  # rad
    'actions': ['force'],
    'rewards': {'rub': 1.0},
    'rate': 10.0,  # Hz
    'begin': 5.5,  # s, when the scenario begins to slide
    'duration': 4.0,  # s
}
HELD_OUT = range(1000, 1024)  # seeds
CANDIDATES, BEST, WORLDS = 12, 4, 4  # of a generation
CONSTANTS = np.linspace(-0.7, 0.3, 6)  # 4.5 to 19.5 N


def try_policy(policy: np.ndarray, seed: int) -> float:
    """Return the mean reward of a policy in one world."""
    env = gymnasium.make('multicontact_control:MultiContact-v0', **WORLD)
    seen, _ = env.reset(seed=seed)
    total, ended = 0.0, False
    while not ended:
        load = np.hypot(*seen['wrench'][:2]) / 4.0
        speed = np.linalg.norm(seen['twist'][:3]) / 0.1
        force = seen['force_measured'][0] / 10.0
        action = policy @ [1.0, force, load, speed, seen['action'][0]]
        seen, reward, lost, over, _ = env.step(np.array([action], dtype=np.float32))
        total += float(reward)
        ended = lost or over
    env.close()
    return total / (WORLD['rate'] * WORLD['duration'])


def score(policies: np.ndarray, seeds: range) -> np.ndarray:
    """Return the rewards of policies in worlds, shape (policies, worlds)."""
    jobs = [delayed(try_policy)(policy, seed) for policy in policies for seed in seeds]
    return np.reshape(Parallel(n_jobs=2)(jobs), (len(policies), len(seeds)))


def main(picture: Path, generations: int = 8, held_out: range = HELD_OUT) -> None:
    """Learn, print mean and worst of the held-out worlds, and draw the learning curve."""
    random = np.random.default_rng(0)
    mean, spread, curve = np.zeros(5), np.full(5, 0.5), []
    for generation in range(generations):
        policies = mean + spread * random.standard_normal((CANDIDATES, 5))
        seeds = range(generation * WORLDS, (generation + 1) * WORLDS)
        rewards = score(policies, seeds).mean(axis=1)
        best = policies[np.argsort(rewards)[-BEST:]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.02
        curve.append(score(mean[np.newaxis], held_out)[0])
    constant = max(score(np.outer(CONSTANTS, [1, 0, 0, 0, 0]), held_out), key=np.mean)
    found = {'policy': np.array(curve), 'constant': np.tile(constant, (len(curve), 1))}
    for name, rewards in found.items():
        print(f'{name}: mean {rewards[-1].mean():.3f}, worst {rewards[-1].min():.3f}')
        plt.plot(rewards.mean(axis=1), label=f'{name}, mean')
        plt.plot(rewards.min(axis=1), label=f'{name}, worst')
    plt.gca().set(xlabel='generation', ylabel='mean reward in held-out worlds')
    plt.legend()
    plt.savefig(picture)


if __name__ == '__main__':
    main(Path(sys.argv[1]))
