"""How a job is declared: the fields of its options, their checks, and the files they name."""

import difflib
import os
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    Self,
    Union,
    get_args,
    get_origin,
)

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from nolens.documents import parse_toml
from nolens.errors import OptionError
from nolens.files.formats import Address
from nolens.files.input import read_text
from nolens.printable import quoted
from nolens.quantities import Quantity

RECORD = "record of the run"
Role = Literal["value", "input", "output", "camera", "material"]
"""What a field names: a value, files to read or to write, a camera, or a material."""


@dataclass(frozen=True)
class Option:
    """What a person is told of a field, as in ``steps: Annotated[int, Option("How many.")] = 9``.

    Everything that shows or takes a job's options (the command line, its help, TOML files, the
    studio and the record) takes them from here.

    Attributes
    ----------
    help
        What it means, as a person reads it.
    group
        Heading under which ``--help-all`` and the page's "More" list it. Without one it is among
        what most people need, which ``--help`` lists.
    default
        What is taken where nothing is given, for a field without a plain default.
    needed
        For a field without a default: what is to be named, and how.
    role
        What it names.
    what
        What messages and the record call its file; its name, where nothing is said.
    suffixes
        Those that a file to write may have.
    flag
        A short spelling, such as ``-o``.
    positional
        Whether it is given by its place, without its name.
    negative
        Whether a switch can be turned off by ``--no-...``.
    several
        Whether one name may be followed by several values.
    label
        What the studio's page calls it.
    former
        Its name in the version before, which is still taken, with a note.
    former_switch
        The value that the former name, a switch, stands for.
    """

    help: str
    group: str = ""
    _: KW_ONLY
    default: str = ""
    needed: str = ""
    role: Role = "value"
    what: str = ""
    suffixes: tuple[str, ...] = ()
    flag: str = ""
    positional: bool = False
    negative: bool = True
    several: bool = False
    label: str = ""
    former: str = ""
    former_switch: str = ""

    @classmethod
    def of(cls, model: "type[JobOptions]", name: str) -> "Option":
        """What is declared for a field.

        Raises
        ------
        TypeError
            If nothing is: every field of a job's options has its text.
        """
        for each in reversed(model.model_fields[name].metadata):
            if isinstance(each, cls):
                return each
        raise TypeError(f"{model.__name__}.{name} has no Option: say what it means")


class Written(NamedTuple):
    """A file that a job writes.

    Parameters
    ----------
    what
        Its role, for messages.
    path
        Where it goes.
    option
        The option that names it.
    suffixes
        Those it may have; empty where the job itself names the file.
    """

    what: str
    path: Path
    option: str = "-o"
    suffixes: tuple[str, ...] = ()


