"""The control law's tick beside TSID's, which runs in a process and an environment of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
import json
from pathlib import Path
import subprocess
from tempfile import TemporaryDirectory
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.errors import RunError
from multicontact_control.experiment.bench.tick import Replay
from multicontact_control.experiment.bench.timing import median, rounded_percentiles, spread
from multicontact_control.experiment.scenario import resolve, Setup
import numpy as np

SCRIPT = Path(__file__).with_name('tsid_tick.py')
ENVIRONMENT = (
    'python3 -m venv tsid && tsid/bin/pip install tsid==1.7.1 pin==3.4.0 "cmeel-urdfdom<5" '
    '"cmeel-tinyxml2<11", then --tsid-python tsid/bin/python')
FEWEST_LAPS = 5

Answer = dict[str, Any]


class TsidMissing(RunError):
    """There is no TSID in an environment."""


def bench_tsid(python: str, ticks: int) -> tuple[dict[str, Any] | None, str]:
    """
    Time the control law and TSID on the same samples, a lap of each in turn.

    Parameters
    ----------
    python
        Python in whose environment TSID is.
    ticks
        How many of either, rounded up to whole laps through the scenario.

    Returns
    -------
    dict or None
        Times and their ratio; None if TSID is not there.
    str
        Why, then, and how to get it.

    Raises
    ------
    RunError
        If TSID ends before it is done.

    """
    setup = resolve('quick', plant='rigid', seed=0, duration=None)
    with TemporaryDirectory() as folder:
        try:
            replay = Replay(setup, supervised=False)
            path = Path(folder) / 'problem.npz'
            _write_problem(path, setup, replay)
            with _script(python, path) as (problem, theirs):
                laps = max(FEWEST_LAPS, -(-ticks // len(replay.samples)))
                timed = [(replay.time_law(), theirs()) for _ in range(1 + laps)]
                return compare(problem, timed[1:]), ''  # the first was to warm up
        except TsidMissing as error:
            return None, f'tsid: not found, {error}; {ENVIRONMENT}'


def compare(
    problem: Answer, laps: Sequence[tuple[tuple[Vector, Vector], Answer]],
) -> dict[str, Any]:
    """
    Put laps of ours and of TSID's side by side.

    Parameters
    ----------
    problem
        What the script says of its problem.
    laps
        Times of the law and of its floor [us], and what the script says of the same lap.

    """
    times = {
        'law_us': [law for (law, _), _ in laps],
        'dynamics_us': [floor for (_, floor), _ in laps],
        'tsid_us': [np.array(theirs['tick_us']) for _, theirs in laps],
        'tsid_dynamics_us': [np.array(theirs['dynamics_us']) for _, theirs in laps]}
    ratios = [float(np.median(law) / np.median(tick))
              for law, tick in zip(times['law_us'], times['tsid_us'])]
    return {
        **{name: rounded_percentiles(np.concatenate(values)) for name, values in times.items()},
        'ratio': median(ratios), 'ratio_spread': spread(ratios), 'laps': len(laps),
        'unsolved': sum(theirs['unsolved'] for _, theirs in laps), 'problem': problem}


def _write_problem(path: Path, setup: Setup, replay: Replay) -> None:
    """Write what the script needs to know."""
    config, names = setup.controller, setup.controller.contact_names
    np.savez(
        path, urdf=str((setup.urdf_dir / config.robot.urdf).resolve()),
        frame=config.robot.operational_frame,
        tips=[setup.plant.surfaces[name].tip_link for name in names],
        normals=[config.contacts[name].normal_world for name in names],
        torque_limit=config.torque_limit,
        q=[sample.q for sample in replay.samples], qd=[sample.qd for sample in replay.samples])


@contextmanager
def _script(python: str, path: Path) -> Iterator[tuple[Answer, Callable[[], Answer]]]:
    """Run the script; yield what it says of its problem, and what lets it take a lap."""
    errors = path.with_suffix('.txt')
    with errors.open('w', encoding='utf-8') as stderr:
        try:
            process = subprocess.Popen(
                [python, '-I', str(SCRIPT), str(path)], stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=stderr, text=True)
        except OSError as error:
            raise TsidMissing(f"'{python}': {error.strerror}") from None
    lines: Any = process.stdout

    def last_words() -> str:
        return (errors.read_text(encoding='utf-8').splitlines() or ['it said nothing'])[-1]

    def lap() -> Answer:
        print(file=process.stdin, flush=True)
        answer = next_answer(lines)
        if answer is None:
            raise RunError(f"TSID's tick: expected the times of a lap, found {last_words()}")
        return answer

    with process:
        problem = next_answer(lines)
        if problem is None:
            raise TsidMissing(last_words())
        yield problem, lap


def next_answer(lines: Iterable[str]) -> Answer | None:
    """Return the next JSON object among what else is printed, None at the end."""
    for line in lines:
        if line.startswith('{'):
            answer: Answer = json.loads(line)
            return answer
    return None
