"""Every operator, through the shared suite."""

import importlib
import math
import pkgutil
from collections.abc import Callable
from copy import copy

import numpy as np
import pytest
import torch
from suite import CPU, EVERYWHERE, ONCE, Case
from torch import Tensor

import nolens.operators
from nolens.calibrate.known_scenes import ManyScenes
from nolens.operators import (
    BlockDiagonal,
    Crop,
    CroppedConvolution,
    Diagonal,
    FieldConvolution,
    FiniteDifference,
    HorizontalStack,
    Identity,
    LinearOperator,
    PixelRectangle,
    SlowLightRemoval,
    StackConvolution,
    StackDifference,
    VerticalStack,
    slow_cosines,
)

Make = Callable[[torch.dtype, torch.device], LinearOperator]


def convolution(
    sensor: tuple[int, int],
    psf: tuple[int, int],
    support: tuple[int, int, int, int] | None = None,
    channels: int = 3,
) -> Make:
    cells = torch.rand((channels, *psf), generator=torch.Generator().manual_seed(1)).double()

    def make(dtype: torch.dtype, device: torch.device) -> LinearOperator:
        where = None if support is None else PixelRectangle(*support)
        return CroppedConvolution(cells.to(device, dtype), sensor, where)

    return make


def difference(*shape: int) -> Make:
    return lambda _dtype, _device: FiniteDifference(shape)


def diagonal(*shape: int) -> Make:
    weights = torch.rand(shape, generator=torch.Generator().manual_seed(4)).double() - 0.3
    return lambda dtype, device: Diagonal(weights.to(device, dtype))


def slow_light(*shape: int, invalid: float = 0.1) -> Make:
    valid = torch.rand(shape, generator=torch.Generator().manual_seed(6)) >= invalid
    return lambda _dtype, device: SlowLightRemoval(valid.to(device))


def combined(combine: Callable[..., LinearOperator], *makes: Make) -> Make:
    return lambda dtype, device: combine(*(make(dtype, device) for make in makes))


def field(
    points: list[tuple[float, float]],
    support: tuple[int, int, int, int] | None = None,
    channels: int = 3,
    *,
    terms: int | None = None,
    mapped: bool = False,
) -> Make:
    """With `terms`, so many PSFs in place of one for each point."""
    generator = torch.Generator().manual_seed(4)
    psfs = torch.rand((len(points), channels, 7, 8), generator=generator).double()
    if terms is not None:
        psfs[terms:] = 0.5 * psfs[:terms].sum(dim=0)

    def make(dtype: torch.dtype, device: torch.device) -> FieldConvolution:
        where = None if support is None else PixelRectangle(*support)
        values, places = psfs.to(device, dtype), torch.tensor(points)
        error = 0.0 if terms is None else 1e-3
        made = FieldConvolution(values, places, (5, 6), where, error=error, mapped=mapped)
        assert len(made.terms) == (terms or len(points))
        assert not mapped or all(each.stored.device == CPU for each in made.terms)
        return made

    return make


def channel(number: int, make: Make) -> Make:
    """That of one channel, moved to the device where it is already."""

    def of_channel(dtype: torch.dtype, device: torch.device) -> LinearOperator:
        whole = make(dtype, device)
        assert isinstance(whole, CroppedConvolution)
        return whole.single(number).to(device)

    return of_channel


def many_scenes(support: tuple[int, int, int, int], psf: tuple[int, int]) -> Make:
    cells = torch.rand((2, *support[2:]), generator=torch.Generator().manual_seed(2)).double()
    return lambda dtype, device: ManyScenes(
        cells.to(device, dtype), PixelRectangle(*support), (6, 7), psf
    )


def many_scenes_aslant(support: tuple[int, int, int, int], psf: tuple[int, int]) -> Make:
    cells = torch.rand((5, *support[2:]), generator=torch.Generator().manual_seed(3)).double()

    def make(dtype: torch.dtype, device: torch.device) -> LinearOperator:
        scenes = cells.to(device, dtype)
        return ManyScenes(scenes[:2], PixelRectangle(*support), (6, 7), psf, scenes[2:])

    return make