class JobOptions(BaseModel):
    """Options of a job: unchangeable, without unknown names.

    The docstring of a model is the help of its command, and every field has an `Option`.

    Attributes
    ----------
    usage
        The shortest way to run it.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True
    )
    usage: ClassVar[str] = ""

    @field_validator("*", mode="before")
    @classmethod
    def _one_of_several(cls, value: Any, info: ValidationInfo) -> Any:
        """One text, path or quantity stands for a tuple of it, where any number is meant."""
        field = cls.model_fields[str(info.field_name)]
        read = any(isinstance(each, BeforeValidator) for each in field.metadata)
        one = isinstance(value, (str, Path, Quantity)) and not read
        return (value,) if one and _takes_several(field.annotation) else value

    @classmethod
    def gather(
        cls,
        choices: dict[str, Any],
        config: Path | None = None,
        note: Callable[[str], None] = lambda text: None,
    ) -> Self:
        """Options as a person gave them and, for what that leaves out, from a TOML file.

        Parameters
        ----------
        choices
            Options by name.
        config
            TOML file with any of the same names; relative paths in it start from its folder.
        note
            Is told of names of the version before.

        Raises
        ------
        FileError
            If the TOML file cannot be read.
        DataError
            If it is no TOML file.
        OptionError
            If a name is unknown (with the nearest known one), one is missing, its value cannot be
            used, or two do not go together.
        """
        stored = {} if config is None else cls._stored(expand_home(config))
        values: dict[str, Any] = {}
        for key, value in {**stored, **choices}.items():
            name = cls.spellings().get(key, "")
            if not name:
                raise OptionError(f"there is no option {key!r}{_nearest(key, cls.spellings())}")
            if key != name and Option.of(cls, name).former == key:
                note(f"{key} is called {name} now; the former name goes with the next version")
                switch = Option.of(cls, name).former_switch
                if switch and value is not True:
                    continue
                value = switch or value
            if name not in values or key in choices:
                values[name] = value
        for name in sorted(cls.model_fields, key=lambda each: not Option.of(cls, each).positional):
            field = cls.model_fields[name]
            if field.is_required() and values.get(name) in (None, "", (), []):
                one = name.removesuffix("s") if _takes_several(field.annotation) else name
                one = one.replace("_", " ")
                raise OptionError(f"no {one} is given; name {Option.of(cls, name).needed}")
        external = {name: field.alias or name for name, field in cls.model_fields.items()}
        try:
            options = cls.model_validate({external.get(key, key): values[key] for key in values})
        except ValidationError as error:
            sources = dict.fromkeys({*stored} - {*choices}, config)
            raise OptionError(explain(error, sources)) from None
        options.check_together()
        if config is not None:
            check_apart(options, {"configuration": config})
        return options

    def check_together(self) -> None:
        """Refuse options that do not go together; `model_fields_set` has those that were given.

        Raises
        ------
        OptionError
            If there are such.
        """

    @classmethod
    def _stored(cls, config: Path) -> dict[str, Any]:
        """Values of a TOML file, its relative paths from its folder."""
        values = parse_toml(read_text(config), str(config))
        names = [name.replace("-", "_") for name in values]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice:
            raise OptionError(
                f"{config} has the key {twice} twice, with _ and with -: leave one out"
            )
        values = dict(zip(names, values.values(), strict=True))
        spellings = cls.spellings()
        for key, value in values.items():
            if key not in spellings:
                raise OptionError(
                    f"{config} has the key {key!r}, which is no option{_nearest(key, spellings)}"
                )
            name = spellings[key]
            role = Option.of(cls, name).role
            several = _takes_several(cls.model_fields[name].annotation)
            if role in ("input", "output"):
                values[key] = _beside(config, key, value, several=several)
            elif role in ("camera", "material"):
                names = value if several and isinstance(value, list) else [value]
                there = [_beside_or_known(config, each) for each in names]
                values[key] = there if names is value else there[0]
        return values

    @classmethod
    def spellings(cls) -> dict[str, str]:
        """Field by each name that a person may give it, its own first."""
        fields = {field.alias or name: name for name, field in cls.model_fields.items()}
        for name in cls.model_fields:
            fields.setdefault(name, name)
            former = Option.of(cls, name).former
            fields |= {former: name} if former else {}
        return fields

    @classmethod
    def flag(cls, name: str) -> str:
        """How a field is given on the command line: ``-o``, ``--dot-pitch``."""
        external = cls.model_fields[name].alias or name
        return Option.of(cls, name).flag or f"--{external.replace('_', '-')}"

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role; those of a field with several are numbered."""
        files: dict[str, Path] = {}
        for name in type(self).model_fields:
            option, value = Option.of(type(self), name), getattr(self, name)
            if option.role == "input":
                role, paths = option.what or name, value if isinstance(value, tuple) else (value,)
                for number, path in enumerate(paths, start=1):
                    if path is not None:
                        file = Address.of(path).file
                        files[f"{role} {number}" if len(paths) > 1 else role] = file
        return files

    @property
    def files(self) -> tuple[Written, ...]:
        """Files that fields with suffixes name."""
        files = []
        for name in type(self).model_fields:
            option, path = Option.of(type(self), name), getattr(self, name)
            if option.suffixes and path is not None:
                what = option.what or name
                files.append(Written(what, path, self.flag(name), option.suffixes))
        return tuple(files)

    @property
    def written(self) -> tuple[Written, ...]:
        """All files that are written, the record last."""
        files, record = self.files, self.record
        if record is None:
            return files
        return (*files, Written(RECORD, record, files[0].option if files else "-o"))

    @property
    def record(self) -> Path | None:
        """File of the run's record; None where none is written."""
        return None

    @property
    def output_folder(self) -> Path | None:
        """Folder that is made for what is written; None where there must be one."""
        return None


def _beside(config: Path, name: str, value: Any, *, several: bool) -> Any:
    """A path of a TOML file, or a list of them, from the folder of that file."""
    files = value if several and isinstance(value, list) else [value]
    if not all(isinstance(each, str) for each in files):
        more = " or a list of them" if several else ""
        raise OptionError(f"{name} in {config} is {value!r}; give the path of a file{more}")
    paths = tuple(config.parent / expand_home(Path(each)) for each in files)
    return paths if several else paths[0]


