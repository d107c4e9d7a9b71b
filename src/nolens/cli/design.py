"""`nolens design`: thickness, tolerances, and a command for every kind of mask."""

from itertools import pairwise
from typing import Annotated, Any

from cyclopts import App, Parameter

from nolens.amounts import amount
from nolens.cli.app import run_app
from nolens.cli.command import command
from nolens.errors import OptionError
from nolens.jobs import (
    MASK_KINDS,
    MaskOptions,
    design_mask,
    design_thickness,
    study_tolerances,
)


def _thickness_lines(summary: dict[str, Any]) -> list[str]:
    lines = [_sensor_line(summary), *_master_lines(summary)]
    for replica in summary["materials"]:
        lines += ["", *_replica_lines(replica)]
    lines += ["", *_colour_lines(summary["materials"])]
    return [*lines, ""] if summary["outputs"] else lines


def _sensor_line(summary: dict[str, Any]) -> str:
    layers = [
        f"{layer['name']} {_length(layer['thickness_mm'])}"
        + ("" if layer["index"] == 1 else f" of {_medium(layer)}")
        for layer in summary["cover"]
    ]
    light = f"light of {summary['wavelength_nm']:g} nm"
    if summary["distance_mm"] is not None:
        light += f" from {summary['distance_mm']:g} mm"
    return f"over the sensor: {', '.join(layers) or 'nothing'}; {light}"


def _master_lines(summary: dict[str, Any]) -> list[str]:
    radius = _length(summary["radius_mm"], 3)
    film = summary["film"]
    if film is None:
        return [f"lenslets with a radius of curvature of {radius}"]
    text = (
        f"film of {_length(film['thickness_mm'])} {_medium(film)}, relief towards the "
        f"{film['side']}, sharpest at {_length(film['distance_mm'])}: its lenslets have a radius "
        f"of curvature of {radius}"
    )
    lines = [text]
    if film["assumed"]:
        lines.append("  (the paper's film; say yours with --film and --film-distance, or --radius)")
    printed = summary["printed_radius_mm"]
    if printed is not None:
        lines.append(
            f"  (eq. 3 as the paper prints it gives {printed:.3f} mm: it counts the cover glass "
            "without the ratio of refractive indices)"
        )
    return lines


def _replica_lines(replica: dict[str, Any]) -> list[str]:
    name = _medium({"material": replica["material"], "index": replica["index"]["value"]})
    room = replica["room_mm"]["value"]
    low, high = replica["sharp_mm"]
    lines = [
        f"{name}: pour {_length(replica['thickness_mm'], 2)}; it may be off by ± {room:.2f} mm "
        f"({low:.2f} to {high:.2f} mm) before the lines are 10 % wider"
    ]
    if replica["printed_thickness_mm"] is not None:
        lines.append(f"  from eq. 3 as printed: {replica['printed_thickness_mm']:.2f} mm")
    spherical = replica.get("spherical_mm")
    edge = ""
    if spherical is not None:
        edge = f"; light at the edge of a lenslet focuses {1e3 * spherical['value']:.1f} µm nearer"
    focal, depth = replica["focal_length_mm"]["value"], replica["depth_of_focus_mm"]["value"]
    inside = replica["focal_length_in_material_mm"]["value"]
    lines += [
        f"  lenslets: focal length {focal:.2f} mm as in air, {inside:.2f} mm in the layer; NA "
        f"{replica['aperture']['value']:.3f}; depth of focus {depth:.2f} mm as in air, "
        f"{replica['depth_of_focus_in_material_mm']['value']:.2f} mm of the layer, end to end",
        f"  lines of the pattern about {replica['line_width_um']['value']:.1f} µm wide{edge}",
    ]
    fractions = replica["thickness_mm"].get("fractions", {})
    parts = replica["thickness_mm"].get("parts", {})
    if len(fractions) > 0:
        ordered = sorted(fractions, key=lambda each: -fractions[each])
        lines.append(
            "  ± of the thickness comes from: "
            + ", ".join(
                f"{each} {abs(parts[each]):.2g} mm ({100 * fractions[each]:.3g} %)"
                for each in ordered
                if fractions[each] > 0
            )
        )
    return lines