def stack(masks: tuple[int, ...] | None, *makes: Make) -> Make:
    """Rows of the masks without light, and a slice without any."""
    weights = None
    if masks is not None:
        weights = torch.rand(masks, generator=torch.Generator().manual_seed(5)).double()
        weights[0, ..., :2, :], weights[1] = 0, 0

    def make(dtype: torch.dtype, device: torch.device) -> StackConvolution:
        parts = [make(dtype, device) for make in makes]
        assert all(isinstance(part, CroppedConvolution) for part in parts)
        return StackConvolution(parts, None if weights is None else weights.to(device, dtype))

    return make


RGB = (3,)
FIELD = [(0.0, 0.0), (0.0, 5.0), (4.0, 0.0), (4.5, 5.0), (2.0, 2.0)]
GREY = convolution((4, 5), (4, 5), (0, 1, 4, 3), channels=1)
COLOUR = convolution((4, 5), (4, 5), (0, 1, 4, 3))
TABLE = [
    Case("convolution", convolution((4, 6), (4, 6)), RGB),
    Case("convolution, odd", convolution((5, 7), (5, 7)), RGB),
    Case("convolution, odd by even", convolution((5, 4), (5, 4)), RGB),
    Case("convolution, one psf for three", convolution((4, 5), (4, 5), channels=1), RGB),
    Case("convolution, grey", convolution((6, 3), (6, 3), channels=1), (1,)),
    Case("convolution, one row", convolution((1, 6), (1, 7), channels=1), (1,)),
    Case("convolution, wide", convolution((4, 6), (8, 12)), RGB),
    Case("convolution, wide, mixed parity", convolution((4, 5), (7, 8)), RGB),
    Case("convolution, support inside", convolution((6, 7), (6, 7), (2, 1, 3, 4)), RGB),
    Case("convolution, support partly off", convolution((6, 7), (7, 8), (-2, 4, 5, 6)), RGB),
    Case("convolution, support is larger", convolution((4, 4), (9, 8), (-3, -2, 10, 9)), RGB),
    Case("convolution, support beside", convolution((5, 4), (14, 15), (-5, 6, 3, 2)), RGB),
    Case("convolution, support of a cell", convolution((5, 6), (5, 6), (4, 0, 1, 1), 1), RGB),
    Case("field", field(FIELD, (-2, -1, 9, 8)), RGB),
    Case("field, two psfs for all", field(FIELD, (-2, -1, 9, 8), terms=2), RGB),
    Case("field, mapped", field(FIELD, (-2, -1, 9, 8), mapped=True), RGB),
    Case("field, two mapped psfs for all", field(FIELD, None, terms=2, mapped=True), RGB),
    Case("field, a channel", channel(1, field(FIELD, (1, 0, 4, 7), mapped=True)), (1,)),
    Case("field, no support", field([(0, 0), (0, 5), (4, 0)]), RGB),
    Case("field, one psf for three", field([(1, 1), (3, 4)], (0, 0, 5, 6), 1), RGB),
    Case("field of a point, grey", field([(2, 2)], (1, -1, 4, 6), 1), (1,)),
    Case("stack of mapped depths", stack(None, *2 * [field(FIELD, (-1, 0, 6, 5), mapped=True)])),
    Case("stack of depths", stack(None, *2 * [field([(0, 0), (4, 5)], (-1, 0, 6, 5))])),
    Case("stack of bands", stack((3, 5, 6), *3 * [convolution((5, 6), (7, 8), None, 1)]), (1,)),
    Case("stack of instants", stack((4, 3, 5, 6), convolution((5, 6), (5, 6), (1, -1, 3, 5)))),
    Case("many scenes", many_scenes((1, 2, 4, 5), (6, 7)), (2,)),
    Case("many scenes, wide psf", many_scenes((-1, 2, 5, 6), (11, 12)), (2,)),
    Case("many scenes aslant", many_scenes_aslant((-1, 1, 5, 4), (10, 11))),
    Case("difference", difference(4, 6)),
    Case("difference, odd", difference(5, 7)),
    Case("difference, one row", difference(1, 5)),
    Case("difference, one column", difference(4, 1), (2,)),
    Case("difference, colour", difference(3, 4), RGB),
    Case("difference, volume", difference(3, 4, 2)),
    Case("difference, stack", combined(lambda: StackDifference((3, 4, 2), 0.7)), RGB),
    Case("identity", combined(lambda: Identity((4, 3)))),
    Case("diagonal", diagonal(3, 4, 5)),
    Case("slow light", slow_light(2, 6, 7)),
    Case("slow light, two rows, all valid", slow_light(1, 2, 5, invalid=0)),
    Case("mask", combined(lambda: Diagonal(torch.arange(12).reshape(3, 4) % 3 > 0))),
    Case("crop", combined(lambda: Crop((5, 6), (1, 2, 4, 3))), RGB),
    Case("adjoint", combined(lambda a: a.H, GREY), (1,)),
    Case("composition", combined(lambda a, b: a @ b, diagonal(3, 4, 5), GREY)),
    Case("composition, inner has channels", combined(lambda a, b: a @ b, diagonal(4, 5), COLOUR)),
    Case("gram", combined(LinearOperator.gram, COLOUR)),
    Case("sum", combined(lambda a, b: a - 2 * b, GREY, convolution((4, 5), (7, 8), (0, 1, 4, 3)))),
    Case("multiple", combined(lambda a: -a * 0.5, difference(4, 3))),
    Case("vertical stack", combined(lambda *a: VerticalStack(a), diagonal(4, 3), diagonal(4, 3))),
    Case("horizontal stack", combined(lambda *a: HorizontalStack(a), GREY, GREY), RGB),
    Case("block-diagonal", combined(lambda *a: BlockDiagonal(a), COLOUR, COLOUR)),
]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["float32", "float64"])
@pytest.mark.parametrize("case", TABLE, ids=lambda case: case.name)
@pytest.mark.parametrize("check", EVERYWHERE, ids=lambda check: check.__name__)
def test_operator(check, case, dtype):
    if dtype not in case.dtypes:
        pytest.skip(f"{case.name} does not support {dtype}")
    check(case, dtype, CPU)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
