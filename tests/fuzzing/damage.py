"""Hypothesis strategies that damage good files, each kind where it hurts."""

import io
import json
import re
import struct
import tomllib
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import tomli_w
from hypothesis import strategies as st

Draw = Callable[[Any], Any]

_USUAL = """
0 -0.0 -1 1 2 0.5 1e-30 1e-300 5e-324 1e30 3e38 1e308 1e309 -1e308 nan inf -inf 65535 65536
4294967295 4294967296 2147483648 9223372036854775807 9223372036854775808 18446744073709551616
1e999999999 0x10 1_000 ٣ 1,5 ½
"""
NUMBERS = ("", "1" + "0" * 40, "9" * 5000, *_USUAL.split())
UNITS = (
    "mm",
    "um",
    "µm",
    "nm",
    "m",
    "km",
    "deg",
    "rad",
    "°",
    "%",
    "ms",
    "s",
    "cd/m2",
    "parsec",
    "",
)
TEXTS = (
    "",
    " ",
    "\0",
    "o\0.png",
    "\x1b[31mred\x1b[0m",
    "a\nb = 1\n",
    "\u202eabc",
    "\ufeff",
    "ü" * 50,
    "x" * 100_000,
    "../../etc/passwd",
    "/etc/passwd",
    "/dev/zero",
    "/proc/self/mem",
    "~nobody/x",
    "-",
    "--help",
    "[red]x",
    "{0.__class__}",
    "%s%n",
    "\u2028",
    "'; x",
    '"',
    "[" * 3000,
    "con",
    "out",
    ".",
)
FRAGMENTS = (
    "[" * 3000,
    "{a=" * 3000,
    "a" + ".a" * 3000 + " = 1\n",
    "x = " + "9" * 5000 + "\n",
    "x = 0x" + "f" * 5000 + "\n",
    "x = 1e" + "9" * 400 + "\n",
    '"""',
    "\x00",
    "\xff",
    "[[a]]\n" * 3000,
    "x = '" + "y" * 200_000 + "'\n",
    '{"a":' * 3000,
    "," * 5000,
    "\r" * 1000,
    "- " * 3000,
)
SIZES = (0, 1, 2, 3, 7, 16, 255, 256, 4096, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1)

numbers = st.sampled_from(NUMBERS)
quantities = st.builds(
    lambda number, space, unit: number + space + unit,
    numbers,
    st.sampled_from(("", " ", "  ")),
    st.sampled_from(UNITS),
)
windows = st.builds(
    lambda *each: "{}x{}{}".format(*each),
    numbers,
    numbers,
    st.sampled_from(("", "+0+0", "-5+3", "+99999999999999999999+0", "+", "x3")),
)
texts = st.one_of(st.sampled_from(TEXTS), st.text(max_size=20))
words = st.one_of(numbers, quantities, windows, texts)
"""What a person or a file might give for anything."""


def values(depth: int = 2) -> st.SearchStrategy[Any]:
    """Values of JSON and TOML: wrong types, extremes, nests."""
    leaves: st.SearchStrategy[Any] = st.one_of(
        st.none(),
        st.booleans(),
        st.sampled_from((0, -1, 1, 2**31, 2**63, -(2**63), 10**30, 10**400)),
        st.sampled_from((0.0, -0.0, 0.5, 1e-300, 1e300, float("nan"), float("inf"))),
        quantities,
        texts,
    )
    return st.recursive(
        leaves,
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=3),
        max_leaves=4 * depth,
    )


@st.composite
def garbled(draw: Draw, data: bytes) -> bytes:
    """Bytes changed, cut, doubled, and taken out, most of them near the start."""
    other = bytearray(data)
    for _ in range(draw(st.integers(1, 6))):
        size = max(1, len(other))
        last = draw(st.sampled_from((64, 512, size)))
        at = draw(st.integers(0, max(0, min(last, size) - 1)))
        act = draw(st.integers(0, 6))
        if act <= 1:
            other[at : at + 1] = bytes([draw(st.integers(0, 255))])
        elif act == 2:
            code = draw(st.sampled_from(("<H", ">H", "<I", ">I", "<Q", ">Q")))
            most = 2 ** (8 * struct.calcsize(code)) - 1
            word = struct.pack(code, min(draw(st.sampled_from(SIZES)), most))
            other[at : at + len(word)] = word
        elif act == 3:
            del other[at:]
        else:
            length = draw(st.sampled_from((1, 2, 4, 16, 100, 1000)))
            part = bytes(other[at : at + length])
            if act == 4:
                del other[at : at + length]
            elif act == 5:
                other[at:at] = part * draw(st.sampled_from((1, 2, 50)))
            else:
                to = draw(st.integers(0, size - 1))
                other[to : to + length] = part
    return bytes(other)


