"""The wrist sensor: what hangs on it, what it reads of itself, and the test that proves it."""
