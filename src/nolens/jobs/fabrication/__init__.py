"""The job of `nolens fabricate`."""
