"""What surrounds the control law: which inputs are valid, contacts, limits, reactions."""
