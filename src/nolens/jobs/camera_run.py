"""What every simulation begins with, and how it is recorded."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import torch

from nolens.camera import OpenCamera
from nolens.files import InputFile, RunRecord, camera_files, check_output, read_camera
from nolens.jobs.clock import Clock
from nolens.jobs.device import pick_device
from nolens.jobs.options import check_apart
from nolens.jobs.raw import check_raw
from nolens.jobs.scene_options import CameraOptions
from nolens.twin import Light, Twin
from nolens.twin.preview import preview_model


@dataclass(frozen=True)
class Run:
    """A simulation whose files and options have been checked.

    Parameters
    ----------
    options
        What was asked for.
    opened
        The camera.
    files
        Files that are read, by role.
    device
        Where to compute.
    light
        Spectrum of the light.
    preview
        The camera with a stand-in for its relief.
    clock
        When it began.
    """

    options: CameraOptions
    opened: OpenCamera
    files: dict[str, Path]
    device: torch.device
    light: Light
    preview: Twin
    clock: Clock

    @classmethod
    def begin(cls, options: CameraOptions) -> Self:
        """Read the camera, and check what is to be written before any work is done for it.

        Raises
        ------
        NolensError
            If the camera, an option or an output cannot be used.
        """
        clock = Clock()
        opened = read_camera(options.camera)
        check_raw(options.output, opened.camera.sensor, options.pictures)
        check_output(options.record, (".json",))
        files = {**options.inputs, **camera_files(options.camera, opened.camera)}
        check_apart(options, files)
        device, light = pick_device(options.device), Light(options.light)
        bare = preview_model(opened, fresnel=options.fresnel)
        return cls(options, opened, files, device, light, bare, clock)

    @property
    def seconds(self) -> float:
        """Since the run began."""
        return self.clock.seconds

    def inputs(self) -> dict[str, InputFile]:
        """Hash the files that are read, while they are as they were read."""
        return {role: InputFile.of(path) for role, path in self.files.items()}

    def record(
        self, inputs: dict[str, InputFile], summary: dict[str, Any], warnings: list[str]
    ) -> RunRecord:
        """All that is needed to repeat the run."""
        return RunRecord(
            started=self.clock.started,
            inputs=inputs,
            parameters={
                **self.options.model_dump(mode="json"),
                "camera_description": self.opened.camera.model_dump(mode="json"),
            },
            result=summary,
            history=[],
            warnings=warnings,
        )
