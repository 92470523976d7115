"""The robustness map, from its grid to its files."""

import io
import json

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.presets.robustness.study import (
    robustness_study,
    RobustnessStudy,
    stable_range,
)
from multicontact_control.experiment.study.study import run_study, StudyOptions
import pytest
from rich.console import Console


def test_quick_map_is_a_part_of_the_whole():
    whole, quick = robustness_study(), robustness_study(quick=True)
    assert len(quick.jobs()) == 2 * 8 * 4
    assert len(whole.jobs()) == 2 * 8 * 13 * 4
    assert set(quick.plants) < set(whole.plants)
    assert set(quick.estimators) < set(whole.estimators)
    assert robustness_study(('puma',), ('fixed',), quick=True).plants == ('puma',)


def test_bad_names_are_all_said():
    with pytest.raises(ConfigError, match="plant: .*'ur5'\nestimators: .*'kalman'"):
        robustness_study(('ur5',), ('kalman',)).check()


@pytest.mark.slow
def test_map_is_drawn_from_its_runs(tmp_path):
    study = RobustnessStudy(('rigid',), ('fixed',), (1.0, 20.0), (1,))
    shown = io.StringIO()
    content = run_study(study, StudyOptions(tmp_path, jobs=1), Console(file=shown, width=160))
    assert stable_range(content, 'rigid', 'fixed', 1) == (1.0, 1.0)
    assert all(JobCache(tmp_path).finished(point['key']) for point in content['points'])
    assert json.loads((tmp_path / 'robustness.json').read_text())['points'] == content['points']
    for name in ('robustness.png', 'robustness.html'):
        assert (tmp_path / name).stat().st_size > 10000
        assert f'/{name}' in shown.getvalue()
    assert '1 - 1' in shown.getvalue() and '>1 - 1<' in (tmp_path / 'robustness.html').read_text()
