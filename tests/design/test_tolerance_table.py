"""Tolerances as text, and what of a camera can vary."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nolens.camera import Camera, Flat, preset
from nolens.design.tolerances.models import Builds, check_possible
from nolens.design.tolerances.parameters import (
    Parameter,
    default_parameters,
    draw,
    find,
    parameters_from_toml,
    parameters_to_toml,
    variables,
)
from nolens.errors import DataError, NolensError, OptionError

PAPER = preset("paper")
RESIN = '[[parameter]]\nname = "resin.thickness"\ndistribution = "normal"\n'
ONE = 'tolerance = "1um"\n'


def read(text: str, camera: Camera = PAPER) -> tuple[Parameter, ...]:
    return parameters_from_toml(text, "t.toml", camera)


@pytest.mark.parametrize("name", ["paper", "paper-film", "small"])
def test_defaults_can_be_written_and_read(name: str) -> None:
    camera = preset(name)
    parameters = default_parameters(camera)
    text = parameters_to_toml(parameters, camera)
    again = read(text, camera)
    assert [each.name for each in again] == [each.name for each in parameters]
    for one, other in zip(again, parameters, strict=True):
        assert (one.distribution, one.unit, one.note) == (
            other.distribution,
            other.unit,
            other.note,
        )
        assert (one.middle, one.tolerance) == pytest.approx((other.middle, other.tolerance))
    assert parameters_to_toml(again, camera) == text
    assert all(each.note.startswith("assumed") for each in parameters)
    check_possible(camera, parameters, draw(parameters, 1000, 0))


def test_defaults_of_the_papers_camera() -> None:
    found = {each.name: each for each in default_parameters(PAPER)}
    assert list(found) == [
        "resin.thickness", "resin.index", "cover glass.thickness", "cover glass.index",
        "gap.thickness", "wedge", "relief.gain", "relief.shrinkage", "decentre",
    ]  # fmt: skip
    assert found["resin.thickness"].middle == 1060 and found["resin.thickness"].tolerance == 50
    assert found["gap.thickness"].tolerance == 20
    assert found["relief.shrinkage"].middle == 2 and found["relief.shrinkage"].tolerance == 1


def test_thin_layers_get_a_tenth() -> None:
    layers = list(PAPER.layers)
    layers[2] = layers[2].model_copy(update={"thickness": type(layers[2].thickness)("30", "um")})
    thin = PAPER.model_copy(update={"layers": tuple(layers)})
    found = {each.name: each for each in default_parameters(thin)}
    assert found["gap.thickness"].tolerance == 3


def test_all_keys() -> None:
    text = RESIN + 'tolerance = "0.1mm"\nmean = "1.1 mm"\nat_most = "150um"\nnote = "why"\n'
    (found,) = read(text)
    assert found == Parameter("resin.thickness", "normal", 1100.0, 100.0, "um", 150.0, "why")
    assert read(parameters_to_toml((found,), PAPER)) == (found,)
    (index,) = read(RESIN.replace("resin.thickness", "layers.1.index") + "tolerance = 0.01\n")
    assert index.name == "cover glass.index" and index.unit == "" and index.tolerance == 0.01
    assert index.middle == PAPER.indices(550.0)[1]
    (wedge,) = read(RESIN.replace("resin.thickness", "wedge") + 'tolerance = "10 mrad"\n')
    assert wedge.tolerance == pytest.approx(math.degrees(0.01))


def test_layers_without_a_name_of_their_own() -> None:
    layers = tuple(
        each.model_copy(update={"name": name})
        for each, name in zip(PAPER.layers, ("relief", "same", "same"), strict=True)
    )
    camera = PAPER.model_copy(update={"layers": layers})
    assert [name for name in variables(camera) if "thickness" in name] == [
        "layers.0.thickness", "layers.1.thickness", "layers.2.thickness",
    ]  # fmt: skip
    assert find(variables(camera), camera, "layers.2.index").middle == camera.indices(550.0)[2]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (RESIN.replace("resin.", "rasin.") + ONE, ("mean 'resin.thickness'", "relief.gain")),
        (RESIN.replace("resin.", "layers.3.") + ONE, ("'layers.3.thickness'", "Known are")),
        (RESIN.replace("normal", "normale") + ONE, ("did you mean 'normal'", "triangular")),
        (RESIN + "tolerance = 50", ("resin.thickness.tolerance", "50 has no unit", "50 mm")),
        (RESIN + 'tolerance = "5 deg"', ("'deg' is unknown", "um")),
        (RESIN + 'tolerance = "-5 um"', ("negative", "0 or more")),
        (RESIN + 'tolerance = "5 um"\nat_most = "0um"', ("at_most",)),
        (RESIN.replace("normal", "uniform") + ONE + 'at_most = "9um"', ("at_most", "normal")),
        (RESIN, ("tolerance", "missing")),
        (RESIN + 'tolerance = "5 um"\nsigma = 3', ("'sigma'", "unknown")),
        (RESIN + 'tolerance = "5 um"\n' + RESIN + 'tolerance = "5 um"', ("twice",)),
        (RESIN.replace("thickness", "index") + 'tolerance = "5 um"', ("no unit", "0.005")),
        (RESIN.replace("thickness", "index") + "tolerance = true", ("no unit", "0.005")),
        (RESIN.replace("thickness", "index") + "tolerance = nan", ("tolerance is nan", "-4 to 4")),
        ("", ("parameter", "missing")),
        ("parameter = []", ("parameter",)),
        ("x = [", ("no TOML",)),
    ],
)  # fmt: skip
def test_bad_tables(text: str, words: tuple[str, ...]) -> None:
    with pytest.raises(NolensError) as error:
        read(text)
    message = str(error.value)
    assert isinstance(error.value, OptionError | DataError)
    assert message.startswith("t.toml") and "\n" not in message.removeprefix("t.toml is no TOML")
    for word in words:
        assert word in message, message


def test_flat_masks_have_no_tolerances() -> None:
    mask = PAPER.mask.model_copy(update={"relief": Flat(kind="flat")})
    with pytest.raises(OptionError, match="flat"):
        default_parameters(PAPER.model_copy(update={"mask": mask}))


def test_builds_are_what_their_parameters_say() -> None:
    names = (
        "resin.thickness",
        "resin.index",
        "relief.shrinkage",
        "relief.gain",
        "wedge",
        "decentre",
    )
    rows = torch.tensor([[1000.0, 1.5, 2.0, 90.0, 1.0, 100.0]]).double()
    builds = Builds.of(PAPER, names, rows)
    assert builds.thickness_um.tolist() == [pytest.approx([980.0, 490.0, 235.0])]
    assert builds.index_change.tolist() == [pytest.approx([1.5 - PAPER.indices(550.0)[0], 0, 0])]
    assert (float(builds.scale[0]), float(builds.gain[0])) == pytest.approx((0.98, 0.9))
    # 1 degree over 1100 um is 19.2 um more.
    there = builds.at(PAPER, 1200.0).thickness_um[0]
    assert there.tolist() == pytest.approx([980 + 1100 * math.tan(math.radians(1)), 490, 235])


@pytest.mark.parametrize(
    ("name", "middle", "tolerance", "words"),
    [
        ("gap.thickness", 235.0, 300.0, ("gap.thickness", "more than 0 um", "at_most")),
        ("cover glass.index", 1.52, 1.0, ("cover glass.index", "1 to 4")),
        ("cover glass.index", 0.9, 0.01, ("change its mean, 0.9",)),
        ("relief.shrinkage", 0.0, 30.0, ("relief.shrinkage", "-10 to 10 %")),
    ],
)
def test_impossible_tolerances(
    name: str, middle: float, tolerance: float, words: tuple[str, ...]
) -> None:
    unit = variables(PAPER)[name].unit
    parameters = (Parameter(name, "normal", middle, tolerance, unit),)
    with pytest.raises(OptionError) as error:
        check_possible(PAPER, parameters, draw(parameters, 100, 0))
    for word in words:
        assert word in str(error.value), error.value


@given(seed=st.integers(0, 50))
def test_what_is_advised_would_do(seed: int) -> None:
    parameters = (Parameter("gap.thickness", "normal", 235.0, 400.0, "um"),)
    with pytest.raises(OptionError) as error:
        check_possible(PAPER, parameters, draw(parameters, 50, seed))
    advised = float(str(error.value).split("± ")[1].split(" µm")[0])
    narrower = (parameters[0].with_tolerance(advised),)
    check_possible(PAPER, narrower, draw(narrower, 50, seed))
    wider = (parameters[0].with_tolerance(advised * 1.11),)
    with pytest.raises(OptionError):
        check_possible(PAPER, wider, draw(wider, 50, seed))


def test_a_wedge_may_not_cut_through_the_layer() -> None:
    parameters = (
        Parameter("wedge", "uniform", 0.0, 9.0, "deg"),
        Parameter("resin.thickness", "uniform", 400.0, 10.0, "um"),
    )
    with pytest.raises(OptionError, match="wedge"):
        check_possible(PAPER, parameters, draw(parameters, 100, 0))
