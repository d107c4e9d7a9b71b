"""Figures as JSON has them."""

from typing import Any


def rounded(value: Any, digits: int = 6) -> Any:
    """Some digits of every number, keys as text."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    if isinstance(value, dict):
        return {str(key): rounded(each, digits) for key, each in value.items()}
    return [rounded(each, digits) for each in value] if isinstance(value, list | tuple) else value
