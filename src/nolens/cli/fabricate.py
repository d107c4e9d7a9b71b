"""`nolens fabricate`."""

from typing import Any

from nolens.amounts import amount
from nolens.cli.command import command
from nolens.jobs import fabricate as fabricate_job


def _lines(summary: dict[str, Any]) -> list[str]:
    frame, resin, mould = summary["frame"], summary["resin"], summary["mould"]
    mask, relief = summary["mask"], summary["relief"]
    width, height, tall = frame["outer_mm"]
    angle = frame["shading_angle_deg"]
    shades = "shades no pixel" if angle is None else f"shades pixels from {angle:.0f}° on"
    mass = "" if resin["mass_mg"] is None else f", {resin['mass_mg']:.0f} mg"
    low, high = mask["heights_um"]
    rows, columns = mask["points"]
    return [
        f"frame {width:.2f} × {height:.2f} × {tall:.2f} mm around {frame['inner_mm'][0]:.2f} × "
        f"{frame['inner_mm'][1]:.2f} mm, {frame['volume_mm3']:.1f} mm³; it {shades}",
        f"pour {resin['pour_mm3']:.1f} mm³{mass} of {resin['material'] or 'the resin'}: cavity "
        f"{resin['cavity_mm3']:.1f} mm³, shrinkage {100 * resin['shrinkage']:g} %, rim and vents "
        f"{resin['overflow_mm3']:.1f} mm³, crown {resin['meniscus_mm3']:.1f} mm³",
        f"mould {mould['dish_mm'][0]:.1f} × {mould['dish_mm'][1]:.1f} × {mould['thickness_mm']:g} "
        f"mm: {mould['base_g']:.2f} g base, {mould['hardener_g']:.2f} g hardener "
        f"({mould['ratio']:g}:1)",
        f"mask {mask['about']}: {mask['size_mm'][0]:.3f} × {mask['size_mm'][1]:.3f} mm, "
        f"{rows}×{columns} points, {low:.3f} to {high:.3f} µm, {mask['levels']} levels of "
        f"{1e3 * mask['step_um']:.1f} nm",
        f"relief of {relief['triangles']} triangles, a point every "
        f"{amount(relief['pitch_um'], 'um')}: "
        f"{amount(1e3 * relief['rms_error_um'], 'nm', digits=2)} rms beside the mask's heights",
        f"{summary['seconds']:.1f} s",
    ]


fabricate = command(fabricate_job, _lines, name="fabricate")
