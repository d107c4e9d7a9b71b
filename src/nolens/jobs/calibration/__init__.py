"""Jobs of `nolens calibrate`."""
