"""Running, recording, judging and drawing experiments."""
