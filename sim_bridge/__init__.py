"""The plant: a simulated arm with its drives, wrist sensor and contacts."""

# Says how to install pinocchio, which many modules here import, where it is missing.
import multicontact_control.dynamics.robot  # noqa: F401
