"""What all parts of a camera's description have in common: checks and types of fields."""

import difflib
from pathlib import PurePosixPath
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from nolens.printable import printable, quoted
from nolens.quantities import Length
from nolens.ranges import Between


def refusal(reason: str, **about: Any) -> PydanticCustomError:
    """Give an error for validators to raise, whose message is `reason` and nothing else."""
    return PydanticCustomError("refused", "{reason}", {"reason": reason, **about})


class Part(BaseModel):
    """A part of a camera's description: unchangeable, without unknown or missing keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, fields: Any) -> Any:
        if not isinstance(fields, dict):
            return fields
        known = cls.model_fields
        for key in fields:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, n=1)
                meant = f": did you mean {near[0]!r}?" if near else "."
                raise refusal(
                    f"the key {quoted(key)} is unknown{meant} Known are {', '.join(known)}"
                )
        required = [name for name, field in known.items() if field.is_required()]
        missing = [name for name in required if name not in fields]
        if missing:
            be = "is" if len(missing) == 1 else "are"
            raise refusal(f"{', '.join(missing)} {be} missing: give {', '.join(required)}")
        return fields


def _on_a_line(text: str) -> str:
    if printable(text) != text:
        raise refusal("it must be on one line, without control characters")
    return text


def _file_in_folder(*suffixes: str) -> AfterValidator:
    """Check that text is the name of a file in the camera's folder, with one of the suffixes."""

    def check(file: str) -> str:
        path = PurePosixPath(file)
        inside = not path.is_absolute() and ".." not in path.parts and "\0" not in file
        if not inside or path.suffix.lower() not in suffixes:
            raise refusal(
                f"it must be a {' or '.join(suffixes)} file in the camera's folder, such as "
                f"name{suffixes[0]}"
            )
        return file

    return AfterValidator(check)


Number = Annotated[float, Field(strict=True)]
Counts = Annotated[float, Between(-1e9, 1e9)]
"""A level in the counts of a file."""
UnitInterval = Annotated[Number, Between(0, 1)]
Wavelength = Annotated[Number, Between(1, 1e6)]
"""In nm: soft X-rays to the far infrared."""
Text = Annotated[str, Field(min_length=1, max_length=1000), AfterValidator(_on_a_line)]
ChannelName = Annotated[str, Field(min_length=1, max_length=40), AfterValidator(_on_a_line)]
PositiveLength = Annotated[Length, Between("1 nm", "10 m")]
"""Of what can be made or measured of a camera."""
PixelPitch = Annotated[Length, Between("50 nm", "10 mm")]
"""From one pixel to the next, or of pixels that are added up."""
CsvFile = Annotated[str, Field(max_length=255), _file_in_folder(".csv")]
TiffFile = Annotated[str, Field(max_length=255), _file_in_folder(".tif", ".tiff")]
MapFile = Annotated[str, Field(max_length=255), _file_in_folder(".tif", ".tiff", ".npy")]