@pytest.mark.parametrize("check", EVERYWHERE, ids=lambda check: check.__name__)
def test_operator_on_cuda(check):
    for case in TABLE:
        for dtype in case.dtypes:
            check(case, dtype, torch.device("cuda"))


@pytest.mark.parametrize("case", TABLE, ids=lambda case: case.name)
@pytest.mark.parametrize("check", ONCE, ids=lambda check: check.__name__)
def test_operator_once(check, case):
    check(case)


def test_every_operator_is_in_the_table():
    package = nolens.operators
    for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        importlib.import_module(module.name)
    known, todo = set(), [LinearOperator]
    while todo:
        found = [c for c in todo.pop().__subclasses__() if c.__module__.startswith("nolens.")]
        known.update(found)
        todo.extend(found)
    tried = {type(case.make(torch.float32, CPU)) for case in TABLE}
    bases = {c for c in known if c.__abstractmethods__ or c.__name__.startswith("_")}
    assert known - bases == tried


def dense(operator: LinearOperator) -> Tensor:
    """Its matrix, in float64."""
    size = math.prod(operator.domain_shape)
    return (
        operator(torch.eye(size).double().reshape(size, *operator.domain_shape)).reshape(size, -1).T
    )


def test_the_algebra_is_that_of_matrices():
    """Of the matrices; the norm is the largest singular value, of tensors and adjoints too."""
    a, b, c = (make(torch.float64, CPU) for make in (COLOUR, difference(4, 3), diagonal(3, 4, 3)))
    v = torch.arange(36.0).double().reshape(3, 4, 3).sin()
    torch.testing.assert_close(dense(a.H), dense(a).T)
    torch.testing.assert_close(dense(a @ c), dense(a) @ dense(c))
    torch.testing.assert_close(dense(c - np.float64(2) * c.gram()), dense(c) - 2 * dense(c) ** 2)
    torch.testing.assert_close(a @ v, a(v))
    torch.testing.assert_close((-b @ c)(v), -b(c(v)))
    torch.testing.assert_close(VerticalStack([a, 3 * a])(v), torch.stack([a(v), 3 * a(v)]))
    torch.testing.assert_close(HorizontalStack([a, 3 * a])(torch.stack([v, c(v)])), a(v + 3 * c(v)))
    masks = torch.rand((2, 4, 5), generator=torch.Generator().manual_seed(6)).double()
    for mask in (None, masks):
        parts = [a, 3 * a] if mask is None else [Diagonal(mask[0]) @ a, Diagonal(mask[1]) @ a]
        scenes = torch.stack([v, c(v)], dim=-3)
        other = copy(a)
        other.transfer = (3 if mask is None else 1) * a.transfer
        torch.testing.assert_close(
            StackConvolution([a, other], mask)(scenes),
            HorizontalStack(parts)(scenes.transpose(0, 1)),
        )
    assert a.H.H is a
    for each in (a, a.H, b @ c):
        largest = float(torch.linalg.matrix_norm(dense(each), 2))
        assert each.norm(v.new_empty(each.domain_shape), tolerance=1e-9) == pytest.approx(largest)
        assert each.norm(v.new_empty(each.domain_shape)) == pytest.approx(largest, rel=1e-2)


