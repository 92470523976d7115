"""`multicontact compare --laws`: force laws raced in everything that a contact may meet."""
