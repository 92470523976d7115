"""`multicontact compare`: every noise estimator on the disturbances of the paper."""
