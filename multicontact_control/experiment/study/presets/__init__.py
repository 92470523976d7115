"""What `multicontact` can study: one folder for each."""
