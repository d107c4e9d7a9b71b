"""Descriptions of cameras: text that does not change, and errors that say what to do."""

import copy
import re
import tomllib
from datetime import date

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nolens.camera import (
    MATERIALS,
    MOSAICS,
    AngularCurve,
    Camera,
    LoadedCamera,
    Material,
    SpectralCurve,
    from_mapping,
    from_toml,
    preset,
    preset_text,
    to_toml,
)
from nolens.errors import DataError, OptionError

SMALL = tomllib.loads(preset_text("small"))
ABSENT = object()

lengths = st.builds(
    "{}{}{}".format,
    st.sampled_from(["1", "1.50", "07", "2e-1", ".3"]),
    st.sampled_from(["", " "]),
    st.sampled_from(["um", "µm", "mm"]),
) | st.sampled_from(["500 nm", "0.7cm", "3e-3 m"])
notes = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=20)
texts = st.text(
    st.characters(exclude_categories=["Cc", "Cf", "Cs", "Zl", "Zp"]), min_size=1, max_size=20
)
shares = st.floats(0, 1)
factors = st.floats(1e-3, 1e4)


def increasing(low: float, high: float):
    values = st.lists(st.floats(low, high, exclude_min=True), min_size=2, max_size=9, unique=True)
    return values.map(sorted)


@st.composite
def sensors(draw):
    mosaic = draw(st.sampled_from([*MOSAICS, "none"]))
    curve = {"source": draw(texts), "wavelength_nm": draw(increasing(1, 2000))}
    points = len(curve["wavelength_nm"])
    channels = ["grey"] if mosaic == "none" else "RGB"
    values = st.lists(shares, min_size=points, max_size=points)
    curve["values"] = {channel: draw(values) for channel in channels}
    angles = [0, *draw(increasing(0, 90))]
    rest = st.lists(shares, min_size=len(angles) - 1, max_size=len(angles) - 1)
    acceptance = {"source": draw(texts), "angle_deg": angles, "response": [1, *draw(rest)]}
    sensor = {
        "name": draw(texts),
        "rows": 2 * draw(st.integers(8, 3000)),
        "columns": 2 * draw(st.integers(8, 3000)),
        "pitch": draw(lengths),
        "mosaic": mosaic,
        "bits": draw(st.integers(8, 16)),
        "black_counts": draw(st.floats(0, 254)),
        "full_well_electrons": draw(st.floats(1, 1e9)),
        "read_noise_electrons": draw(st.floats(0, 100)),
        "counts_per_electron": draw(factors),
        "quantum_efficiency": draw(st.sampled_from([curve, {"file": "curves/qe.csv"}])),
        "acceptance": draw(st.sampled_from([acceptance, {"file": "acceptance.csv"}])),
    }
    return sensor | draw(st.fixed_dictionaries({}, optional={"gain": factors}))


OWN = {
    "name": "my-resin", "source": "a refractometer", "formula": "cauchy",
    "coefficients": [1.5, 0.004], "range_nm": [400, 900.5],
    "density_g_cm3": 1.15, "density_source": "a balance",
}  # fmt: skip


@st.composite
def own_materials(draw):
    """Materials whose indices are above 1 for sure, with names that none of the package has."""
    names = draw(st.lists(st.from_regex("own-[a-z0-9]{1,9}", fullmatch=True), unique=True))
    made = []
    for name in names:
        formula, coefficients = draw(
            st.one_of(
                st.tuples(st.just("constant"), st.tuples(st.floats(1, 4))),
                st.tuples(st.just("abbe"), st.tuples(st.floats(1.3, 1.9), st.floats(15, 100))),
                st.tuples(st.just("cauchy"), st.tuples(st.floats(1, 2), st.floats(0, 0.02))),
                st.tuples(st.just("sellmeier"), st.tuples(st.floats(0, 3), st.floats(0, 0.03))),
            )
        )
        one = {"name": name, "source": draw(texts), "formula": formula}
        one |= {"coefficients": list(coefficients), "range_nm": draw(increasing(300, 2000))[:2]}
        if draw(st.booleans()):
            one |= {"density_g_cm3": draw(st.floats(0.5, 9)), "density_source": draw(texts)}
        if draw(st.booleans()):
            one |= {"cure_shrinkage_percent": draw(st.floats(0, 20))}
            one |= {"cure_shrinkage_source": draw(texts)}
        made.append(one)
    return made


