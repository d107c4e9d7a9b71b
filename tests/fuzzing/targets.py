"""What is fuzzed: for each kind of input, the command that reads it."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from cyclopts import App
from damage import Draw, numbers, quantities, texts, values, windows
from hypothesis import strategies as st

from nolens.cli.app import COMMANDS, application

BAD = "{bad}"
"""Stands for the damaged file in a command's arguments."""
QUICK = ("--black", "256", "--iterations", "3")


@dataclass(frozen=True)
class FileTarget:
    """A command that reads a file which is damaged.

    Parameters
    ----------
    name
        Folder of its files in the corpus.
    seed
        The good file, below the folder of seeds. Where it lies in a folder of its own, that
        folder is copied and the damaged file put in its place.
    command
        Arguments; `BAD` stands for the damaged file, or for the folder that holds it.
    """

    name: str
    seed: str
    command: tuple[str, ...]

    @property
    def suffix(self) -> str:
        """Of the file."""
        return "." + self.seed.rpartition(".")[2]

    @property
    def in_folder(self) -> bool:
        """Whether the command is given the folder."""
        return self.seed.startswith(("camera/", "set/", "job/")) and not self.seed.endswith(
            "curve.toml"
        )

    def arguments(self, bad: str) -> list[str]:
        """Of the command, for one damaged file or the folder that it is in."""
        return [each.replace(BAD, bad) for each in self.command]


def _reads() -> Iterator[FileTarget]:
    for kind in ("png", "tif", "npy", "dng"):
        name = f"frame-{kind}"
        yield FileTarget(name, f"raw.{kind}", ("info", BAD))
    for kind in ("npz", "mat", "h5", "exr", "mkv", "zip", "parquet"):
        yield FileTarget(f"frame-{kind}", f"raw.{kind}", ("info", BAD))
    yield FileTarget("frame-tif", "planes.tif", ("info", BAD))
    yield FileTarget("frame-png", "grey.png", ("info", BAD))
    yield FileTarget("frame-png", "palette.png", ("info", BAD))
    yield FileTarget("frame-tif", "tiled.tif", ("info", BAD))
    solve = ("reconstruct", "raw.png", "--psf", "psf.png", "-o", "out/o.png", *QUICK)
    for kind in ("png", "tif", "npy"):
        bad_psf = ("reconstruct", f"raw.{kind}", "--psf", BAD, "-o", "out/o.png", *QUICK)
        yield FileTarget(f"psf-{kind}", f"psf.{kind}", bad_psf)
    for kind in ("npy", "tif"):
        stack = ("reconstruct", BAD, "--psf", "grey-psf.png", "-o", "out/o", *QUICK)
        yield FileTarget(f"sequence-{kind}", f"frames.{kind}", stack)
    yield FileTarget("dark-tif", "dark.tif", (*solve[:6], *QUICK[2:], "--dark", BAD))
    yield FileTarget("config", "config.toml", ("reconstruct", "--config", BAD, "-o", "out/o.png"))
    resumed = ("reconstruct", "raw.tif", "--psf", "psf.tif", "-o", "out/o.png", "--iterations", "9")
    yield FileTarget("state", "stopped.npz", (*resumed, "--black", "256", "--resume", BAD))
    shot = ("--camera", "camera", "--wavelengths", "1", "--field-points", "1", "-o", "out/o.dng")
    for seed in ("scene.png", "alpha.png", "scene.jpg", "scene.tif"):
        name = f"scene-{seed.rpartition('.')[2]}"
        yield FileTarget(name, seed, ("simulate", BAD, "--angle", "10deg", *shot))
    pattern = ("psf", "--wavelengths", "1", "--light", "535nm", "-o", "out/o.tif", "--camera", BAD)
    yield FileTarget("camera", "camera/camera.toml", pattern)
    yield FileTarget("camera", "camera/camera.toml", ("camera", "show", BAD))
    yield FileTarget("camera", "camera/camera.toml", ("fabricate", BAD, "-o", "out/o"))
    yield FileTarget("camera", "camera/camera.toml", ("design", "tolerance", BAD, "--show"))
    yield FileTarget("curve", "camera/curve.csv", ("camera", "show", "curved"))
    yield FileTarget("material", "glass.toml", ("material", "show", BAD))
    for kind in ("csv", "txt", "xyz", "tif"):
        relief = ("camera", "relief", "camera", BAD, "--pitch", "1um", "--unit", "um")
        yield FileTarget(f"relief-{kind}", f"map.{kind}", (*relief, "--tile", "-o", "out/o"))
    focus = ("refocus", "raw.png", "--psfs", BAD, "-o", "out/o", "--depth", "100mm", *QUICK)
    yield FileTarget("psfs", "set/psfs.toml", (*focus, "--support", "24x32"))
    yield FileTarget("psfs", "set/psfs.toml", ("calibrate", "distances", BAD, "--at", "20cm"))
    yield FileTarget("psfs", "set/psfs.toml", ("calibrate", "plan", BAD, "--angle", "20deg"))
    study = ("design", "tolerance", "small", BAD, "--model", "rays", "--trials", "50")
    yield FileTarget("tolerances", "tolerances.toml", (*study, "-o", "out/o"))
    yield FileTarget("figures-tif", "psf.tif", ("measure", "psf", BAD, "--pixel", "3.1um"))
    point = ("calibrate", BAD, "--distance", "300mm", "--pixel", "1.55um", "-o", "out/o")
    yield FileTarget("point-dng", "psf.dng", point)
    yield FileTarget("point-tif", "psf.tif", point)

    # Files of our own that no command takes alone: see `readers`.
    yield FileTarget("record", "record.json", ("@record", BAD))
    yield FileTarget("job", "job/job.json", ("@job", BAD))
    yield FileTarget("workspace", "set/psfs.toml", ("@workspace", BAD))
    yield FileTarget("workspace", "camera/camera.toml", ("@workspace", BAD))


