"""Training of the priors that know pictures."""
