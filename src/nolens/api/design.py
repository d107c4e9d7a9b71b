"""Designing a camera: its mask, and how thick the resin under it must be."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from nolens.api.inputs import CallbackReporter, Progress, reported
from nolens.api.simulate import Camera
from nolens.design.thickness import ReplicaDesign, thickness_summary
from nolens.files import read_camera
from nolens.jobs.designing.mask import with_mask
from nolens.jobs.designing.thickness import ThicknessOptions, read_case


def design_mask(
    kind: str,
    camera: str | Path | Camera = "paper",
    *,
    progress: Progress = False,
    **options: Any,
) -> Camera:
    """The same camera with a designed mask.

    Parameters
    ----------
    kind
        ``"random-lenslets"``, ``"lenslet-array"``, ``"diffuser"``, ``"contour"``, ``"optimised"``,
        or one that another package adds.
    camera
        Its layers and sensor are kept.
    progress
        True draws a bar, a function is called with the fraction that is done.
    options
        Those of ``nolens design mask KIND``, by name: ``pitch="70um"``, ``iterations=60``.

    Raises
    ------
    OptionError
        If there is no such kind or option, or a value cannot be used.
    """
    camera = camera if isinstance(camera, Camera) else Camera(camera)
    with reported(progress, "mask") as report:
        loaded = with_mask(
            kind,
            camera.loaded,
            CallbackReporter(report),
            **{"device": camera.device.type, **options},
        )
    return Camera(loaded, pixels=camera.pixels, device=camera.device)


@dataclass(frozen=True)
class ThicknessDesign:
    """How thick the resin on a sensor must be.

    Parameters
    ----------
    figures
        Of every material: thickness, tolerance, focal length, width of the lines, each with its ±,
        as ``nolens design thickness --json`` prints them.
    camera
        The camera with a replica of the first material.
    """

    figures: dict[str, Any] = field(repr=False)
    camera: Camera

    @property
    def thickness_mm(self) -> dict[str, float]:
        """Thickness in focus by material."""
        return {
            each["material"]: each["thickness_mm"]["value"] for each in self.figures["materials"]
        }

    def __str__(self) -> str:
        return "; ".join(
            f"{each['material']}: {each['thickness_mm']['value']:.2f} mm ± "
            f"{each['room_mm']['value']:.2f} mm"
            for each in self.figures["materials"]
        )


def design_thickness(camera: str | Path = "paper", **options: Any) -> ThicknessDesign:
    """How thick the resin must be for a master to focus on a sensor, and how far off it may be.

    Parameters
    ----------
    camera
        Has the layers over the sensor: a preset, a folder with camera.toml, or a .toml file.
    options
        Those of ``nolens design thickness``, by name: ``film="0.305mm"``, ``material="pua311"``.

    Raises
    ------
    OptionError
        If there is no such option, a value cannot be used, or a material cannot focus there.
    """
    mask_options = ThicknessOptions.gather({**options, "camera": str(camera)})
    case, media = read_case(mask_options, read_camera(mask_options.camera))
    designs = tuple(ReplicaDesign.of(case, medium) for medium in media)
    replica = replace(case.loaded, camera=designs[0].camera(), relief_um=None)
    return ThicknessDesign(thickness_summary(designs), Camera(replica))
