"""The list of commands: quick, and in the commands' own words."""

import importlib
import inspect

from cyclopts import App
from running import command, run

from nolens.cli.app import COMMANDS


def test_list_says_what_each_command_says_of_itself() -> None:
    for path, sentence in COMMANDS.items():
        module, name = path.split(":")
        there = getattr(importlib.import_module(f"nolens.cli.{module}"), name)
        own = there.help if isinstance(there, App) else inspect.getdoc(there)
        assert " ".join(own.split("\n\n")[0].split()) == sentence


def test_help_names_every_command() -> None:
    shown = command("--help")
    assert shown.code == 0
    for path in COMMANDS:
        assert f" {path.split(':')[1]} " in shown.out


def test_a_commands_own_help_says_all_of_it() -> None:
    shown = run("simulate", "--help")
    assert shown.code == 0
    assert "--exposure" in shown.out
    assert len(shown.out) > 1000
