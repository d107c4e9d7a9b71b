"""What `nolens design tolerance` can be told, as a frozen model."""

import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from nolens.design.tolerances import Sharpness
from nolens.errors import OptionError
from nolens.jobs.fields import FilePath, Name, Seed, Word
from nolens.jobs.options import JobOptions, Written
from nolens.quantities import Length, Share
from nolens.ranges import Between

_TIMES = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*[x×]\s*")
_ENOUGH = "1000 show a yield to within 2 or 3 %"


class ToleranceOptions(JobOptions):
    """What `nolens design tolerance` can be told.

    Attributes
    ----------
    camera
        Preset, folder or .toml file.
    tolerances
        File of the parameters; None takes assumptions.
    output
        Folder for tolerance.json, trials.csv and tolerance.png.
    criterion
        See `nolens.design.tolerances.Sharpness`.
    model
        The twin's waves, or rays.
    light
        As in the simulations.
    trials, seed
        How many cameras are drawn, and with which random numbers.
    limit
        What a camera must meet: a length, a share, or so many times the nominal figure.
    wanted
        The yield that `solve` is for.
    solve
        Parameter whose tolerance is asked for.
    """

    camera: Name
    tolerances: FilePath | None = None
    output: FilePath
    criterion: Word = "line-width"
    model: Literal["wave", "rays"] = "wave"
    light: Word = "550nm"
    trials: Annotated[int, Between(10, 1_000_000, _ENOUGH)] = 1000
    seed: Seed = 0
    limit: Annotated[str, Field(max_length=40)] | None = None
    wanted: Annotated[Share, Between("0.01 %", "99.99 %")] | None = Field(None, alias="yield")
    solve: Word | None = None

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used, or two do not go together.
        """
        if not given.get("output"):
            raise OptionError("no output is given; name a folder for the trials and plots (-o out)")
        options = cls.checked(given)
        options._check_asked()
        return options

    def _check_asked(self) -> None:
        if (self.wanted is None) != (self.solve is None):
            raise OptionError(
                "--yield and --solve go together: the yield that is wanted, and the parameter "
                "whose tolerance is to be found, such as --yield 90% --solve resin.thickness"
            )
        if self.solve is not None and self.limit is None:
            raise OptionError(
                "--solve needs a limit that the cameras have to meet: give --limit, such as 1.2x"
            )

    def limit_for(self, sharpness: Sharpness, nominal: float) -> float | None:
        """Limit in the criterion's unit.

        Parameters
        ----------
        sharpness
            The criterion.
        nominal
            Its figure with every parameter in its middle.

        Raises
        ------
        OptionError
            If the text is no limit for this criterion.
        """
        if self.limit is None:
            return None
        times = _TIMES.fullmatch(self.limit)
        if times is not None:
            limit = float(times[1]) * nominal
        else:
            kind = Length if sharpness.unit == "um" else Share
            try:
                limit = kind.parse(self.limit).to(sharpness.unit)
            except OptionError as error:
                raise OptionError(
                    f"--limit: {error}; or give it as a multiple of the nominal figure, such as "
                    "1.2x"
                ) from None
        if not limit > 0:
            raise OptionError(f"--limit {self.limit} is not more than zero: nothing meets it")
        return limit

    @property
    def inputs(self) -> dict[str, Path]:
        """The file of the tolerances."""
        return {} if self.tolerances is None else {"tolerances": self.tolerances}

    @property
    def written(self) -> tuple[Written, ...]:
        """Record, trials and plots."""
        return (
            Written("record of the run", self.output / "tolerance.json"),
            Written("trials", self.output / "trials.csv"),
            Written("plots", self.output / "tolerance.png"),
        )
