"""`multicontact map`: how wrong stiffness and delay may be."""
