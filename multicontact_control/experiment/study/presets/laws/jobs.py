"""What a force law is put to, and what is measured of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, TYPE_CHECKING

from multicontact_control.experiment.metrics import (
    disturbance_summary,
    force_error,
    step_responses,
    windows,
)
from multicontact_control.experiment.overrides import ARGUMENTS, overrides_of
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.results import summarise
from multicontact_control.experiment.scenario import resolve, Setup
from multicontact_control.experiment.study.jobs import content_key, JobResult, setup_content
from multicontact_control.experiment.study.measure import largest, largest_known, long_enough
from multicontact_control.files import finite
import numpy as np

if TYPE_CHECKING:
    from multicontact_control.experiment.closed_loop import ClosedLoop

TASK, VANISHING, STIFFNESS, DELAY, FRICTION = (
    'task', 'vanishing', 'stiffness', 'delay', 'friction')
DURATIONS = {TASK: 16.0, VANISHING: 7.0, STIFFNESS: 9.0, DELAY: 9.0, FRICTION: 9.0}  # s
GONE_FROM, GONE_FOR, GONE_BY = 5.2, 0.3, 0.05  # s, s, m: a surface that goes for a moment
MEAN_TIME = 0.012  # s, over which forces of a vanishing surface's neighbour are averaged


@dataclass(frozen=True)
class LawJob:
    """A force law in one situation."""

    preset: str  # name or path of the parameters that make it
    plant: str
    seed: int
    situation: str  # one of the above
    # True over modelled stiffness, delay of the actuator [periods], or joint friction over that
    # of the plant; 1 in the others.
    value: float = 1.0
    settings: tuple[tuple[str, Any], ...] = ()  # dotted names and values over the preset

    def setup(self) -> Setup:
        """Return everything the run needs, checked."""
        scenario = 'disturbance' if self.situation == TASK else 'quick'
        options: dict[str, Any] = {
            'plant': self.plant, 'seed': self.seed, 'preset': self.preset,
            'duration': DURATIONS[self.situation]}
        base = resolve(scenario, **options)
        if self.settings:
            options |= {ARGUMENTS[section]: values for section, values in overrides_of(
                dict(self.settings), base, 'settings').items()}
        return resolve(scenario, **options, plant_overrides=self._plant(base))

    def _plant(self, base: Setup) -> dict[str, Any]:
        if self.situation == STIFFNESS:
            return {'surfaces': {
                name: {'stiffness': self.value * base.controller.contacts[name].stiffness}
                for name in base.controller.contact_names}}
        if self.situation == DELAY:
            return {'actuator_delay_ticks': int(self.value)}
        if self.situation == FRICTION:
            return {'joint_friction_scale': self.value * base.plant.joint_friction_scale}
        return {}

    def key(self) -> str:
        """Return the hash of all that decides the outcome; see `Job.key`."""
        return content_key('law', {'situation': self.situation, **setup_content(self.setup())})

    def describe(self) -> dict[str, Any]:
        """Return what a reader of the result should know."""
        return {**asdict(self), 'settings': dict(self.settings)}


def run_law_job(job: LawJob) -> JobResult:
    """
    Run a job in this process and measure it.

    Returns
    -------
    JobResult
        `metrics`: whether the run was `stable` and, if not, `why`; and by contact what
        `_contact_metrics` returns; `activity_nm`, the rms change of the torque per period, of the
        joint with the largest; `neighbour_n`, how far means over 12 ms of the other force went
        off while a surface was away, None in the other situations.

    """
    from multicontact_control.experiment.closed_loop import run_in_process

    setup = job.setup()

    def disturb(loop: ClosedLoop) -> None:
        rate = setup.controller.rate
        last = len(setup.controller.contact_names) - 1
        if loop.tick == round(GONE_FROM * rate):
            loop.plant.contacts.shift(last, GONE_BY)
        elif loop.tick == round((GONE_FROM + GONE_FOR) * rate):
            loop.plant.contacts.shift(last, -GONE_BY)

    vanishing = job.situation == VANISHING
    result = long_enough(run_in_process(
        setup, supervised=True, disturb=disturb if vanishing else None), setup)
    data = result.data
    summary = summarise(data, setup, mode='in_process', timing={},
                        ended_early=result.ended_early, events=result.events)
    disturbances = disturbance_summary(data, setup, summary['unstable_at_s'])
    metrics = {
        'stable': summary['stable'], 'why': '; '.join(summary['instabilities']),
        'oscillates': any(contact['oscillation_s'] for contact in summary['contacts'].values()),
        'contacts': {name: _contact_metrics(data, setup, i, disturbances['contacts'][name])
                     for i, name in enumerate(data.contact_names)},
        'activity_nm': _activity(data, setup),
        'neighbour_n': _neighbour(data, setup) if vanishing else None}
    return JobResult(finite(metrics), {}, result.wall_time)


def _contact_metrics(
    data: RunData, setup: Setup, contact: int, disturbances: Mapping[str, Any],
) -> dict[str, Any]:
    """Return errors at rest and moving, answers to steps, and those to pushes at rest."""
    pushes = [push for push in disturbances['recoveries'] if not push['moving']]
    return {
        'rest_rms_n': disturbances['rest']['rms_n'],
        'moving_rms_n': disturbances['moving']['rms_n'],
        'steps': [{'rise_s': step.rise_63, 'overshoot_percent': step.overshoot_percent}
                  for step in step_responses(data, setup, contact)],
        'push_peak_n': largest_known(push['peak'] for push in pushes),
        'push_off_s': largest(push['recovery'] for push in pushes)}


def _activity(data: RunData, setup: Setup) -> float:
    judged = windows(setup.scenario.reference, data.time)
    window = judged.moving if judged.moving.any() else judged.loaded
    change = np.diff(data.torque, axis=0)[window[1:]]
    return float(np.sqrt((change * change).mean(axis=0)).max()) if len(change) else float('nan')


def _neighbour(data: RunData, setup: Setup) -> float:
    error = force_error(data, setup, 0)
    window = (data.time >= GONE_FROM) & (data.time < GONE_FROM + GONE_FOR + 1.0)
    count = round(MEAN_TIME * data.rate)
    if window.sum() < count:  # the run ended before
        return float('nan')
    means = np.convolve(error[window], np.full(count, 1.0 / count), 'valid')
    return float(np.abs(means).max())