layers = st.tuples(
    st.fixed_dictionaries({"thickness": lengths}, optional={"name": texts}),
    st.one_of(
        st.fixed_dictionaries({"material": st.sampled_from(sorted(MATERIALS))}),
        st.fixed_dictionaries({"index": st.floats(1, 4)}),
    ),
).map(lambda parts: parts[0] | parts[1])
reliefs = st.one_of(
    st.fixed_dictionaries(
        dict.fromkeys(("radius", "pitch", "smoothing", "grid", "overhang"), lengths)
        | {"kind": st.just("random-lenslets"), "seed": st.integers(0, 2**63 - 1)}
    ),
    st.fixed_dictionaries({"kind": st.just("file"), "file": st.just("a.tif"), "grid": lengths}),
    st.just({"kind": "flat"}),
)
apertures = st.fixed_dictionaries(
    {"shape": st.sampled_from(["rectangle", "ellipse"]), "width": lengths, "height": lengths}
)
cameras = st.fixed_dictionaries(
    {
        "schema_version": st.just(1),
        "name": texts,
        "reference_distance": lengths,
        "sensor": sensors(),
        "layers": st.lists(layers, min_size=1, max_size=4),
        "mask": st.fixed_dictionaries(
            {"surface": st.just(0), "relief": reliefs}, optional={"aperture": apertures}
        ),
    },
    optional={"note": notes, "materials": own_materials()},
)


@settings(max_examples=60)
@given(cameras)
def test_text_does_not_change(mapping):
    camera = from_mapping(Camera, mapping, "camera.toml")
    text = to_toml(camera)
    again = from_toml(Camera, text, "camera.toml")
    assert again == camera
    for own in camera.materials:
        assert from_toml(Material, to_toml(own), "my-resin.toml") == own
    assert to_toml(again) == text
    assert from_mapping(Camera, camera.model_dump(), "a copy") == camera


def test_text_is_for_people():
    text = to_toml(preset("small"))
    assert "angle_deg = [0, 10, 20, 30, 40, 50, 60]\n" in text
    assert '{ name = "resin", thickness = "1.06 mm", material = "pua311" },\n' in text
    assert "gain" not in text
    numbers = [line for line in text.splitlines() if re.match(r" {4}\d", line)]
    assert all(len(line) <= 100 for line in numbers)


def test_an_index_holds_at_every_wavelength():
    layers = [{"thickness": "1 mm", "index": 1.5}, {"thickness": "1 mm", "material": "bk7"}]
    camera = from_mapping(Camera, SMALL | {"layers": layers}, "camera.toml")
    assert camera.indices(400)[0] == camera.indices(700)[0] == 1.5
    assert camera.indices(400)[1] > camera.indices(700)[1] > 1.5


def test_a_cameras_own_material():
    layers = [{"thickness": "1 mm", "material": "my-resin"}, *SMALL["layers"][1:]]
    camera = from_mapping(Camera, SMALL | {"layers": layers, "materials": [OWN]}, "camera.toml")
    assert camera.indices(500) == pytest.approx(
        (1.5 + 0.004 / 0.25, *preset("small").indices(500)[1:])
    )
    assert camera.indices(400)[0] == pytest.approx(1.525)
    text = to_toml(camera)
    assert '\n[[materials]]\nname = "my-resin"\n' in text
    assert "coefficients = [1.5, 0.004]\nrange_nm = [400, 900.5]\n" in text
    with pytest.raises(OptionError, match=r"my-resin .* 400 to 900\.5 nm, not at 399 nm"):
        camera.indices(399)
    layers[0] = layers[0] | {"material": "my-resine"}
    with pytest.raises(DataError, match=r"layers\[0\].*did you mean 'my-resin'"):
        from_mapping(Camera, SMALL | {"layers": layers, "materials": [OWN]}, "camera.toml")


def test_spectral_curve_is_zero_outside():
    curve = SpectralCurve(source="made up", wavelength_nm=(400, 500), values={"grey": (0.2, 0.4)})
    at = curve.at("grey", np.array([[399, 400, 425], [450, 500, 501.0]]))
    np.testing.assert_allclose(at, [[0, 0.2, 0.25], [0.3, 0.4, 0]])


