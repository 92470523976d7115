"""When a contact counts as found, held or lost."""

from __future__ import annotations

from multicontact_control.config.base import Config, parameter, Real
from multicontact_control.errors import ConfigError
from pydantic import model_validator


class ContactStateConfig(Config):
    """When a contact counts as made, held or lost, and how it is looked for."""

    approach_speed: Real = parameter(
        0.02, 'Largest speed along a normal towards a surface that is not felt; what a scenario '
        'says of its approach goes before.', unit='m/s', gt=0.0, le=0.25)
    approach_ramp_time: Real = parameter(
        0.5, 'Time to reach that speed.', unit='s', gt=0.0, le=10.0)
    approach_distance: Real = parameter(
        0.1, 'A surface not met over this distance is given up.', unit='m', gt=0.0, le=2.0)
    search_distance: Real = parameter(
        0.01, 'A lost surface not met this far beyond where it was is given up.', unit='m',
        gt=0.0, le=0.5)
    contact_threshold: Real = parameter(
        1.5, 'Measured force that counts as touch.', unit='N', gt=0.0, le=100.0)
    release_threshold: Real = parameter(
        0.5, 'Measured force below which a contact may be lost.', unit='N', ge=0.0, le=100.0)
    release_fraction: Real = parameter(
        0.3, 'The same relative to the force it was held with or is to have, whichever is less: '
        'a tool that falls after its surface reads its own inertia.', ge=0.0, lt=1.0)
    escape_speed: Real = parameter(
        0.1, 'Speed of the contact point into its surface that only a lost one reaches.',
        unit='m/s', gt=0.0, le=5.0)
    preload: Real = parameter(
        2.0, 'Desired force from touch until the contact holds.', unit='N', gt=0.0, le=100.0)
    force_rate: Real = parameter(
        100.0, 'Rise of the desired force of a contact that was lost, from touch on.',
        unit='N/s', gt=0.0, le=1e4)
    impact_time: Real = parameter(
        0.05, 'Least time in contact from touch to holding.', unit='s', ge=0.0, le=1.0)
    bounce_time: Real = parameter(
        0.01, 'The same as loss_time, between touch and holding.', unit='s', ge=0.0, le=1.0)
    loss_time: Real = parameter(
        0.004, 'Time below the release threshold until a contact is lost.', unit='s', ge=0.0,
        le=1.0)
    lost_time: Real = parameter(
        0.05, 'Least time from loss to a new approach.', unit='s', ge=0.0, le=10.0)
    braking: Real = parameter(
        5.0, 'Acceleration that brakes a tip that has lost its surface, or pulls it back.',
        unit='m/s^2', gt=0.0, le=50.0)
    force_ceiling: Real = parameter(
        60.0, 'Measured force at which a contact is left.', unit='N', gt=0.0, le=1000.0)
    retract_distance: Real = parameter(
        0.01, 'Way back from a surface that is left.', unit='m', gt=0.0, le=0.2)
    retract_speed: Real = parameter(
        0.05, 'Speed on that way.', unit='m/s', gt=0.0, le=0.25)
    blend_time: Real = parameter(
        0.003, 'Time constant by which a change of active contacts, or of the law, is blended.',
        unit='s', gt=0.0, le=1.0)
    energy_limit: Real = parameter(
        0.5, 'Energy a contact may take up beyond what it stores, within energy_memory.',
        unit='J', gt=0.0, le=100.0)
    energy_memory: Real = parameter(
        1.0, 'Time constant by which that energy is forgotten.', unit='s', gt=0.0, le=100.0)
    injected_damping: Real = parameter(
        0.0, 'Force per speed taken from the command while that limit is passed; 0 for none.',
        unit='N s/m', ge=0.0, le=1e4)

    @model_validator(mode='after')
    def _check_across_fields(self) -> ContactStateConfig:
        if not self.release_threshold < self.contact_threshold < self.force_ceiling:
            raise ConfigError(
                'contact_state.contact_threshold',
                f'above release_threshold {self.release_threshold:g} N and below force_ceiling '
                f'{self.force_ceiling:g} N', f'{self.contact_threshold:g} N')
        return self
