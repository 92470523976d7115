"""What is said of designed force laws."""

import math

from multicontact_control.experiment.law_report import show_design
from multicontact_control.force.laws.design import DesignedLaw
from multicontact_control.force.laws.margins import Margins
import pytest


@pytest.mark.parametrize(('stiffest', 'words'), [
    (3.0, 'stable up to 3.00 times as stiff\n'), (math.inf, 'stable however stiff it is\n')])
def test_stiffest_surface_is_told_in_words(stiffest, words):
    margins = Margins(gain=2.0, phase=1.0, delay=0.01, crossover=30.0, softest=0.1,
                      stiffest=stiffest)
    assert words in show_design(DesignedLaw({}, 6000.0, margins, 0.05, math.inf, 0.1))
