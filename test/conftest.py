"""Nothing compiles during a test: what is to be compiled is compiled before the first one."""

from multicontact_control.experiment.compilation import ensure_compiled


def pytest_sessionstart(session):
    """Compile; of several workers that start at once, one does."""
    ensure_compiled()