FILES = tuple(_reads())
"""Every command that reads a file."""

_OF_CORPUS = {
    "info": ("frame",),
    "simulate": ("scene",),
    "reconstruct": ("psf-", "sequence"),
    "resume": ("state",),
    "relief": ("relief-csv",),
    "toml": ("camera", "material", "tolerances", "config", "psfs", "workspace"),
    "psfs": ("psfs", "workspace"),
    "json": ("record", "job"),
}


def of_corpus(name: str) -> list[FileTarget]:
    """Targets of a file of the corpus, by the first word of its name; one for each command."""
    word = name.partition("-")[0]
    starts = _OF_CORPUS.get(word, (word,))
    chosen = {each.command: each for each in FILES if each.name.startswith(starts)}
    return list(chosen.values())


BASES: dict[tuple[str, ...], tuple[str, ...]] = {
    ("reconstruct",): ("raw.png", "--psf", "psf.png", "-o", "out/o.png", *QUICK),
    ("refocus",): (
        "raw.png",
        "--psfs",
        "set",
        "-o",
        "out/o",
        "--depth",
        "100mm",
        *QUICK,
        "--support",
        "24x32",
    ),
    ("info",): ("raw.png",),
    ("simulate",): (
        "scene.png",
        "--camera",
        "camera",
        "-o",
        "out/o.dng",
        "--angle",
        "10deg",
        "--wavelengths",
        "1",
        "--field-points",
        "1",
    ),
    ("psf",): ("--camera", "camera", "-o", "out/o.tif", "--wavelengths", "1"),
    ("calibrate",): ("psf.dng", "--distance", "300mm", "--pixel", "1.55um", "-o", "out/o"),
    ("calibrate", "plan"): ("camera", "--angle", "20deg"),
    ("measure", "psf"): ("psf.tif", "--pixel", "3.1um"),
    ("measure", "field"): ("set",),
    ("camera", "relief"): (
        "camera",
        "map.csv",
        "--pitch",
        "1um",
        "--unit",
        "um",
        "--tile",
        "-o",
        "out/o",
    ),
    ("camera", "show"): ("camera",),
    ("material", "show"): ("pdms",),
    **{
        ("design", "mask", kind): ("--camera", "camera", "--overhang", "0.3mm", "-o", "out/o")
        for kind in ("random-lenslets", "lenslet-array", "diffuser")
    },
    ("design", "thickness"): (
        "--film",
        "0.305mm",
        "--film-distance",
        "0.4mm",
        "--material",
        "pua311",
    ),
    ("design", "tolerance"): ("small", "--model", "rays", "--trials", "50", "-o", "out/o"),
    ("fabricate",): ("camera", "-o", "out/o"),
}
"""A quick good call of each command, to which hostile options are added."""

