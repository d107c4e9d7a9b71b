"""`nolens design thickness`."""

from typing import Any

from nolens.cli.command import command
from nolens.jobs import ThicknessOptions, design_thickness


def _lines(summary: dict[str, Any]) -> list[str]:
    lines = [_sensor(summary), *_master(summary)]
    for found in summary["materials"]:
        lines += ["", *_replica(found)]
    lines += ["", *_colours(summary["materials"])]
    return [*lines, ""] if summary["outputs"] else lines


def _sensor(summary: dict[str, Any]) -> str:
    layers = [
        f"{layer['name']} {_length(layer['thickness_mm'])}"
        + ("" if layer["index"] == 1 else f" of {_medium(layer)}")
        for layer in summary["cover"]
    ]
    light = f"light of {summary['wavelength_nm']:g} nm"
    if summary["distance_mm"] is not None:
        light += f" from {summary['distance_mm']:g} mm"
    return f"over the sensor: {', '.join(layers) or 'nothing'}; {light}"


def _master(summary: dict[str, Any]) -> list[str]:
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


def _replica(found: dict[str, Any]) -> list[str]:
    name = _medium({"material": found["material"], "index": found["index"]["value"]})
    room = found["room_mm"]["value"]
    low, high = found["sharp_mm"]
    lines = [
        f"{name}: pour {_length(found['thickness_mm'], 2)}; it may be off by ± {room:.2f} mm "
        f"({low:.2f} to {high:.2f} mm) before the lines are 10 % wider"
    ]
    if found["printed_thickness_mm"] is not None:
        lines.append(f"  from eq. 3 as printed: {found['printed_thickness_mm']:.2f} mm")
    spherical = found.get("spherical_mm")
    edge = ""
    if spherical is not None:
        edge = f"; light at the edge of a lenslet focuses {1e3 * spherical['value']:.1f} µm nearer"
    focal, depth = found["focal_length_mm"]["value"], found["depth_of_focus_mm"]["value"]
    inside = found["focal_length_in_material_mm"]["value"]
    lines += [
        f"  lenslets: focal length {focal:.2f} mm as in air, {inside:.2f} mm in the layer; NA "
        f"{found['aperture']['value']:.3f}; depth of focus {depth:.2f} mm as in air, "
        f"{found['depth_of_focus_in_material_mm']['value']:.2f} mm of the layer, end to end",
        f"  lines of the pattern about {found['line_width_um']['value']:.1f} µm wide{edge}",
    ]
    shares = found["thickness_mm"].get("shares", {})
    parts = found["thickness_mm"].get("parts", {})
    if len(shares) > 0:
        ordered = sorted(shares, key=lambda each: -shares[each])
        lines.append(
            "  ± of the thickness comes from: "
            + ", ".join(
                f"{each} {abs(parts[each]):.2g} mm ({100 * shares[each]:.3g} %)"
                for each in ordered
                if shares[each] > 0
            )
        )
    return lines


def _colours(materials: list[dict[str, Any]]) -> list[str]:
    """Table of all colours and materials."""
    heads = [f"{found['material']}" for found in materials]
    lines = ["in other light: the thickness in focus, and lines at the thickness above"]
    lines.append(f"  {'':8}{''.join(f'{head:>20}' for head in heads)}")
    cells: dict[str, list[str]] = {}
    for number, found in enumerate(materials):
        for row in found["colours"]:
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


thickness = command(ThicknessOptions, design_thickness, _lines, name="thickness")
