"""Soaks: what they find, and that a quarter of an hour on each plant finds nothing."""

import io

from multicontact_control.errors import ConfigError
from multicontact_control.experiment import soak as soaking
from multicontact_control.experiment.faults.judge import MET_FORCE
from multicontact_control.experiment.faults.situation import with_obstacles
from multicontact_control.experiment.faults.vocabulary import SIDE_WALL
from multicontact_control.experiment.soak import PROBLEMS, Soak
from multicontact_control.experiment.study.presets.soak.study import (
    is_good,
    memory_growth,
    SoakStudy,
)
from multicontact_control.experiment.study.study import run_study, StudyOptions
from multicontact_control.experiment.study.table import terminal_table
import numpy as np
import pytest
from rich.console import Console


@pytest.fixture
def soak():
    soak = Soak(with_obstacles('quick', 'rigid', 0), 0)
    yield soak
    soak.close()


def test_half_a_minute_finds_nothing_and_does_something(soak):
    outcome = soak.run(30.0)
    assert outcome.simulated_s >= 30.0
    assert sum(outcome.episodes.values()) >= 5
    assert not outcome.counts
    assert (outcome.unsafe, outcome.alternating, outcome.oscillating, outcome.stuck) == (
        [], [], [], [])


def test_same_seed_same_soak():
    outcomes = []
    for _ in range(2):
        soak = Soak(with_obstacles('quick', 'rigid', 3), 3)
        outcomes.append(soak.run(10.0))
        soak.close()
    assert outcomes[0] == outcomes[1]


def test_surface_that_has_gone_is_reported_as_stuck(soak, monkeypatch):
    monkeypatch.setattr(soaking, 'SETTLE_TIME', 4.0)  # it is gone for good
    soak.run(1.0)
    soak._loop.plant.contacts.shift(0, 1.0)
    soak._wanted['table'] = 10.0
    soak._command_forces = lambda: soak._loop.control.set_forces(soak._wanted)
    soak._episode('forces')
    soak._settle()
    assert len(soak.outcome.stuck) == 1
    assert soak.outcome.helped == 4


def test_torque_beyond_its_limit_is_unsafe(soak, monkeypatch):
    monkeypatch.setattr(soak, '_limit', [1e-3 * limit for limit in soak._limit])
    soak._advance()
    assert 'beyond the limit' in soak.outcome.unsafe[0]


@pytest.mark.parametrize('pauses', [[3.0], [1.2] * 5])
def test_force_that_oscillates_about_its_command_is_reported(soak, pauses):
    """Its mean is the command: a stretch of 2 s is seen in one pause, and over some."""
    soak._command_forces()
    soak._settle()
    assert soak._wait(3.0, quiet=True)
    assert soak.outcome.oscillating == []
    calm = soak._quiet_squares[-1]
    contacts, advance = soak._loop.plant.contacts, soak._advance

    def shaken(faults=()):
        advance(faults)
        # The table swings by 0.3 mm, as fast as a limit cycle: too fast for the law to follow.
        time = soak._loop.tick * soak._period
        contacts.shift(0, 3e-4 * (np.sin(200.0 * time) - np.sin(200.0 * (time - soak._period))))
    soak._advance = shaken
    for pause in pauses:
        assert soak._wait(pause, quiet=True)  # by its mean all is as commanded
    assert soak.outcome.counts['oscillating'] == len(soak.outcome.oscillating) >= 1
    assert 'table at 32 Hz' in soak.outcome.oscillating[0]
    assert max(soak._quiet_squares) > max(0.3 ** 2, 4.0 * calm)
    assert not is_good({**vars(soak.outcome), 'minutes': []})


def test_obstacle_that_is_pressed_hard_is_unsafe_once(soak):
    """No contact is beyond its ceiling then: only what is in the way says so."""
    soak._command_forces()
    soak._settle()
    contacts = soak._loop.plant.contacts
    contacts.put_before_tip(SIDE_WALL, -0.03)
    for _ in range(3):
        soak._advance()
    assert soak._loop.obstacle_forces.max() > MET_FORCE
    assert len(soak.outcome.unsafe) == 1
    assert 'in the way' in soak.outcome.unsafe[0]


def test_leak_and_drift_are_no_good():
    def outcome(slope, last, rms=0.2):
        return {'counts': {}, 'minutes': [
            {'memory_mb': 100.0 + slope * k / 60.0, 'error_n': 0.1 if k < 40 else last,
             'error_rms_n': 0.2 if k < 40 else rms} for k in range(60)]}
    assert memory_growth(outcome(3.0, 0.1)['minutes']) == pytest.approx(3.0)
    assert is_good(outcome(1.0, 0.1))
    assert not is_good(outcome(3.0, 0.1))
    assert not is_good(outcome(0.0, 0.5))
    assert not is_good(outcome(0.0, 0.1, rms=0.5))
    assert not is_good({**outcome(0.0, 0.1), 'counts': {'stuck': 1}})


def test_terminal_of_80_columns_has_a_line_for_each_soak(tmp_path):
    """Its heads and numbers were split into pieces of four letters."""
    minutes = [{'memory_mb': 300.0 - k / 60.0, 'error_n': 0.1, 'error_rms_n': 0.2}
               for k in range(60)]
    soaks = [{'plant': plant, 'seed': 23, 'simulated_s': 86_400.0, 'helped': 12, 'counts': {},
              'episodes': {'faults': 23_456}, 'minutes': minutes,
              **dict.fromkeys(PROBLEMS, [])} for plant in ('rigid', 'puma')]
    (section,) = SoakStudy().page(soaks, tmp_path).sections
    text = io.StringIO()
    Console(file=text, width=80).print(terminal_table(section.heading, section.listing, 80))
    _, _, head, _, *lines = text.getvalue().strip().splitlines()
    assert [line.split() for line in lines] == [
        [plant, '23', '24.00', '23456', *['0'] * len(PROBLEMS), '-1.00', '0.100', 'yes']
        for plant in ('rigid', 'puma')]
    assert {'plant', 'unsafe', 'stuck', 'good'} <= set(head.split())


def test_options_that_are_not_acceptable_are_named():
    with pytest.raises(ConfigError, match='hours'):
        SoakStudy(hours=0.0).check()
    with pytest.raises(ConfigError, match='parts'):
        SoakStudy(parts=0).check()
    assert [job.plant for job in SoakStudy(hours=4.0, parts=2).jobs()] == [
        'rigid', 'puma', 'rigid', 'puma']


@pytest.mark.slow
def test_study_writes_its_files_and_finds_nothing(tmp_path):
    content = run_study(SoakStudy(hours=0.02), StudyOptions(tmp_path, jobs=2))
    assert all(map(is_good, content)), content
    assert (tmp_path / 'soak.html').is_file()
