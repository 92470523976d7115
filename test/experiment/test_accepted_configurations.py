"""A configuration that is accepted is safe, whatever its numbers make of the control."""

from annotated_types import Ge, Gt, Le, Lt
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from multicontact_control.config import ControllerConfig
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
import numpy as np
import pytest

SECTIONS = ('motion', 'force', 'contact_state', 'watchdog', 'limits', 'transition', 'friction')
FACTOR = 30.0  # times the default, either way, as far as the bounds allow
TICKS = 700


def values(field):
    """Return values of a parameter: near its default on a logarithmic scale, and its bounds."""
    default = field.default
    if isinstance(default, bool) or not isinstance(default, (int, float)):
        return None
    least = max((limit.ge if isinstance(limit, Ge) else limit.gt for limit in field.metadata
                 if isinstance(limit, (Ge, Gt))), default=-np.inf)
    largest = min((limit.le if isinstance(limit, Le) else limit.lt for limit in field.metadata
                   if isinstance(limit, (Le, Lt))), default=np.inf)
    low, high = max(least, default / FACTOR), min(largest, default * FACTOR)
    if not 0.0 < low < high:
        return None
    drawn = st.floats(np.log(low), np.log(high)).map(np.exp).map(
        lambda x: float(min(max(x, low), high)))
    return drawn.map(round) if isinstance(default, int) else drawn


PARAMETERS = {
    (section, name): strategy for section in SECTIONS
    for name, field in type(ControllerConfig.model_fields[section].default).model_fields.items()
    if (strategy := values(field)) is not None}


@pytest.mark.slow
@settings(max_examples=15, deadline=None, derandomize=True,
          suppress_health_check=list(HealthCheck))
@given(chosen=st.lists(st.sampled_from(sorted(PARAMETERS)), min_size=1, max_size=6, unique=True),
       data=st.data(), plant=st.sampled_from(['rigid', 'puma']))
def test_accepted_configuration_is_safe(chosen, data, plant):
    """Torques and their rates within limits, and no force beyond the ceiling for 0.1 s."""
    changes = {}
    for section, name in chosen:
        changes.setdefault(section, {})[name] = data.draw(PARAMETERS[section, name])
    try:
        loop = ClosedLoop(resolve('quick', plant=plant, controller=changes), commanded=True)
    except ConfigError:
        return
    config = loop.setup.controller
    limit = np.array(config.torque_limit)
    step = np.array(config.limits.torque_rate) * config.period
    ceiling = 1.25 * config.contact_state.force_ceiling
    above, last = 0, None
    loop.advance()
    loop.control.set_forces(dict.fromkeys(
        config.contact_names, max(10.0, config.contact_state.smallest_force)))
    for _ in range(TICKS):
        loop.advance()
        torque = loop.command
        assert np.isfinite(torque).all()
        assert (np.abs(torque) <= limit * (1.0 + 1e-9)).all()
        assert last is None or (np.abs(torque - last) <= step * (1.0 + 1e-9)).all()
        last = torque.copy()
        above = above + 1 if loop.sample.contact_force.max() > ceiling else 0
        assert above <= 50, loop.sample.contact_force
    loop.close()
