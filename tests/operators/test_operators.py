"""Every operator, through the shared suite."""

import importlib
import pkgutil
from collections.abc import Callable

import pytest
import torch
from suite import CPU, EVERYWHERE, ONCE, Case

import nolens.operators
from nolens.calibrate.known_scenes import ManyScenes
from nolens.operators import CroppedConvolution, FiniteDifference, LinearOperator, PixelRectangle

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


def difference(height: int, width: int) -> Make:
    return lambda _dtype, _device: FiniteDifference((height, width))


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


RGB = (3,)
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
    Case("many scenes", many_scenes((1, 2, 4, 5), (6, 7)), (2,)),
    Case("many scenes, wide psf", many_scenes((-1, 2, 5, 6), (11, 12)), (2,)),
    Case("many scenes aslant", many_scenes_aslant((-1, 1, 5, 4), (10, 11))),
    Case("difference", difference(4, 6)),
    Case("difference, odd", difference(5, 7)),
    Case("difference, one row", difference(1, 5)),
    Case("difference, one column", difference(4, 1), (2,)),
    Case("difference, colour", difference(3, 4), RGB),
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
    assert {c for c in known if not c.__abstractmethods__} == tried
