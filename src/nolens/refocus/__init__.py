"""Pictures at any depth from one measurement, and how far away things are."""