@st.composite
def png(draw: Draw, data: bytes) -> bytes:
    """Chunks changed with their checksums right."""
    chunks, at = [], 8
    while at + 8 <= len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        chunks.append((kind, data[at + 8 : at + 8 + length]))
        at += 12 + length
    for _ in range(draw(st.integers(1, 3))):
        number = draw(st.integers(0, len(chunks) - 1))
        kind, body = chunks[number]
        act = draw(st.integers(0, 5))
        if kind == b"IHDR" and len(body) == 13 and act < 4:
            fields = list(struct.unpack(">IIBBBBB", body))
            which = draw(st.integers(0, 6))
            most = 2**32 - 1 if which < 2 else 255
            fields[which] = min(draw(st.sampled_from((*SIZES, 12000, 4, 6))), most)
            chunks[number] = (kind, struct.pack(">IIBBBBB", *fields))
        elif kind == b"IDAT" and act < 2:
            zeros = draw(st.sampled_from((0, 100, 10**6, 10**8)))
            chunks[number] = (kind, zlib.compress(bytes(zeros), 9))
        elif act == 2:
            chunks.insert(number, (kind, body))
        elif act == 3:
            del chunks[number]
            if not chunks:
                break
        elif act == 4:
            other = draw(st.sampled_from((b"tRNS", b"PLTE", b"acTL", b"gAMA", b"iCCP", b"zTXt")))
            chunks.insert(number, (other, draw(st.binary(max_size=40))))
        else:
            chunks[number] = (kind, draw(garbled(body)) if body else body)
    parts = [data[:8]]
    for kind, body in chunks:
        crc = struct.pack(">I", zlib.crc32(kind + body))
        parts.append(struct.pack(">I", len(body)) + kind + body + crc)
    return b"".join(parts)


@st.composite
def tiff(draw: Draw, data: bytes) -> bytes:
    """Entries of the directories changed."""
    if data[:4] != b"II*\0":
        return bytes(draw(garbled(data)))
    other = bytearray(data)
    at = struct.unpack_from("<I", data, 4)[0]
    entries = []
    while 0 < at < len(data) - 2 and len(entries) < 200:
        count = struct.unpack_from("<H", data, at)[0]
        places = [at + 2 + 12 * number for number in range(count)]
        entries += [each for each in places if each + 12 <= len(data)]
        after = at + 2 + 12 * count
        at = struct.unpack_from("<I", data, after)[0] if after + 4 <= len(data) else 0
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.sampled_from(entries))
        which = draw(st.integers(0, 3))
        if which == 0:
            struct.pack_into(
                "<H",
                other,
                place,
                draw(
                    st.sampled_from(
                        (
                            256,
                            257,
                            258,
                            259,
                            262,
                            273,
                            277,
                            278,
                            279,
                            284,
                            317,
                            322,
                            323,
                            324,
                            325,
                            330,
                            339,
                            50706,
                            50717,
                            33422,
                            270,
                            0,
                            65535,
                        )
                    )
                ),
            )
        elif which == 1:
            struct.pack_into("<H", other, place + 2, draw(st.integers(0, 20)))
        else:
            size = draw(st.sampled_from(SIZES))
            struct.pack_into("<I", other, place + (4 if which == 2 else 8), size)
    return bytes(other)


@st.composite
def npy(draw: Draw, data: bytes) -> bytes:
    """The header's text changed."""
    shape = draw(
        st.one_of(
            st.lists(st.sampled_from((0, 1, 2, 3, 4, 7, 48, 10**6, 2**31, 2**63, -1)), max_size=5),
            st.just([48, 64, 2]),
            st.just([100_000, 100_000]),
        )
    )
    kind = draw(
        st.sampled_from(
            (
                "<f4",
                "<f8",
                "|u1",
                "<u2",
                ">u2",
                "<f2",
                "|O",
                "<c8",
                "|b1",
                "<i8",
                "|S5",
                "<U9",
                "<M8[s]",
                "|V9",
                "x",
                "<f99",
            )
        )
    )
    text = f"{{'descr': {kind!r}, 'fortran_order': {draw(st.booleans())}, 'shape': {tuple(shape)}}}"
    if draw(st.integers(0, 4)) == 0:
        text = draw(st.sampled_from(("__import__('os')", "[" * 3000, "{}", "(" * 500 + ")" * 500)))
    head = text.encode("latin-1") + b"\n"
    version = draw(st.sampled_from((b"\1\0", b"\2\0", b"\3\0", b"\x09\0")))
    length = struct.pack("<H" if version == b"\1\0" else "<I", len(head))
    return b"\x93NUMPY" + version + length + head + data[128:]


