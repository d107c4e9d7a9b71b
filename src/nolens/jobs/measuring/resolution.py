"""How fine a camera resolves: from frames, or from its description, to angles."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from nolens.errors import DataError
from nolens.evaluate import point_pair
from nolens.experiments.resolution import (
    EXPECTED_STEPS,
    POINT_ITERATIONS,
    POINTS_REGION,
    TARGET_ITERATIONS,
    TAU,
    EdgeResolution,
    SeenPair,
    SolverSettings,
    StarResolution,
    TwoPoints,
    edge_resolution,
    siemens_resolution,
    two_point_resolution,
)
from nolens.files import (
    InputFile,
    RunRecord,
    check_output,
    readable,
    write_record,
    write_together,
)
from nolens.jobs.clock import Clock
from nolens.jobs.given import check_apart
from nolens.jobs.measuring.resolution_draw import draw_edge, draw_star, draw_two_points
from nolens.jobs.measuring.resolution_options import (
    EdgeOptions,
    ResolutionOptions,
    SiemensOptions,
    TwoPointOptions,
)
from nolens.jobs.measuring.resolution_pictures import GivenCamera, Shown, shown
from nolens.jobs.measuring.resolution_ready import ReadyBench, Work
from nolens.jobs.measuring.resolution_tell import edge_figures, star_figures, two_point_figures
from nolens.jobs.reporter import Reporter
from nolens.quantities import Angle

_SPOKES = 36
_ANGLE = Angle("20", "deg")
_SIZE_OFF = 0.1
_PATTERNS = 25


@dataclass(frozen=True)
class ResolutionOutcome:
    """What a measurement came to.

    Parameters
    ----------
    found
        The resolution.
    summary
        Its figures, in values that JSON has.
    """

    found: TwoPoints | StarResolution | EdgeResolution
    summary: dict[str, Any]


def measure_two_points(options: TwoPointOptions, reporter: Reporter) -> ResolutionOutcome:
    """Measure the dip between two points by separation, and the smallest resolved angle.

    Parameters
    ----------
    options
        Frames, or what to simulate.
    reporter
        Is told of doubts and how far the work is.

    Raises
    ------
    NolensError
        If a file, an option or an output cannot be used, or a frame shows no two points; then
        nothing is written.
    """
    run = _Run.begin(options, POINT_ITERATIONS)
    if options.simulate is None:
        assert options.distance is not None and options.distance != "infinity"
        seen = []
        for separation, each in zip(options.separation, run.shown(reporter), strict=True):
            angle = math.degrees(2 * math.atan(separation.um / options.distance.um / 2))
            pair = point_pair(each.picture, each.scale.cells(angle))
            seen.append(SeenPair(angle, pair, each.picture))
        found = TwoPoints.of(seen, options.dip.value)
    else:
        pictures_taken = EXPECTED_STEPS * options.draws
        side = (POINTS_REGION, POINTS_REGION)
        work = Work(
            patterns=2 * pictures_taken, solves=pictures_taken, region=side,
            iterations=run.settings.iterations,
        )  # fmt: skip
        ready = run.ready(reporter, lambda _: work)
        found = two_point_resolution(
            ready.bench, ready.distance_um, direction_deg=options.direction.deg,
            draws=options.draws, threshold=options.dip.value, settings=run.settings,
            tick=partial(reporter.advance, "two points"),
        )  # fmt: skip
    resolved = found.resolved
    if resolved.value is None:
        run.warn(
            reporter,
            f"all separations are resolved: the smallest resolved angle is {resolved.resolved:.3g} "
            "deg or less"
            if resolved.unresolved is None
            else f"the largest separation, {resolved.unresolved:.3g} deg, is not resolved: take "
            "frames at larger ones",
        )
    return run.finish(found, two_point_figures(found), partial(draw_two_points, found=found))


def measure_siemens(options: SiemensOptions, reporter: Reporter) -> ResolutionOutcome:
    """Measure the contrast of a Siemens star in every direction.

    Parameters
    ----------
    options
        A frame, or what to simulate.
    reporter
        Is told of doubts and how far the work is.

    Raises
    ------
    NolensError
        If a file, an option or an output cannot be used, or the frame shows no such star; then
        nothing is written.
    """
    run = _Run.begin(options, TARGET_ITERATIONS)
    if options.simulate is None:
        (each,) = run.shown(reporter)
        found = StarResolution.of(
            each.scale.flat(each.picture), periods=options.spokes,
            threshold=options.threshold.value,
        )  # fmt: skip
        _check_size(found, options)
    else:
        angle = options.angle or _ANGLE
        ready = run.ready(reporter, partial(run.target_work, angle_deg=angle.deg))
        found = siemens_resolution(
            ready.bench, ready.distance_um, angle.deg, periods=options.spokes or _SPOKES,
            threshold=options.threshold.value, settings=run.settings,
            tick=partial(reporter.advance, "Siemens star"),
        )  # fmt: skip
    if any(found.at_limit):
        run.warn(
            reporter,
            "the finest spokes that the cells can show are resolved in some directions: a star of "
            "more spokes may show finer ones",
        )
    return run.finish(found, star_figures(found), partial(draw_star, found=found))


def measure_edge(options: EdgeOptions, reporter: Reporter) -> ResolutionOutcome:
    """Measure the contrast by frequency across a slanted edge.

    Parameters
    ----------
    options
        A frame, or what to simulate.
    reporter
        Is told how far the work is.

    Raises
    ------
    NolensError
        If a file, an option or an output cannot be used, or the frame shows no such edge; then
        nothing is written.
    """
    run = _Run.begin(options, TARGET_ITERATIONS)
    if options.simulate is None:
        (each,) = run.shown(reporter)
        found = EdgeResolution.of(each.scale.flat(each.picture))
    else:
        ready = run.ready(reporter, partial(run.target_work, angle_deg=options.angle.deg))
        found = edge_resolution(
            ready.bench, ready.distance_um, options.angle.deg, settings=run.settings,
            tick=partial(reporter.advance, "slanted edge"),
        )  # fmt: skip
    return run.finish(found, edge_figures(found), partial(draw_edge, found=found))


@dataclass
class _Run:
    """One measurement: what it reads and writes."""

    options: ResolutionOptions
    settings: SolverSettings
    clock: Clock
    files: dict[str, Path]
    inputs: dict[str, InputFile] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    @classmethod
    def begin(cls, options: ResolutionOptions, iterations: int) -> "_Run":
        """Check what is written, before any work."""
        clock = Clock()
        if options.plot is not None and options.record is not None:
            check_output(options.plot, (".png",))
            check_output(options.record, (".json",))
        check_apart(options, options.inputs)
        settings = SolverSettings(
            options.iterations or iterations, options.tau or TAU, options.fill.value, options.seed
        )
        return cls(options, settings, clock, options.inputs)

    def shown(self, reporter: Reporter) -> list[Shown]:
        """All frames as pictures."""
        given = GivenCamera.of(self.options)
        self._reads(given.files)
        return shown(
            self.options, given, self.settings.iterations,
            tick=partial(reporter.advance, "frames"), warn=partial(self.warn, reporter),
        )  # fmt: skip

    def warn(self, reporter: Reporter, text: str) -> None:
        """Say a doubt, and keep it for the record."""
        reporter.warn(text)
        self.warnings.append(text)

    def ready(self, reporter: Reporter, work: Callable[[ReadyBench], Work]) -> ReadyBench:
        """The simulated camera, its work foretold."""
        bench = ReadyBench.of(self.options)
        self._reads(bench.files)
        return bench.foretold(work(bench), reporter)

    def target_work(self, ready: ReadyBench, angle_deg: float) -> Work:
        """What a picture of a screen takes."""
        return Work(
            patterns=_PATTERNS, solves=1, region=ready.cells_of(angle_deg),
            iterations=self.settings.iterations,
        )  # fmt: skip

    def finish(
        self, found: TwoPoints | StarResolution | EdgeResolution, figures: dict[str, Any],
        plot: Callable[[Path], None],
    ) -> ResolutionOutcome:  # fmt: skip
        """Write the plot and the record, if they are asked for."""
        options, settings = self.options, self.settings
        solved = options.simulate is not None or options.psf is not None
        summary = {
            **figures,
            "simulated": options.simulate,
            "iterations": settings.iterations if solved else None,
            "tau": settings.tau if solved else None,
            "warnings": self.warnings,
            "outputs": [readable(path) for _, path, _ in options.written],
            "seconds": self.clock.seconds,
        }
        if options.plot is not None and options.record is not None:
            record = RunRecord(
                started=self.clock.started, inputs=self.inputs,
                parameters=options.model_dump(mode="json"), result=summary, history=[],
                warnings=self.warnings,
            )  # fmt: skip
            write_together(
                {options.record: partial(write_record, record=record), options.plot: plot}
            )
        return ResolutionOutcome(found, summary)

    def _reads(self, more: dict[str, Path]) -> None:
        self.files = {**self.files, **more}
        check_apart(self.options, self.files)
        self.inputs = {role: InputFile.of(path) for role, path in self.files.items()}


def _check_size(found: StarResolution, options: SiemensOptions) -> None:
    """Refuse a star that is not as large as it was said to be."""
    if options.angle is None:
        return
    if abs(found.diameter_deg / options.angle.deg - 1) > _SIZE_OFF:
        raise DataError(
            f"the star in {options.frames[0]} is {found.diameter_deg:.3g} deg wide, not "
            f"{options.angle.deg:g} deg: check the angle of a cell (--camera, --cell-angle), the "
            "star's size and its distance"
        )
