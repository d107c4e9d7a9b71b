"""Names of the files of a capture."""

import re
from dataclasses import dataclass, field
from pathlib import Path

from nolens.errors import FileError, OptionError
from nolens.files import FRAME_SUFFIXES, check_folder, check_output
from nolens.jobs.capturing.options import CaptureOptions


@dataclass
class Naming:
    """Gives every file its name, and none that is taken.

    Parameters
    ----------
    folder
        Where they go.
    stem
        What their names begin with.
    suffix
        None where it follows from the frames.
    options
        They say whether there are several.
    """

    folder: Path
    stem: str
    suffix: str | None
    options: CaptureOptions
    _number: int = field(default=0, init=False)

    @classmethod
    def of(cls, options: CaptureOptions) -> "Naming":
        """Find the folder, and check it before any frame is taken.

        Raises
        ------
        FileError
            If it cannot be written to, or the suffix is not known.
        OptionError
            If an average is to be a .dng.
        """
        output = options.output
        if not output.suffix or output.is_dir():
            check_folder(output)
            found = cls(output, options.kind, None, options)
        else:
            if options.several:
                check_folder(output.parent)
                if output.suffix.lower() not in FRAME_SUFFIXES:
                    raise FileError(
                        f"cannot write {output}: the suffix {output.suffix} is not known here. "
                        f"Accepted: {', '.join(FRAME_SUFFIXES)}"
                    )
            else:
                check_output(output, FRAME_SUFFIXES)
                check_output(output.with_suffix(".json"), (".json",))
            if options.average and output.suffix.lower() == ".dng":
                raise OptionError(
                    f"{output.name} would be a DNG, which holds whole counts, and an average has "
                    f"fractions: write {output.with_suffix('.tif').name}"
                )
            found = cls(output.parent, output.stem, output.suffix, options)
        if found._numbered:
            found._number = found._last()
        return found

    def next(self, exposure_s: float, suffix: str) -> Path:
        """Name of the next file.

        Parameters
        ----------
        exposure_s
            Of its frames.
        suffix
            Where none was given.
        """
        name = self.stem
        if self._numbered:
            self._number += 1
            name += f"-{self._number:04d}"
        if self.options.bracket > 1:
            name += f"-{1e3 * exposure_s:.4g}ms"
        # Not with_suffix: what follows the last dot of the name may be part of a number.
        return self.folder / f"{name}{self.suffix or suffix}"

    @property
    def _numbered(self) -> bool:
        return self.options.several or self.suffix is None

    def _last(self) -> int:
        """Largest number that is taken, so that frames of another day stay."""
        pattern = re.compile(rf"{re.escape(self.stem)}-(\d+)(?:-[^/]*ms)?\.\w+")
        try:
            names = [each.name for each in self.folder.iterdir()]
        except OSError:  # It is made with the first frame.
            return 0
        found = (pattern.fullmatch(name) for name in names)
        return max((int(match[1]) for match in found if match), default=0)
