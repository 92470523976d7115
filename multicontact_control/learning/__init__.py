"""Learning from the arm, and by it."""