def test_mapped_transfer_functions_measure_the_same():
    """And one channel of them what it does among others."""
    v = torch.rand((3, 9, 8), generator=torch.Generator().manual_seed(9)).double()
    support = (-2, -1, 9, 8)
    whole, mapped = (field(FIELD, support, mapped=m)(torch.float64, CPU) for m in (False, True))
    assert torch.equal(mapped(v), whole(v)) and torch.equal(mapped.H(whole(v)), whole.H(whole(v)))
    one = channel(1, field(FIELD, support, mapped=True))(torch.float64, CPU)
    torch.testing.assert_close(one(v[1:2]), whole(v)[1:2])


@pytest.mark.parametrize(
    ("combine", "words"),
    [
        (lambda a, d: d @ a, "(3, 3), and CroppedConvolution gives (3, 4, 5)"),
        (lambda a, d: a + d, "from (3, 4, 3) to (3, 4, 5) and from (3, 3)"),
        (lambda a, d: VerticalStack([a, d]), "a VerticalStack takes operators of one domain"),
        (lambda _a, _d: VerticalStack([]), "got []"),
        (lambda _a, _d: Crop((4, 5), (1, 2, 4, 3)), "(1, 2, 4, 3) (top, left, height, width)"),
    ],
)
def test_operators_that_do_not_fit(combine, words):
    with pytest.raises(ValueError) as caught:
        combine(COLOUR(torch.float64, CPU), diagonal(3, 3)(torch.float64, CPU))
    assert words in str(caught.value)


def test_slow_light_goes_and_the_mean_stays():
    valid = torch.rand(2, 40, 50, generator=torch.Generator().manual_seed(7)) > 0.1
    removal = SlowLightRemoval(valid)
    image = torch.rand(2, 40, 50, generator=torch.Generator().manual_seed(8)).double()
    rows, columns = (slow_cosines(side) for side in (40, 50))
    for row, column in ((0, 1), (1, 0), (2, 2)):
        slow = 3 * (rows[row][:, None] * columns[column]).expand_as(image)
        left = removal(image + slow) - removal(image)
        mean = (slow * valid).sum((-2, -1), keepdim=True) / valid.sum((-2, -1), keepdim=True)
        torch.testing.assert_close(left, torch.where(valid, mean, 0.0).double())
    torch.testing.assert_close(removal(torch.ones_like(image)), valid.double())
    torch.testing.assert_close(removal(removal(image)), removal(image))
