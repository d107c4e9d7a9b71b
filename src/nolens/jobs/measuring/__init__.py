"""Jobs of `nolens measure`."""