def _beside_or_known(config: Path, name: Any) -> Any:
    """The name of a camera or material that there is, unless a file or folder has it."""
    if not isinstance(name, str):
        return name
    there = config.parent / expand_home(Path(name))
    return str(there) if os.path.lexists(there) else name


def expand_home(path: Path) -> Path:
    """Take ~ for the home folder, where the shell has not done so (--psf=~/psf.dng)."""
    try:
        return path.expanduser()
    except RuntimeError:  # No such user: then it is a name like any other.
        return path


def _nearest(name: str, known: Mapping[str, str]) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    return f". Did you mean {near[0]!r}?" if near else f"; known are {', '.join(known)}"


def _takes_several(annotation: Any) -> bool:
    """Whether a type is a tuple of any length, or is one of several that a value may have."""
    if get_origin(annotation) is tuple:
        return get_args(annotation)[-1] is Ellipsis
    return any(_takes_several(each) for each in get_args(annotation))


def default_text(model: type[JobOptions], name: str) -> str:
    """What is taken where an option is left out, as text; empty where that says nothing."""
    field = model.model_fields[name]
    return Option.of(model, name).default or (
        "" if field.is_required() else _as_text(field.default)
    )


def _as_text(value: Any) -> str:
    if value is None or value is False or value == ():
        return ""
    if value is True:
        return "on"
    if isinstance(value, tuple):
        return ",".join(map(_as_text, value))
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, Quantity):
        return f"{value.number}{value.unit}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def choices_of(annotation: Any) -> tuple[str, ...]:
    """The values of a type that has a few, as text; none where other values are taken too.

    Files that are taken in place of a value count for nothing.
    """
    inner = [each for each in get_args(annotation) if each is not NoneType]
    if get_origin(annotation) in (Union, UnionType):
        return choices_of(inner[0]) if len(inner) == 1 or _is_path(inner[1]) else ()
    if get_origin(annotation) is Annotated:
        return choices_of(inner[0])
    if get_origin(annotation) is Literal:
        return tuple(str(each) for each in get_args(annotation))
    if annotation is bool:
        return ("on", "off")
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return tuple(str(each.value) for each in annotation)
    return ()


def _is_path(annotation: Any) -> bool:
    return annotation is Path or get_args(annotation)[:1] == (Path,)


def check_apart(options: JobOptions, read: Mapping[str, Path]) -> None:
    """Refuse to write over a file that is read, or over another one that is written.

    Parameters
    ----------
    options
        They name the files to write.
    read
        Files that are read, by role.

    Raises
    ------
    OptionError
        If two of them are one file.
    """
    before: list[Path] = []
    for what, path, option, _ in options.written:
        for role, other in read.items():
            if _same(path, other):
                raise OptionError(
                    f"the {what} {path} would overwrite the {role} {other}: give another name "
                    f"({option})"
                )
        if any(_same(path, other) for other in before):
            raise OptionError(
                f"the {what} {path} is given twice: give each its own name ({option})"
            )
        before.append(path)


def explain(error: ValidationError, sources: Mapping[str, Path | None] | None = None) -> str:
    """Say on one line what was given for which option, and what would be accepted.

    Parameters
    ----------
    error
        Of the model of the options.
    sources
        For options from a file, that file.
    """
    by_option: dict[str, list[str]] = {}
    errors = error.errors(include_url=False)
    places = [each["loc"] for each in errors]
    for each in errors:
        # A list whose only item is wrong is called empty as well.
        if any(place != each["loc"] == place[: len(each["loc"])] for place in places):
            continue
        name = str(each["loc"][0]) if each["loc"] else ""
        if sources and name in sources:
            what = f"{name} in {sources[name]}"
        else:
            what = f"--{name.replace('_', '-')}"
        message = each["msg"][:1].lower() + each["msg"][1:].partition(", unable to parse")[0]
        reasons = by_option.setdefault(f"{what} is {quoted(each['input'])}", [])
        reasons.append(message.removeprefix("input should be ") if reasons else message)
    return "; ".join(f"{what}: {' or '.join(reasons)}" for what, reasons in by_option.items())


def _same(one: Path, other: Path) -> bool:
    """Whether two paths lead to one file."""
    try:
        return one.resolve() == other.resolve() or one.samefile(other)
    except (OSError, ValueError, RuntimeError):  # At least one of them does not exist.
        return False
