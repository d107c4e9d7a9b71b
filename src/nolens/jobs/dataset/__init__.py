"""`nolens dataset`."""
