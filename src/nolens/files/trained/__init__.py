"""Weights of the priors that come with nolens, each with its card."""
