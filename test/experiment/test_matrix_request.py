import io

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.engine import cell_of
from multicontact_control.experiment.matrix_request import MatrixRequest
import pytest
from rich.console import Console

CELLS = [cell_of('step', 'rigid', 0, duration=1.0)]


def request(out, **changes):
    values = {'plants': (), 'estimators': (), 'jobs': 2, 'quick': False, 'out': out,
              'overwrite': False}
    return MatrixRequest(**{**values, **changes})


def test_matrix_begins_with_its_folder_and_how_long_it_takes(tmp_path):
    shown = io.StringIO()
    executor = request(tmp_path / 'out').begin(CELLS, Console(file=shown, width=120))
    assert executor.jobs == 2
    assert (tmp_path / 'out' / 'cells').is_dir()
    assert shown.getvalue().startswith('1 runs, 0 of them finished before; the other 1 will take')


def test_matrix_with_bad_options_is_refused_before_its_folder_is_made(tmp_path):
    with pytest.raises(ConfigError, match='jobs: expected a whole number >= 0, found -2'):
        request(tmp_path / 'out', jobs=-2).begin(CELLS, Console(quiet=True))
    assert not (tmp_path / 'out').exists()
