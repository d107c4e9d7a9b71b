"""Jobs of `nolens design`."""
