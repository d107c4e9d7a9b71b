"""Jobs of `nolens batch`: one job for every item of a set."""
