"""Designing a camera: how thick the resin, how far off it may be, which mask."""