_DANGEROUS = ("--device",)


@cache
def _application() -> App:
    app = application()
    for path in COMMANDS:
        app.command(f"nolens.cli.{path}")
    return app


@cache
def options(command: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Name and type of every option of a command."""
    app = _application()
    for word in command:
        app = app[word]
    arguments = app.assemble_argument_collection()
    return tuple(
        (each.names[0], str(each.hint))
        for each in arguments
        if each.names[0].startswith("--") and each.names[0] not in (*_DANGEROUS, "--*")
    )


_PATHS = (
    "raw.png",
    "psf.tif",
    "map.csv",
    "camera",
    "set",
    "out",
    "nothing",
    "/dev/zero",
    "scene.jpg",
)


@st.composite
def calls(draw: Draw, command: tuple[str, ...]) -> list[str]:
    """A call of a command with up to three hostile options."""
    given = [*command, *BASES[command]]
    for _ in range(draw(st.integers(1, 3))):
        name, kind = draw(st.sampled_from(options(command)))
        if "bool" in kind:
            given.append(name)
            continue
        if "int" in kind or "float" in kind:
            value = draw(numbers)
        elif "Path" in kind:
            value = draw(st.one_of(st.sampled_from(_PATHS), texts))
        else:
            value = draw(st.one_of(quantities, quantities, windows, numbers, texts))
        given.append(f"{name}={value}")
    # The system takes no NUL in an argument, and no more than 128 kB in one.
    return [each.replace("\0", "")[:100_000] for each in given]


JOB_KINDS = (
    "reconstruct",
    "refocus",
    "simulate",
    "psf",
    "calibrate",
    "design-thickness",
    "preview",
    "fabricate",
    "measure-psf",
    "measure-field",
)


@st.composite
def requests(draw: Draw) -> tuple[str, str, Any]:
    """Method, path and body of a request to the studio."""
    path = draw(
        st.sampled_from(
            (
                "jobs",
                "live/start",
                "live/settings",
                "live/scene",
                "live/save",
                "files",
                "file",
                "uploads",
                "about",
                "jobs/x",
                "jobs/x/cancel",
                "camera",
            )
        )
    )
    method = draw(st.sampled_from(("POST", "POST", "GET", "PATCH", "PUT", "DELETE")))
    body: Any = draw(values())
    if path == "jobs":
        names = st.sampled_from(
            (
                "camera",
                "light",
                "output",
                "measurement",
                "psf",
                "tau",
                "film",
                "iterations",
                "depth",
                "scene",
                "support",
                "crop",
            )
        )
        body = {
            "kind": draw(st.sampled_from(JOB_KINDS)),
            "options": draw(st.dictionaries(names, values(), max_size=4)),
        }
    elif path == "live/settings":
        names = st.sampled_from(("tau", "iterations", "exposure_s", "gain", "frozen", "method"))
        body = draw(st.dictionaries(names, values(), max_size=3))
    query = draw(st.sampled_from(("", "?path=work", "?path=../x", "?name=a.png", "?path=")))
    if draw(st.booleans()):
        query = f"?path=work/{draw(texts)}"[:5000]
    return method, path + query, body
