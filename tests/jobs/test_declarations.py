"""A job is declared once: every option has its text where its field is, and nowhere else."""

import ast
import importlib
import pkgutil
from collections import Counter
from pathlib import Path
from typing import Annotated

import pytest

import nolens
from nolens.jobs import PsfOptions
from nolens.jobs.fields import FilePath
from nolens.jobs.options import JobOptions, Option
from nolens.studio.job_process import declarations

SOURCES = [
    path
    for room in ("jobs", "reproduction", "cli")
    for path in sorted((Path(nolens.__file__).parent / room).rglob("*.py"))
]


def models() -> list[type[JobOptions]]:
    for module in pkgutil.walk_packages(nolens.__path__, "nolens."):
        if module.name.startswith(("nolens.jobs.", "nolens.reproduction.")):
            importlib.import_module(module.name)
    found: list[type[JobOptions]] = [JobOptions]
    for each in found:
        found += [child for child in each.__subclasses__() if child not in found]
    # Of bases such as CameraOptions, each job says what it means by them.
    return [each for each in found if not each.__subclasses__() and each.__module__ != __name__]


@pytest.mark.parametrize("model", models(), ids=lambda each: str(each.__name__))
def test_every_field_says_what_it_means(model: type[JobOptions]) -> None:
    assert model.__doc__ and "Attributes\n" not in model.__doc__
    for name, field in model.model_fields.items():
        option = Option.of(model, name)
        assert option.help.endswith((".", ")")), name
        assert "[default" not in option.help and not option.help.endswith("Needed."), name
        assert bool(option.needed) == field.is_required(), name
        assert not (option.group and (field.is_required() or option.positional)), name


def test_no_text_is_written_twice() -> None:
    texts: Counter[str] = Counter()
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "Option" and node.args:
                texts[ast.unparse(node.args[0])] += 1
    assert sum(texts.values()) > 150
    assert [text for text, count in texts.items() if count > 1 and len(text) > 40] == []


def test_commands_declare_no_options() -> None:
    """Those that run no job have some: info, show and list, studio."""
    by_hand = {"info": 3, "show_camera": 2, "list_materials": 1, "show_material": 2, "studio": 5}
    for path in SOURCES:
        if path.parent.name == "cli" and path.name not in ("command.py", "app.py"):
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                    count = len(node.args.posonlyargs + node.args.args + node.args.kwonlyargs)
                    count += node.args.vararg is not None
                    assert count <= by_hand.get(node.name, 1), node.name


def test_former_names_are_taken_with_a_note(tmp_path: Path) -> None:
    notes: list[str] = []
    stored = tmp_path / "psf.toml"
    stored.write_text('depth = "80mm"\ncamera = "small"\n')
    given = {"at": "20deg,0deg", "output": tmp_path / "psf.tif"}
    options = PsfOptions.gather(given, stored, notes.append)
    assert str(options.angle[0]) == "20 deg" and str(options.distance) == "80 mm"
    assert [note.split(";")[0] for note in notes] == [
        "depth is called distance now", "at is called angle now",
    ]  # fmt: skip


def test_paths_of_a_file_start_from_its_folder(tmp_path: Path) -> None:
    class Options(JobOptions):
        """Nothing."""

        raw: Annotated[FilePath, Option("A file.", role="input", needed="it")]
        camera: Annotated[str, Option("A camera.", role="camera")] = "paper"

    (tmp_path / "mine").mkdir()
    config = tmp_path / "run.toml"
    for name, camera in (("mine", str(tmp_path / "mine")), ("small", "small")):
        config.write_text(f'raw = "raw.dng"\ncamera = "{name}"\n')
        options = Options.gather({}, config)
        assert (options.raw, options.camera) == (tmp_path / "raw.dng", camera)


def test_studio_has_what_the_jobs_declare() -> None:
    found = declarations()
    assert found["reconstruct"]["tau"]["label"] == "τ, weight of the prior"
    assert found["measure-field"]["psfs"]["role"] == "input"
    assert found["calibrate"]["name"]["label"] == "Folder of its PSFs"
    reconstruct = found["reconstruct"]
    assert reconstruct["quality"]["choices"] == ["draft", "photo", "exact"]
    assert reconstruct["prior"]["default"] == "auto" and "l1" in reconstruct["prior"]["choices"]
    assert reconstruct["low_frequency"]["choices"] == ["on", "off"]
    assert (reconstruct["detail"]["group"], reconstruct["tau"]["group"]) == ("", "Model and solver")
    assert reconstruct["crop"]["choices"] == []  # A window is taken beside "all".
    for kind, options in found.items():
        assert any(each["role"] in ("input", "camera") for each in options.values()), kind