def _colour_lines(materials: list[dict[str, Any]]) -> list[str]:
    """Table of all colours and materials."""
    heads = [f"{replica['material']}" for replica in materials]
    lines = ["in other light: the thickness in focus, and lines at the thickness above"]
    lines.append(f"  {'':8}{''.join(f'{head:>20}' for head in heads)}")
    cells: dict[str, list[str]] = {}
    for number, replica in enumerate(materials):
        for row in replica["colours"]:
            columns = cells.setdefault(row["light"], [""] * len(materials))
            columns[number] = f"{row['thickness_mm']:.3f} mm {row['line_width_um']:5.1f} µm"
    lines += [
        f"  {light:8}{''.join(f'{cell:>20}' for cell in columns)}"
        for light, columns in cells.items()
    ]
    return lines


def _length(figure: dict[str, Any], digits: int | None = None) -> str:
    """A length with its ±; with as many digits as it was given with, or so many."""
    form = "g" if digits is None else f".{digits}f"
    text = f"{figure['value']:{form}} mm"
    if figure["plus_minus"] > 0:
        text += f" ± {figure['plus_minus']:{form}} mm"
    return text


def _medium(layer: dict[str, Any]) -> str:
    index = f"n {layer['index']:.4g}"
    return index if layer["material"].startswith("n ") else f"{layer['material']} ({index})"


def _tolerance_lines(summary: dict[str, Any]) -> list[str]:
    if "tolerances" in summary:
        return str(summary["tolerances"]).removesuffix("\n").split("\n")
    unit, rows = summary["unit"], summary["sensitivities"]
    lines = [
        f"{summary['criterion']} {amount(summary['nominal'], unit, digits=4)} with every parameter "
        "at its mean; change at − and + its tolerance, the worst first:"
    ]
    wide = max(len(row["parameter"]) for row in rows)
    for row in rows:
        mean = amount(row["mean"], digits=6)
        varied = f"{mean} ± {amount(row['tolerance'], row['unit'], digits=4)}"
        varied += f" ({row['tolerance_means']})"
        changes = (
            "not measurable" if row[key] is None else amount(row[key], unit, sign=True)
            for key in ("change_at_minus", "change_at_plus")
        )
        assumed = "  assumed" if row["note"].startswith("assumed") else ""
        lines.append(f"  {row['parameter']:<{wide}}  {varied:<28} {' / '.join(changes)}{assumed}")
    lines += _trial_lines(summary)
    if "solved" in summary:
        lines.append(_solution(summary["solved"]))
    return [*lines, f"{summary['seconds']:.1f} s"]


def _trial_lines(summary: dict[str, Any]) -> list[str]:
    unit, predicted = summary["unit"], summary["prediction"]
    lines = []
    if predicted["second_order_sigma"] is not None:
        lines.append(
            f"predicted: mean {amount(predicted['mean'], unit, digits=4)}, sigma "
            f"{amount(predicted['second_order_sigma'], unit)} ("
            f"{amount(predicted['root_sum_square_sigma'], unit)} by "
            "the root of the sum of squares alone)"
        )
    if summary["sigma"] is not None:
        lines.append(
            f"{summary['trials']} cameras drawn: mean "
            f"{amount(summary['mean'], unit, digits=4)}, sigma {amount(summary['sigma'], unit)}"
        )
    if summary["not_measurable"]:
        lines.append(f"{summary['not_measurable']} of them show no lines that could be measured")
    reached = (
        f"{level} {'none' if value is None else amount(value, unit, digits=4)}"
        for level, value in summary["levels"].items()
    )
    lines.append(f"this good or better: {', '.join(reached)}")
    if "yield" in summary:
        limit = amount(summary["limit"], unit, digits=4)
        lines.append(f"{_yield(summary['yield'])} meet the limit of {limit}")
    return lines


def _yield(good: dict[str, Any]) -> str:
    low, high = good["interval_95"]
    return f"{100 * good['fraction']:.1f} % (95 % interval {100 * low:.1f} to {100 * high:.1f} %)"


