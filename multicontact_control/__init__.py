"""Multi-contact compliant motion control after Park, Cortesão and Khatib (ICRA 2004)."""

__version__ = '0.1.0'
