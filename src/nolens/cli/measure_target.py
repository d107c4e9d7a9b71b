"""`nolens measure target`."""

from pathlib import Path
from typing import Annotated, Literal

from nolens.cli.app import Output, Quantity, Whole, given_options
from nolens.cli.messages import show
from nolens.jobs import TargetOptions, make_target


def target(
    kind: Literal["siemens", "edge"] | None = None,
    /,
    *,
    output: Annotated[Path | None, Output] = None,
    pixels: Annotated[int | None, Whole] = None,
    spokes: Annotated[int | None, Whole] = None,
    tilt: Annotated[str | None, Quantity] = None,
) -> int:
    """Make the picture of a resolution target, to show on a screen or to print.

    nolens measure target siemens -o star.png

    nolens measure target edge -o edge.png --tilt 5deg

    Show it filling the screen, without scaling it, and photograph it. nolens measure resolution
    siemens or edge takes the photograph.

    Parameters
    ----------
    kind
        siemens: a star of bright spokes. edge: a slanted edge, dark at the left. Needed.
    output
        Picture to write: .png. Needed.
    pixels
        Pixels along its sides.  [default: 2000]
    spokes
        Bright spokes of the star.  [default: 36]
    tilt
        Angle of the edge from upright.  [default: 5deg]
    """
    show(str(make_target(TargetOptions.gather(given_options(locals())))))
    return 0