def _solution(solved: dict[str, Any]) -> str:
    allowed = f"± {amount(solved['tolerance'], solved['unit'])}"
    target, reached = f"{100 * solved['target_yield']:g} %", _yield(solved["reached"])
    if solved["verdict"] == "impossible":
        return (
            f"no tolerance of {solved['parameter']} gives a yield of {target}: even with none it "
            f"is {reached}"
        )
    if solved["verdict"] == "any":
        return (
            f"any tolerance of {solved['parameter']} up to {allowed}, the largest possible one, "
            f"gives a yield of {target}: {reached}"
        )
    return f"{solved['parameter']} may be {allowed} for a yield of {target}: {reached}"


def _mask_lines(summary: dict[str, Any]) -> list[str]:
    lines = _mask_table(summary)
    if "target_correlation" in summary:
        values = ", ".join(f"{each:.3f}" for each in summary["target_correlation"])
        lines.append(f"correlation of the PSF with its target, channel by channel: {values}")
    return [*lines, f"{summary['seconds']:.1f} s on {summary['device']}"]


def _mask_table(summary: dict[str, Any]) -> list[str]:
    """Figures of the mask beside the paper's diffuser in the same camera."""
    own, papers = summary["figures"], summary["paper_diffuser"]
    rows = [
        ("width of the PSF's autocorrelation, µm", "width_um", 1, ".1f"),
        ("line width, µm", "line_um", 1, ".1f"),
        ("pitch of the PSF, µm", "pitch_um", 1, ".1f"),
        ("sparsity, %", "sparsity", 100, ".1f"),
        ("height of the relief, µm", "height_um", 1, ".2f"),
        ("steepest slope", "slope", 1, ".3f"),
    ]
    papers_name = "the paper's"
    lines = [f"{'':42}{'this mask':>12}{papers_name:>12}"]
    for name, key, factor, form in rows:
        cells = (_cell(side[key], factor, form) for side in (own, papers))
        lines.append(f"{name:42}" + "".join(f"{cell:>12}" for cell in cells))
    for number, per_mm in enumerate(summary["magnitude_per_mm"]):
        cells = (_cell(side["magnitude"][number], 100, ".2f") for side in (own, papers))
        name = f"spectral magnitude of 1 mm² at {per_mm:g}/mm, %"
        lines.append(f"{name:42}" + "".join(f"{cell:>12}" for cell in cells))
    return lines


def _cell(value: float | None, factor: float, form: str) -> str:
    return "-" if value is None else format(factor * value, form)


design = App(name="design", help="Design a camera: thickness, tolerances and masks.")
mask = App(name="mask", help="Design a mask for a camera, and write the camera that has it.")
design.command(mask)
design.command(
    command(design_thickness, _thickness_lines, name="thickness"),
    name="thickness",
)
design.command(
    command(study_tolerances, _tolerance_lines, name="tolerance"),
    name="tolerance",
)
_Words = Annotated[str, Parameter(show=False, allow_leading_hyphen=True)]


@mask.default
def _kind_after_options(*words: _Words) -> int:
    """Take a kind that stands behind options, or say which kinds there are."""
    if words and not words[0].startswith("-"):
        MASK_KINDS.load(words[0])
    kinds = MASK_KINDS.names
    for place, (before, word) in enumerate(pairwise(words), start=1):
        is_value = before.startswith("-") and "=" not in before and before != "--json"
        if word in kinds and not is_value:
            return run_app(mask, [word, *words[:place], *words[place + 1 :]])
    raise OptionError(
        f"no kind is given; name one of {', '.join(kinds)}: nolens {MaskOptions.usage}"
    )


def _add(name: str) -> None:
    """Add the command of a kind."""
    try:
        kind = MASK_KINDS.load(name)
    except OptionError as error:
        # A package that cannot be loaded must not take the other kinds with it.
        reason = str(error)

        def refuse(*words: _Words) -> None:
            raise OptionError(reason)

        mask.command(refuse, name=name, help=f"{reason}.", help_flags=())
    else:
        mask.command(command(design_mask, _mask_lines, name=name, options=kind), name=name)


for _kind in MASK_KINDS.names:
    _add(_kind)
