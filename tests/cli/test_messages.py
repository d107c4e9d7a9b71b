"""What a terminal is told: plain text, a line for each message, and not too long."""

import json

import pytest

from nolens.cli.messages import say, show
from nolens.printable import quoted

HOSTILE = [
    ("a\nb", r"a\nb"),
    ("\x1b[2Jgone\x07", r"\u001b[2Jgone\u0007"),
    ("\x9b31m \x7f \t \r", r"\u009b31m \u007f \t \r"),
    ("photo\u202egnp.exe\u2066", r"photo\u202egnp.exe\u2066"),
    ("\u2028\u2029\x85\x0c", r"\u2028\u2029\u0085\u000c"),
    ("half \udcff", r"half \udcff"),
    ("[red]3×2 µm − 5 °[/red] \u00a0é 像 🔬", "[red]3×2 µm − 5 °[/red] \u00a0é 像 🔬"),
]


@pytest.mark.parametrize(("text", "shown"), HOSTILE)
def test_terminal_gets_plain_text(
    text: str, shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    say(text)
    show(text)
    assert capsys.readouterr() == (f"{shown}\n", f"nolens: {shown}\n")


def test_json_keeps_its_meaning(capsys: pytest.CaptureFixture[str]) -> None:
    everything = "".join(map(chr, range(0x3000)))
    show(json.dumps(everything))
    assert json.loads(capsys.readouterr().out) == everything


def test_long_messages_keep_their_advice(capsys: pytest.CaptureFixture[str]) -> None:
    say(f"begin {4000 * 'x'}: give a shorter one")
    said = capsys.readouterr().err
    assert said.startswith("nolens: begin xxx") and said.endswith("xxx: give a shorter one\n")
    assert "… (2526 characters left out) …" in said
    assert len(said) < 1600


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("a\x1b", r"'a\x1b'"),
        (10**5000, "too long to be shown"),
        (list(range(100)), "[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 1… 95, 96, 97, 98, 99]"),
    ],
    ids=["text", "number", "list"],
)
def test_values_in_messages_are_short(value: object, text: str) -> None:
    assert quoted(value) == text