def test_angular_curve_holds_its_last_value():
    curve = AngularCurve(source="made up", angle_deg=(0, 10), response=(1, 0.5))
    np.testing.assert_allclose(curve.at(np.array([0, 5, 10, 80.0])), [1, 0.75, 0.5, 0.5])


def test_a_camera_that_names_files_is_not_open():
    mapping = copy.deepcopy(SMALL)
    mapping["sensor"]["acceptance"] = {"file": "a.csv"}
    with pytest.raises(DataError, match=r"names the file a\.csv.*read_camera"):
        LoadedCamera.of(from_mapping(Camera, mapping, "camera.toml"))


LENSLETS = SMALL["mask"]["relief"]
BAD = [
    ("layers.1.thickness", 0, "layers[1].thickness is 0: a layer of zero or negative thickness is "
     "impossible: leave the layer out"),
    ("layers.1.thickness", "-1 mm", "leave the layer out"),
    ("layers.1.thickness", 2, "2 has no unit: write a length as 2 mm"),
    ("layers.1.thickness", "1 furlong", "units: nm, um, mm, cm, m"),
    ("layers.1.thickness", ABSENT, "layers[1]: thickness is missing"),
    ("layers.1.thicknes", "1 mm", "layers[1]: the key 'thicknes' is unknown: did you mean "
     "'thickness'?"),
    ("layers.1.material", "pdmss", "did you mean 'pdms'?"),
    ("layers.1.material", "n-bk7", "layers[1].material is 'n-bk7': there is no material 'n-bk7'; "
     "did you mean 'bk7'?"),
    ("layers.1.material", 3, "layers[1].material is 3: it should be a valid string"),
    ("materials", [OWN | {"name": "pdms"}], "materials[0].name is 'pdms': a material 'pdms' comes "
     "with nolens: give yours another name, such as my-pdms"),
    ("materials", [OWN, OWN], "materials[1].name is 'my-resin', as that of one before it"),
    ("materials", [OWN | {"formula": "schott"}], "materials[0].formula is 'schott': it should be "
     "'constant', 'abbe', 'cauchy', 'sellmeier' or 'power-series'"),
    ("materials", [OWN | {"coefficients": [0.99]}], "materials[0]: the refractive index is 0.99 at "
     "400 nm; it must be 1 to 4"),
    ("materials", OWN, "materials: it should be a list"),
    ("layers.1.material", ABSENT, "layers[1]: neither material nor index is given"),
    ("layers.1.index", 1.5, "layers[1]: material and index are both given"),
    ("layers.1.index", 0.9, "layers[1].index is 0.9: it must be 1 to 4"),
    ("layers", [], "layers is []: it should have at least 1 item"),
    ("layers", [SMALL["layers"][0]] * 21, "it should have at most 20 items"),
    ("layers", "resin", "layers is 'resin': it should be a list"),
    ("layers.0", 3, "layers[0] is 3: it should be a table of keys and values"),
    ("mask.surface", 3, "mask.surface is 3, but there are 3 layers: give the index of a layer, "
     "0 to 2"),
    ("mask.surface", -1, "mask.surface is -1"),
    ("mask.relief.kind", "lens", "mask.relief.kind is 'lens': known are 'random-lenslets'"),
    ("mask.relief.kind", ABSENT, "mask.relief: kind is missing: give kind = random-lenslets"),
    ("mask.relief", 3, "mask.relief is 3: it should be a table"),
    ("mask.relief.radius", "inf", "mask.relief.radius is 'inf': 'inf' is not a length"),
    ("mask.relief.overhang", "0 mm", "mask.relief.overhang is '0 mm': it must be 1 nm to 10 m"),
    ("mask.relief.seed", True, "mask.relief.seed is True: it should be a valid integer"),
    ("mask.relief.seed", -1, "it must be 0 to 9223372036854775807"),
    ("mask.relief", {"kind": "file", "grid": "1 um"}, "mask.relief: file is missing"),
    ("mask.relief", {"kind": "file", "grid": "1 um", "file": "../a.tif"},
     "mask.relief.file is '../a.tif': it must be a .tif or .tiff file in the camera's folder"),
    ("mask.aperture.shape", "star", "it should be 'rectangle' or 'ellipse'"),
    ("sensor", ABSENT, "sensor is missing: give schema_version"),
    ("sensor.rows", 257, "give even numbers"),
    ("sensor.rows", 8, "sensor.rows is 8: it must be 16 to 65535"),
    ("sensor.rows", 10**5000, "sensor.rows is too long to be shown"),
    ("sensor.bits", 7, "sensor.bits is 7"),
    ("sensor.gain", float("nan"), "sensor.gain is nan: it should be a finite number"),
    ("sensor.gain", "1", "sensor.gain is '1': it should be a valid number"),
    ("sensor.black_counts", 4095, "black_counts is 4095, but the largest count of 12 bits is 4095"),
    ("sensor.mosaic", "RGBG", "'GBRG' or 'none'"),
    ("sensor.mosaic", "none", "given for R, G, B, but a sensor with the mosaic none has the "
     "channels grey"),
    ("sensor.quantum_efficiency", {"file": "/qe.csv"}, "quantum_efficiency.file is '/qe.csv': it "
     "must be a .csv file in the camera's folder"),
    ("sensor.quantum_efficiency.values.R", [0.1], "values.R has 1 values, but wavelength_nm has "
     "31"),
    ("sensor.quantum_efficiency.values.R.3", 1.5, "sensor.quantum_efficiency.values.R[3] is 1.5"),
    ("sensor.quantum_efficiency.wavelength_nm.3", 420, "420 follows 420: put the values in "
     "increasing order"),
    ("sensor.acceptance.angle_deg.0", 1, "it begins at 1: begin at 0 degrees"),
    ("sensor.acceptance.response.0", 0, "its first value, at 0 degrees, is 0"),
    ("sensor.acceptance.response", [1], "response has 1 values, but angle_deg has 7"),
    ("schema_version", 2, "schema_version is 2: it should be 1"),
    ("name", "", "it should have at least 1 character"),
    ("name", "a\nb = 1", r"name is 'a\nb = 1': it must be on one line, without control"),
    ("layers.0.name", "\x1b[2J", r"layers[0].name is '\x1b[2J': it must be on one line"),
    ("sensor.name", "\u202e" + 500 * "x", "sensor.name is '\\u202exxx"),
    ("name", date(2020, 1, 1), "it should be a valid string"),
    ("sensr", {}, "the key 'sensr' is unknown: did you mean 'sensor'?"),
    ("reference_distance", 300, "300 has no unit: write a length as 300 mm"),
]  # fmt: skip


