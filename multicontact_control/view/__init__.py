"""See and steer the controller on a page in the browser."""
