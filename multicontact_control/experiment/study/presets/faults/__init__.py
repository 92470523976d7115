"""`multicontact faults`: every kind of fault in every situation."""
