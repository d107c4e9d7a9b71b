"""A package that adds to nolens: what docs/extending.md shows."""
