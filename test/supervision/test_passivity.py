"""The passivity observer: silent for springs and dampers, awake for what feeds a bounce."""

from contact_machine import PassivityObserver
from multicontact_control.config import ContactStateConfig
import numpy as np
import pytest

H = 0.0005


def observe(alpha, speed, **config):
    observer = PassivityObserver(ContactStateConfig(**config), 6000.0, H)
    return observer, [observer.update(a, v) for a, v in zip(alpha, speed)]


def test_pressing_on_a_spring_and_letting_go_leaves_no_energy():
    t = np.arange(0.0, 0.2, H)
    depth = 2e-3 * np.sin(np.pi * t / 0.2)
    observer, damping = observe(6000.0 * depth, np.gradient(depth, H))
    assert abs(observer.energy) < 1e-4
    assert damping == [0.0] * len(damping)


def test_energy_is_the_heat_in_a_damper():
    """Find c v^2 over half a second, against the closed form with forgetting."""
    c, v = 100.0, 0.05
    observer, _ = observe([c * v] * 1000, [v] * 1000, energy_memory=1.0)
    stored = (c * v) ** 2 / (2 * 6000.0)
    assert observer.energy == pytest.approx(c * v * v * (1 - np.exp(-0.5)) - stored, rel=2e-2)


def test_growing_oscillation_passes_the_limit_and_is_damped():
    t = np.arange(0.0, 2.0, H)
    speed = 0.1 * np.sin(2 * np.pi * 20 * t)
    observer, damping = observe(15.0 + 300.0 * speed, speed, energy_share=490.0,
                                injected_damping=50.0)
    assert not observer.passive
    late = slice(-200, None)
    np.testing.assert_allclose(damping[late], 50.0 * speed[late])
