"""
Learn how hard to press while wiping a table of unknown friction and tilt, without a neural network.

``python examples/learn_to_wipe.py curve.png`` searches the five numbers of a linear policy by the
cross-entropy method, and draws how it learns, beside the best force that never changes.
"""

from functools import cache
from pathlib import Path
import sys

import gymnasium
from joblib import delayed, Parallel
import matplotlib.pyplot as plt
import numpy as np

ONE_CONTACT = ('controller', 'noise_estimator', 'plant')  # that know of the table alone
WORLD = {
    'scenario': 'one_contact',
    'plant': 'rigid',
    'settings': {f'{node}.contact_names': ['table'] for node in ONE_CONTACT},
    'randomise': {'plant.surfaces.table.friction': (0.1, 0.6)},
    'tilt': 0.1,  # rad
    'actions': ['force'],
    'rewards': {'rub': 1.0},
    'rate': 10.0,  # Hz
    'begin': 5.5,  # s, when the scenario begins to slide
    'duration': 4.0,  # s
}
STEPS = 40
TRAINING_WORLDS, HELD_OUT = 6, range(1000, 1024)  # seeds
CANDIDATES, BEST = 14, 4
CONSTANTS = np.linspace(-0.8, 0.8, 9)  # 3 to 27 N


@cache
def make_world() -> gymnasium.Env:
    """Return the environment of this process."""
    return gymnasium.make('multicontact_control:MultiContact-v0', **WORLD)


def try_policy(policy: np.ndarray, seed: int) -> float:
    """Return the mean reward of a policy in one world."""
    env = make_world()
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
    return total / STEPS


def score(policies: np.ndarray, seeds: range) -> np.ndarray:
    """Return the rewards of policies in worlds, shape (policies, worlds)."""
    jobs = [delayed(try_policy)(policy, seed) for policy in policies for seed in seeds]
    return np.reshape(Parallel(n_jobs=2)(jobs), (len(policies), len(seeds)))


def main(picture: Path, generations: int = 12, held_out: range = HELD_OUT) -> None:
    """Learn, print mean and worst of the held-out worlds, and draw the learning curve."""
    random = np.random.default_rng(0)
    mean, spread = np.zeros(5), np.full(5, 0.5)
    curve = []
    for generation in range(generations):
        candidates = mean + spread * random.standard_normal((CANDIDATES, 5))
        first = generation * TRAINING_WORLDS
        rewards = score(candidates, range(first, first + TRAINING_WORLDS)).mean(axis=1)
        best = candidates[np.argsort(rewards)[-BEST:]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.02
        curve.append([rewards.mean(), rewards.max()])
    constants = score(np.outer(CONSTANTS, [1, 0, 0, 0, 0]), held_out)
    constant = constants[constants.mean(axis=1).argmax()]
    learnt = score(mean[np.newaxis], held_out)[0]
    for name, rewards in (('constant', constant), ('policy', learnt)):
        print(f'{name}: mean {rewards.mean():.3f}, worst {rewards.min():.3f}')
    lines = plt.plot(curve)
    plt.legend(lines, ['mean of a generation', 'its best'])
    plt.axhline(constant.mean(), color='black', linestyle=':')
    plt.xlabel('generation; dotted: the best constant force, in held-out worlds')
    plt.ylabel('reward')
    plt.savefig(picture)


if __name__ == '__main__':
    main(Path(sys.argv[1]))
