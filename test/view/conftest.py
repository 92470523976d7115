"""A recording to be replayed."""

from __future__ import annotations

from multicontact_control.experiment.results import CONFIG_FOLDER, SUMMARY_FILE
from multicontact_control.experiment.scenario import resolve
from multicontact_control.files import write_json
import pytest
from runs import run_of


@pytest.fixture(scope='session')
def recorded_run(tmp_path_factory):
    """Return the folder of a run of 15 s, with what a replay reads."""
    folder = tmp_path_factory.mktemp('run')
    setup = resolve('quick', plant='rigid')
    result = run_of(setup)
    setup.write(folder / CONFIG_FOLDER)
    result.data.save(folder)
    write_json(folder / SUMMARY_FILE, {
        'plant': 'rigid', 'seed': 0, 'events': [
            {'time_s': time, 'what': what} for time, what in result.events]})
    return folder
