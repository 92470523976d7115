"""What the noise of the wrist sensor leaves of the contact forces that are found from it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.contact.wrench import CONTACT_SPACE, measure_contacts
from multicontact_control.errors import ConfigError
from multicontact_control.records import Contact, Control, Frame, Records
import numpy as np
from scipy.spatial.transform import Rotation

# A touch is one reading beyond its threshold: by chance one in 30 000 is 4 deviations off.
SPREAD = 4.0
# Where the tool may be turned, evenly: axes along those of the world first, as most tools are.
# Those of cube and icosahedron.
TURNS = np.concatenate([Rotation.create_group(name).as_matrix() for name in ('O', 'I')])


class Resolution(NamedTuple):
    """How well a column of N is told from the others: its noise against a parameter."""

    name: str
    noise: float  # standard deviation of its force or couple [N]
    bound: float  # what `SPREAD` times that must be below [N]
    field: str  # the parameter that the bound is

    @property
    def suffices(self) -> bool:
        """Whether its noise says nothing by chance."""
        return SPREAD * self.noise <= self.bound

    def __str__(self) -> str:
        """Return name and noise, as a message lists them."""
        return f'{self.name} {self.noise:.3g} N'


def force_noise(
    controls: Records[Control],
    contacts: Records[Contact],
    readings: Vector,
) -> Vector:
    """
    Return the standard deviation of every force and couple by the sensor's noise, (r,) [N].

    By `measure_contacts` itself, of the readings that one standard deviation of each axis of the
    sensor alone is, since the forces are linear in them.

    Parameters
    ----------
    controls, contacts
        One record of `CONTROL` and records of `CONTACT`, shape (r,), of the arm where it is.
    readings
        Standard deviation of each axis of the sensor, force first, shape (6,) [N, N m].

    """
    controls = controls.copy()
    contacts = contacts.copy()
    controls['tool'] = 0
    controls['frame']['twist'] = 0.0
    variances = np.zeros(len(contacts))
    space = np.zeros(1, dtype=CONTACT_SPACE)
    for axis, deviation in enumerate(readings):
        controls['wrench'] = deviation * (np.arange(6) == axis)
        if not measure_contacts(controls[0], contacts, space[0]):
            return np.full(len(contacts), np.inf)
        variances += contacts['alpha_meas'] ** 2
    return np.sqrt(variances)


def resolutions(
    config: ControllerConfig,
    controls: Records[Control],
    contacts: Records[Contact],
) -> tuple[Resolution, ...]:
    """
    Return how well the contacts are told apart where the arm is; see `force_noise`.

    A force must not seem to be a touch by chance, a couple not to lift an end of its contact.
    """
    sensor = config.sensor
    readings = np.repeat([sensor.force_noise_std, sensor.torque_noise_std], 3)
    noise = force_noise(controls, contacts, sensor.noise_share(config.rate) * readings)
    found = []
    for column, deviation in zip(config.columns, noise.tolist()):
        field = 'smallest_force' if column.half_length else 'contact_threshold'
        bound = getattr(config.contact_state, field)
        found.append(
            Resolution(column.name, deviation, bound, f'contact_state.{field}')
        )
    return tuple(found)


def check_resolution(
    config: ControllerConfig,
    controls: Records[Control],
    contacts: Records[Contact],
) -> tuple[Resolution, ...]:
    """
    Refuse contacts whose forces are lost in the sensor's noise however the tool is turned.

    Returns `resolutions` at the first orientation of the tool where all of them suffice.

    Raises
    ------
    ConfigError
        With the standard deviations at the best orientation.

    """
    best: tuple[Resolution, ...] = ()
    turned = controls.copy()
    frame = turned['frame'][0]
    lever = frame['sensor_position'] - frame['position']
    before = frame['rotation'].copy()
    least = np.inf
    for turn in TURNS:
        _turn_tool(frame, turn, before.T @ lever)
        found = resolutions(config, turned, contacts)
        if all(each.suffices for each in found):
            return found
        worst = max(each.noise / each.bound for each in found)
        if worst < least or not best:
            least = worst
            best = found
    raise ConfigError.combine(_too_noisy(best))


def _turn_tool(frame: Records[Frame], turn: Matrix, lever: Vector) -> None:
    """Turn a record of `FRAME`; the lever from its origin to the sensor is in its axes [m]."""
    frame['rotation'] = turn
    frame['sensor_rotation'] = turn  # as good as any: the axes are equally noisy
    frame['sensor_position'] = frame['position'] + turn @ lever


def _too_noisy(found: Sequence[Resolution]) -> Iterator[ConfigError]:
    """Yield an error for each parameter whose bound the noise of some column passes."""
    for field in dict.fromkeys(each.field for each in found):
        lost = [each for each in found if each.field == field and not each.suffices]
        if lost:
            yield ConfigError(
                'contacts',
                f'forces whose noise is at most {lost[0].bound / SPREAD:.3g} N, '
                f'1/{SPREAD:g} of {field}',
                ', '.join(map(str, lost)),
                hint='place the contacts farther apart, or with other normals; the noise is that '
                'of sensor.force_noise_std and sensor.torque_noise_std',
            )
