"""Going on with a run that was interrupted."""

from collections.abc import Mapping
from typing import Any

from nolens.errors import DataError, OptionError
from nolens.files import InputFile, read_state
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.solvers import AdmmState, Problem

_POSING = (
    "black",
    "white",
    "mosaic",
    "bgr",
    "psf_scale",
    "psf_extent",
    "prior",
    "bin",
    "channels",
    "support",
    "field",
    "camera",
)
"""Options that decide what problem is solved; how long and where may change."""


def about_run(
    options: ReconstructOptions, inputs: dict[str, InputFile], tau: float
) -> dict[str, Any]:
    """What a run must have in common with the one that it goes on with.

    Parameters
    ----------
    options, inputs
        Of the run.
    tau
        Weight of the prior.
    """
    values = options.model_dump(mode="json")
    return {
        **{role: file.sha256 for role, file in inputs.items()},
        "tau": tau,
        **{name: values[name] for name in _POSING},
    }


def resumed(problem: Problem, options: ReconstructOptions, about: dict[str, Any]) -> AdmmState:
    """Where to start: from the state file that --resume names, or cold.

    Raises
    ------
    FileError
        If the file cannot be read, or is no state.
    OptionError
        If it was written by a run with other files or options, or edited.
    """
    if options.resume is None:
        return AdmmState.cold(problem, options.penalties)

    def belongs(stored: Mapping[str, Any]) -> None:
        before = _renamed(stored)
        names = sorted(name for name in {*about, *before} if about.get(name) != before.get(name))
        if names:
            known = [name for name in names if name in about] or ["option"]
            raise OptionError(
                f"{options.resume} is the state of a run with another {' and '.join(known)}; give "
                "the same files and options again, or leave out --resume"
            )

    state = AdmmState.cold(problem)
    try:
        state.restore_(read_state(options.resume, state.arrays(), belongs))
    except DataError as error:
        raise OptionError(f"{options.resume} does not fit this run: {error}") from None
    return state


def _renamed(stored: Mapping[str, Any]) -> dict[str, Any]:
    """What a state says of its run, in the present names; those of the version before are read."""
    found = dict(stored)
    if "region" in found:
        found["support"] = found.pop("region")
    if "psf_wider" in found:
        found["psf_extent"] = "wide" if found.pop("psf_wider") else "sensor"
    return found
