"""The content of ``summary.json``: made of a run, and read back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.files import read_json_file, replace_nonfinite_numbers
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.run_folders import SUMMARY_FILE
from multicontact_control.judging.supervisor_events import count_losses, LogLine
from multicontact_control.judging.verdict import judge_run, LOOP_IS_STABLE
from multicontact_control.runs.recording import describe_missing, Missing

SCHEMA = 1  # of the summary: the meaning of its keys


def summarise_run(
    run: RunMetrics,
    *,
    mode: str,
    timing: Mapping[str, Any],
    ended_early: str = '',
    events: Sequence[LogLine] | None = None,
    remarks: Sequence[str] = (),
) -> dict[str, Any]:
    """
    Return the content of ``summary.json`` (schema 1).

    Parameters
    ----------
    run
        The run with its metrics, and with what its recording lacks.
    mode
        How it was made, one of `run_modes`.
    timing
        What is known of ticks, latencies and lost messages.
    ended_early
        Why it ended before its time, as for `judge_run`.
    events
        Times [s] at which the supervisor changed, and to what; None without a supervisor.
    remarks
        What else was wrong with the recording.

    """
    data = run.data
    setup = run.setup
    # What the supervisor did after the run is not part of it.
    end = data.ticks / data.rate
    during = [(time, line) for time, line in events or () if time < end]
    verdict = judge_run(run, mode=mode, ended_early=ended_early, events=during)
    contacts = {contact.name: contact.summarise() for contact in run.contacts}
    if events is not None:
        for name, losses in count_losses(run, during).items():
            contacts[name]['controller_losses'] = losses
    all_remarks = [*_list_bounded_variances(run), *remarks]
    if run.missing:
        all_remarks.insert(0, describe_missing(run.missing))
    missing = [{'from_s': begin, 'to_s': end} for begin, end in run.missing]
    return {
        'schema': SCHEMA,
        'scenario': setup.scenario.name,
        'plant': setup.plant_name,
        'noise_estimator': setup.noise_estimator.estimator,
        'mode': mode,
        'seed': setup.seed,
        'ticks': data.ticks,
        'rate_hz': data.rate,
        'trajectory_sha256': data.trajectory_sha256(),
        'timing': timing,
        'contacts': contacts,
        'motion': run.summarise_motion(),
        'torque': run.summarise_torque(),
        'stable': LOOP_IS_STABLE.get(verdict.name),
        'verdict': verdict.name,
        'judged': verdict.judged,
        'quality': verdict.quality,
        'unjudged': verdict.unjudged or None,
        'instabilities': list(verdict.reasons),
        'unstable_at_s': verdict.unstable_at,
        'ended_early': ended_early or None,
        'claims': [],
        'without_truth': run.list_without_truth(),
        'missing': replace_nonfinite_numbers(missing),
        'remarks': all_remarks,
        'commanded_by_topic': setup.commanded_by_topic,
        'supervised': events is not None,
        'events': [{'time_s': round(time, 6), 'what': line} for time, line in during],
    }


def _list_bounded_variances(run: RunMetrics) -> Iterator[str]:
    """Yield a remark for each contact whose R was at a bound, and how often."""
    bounds = run.setup.controller.noise_variance
    for contact in run.contacts:
        variance = contact.noise_variance
        at_smallest = variance <= bounds.smallest
        at_largest = variance >= bounds.largest
        for bound, reached in (('smallest', at_smallest), ('largest', at_largest)):
            if reached.any():
                yield (
                    f'{contact.name}: R is the {bound} that it may be, '
                    f'{getattr(bounds, bound):g} N^2 (noise_variance.{bound}), in '
                    f'{100.0 * reached.mean():.2g} % of the samples'
                )


def list_missing(summary: Mapping[str, Any]) -> list[Missing]:
    """Return what the recording of a run has lacked from the beginning, by its summary."""
    return [
        Missing(each['from_s'], each['to_s']) for each in summary.get('missing', ())
    ]


def read_summary(folder: Path) -> dict[str, Any]:
    """Return the ``summary.json`` of a folder; ConfigError if it is missing or of another kind."""
    path = folder / SUMMARY_FILE
    if not path.is_file():
        raise ConfigError(
            str(folder),
            f'a run with {SUMMARY_FILE}',
            'one without, which did not come to its end',
            hint='`multicontact report` reads what was recorded',
        )
    summary = read_json_file(path)
    if not isinstance(summary, dict) or summary.get('schema') != SCHEMA:
        raise ConfigError(str(path), f'the summary of a run (schema {SCHEMA})')
    return summary
