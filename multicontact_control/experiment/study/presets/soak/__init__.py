"""`multicontact soak`: hours of random commands and faults."""
