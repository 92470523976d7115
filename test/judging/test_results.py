"""Run folders: named, kept, replaced only when asked."""

from datetime import datetime
from pathlib import Path

from multicontact_control.errors import ConfigError
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.run_folders import open_run_folder, prepare_run_folder
from multicontact_control.judging.run_summary import summarise_run
from multicontact_control.runs.scenario import resolve
import pytest
from synthetic_run import perfect_run

NOW = datetime(2026, 1, 2, 3, 4, 5)


def test_run_that_latest_leads_to_is_overwritten_where_it_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runs = []
    for _ in range(3):
        with open_run_folder(None, 'paper', overwrite=False, now=NOW) as run:
            runs.append(run.name)
            (run / 'summary.json').write_text('{}')
    assert runs == [f'20260102-030405-paper{end}' for end in ('', '-2', '-3')]
    with (
        pytest.raises(KeyboardInterrupt),
        open_run_folder(None, 'paper', overwrite=False, now=NOW) as unfinished,
    ):
        (unfinished / 'config').mkdir()
        raise KeyboardInterrupt
    assert not unfinished.exists()
    scenario_file = run / 'config' / 'scenario.yaml'
    scenario_file.parent.mkdir()
    scenario_file.write_text('')
    latest = Path('runs/latest')
    with pytest.raises(ConfigError, match='--overwrite'):
        prepare_run_folder(latest, 'paper', overwrite=False, now=NOW)
    with open_run_folder(latest, 'paper', overwrite=True, now=NOW) as replaced:
        assert replaced == run.resolve() and list(run.iterdir()) == []
        (run / 'summary.json').write_text('{}')
    assert {path.name for path in Path('runs').iterdir()} == {*runs, 'latest'}
    assert latest.is_symlink() and latest.resolve() == run.resolve()
    with open_run_folder(
        Path('elsewhere/mine'), 'paper', overwrite=False, now=NOW
    ) as chosen:
        (chosen / 'summary.json').write_text('{}')
    assert latest.resolve() == chosen.resolve()


@pytest.mark.parametrize(
    'files',
    [
        ('thesis.tex',),
        ('config/controller.yaml',),
        ('config/scenario.yaml', '.git/HEAD'),
        ('config/scenario.yaml', 'summary.json', 'notes.md'),
    ],
)
def test_folder_with_other_files_is_never_touched(tmp_path, files):
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text('all of it')
    with pytest.raises(
        ConfigError, match='out: expected a new or empty folder, or that of a run'
    ):
        prepare_run_folder(tmp_path, 'paper', overwrite=True, now=NOW)
    assert all((tmp_path / name).is_file() for name in files)


def test_summary_says_how_often_a_variance_was_at_a_bound():
    setup = resolve('quick')
    data = perfect_run(setup)
    data.noise_variance[:] = 0.6
    summary = summarise_run(RunMetrics(data, setup), mode='in_process', timing={})
    assert summary['remarks'] == []
    data.noise_variance[: data.ticks // 4, 1] = 1000.0
    (remark,) = summarise_run(RunMetrics(data, setup), mode='in_process', timing={})[
        'remarks'
    ]
    assert remark == (
        'board: R is the largest that it may be, 1000 N^2 (noise_variance.largest), '
        'in 25 % of the samples'
    )
