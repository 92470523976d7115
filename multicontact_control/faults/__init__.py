"""Faults, what becomes of them, and whether that was safe."""
