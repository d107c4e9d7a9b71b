"""The command line: thin wrappers around `nolens.jobs`."""
