"""The wrist sensor's front end: identification, tare, health, low-pass, push test."""
