"""`nolens reproduce`: every figure of the paper that simulation can give, beside the paper's."""

from nolens.reproduction.job import ReproduceOptions, reproduce

__all__ = ["ReproduceOptions", "reproduce"]
