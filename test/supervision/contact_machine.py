"""One contact by itself: the compiled state machine and passivity observer."""

import math

from multicontact_control.supervision import contacts
from multicontact_control.supervision.contacts import contact_settings, contact_states, STATES


class ContactMachine:

    def __init__(self, config, period, stiffness=math.inf):
        self._settings = contact_settings(config, period)
        self._states = contact_states([stiffness])
        self.config = config

    def __getattr__(self, name):
        return self._states[name][0].item()

    @property
    def state(self):
        return STATES[self._states['state'][0]]

    @property
    def again(self):
        return bool(self._states['again'][0])

    @again.setter
    def again(self, wanted):
        self._states['again'] = wanted

    @property
    def active(self):
        return contacts.is_active(self._states[0])

    def reset(self):
        contacts.reset(self._states)

    def let_go(self, place, speed=0.0):
        contacts.let_go(self._states[0], place, speed)

    def update(self, wanted, alpha, alpha_des, place, speed, escape=None):
        self._states['wanted'], self._states['asked'] = wanted, alpha_des
        contacts.advance_contact(self._states[0], self._settings[0], alpha, place, speed,
                                 speed if escape is None else escape)


class PassivityObserver(ContactMachine):

    def __init__(self, config, stiffness, period):
        super().__init__(config, period, stiffness)
        self._states['state'] = contacts.HOLDING

    @property
    def passive(self):
        return self.energy <= self.energy_limit

    def update(self, alpha, speed):
        return contacts.watch_energy(self._states[0], self._settings[0], alpha, speed)