@st.composite
def npz(draw: Draw, data: bytes) -> bytes:
    """Members changed, added and left out."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(sorted(members)))
        act = draw(st.integers(0, 5))
        if act == 0:
            members.pop(name)
            if not members:
                break
        elif act == 1:
            members[draw(texts) or "x"] = members[name]
        elif act == 2:
            members[name] = draw(npy(members[name]))
        elif name == "about.npy" and act <= 4:
            text = json.dumps(draw(changed(_about(members[name]))))
            members[name] = _npy(np.array(text.replace("\0", "")))
        else:
            array = _array(members[name])
            if array is not None and array.dtype.kind == "f":
                fill = draw(st.sampled_from((np.nan, np.inf, -1.0, 0.0, 1e38)))
                shape = draw(st.sampled_from((array.shape, array.shape[::-1], array.shape[1:], ())))
                array = np.resize(array, shape)
                array = np.where(np.arange(array.size).reshape(shape) % 7 == 0, fill, array)
                members[name] = _npy(array.astype(np.float32))
    stream = io.BytesIO()
    packing = draw(st.sampled_from((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))
    with zipfile.ZipFile(stream, "w", packing) as archive:
        for name, body in members.items():
            archive.writestr(name.replace("\0", "_")[:200], body)
        if draw(st.integers(0, 9)) == 0:
            archive.writestr("more.npy", bytes(2 * 10**8), zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def _about(data: bytes) -> Any:
    try:
        return json.loads(str(_array(data)))
    except ValueError:
        return {"damaged": "before"}


def _array(data: bytes) -> Any:
    """What a member holds; None where it was damaged before."""
    try:
        with np.errstate(all="ignore"):
            return np.load(io.BytesIO(data))
    except Exception:  # Its header is text that numpy evaluates: it can raise nearly anything.
        return None


def _npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=False)
    return stream.getvalue()


@st.composite
def changed(draw: Draw, tree: Any) -> Any:
    """A tree of tables and lists with some values changed, renamed, doubled, taken out."""
    tree = json.loads(json.dumps(tree))
    for _ in range(draw(st.integers(1, 3))):
        node = tree
        while isinstance(node, dict | list) and node:
            keys = list(node) if isinstance(node, dict) else list(range(len(node)))
            key = draw(st.sampled_from(keys))
            if isinstance(node[key], dict | list) and node[key] and draw(st.integers(0, 4)):
                node = node[key]
                continue
            act = draw(st.integers(0, 6))
            if act == 0:
                del node[key]
            elif act == 1 and isinstance(node, dict):
                node[draw(texts)] = node.pop(key)
            elif act == 2:
                node[key] = [node[key]] * draw(st.sampled_from((2, 1000)))
            elif act == 3 and isinstance(node[key], str):
                node[key] = draw(st.one_of(numbers, quantities, texts))
            else:
                node[key] = draw(values())
            break
    return tree


@st.composite
def toml(draw: Draw, data: bytes) -> bytes:
    """Values changed where TOML can say it; else numbers and pieces of the text."""
    if draw(st.integers(0, 3)):
        try:
            tree = draw(changed(tomllib.loads(data.decode())))
            return tomli_w.dumps(tree).encode("utf-8", "surrogatepass")
        except (TypeError, ValueError, AttributeError):
            pass  # None, or another value that TOML does not have.
    return bytes(draw(table(data)))


@st.composite
def document(draw: Draw, data: bytes) -> bytes:
    """JSON with values changed."""
    if draw(st.integers(0, 4)):
        return json.dumps(draw(changed(json.loads(data)))).encode()
    return bytes(draw(table(data)))


@st.composite
def table(draw: Draw, data: bytes) -> bytes:
    """Text with some of its numbers changed, and hostile pieces put in."""
    text = data.decode("utf-8", "replace")
    places = list(re.finditer(r"-?[0-9][0-9.e+-]*", text))
    for _ in range(draw(st.integers(1, 4))):
        if places and draw(st.booleans()):
            match = places[draw(st.integers(0, len(places) - 1))]
            text = text[: match.start()] + draw(numbers) + text[match.end() :]
            places = [each for each in places if each.end() < match.start()]
        else:
            at = draw(st.integers(0, len(text)))
            text = text[:at] + draw(st.sampled_from(FRAGMENTS)) + text[at:]
            places = [each for each in places if each.end() < at]
    return text.encode("utf-8", "surrogatepass")


BY_SUFFIX: dict[str, Callable[[bytes], st.SearchStrategy[bytes]]] = {
    ".png": png,
    ".tif": tiff,
    ".dng": tiff,
    ".npy": npy,
    ".npz": npz,
    ".toml": toml,
    ".json": document,
    ".csv": table,
    ".txt": table,
    ".xyz": table,
}


class File(bytes):
    """The bytes of a file, which nobody wants to see in a message."""

    def __repr__(self) -> str:
        return f"<file of {len(self)} bytes>"


def damaged(data: bytes, suffix: str) -> st.SearchStrategy[bytes]:
    """A file of a kind, damaged as bytes or as what it is."""
    special, data = BY_SUFFIX.get(suffix), File(data)
    return garbled(data) if special is None else st.one_of(special(data), garbled(data))
