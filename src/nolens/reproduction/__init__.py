"""`nolens reproduce`: every figure of the paper that simulation can give, beside the paper's."""

from nolens.reproduction.job import ReproduceOutcome, reproduce
from nolens.reproduction.options import ReproduceOptions

__all__ = ["ReproduceOptions", "ReproduceOutcome", "reproduce"]
