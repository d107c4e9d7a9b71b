"""`nolens train`."""