@pytest.mark.parametrize(("path", "value", "words"), BAD, ids=[f"{b[0]}-{b[2][:20]}" for b in BAD])
def test_bad_input_says_what_to_do(path, value, words):
    mapping = copy.deepcopy(SMALL)
    steps = [int(step) if step.isdigit() else step for step in path.split(".")]
    at = mapping
    for step in steps[:-1]:
        at = at[step]
    if value is ABSENT:
        del at[steps[-1]]
    else:
        at[steps[-1]] = value
    with pytest.raises(DataError) as error:
        from_mapping(Camera, mapping, "camera.toml")
    message = str(error.value)
    assert message.startswith("camera.toml: ")
    assert words in message
    assert "\n" not in message and len(message) < 400


def test_one_bad_layer_is_one_error():
    mapping = SMALL | {"layers": [{"thickness": "0 mm", "material": "air"}]}
    with pytest.raises(DataError) as error:
        from_mapping(Camera, mapping, "camera.toml")
    assert "; " not in str(error.value)


def test_many_errors_are_counted():
    mapping = copy.deepcopy(SMALL)
    mapping["sensor"]["quantum_efficiency"]["values"]["R"] = [2] * 31
    with pytest.raises(DataError, match="and 28 more"):
        from_mapping(Camera, mapping, "camera.toml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('name = "a"\nrows = ', "camera.toml is no TOML file: .*(line 2|end of document)"),
        ("a = 1\na = 2\nb = 3", "line 2, column 6"),
        ("", "schema_version, name, .* are missing"),
    ],
)
def test_broken_toml(text, words):
    with pytest.raises(DataError, match=words):
        from_toml(Camera, text, "camera.toml")
