"""The job of `nolens refocus`."""
