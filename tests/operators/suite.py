"""What every linear operator must do: the checks, for any operator there is or will be.

`test_operators.py` has the table; a new operator is one more line there.
"""

from collections.abc import Callable
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from nolens.operators import LinearOperator

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Case:
    """One line of the table.

    Parameters
    ----------
    name
        Shown by pytest.
    make
        The operator for a dtype and a device.
    lead
        Axes in front of `domain_shape` and of `range_shape`: the channels, where it has some.
    dtypes
        Those that the operator supports.
    """

    name: str
    make: Callable[[torch.dtype, torch.device], LinearOperator]
    lead: tuple[int, ...] = ()
    dtypes: tuple[torch.dtype, ...] = (torch.float32, torch.float64)


@dataclass(frozen=True)
class Drawn:
    """An operator with random v of its domain and y of its range."""

    operator: LinearOperator
    v: Tensor
    y: Tensor


def draw(
    case: Case, dtype: torch.dtype, device: torch.device = CPU, batch: tuple[int, ...] = ()
) -> Drawn:
    generator = torch.Generator().manual_seed(7)
    operator = case.make(dtype, device)
    lead = (*batch, *case.lead)
    v = torch.randn((*lead, *operator.domain_shape), generator=generator, dtype=torch.float64)
    y = torch.randn((*lead, *operator.range_shape), generator=generator, dtype=torch.float64)
    return Drawn(operator, v.to(device, dtype), y.to(device, dtype))


def _close(got: Tensor, expected: Tensor, tolerance: float) -> None:
    torch.testing.assert_close(
        got, expected, rtol=0, atol=tolerance * float(expected.abs().max().clamp_min(1e-30))
    )


def tolerance_of(dtype: torch.dtype) -> float:
    return 1e-12 if dtype == torch.float64 else 1e-5


def check_adjoint(case: Case, dtype: torch.dtype, device: torch.device) -> None:
    """⟨A v, y⟩ = ⟨v, A* y⟩."""
    drawn = draw(case, dtype, device)
    image, back = drawn.operator(drawn.v).double(), drawn.operator.adjoint(drawn.y).double()
    assert image.shape == drawn.y.shape
    assert back.shape == drawn.v.shape
    assert float(image.norm()) > 0, "an operator that gives zero passes any test"
    left = float((image * drawn.y.double()).sum())
    right = float((drawn.v.double() * back).sum())
    size = float(image.norm() * drawn.y.double().norm())
    assert abs(left - right) <= tolerance_of(dtype) * size


def check_linear(case: Case, dtype: torch.dtype, device: torch.device) -> None:
    """A(2v − 3w) = 2Av − 3Aw, and the same of A*."""
    drawn = draw(case, dtype, device)
    for apply, v in ((drawn.operator, drawn.v), (drawn.operator.adjoint, drawn.y)):
        w = v.flip(-1).square()
        _close(apply(2 * v - 3 * w), 2 * apply(v) - 3 * apply(w), tolerance_of(dtype))
        assert not bool(apply(torch.zeros_like(v)).any())


def check_dtype_and_device(case: Case, dtype: torch.dtype, device: torch.device) -> None:
    """What goes in on one device in one precision comes out there and so, and is unchanged."""
    drawn = draw(case, dtype, device)
    for apply, v in ((drawn.operator, drawn.v), (drawn.operator.adjoint, drawn.y)):
        before = v.clone()
        out = apply(v)
        assert (out.dtype, out.device.type) == (dtype, device.type)
        assert torch.equal(v, before)


def check_batch(case: Case, dtype: torch.dtype, device: torch.device) -> None:
    """Leading axes are so many separate inputs."""
    drawn = draw(case, dtype, device, batch=(2, 3))
    for apply, v in ((drawn.operator, drawn.v), (drawn.operator.adjoint, drawn.y)):
        together = apply(v)
        assert together.shape[:2] == (2, 3)
        for i in range(2):
            for j in range(3):
                _close(together[i, j], apply(v[i, j].clone()), tolerance_of(dtype))


def check_memory_layout(case: Case, dtype: torch.dtype, device: torch.device) -> None:
    """Views with other strides give what contiguous tensors give."""
    drawn = draw(case, dtype, device)
    for apply, v in ((drawn.operator, drawn.v), (drawn.operator.adjoint, drawn.y)):
        view = v.transpose(-1, -2).contiguous().transpose(-1, -2)
        _close(apply(view), apply(v), tolerance_of(dtype))


def check_gradient(case: Case) -> None:
    """The gradient of ⟨A v, y⟩ is A* y and the other way; numeric gradients agree."""
    drawn = draw(case, torch.float64)
    for apply, back, v, y in (
        (drawn.operator, drawn.operator.adjoint, drawn.v, drawn.y),
        (drawn.operator.adjoint, drawn.operator, drawn.y, drawn.v),
    ):
        v.requires_grad_()
        (gradient,) = torch.autograd.grad((apply(v) * y.detach()).sum(), v)
        _close(gradient, back(y.detach()), 1e-12)
        assert torch.autograd.gradcheck(apply, (v,), fast_mode=True)
        assert torch.autograd.gradgradcheck(apply, (v,), fast_mode=True)


def check_wrong_shape(case: Case) -> None:
    """Both shapes, what it takes and what it got, are in the message."""
    drawn = draw(case, case.dtypes[0])
    operator = drawn.operator
    for apply, v, shape in (
        (operator, drawn.v, operator.domain_shape),
        (operator.adjoint, drawn.y, operator.range_shape),
    ):
        longer = (*v.shape[:-2], v.shape[-2] + 1, v.shape[-1])
        wider = (*v.shape[:-1], v.shape[-1] + 1)
        for wrong in (longer, wider, shape[1:]):
            with pytest.raises(ValueError) as caught:
                apply(v.new_zeros(wrong))
            assert str(tuple(shape)) in str(caught.value)
            assert str(tuple(wrong)) in str(caught.value)


EVERYWHERE = (
    check_adjoint,
    check_linear,
    check_dtype_and_device,
    check_batch,
    check_memory_layout,
)
"""Checks of a case in a dtype on a device."""

ONCE = (check_gradient, check_wrong_shape)
"""Checks of a case alone."""
