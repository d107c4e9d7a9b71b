"""Figures as JSON has them."""

from typing import Any


def rounded(value: Any) -> Any:
    """Six digits of every number, keys as text."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {str(key): rounded(each) for key, each in value.items()}
    return [rounded(each) for each in value] if isinstance(value, list | tuple) else value
