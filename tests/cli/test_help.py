"""Help: the list of commands in the commands' own words, and what each lists at first."""

import importlib
import inspect
import re
from collections.abc import Iterator

from cyclopts import App
from running import run

from nolens.cli.app import COMMANDS


def test_list_says_what_each_command_says_of_itself() -> None:
    for path, sentence in COMMANDS.items():
        module, name = path.split(":")
        there = getattr(importlib.import_module(f"nolens.cli.{module}"), name)
        own = there.help if isinstance(there, App) else inspect.getdoc(there)
        assert " ".join(own.split("\n\n")[0].split()) == sentence


def test_help_names_every_command() -> None:
    shown = run("--help")
    assert shown.code == 0
    for path in COMMANDS:
        assert f" {path.split(':')[1]} " in shown.out
    assert "--help-all every option" in " ".join(shown.out.split())


def listed(text: str) -> set[str]:
    """Names of the options that a help has a line for."""
    return set(re.findall(r"^│ (?:\*  )?(--[a-z-]+)", text, re.MULTILINE))


def commands() -> Iterator[tuple[str, ...]]:
    """Every command by its words, parts of groups too."""
    for path in COMMANDS:
        module, name = path.split(":")
        there = getattr(importlib.import_module(f"nolens.cli.{module}"), name)
        yield from parts(there, (name,)) if isinstance(there, App) else [(name,)]


def parts(app: App, words: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    if app.default_command is not None and words[-1] != "mask":
        yield words
    for name, part in app.resolved_commands().items():
        if not name.startswith("-") and part.show:
            yield from parts(part, (*words, name))


def test_help_says_how_many_options_it_leaves_out() -> None:
    every = list(commands())
    assert {("calibrate",), ("measure", "resolution", "edge"), ("design", "mask", "contour")} <= {
        *every
    }
    for words in every:
        brief, full = run(*words, "--help"), run(*words, "--help-all")
        assert (brief.code, full.code) == (0, 0), words
        assert listed(brief.out) <= listed(full.out) and "--read-limit" in full.out, words
        left_out = listed(full.out) - listed(brief.out)
        last = brief.out.strip().splitlines()[-1]
        if left_out:
            assert last == f"{len(left_out)} more options: nolens {' '.join(words)} --help-all"
            assert {"--config", "--json"} <= left_out, words
        else:
            assert "--help-all" not in brief.out, words


def test_help_has_what_two_files_need_and_help_all_the_rest_by_group() -> None:
    brief, full = run("reconstruct", "-h"), run("reconstruct", "raw.dng", "--help-all")
    assert {"--psf", "--output", "--quality", "--detail", "--support"} <= listed(brief.out)
    assert "MEASUREMENT" in brief.out and "--relaxation" not in brief.out
    assert 2 * len(brief.out.splitlines()) < len(full.out.splitlines())
    titles = re.findall(r"^╭─ (.+?) ─", full.out, re.MULTILINE)
    assert titles[2:] == [
        "Several pictures of one frame",
        "Files and channels",
        "Model and solver",
        "Picture",
        "How it runs",
    ]
    files, most_need = {"--psf", "--output"}, {"--quality", "--detail", "--support", "--black"}
    assert listed(brief.out) - files - most_need <= {"--sweep", "--flip"}
    solver = full.out.split("─ Model and solver ─")[1].split("─ Picture ─")[0]
    assert {"--tau", "--method", "--prior", "--relaxation"} <= listed(solver)


def test_help_all_behind_two_hyphens_is_a_file() -> None:
    assert "no frames are given" not in (done := run("calibrate", "--", "--help-all")).err
    assert done.code == 2 and "Usage" not in done.out
