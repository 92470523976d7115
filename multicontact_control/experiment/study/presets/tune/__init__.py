"""`multicontact tune`: a force law's gains, by trying a declared grid of them."""
