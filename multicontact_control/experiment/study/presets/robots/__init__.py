"""Robots, engines and scenarios."""
