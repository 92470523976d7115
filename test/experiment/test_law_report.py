"""Parameter files of designed force laws."""

import math
import re
import shlex

from multicontact_control.cli.options import SetupOptions
from multicontact_control.experiment.law_report import (
    DesignedLaw,
    Margins,
    show_design,
    write_design,
)


def test_parameter_file_says_which_stiffness_it_goes_with(tmp_path):
    """A law knows no contacts, so their stiffness is not in it, but in a setting beside it."""
    margins = Margins(gain=2.0, phase=1.0, delay=0.01, crossover=30.0)
    found = DesignedLaw({'law': 'pi', 'input_delay': 0.004}, 3162.3, margins, 3.0, 0.05, math.inf)
    path = tmp_path / 'pi.yaml'
    write_design(found, path)
    for text in (show_design(found), path.read_text()):
        _, setting = shlex.split(re.search(r"--set '[^']+'", text)[0])
        config = SetupOptions(scenario='quick', preset=str(path), settings=[setting]).setup(
            ).controller
        assert (config.force.law, config.force.input_delay) == ('pi', 0.004)
        assert {config.contacts[name].stiffness for name in config.contact_names} == {3162.0}
