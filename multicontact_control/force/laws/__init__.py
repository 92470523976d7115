"""The designs of the force laws, one file each; `multicontact_control.registry` names them."""
