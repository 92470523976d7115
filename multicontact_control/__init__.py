"""Multi-contact compliant motion control after Park, Cortesão and Khatib (ICRA 2004)."""

from importlib import import_module
import sys

__version__ = '0.1.0'

if 'gymnasium' in sys.modules:
    # `gymnasium.make('multicontact_control:MultiContact-v0')` imports this package to find it.
    import_module('multicontact_control.learning.registration')
