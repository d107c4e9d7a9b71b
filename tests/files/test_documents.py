from datetime import date

import pytest

from nolens.documents import parse_json, parse_toml
from nolens.errors import DataError, FileError
from nolens.files import read_text

DEEP = 3000
DIGITS = "1" * 5000

BAD_TOML = {
    "a = ": r"^x.toml is no TOML file: Invalid value .*(line 1|end of document)",
    "a" * 2_000_001: "has 2000001 characters: a TOML file may have 2 million",
    f"a = {'[' * DEEP}{']' * DEEP}": "inside one another more than 40 deep",
    f"a = {'{a=' * DEEP}1{'}' * DEEP}": "more than 40 deep",
    f"[{'a.' * DEEP}a]\nb = 1": "key of 6001 characters in line 1",
    f"[{'a . ' * DEEP}a]\nb = 1": "more than 40 deep",
    '"a".' * DEEP + "a = 1": "more than 40 deep",
    f"{'a={' + ' . '.join(30 * 'a') + '={' + ' . '.join(30 * 'b')}=1}}}}": "more than 40 deep",
    # A quote inside of a text or a comment hides no bracket behind it.
    f'a = "\\"" # \'\nb = {"[" * DEEP}': "more than 40 deep",
    f'a = """\\""""""\nb = {"[" * DEEP}': "more than 40 deep",
    f"a = '''''''''\nb = {'[' * DEEP}": "more than 40 deep",
    f"a = 1\nb = {DIGITS}": "of 5000 characters in line 2: give at most 100",
    f"a = 0x{DIGITS}": "of 5002 characters",
    f"a = 0.{DIGITS}": "of 5002 characters",
    f'a = "{"b" * 1_000_001}"': "a text of 1000001 characters: give at most 1000000",
    f"a = {'[1],' * 1000}\n": "Invalid|Expected",
    '"' + "\\u001b\\n" * 90 + '".a = 1\n' + '"' + "\\u001b\\n" * 90 + '" = 1': "^[ -~]{,260}$",
}
BAD_JSON = {
    "{": "^x.json is no JSON: Expecting property name",
    " " * 16_000_001: "a JSON may have 16 million",
    f"{'[' * DEEP}{']' * DEEP}": "more than 40 deep",
    '{"a":' * DEEP + "1" + "}" * DEEP: "more than 40 deep",
    f'["\\"", {"[" * DEEP}': "more than 40 deep",
    DIGITS: "of 5000 characters in line 1",
    "1e999": "1e999 is beyond the largest number",
    "NaN": "NaN is no number",
    "[-Infinity]": "-Infinity is no number",
    '["\\ud800"]': "half of a character",
    '{"\\udfff": 1}': "half of a character",
}


@pytest.mark.parametrize(
    ("parse", "source", "text", "message"),
    [
        *((parse_toml, "x.toml", text, message) for text, message in BAD_TOML.items()),
        *((parse_json, "x.json", text, message) for text, message in BAD_JSON.items()),
    ],
    ids=lambda value: value[:20] if isinstance(value, str) else "",
)
def test_a_document_beyond_the_limits_is_refused_in_one_line(parse, source, text, message):
    with pytest.raises(DataError, match=message) as caught:
        parse(text, source)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


def test_what_looks_deep_but_is_not_is_read():
    brackets = "[{" * DEEP
    text = f'''
a = "{brackets}\\"{brackets}"
b = '{brackets}"'  # {brackets}
c = """{brackets}
"" {brackets}\\""" {brackets}"""""
d = \'\'\'{brackets}''{brackets}\'\'\'''
[x.y."z.z"]
n = [1.5, -2e-3, 1_000, 0xff, 2020-01-01]
'''
    read = parse_toml(text, "x.toml")
    assert read["a"] == f'{brackets}"{brackets}' and read["b"] == f'{brackets}"'
    assert read["c"] == f'{brackets}\n"" {brackets}""" {brackets}""'
    assert read["d"] == f"{brackets}''{brackets}''"
    assert read["x"]["y"]["z.z"]["n"] == [1.5, -2e-3, 1000, 255, date(2020, 1, 1)]
    assert parse_json(f'["{brackets}\\"{brackets}", 1.5, "\\ud83d\\ude00"]', "x.json") == [
        f'{brackets}"{brackets}', 1.5, "😀",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "text", ['"""\\' * 400_000, "'''\"" * 400_000, '"\\' * 800_000, "a='" * 600_000]
)
def test_texts_without_an_end_take_no_longer(text):
    # A scan that goes back would take hours.
    for parse in (parse_toml, parse_json):
        with pytest.raises(DataError):
            parse(text, "x")


def test_only_whole_files_of_utf_8_are_texts(tmp_path):
    file = tmp_path / "a.toml"
    file.write_bytes(b"\xff")
    with pytest.raises(FileError, match=r"a.toml is no TOML file: .*0xff"):
        read_text(file)
    with file.open("wb") as content:
        content.truncate(5 * 10**9)
    with pytest.raises(FileError, match=r"more than 16 million bytes, which no record has. Give"):
        read_text(file, "record", "Give another")
    for path in ("/dev/zero", tmp_path, "a\0b", "~nobody-at-all/a", "none"):
        with pytest.raises(FileError, match=r"^cannot read"):
            read_text(path)
