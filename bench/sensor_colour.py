"""Colour filters of the presets' sensor, fitted to what Raspberry Pi measured of the IMX477.

`sensor_colour.py --data ../shared/data` prints the fit, its curves and how far the preset `paper`
is from them. The data are `ct_curve` of libcamera's tuning file (`rpi.awb`; BSD-2-Clause): for some
colour temperatures the ratios R/G and B/G of raw counts above black of a grey patch, seen by the
stock High Quality camera, the infrared-cut filter in its mount included.

The file does not say which lamps these were: Planck's law stands for them below 4000 K, the CIE
daylight of that temperature above. The points from 6125 K to 7763 K are evenly spaced and read like
an interpolation. Twelve points of two ratios carry few unknowns, so the shapes are given (those of
usual filters) and four numbers are fitted: the heights of red and blue, the wavelength of blue, and
the wavelength at which the infrared-cut filter passes half. The height of green is not in the data.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from nolens.camera import LoadedCamera, SpectralCurve, preset

Array = NDArray[np.float64]

NODES_NM = np.arange(400.0, 701.0, 10.0)
GRID_NM = np.arange(400.0, 701.0, 1.0)
GREEN_PEAK = 0.65
RED_EDGE_NM, RED_EDGE_WIDTH_NM = 585.0, 9.0
CUT_WIDTH_NM = 12.0
START = (0.55, 615.0, 0.55, 465.0)
DAYLIGHT_FROM_K = 4000.0
# S0, S1 and S2 of the CIE daylight (CIE 15), every 10 nm from 400 nm to 700 nm.
DAYLIGHT_TABLE = """
94.8 104.8 105.9 96.8 113.9 125.6 125.5 121.3 121.3 113.5 113.1 110.8 106.5 108.8 105.3 104.4
100.0 96.0 95.1 89.1 90.5 90.3 88.4 84.0 85.1 81.9 82.6 84.9 81.3 71.9 74.3
43.4 46.3 43.9 37.1 36.7 35.9 32.6 27.9 24.3 20.1 16.2 13.2 8.6 6.1 4.2 1.9
0.0 -1.6 -3.5 -3.5 -5.8 -7.2 -8.6 -9.5 -10.9 -10.7 -12.0 -14.0 -13.6 -12.0 -13.3
-1.1 -0.5 -0.7 -1.2 -2.6 -2.9 -2.8 -2.6 -2.6 -1.8 -1.5 -1.3 -1.2 -1.0 -0.5 -0.3
0.0 0.2 0.5 2.1 3.2 4.1 4.7 5.1 6.7 7.3 8.6 9.8 10.2 8.3 9.6
"""
DAYLIGHT = np.array(DAYLIGHT_TABLE.split(), dtype=np.float64).reshape(3, -1)


def efficiency(red: float, cut_nm: float, blue: float, blue_nm: float) -> dict[str, Array]:
    """Quantum efficiency at `NODES_NM`: shapes of usual filters behind an infrared-cut filter.

    Parameters
    ----------
    red, blue
        Heights of the filters.
    cut_nm
        Where the infrared-cut filter passes half.
    blue_nm
        Where the blue filter passes most.
    """
    cut = _edge(cut_nm - NODES_NM, CUT_WIDTH_NM)
    leak = 0.03 * _bump(420.0, 25.0, 30.0) + 0.01
    curves = {
        "R": (red * _edge(NODES_NM - RED_EDGE_NM, RED_EDGE_WIDTH_NM) + leak) * cut,
        "G": (_bump(525.0, 35.0, 42.0) + 0.02) * cut,
        "B": (blue * _bump(blue_nm, 32.0, 36.0) + 0.01) * cut,
    }
    curves["G"] *= GREEN_PEAK / curves["G"].max()
    return curves


def lamp(kelvin: float) -> Array:
    """Spectral power at `GRID_NM`, in any unit: Planck's law, or daylight from 4000 K on."""
    if kelvin < DAYLIGHT_FROM_K:
        return GRID_NM**-5 / np.expm1(1.438777e7 / (GRID_NM * kelvin))
    cubic = (
        (-4.6070e9, 2.9678e6, 99.11, 0.244063)
        if kelvin <= 7000
        else (-2.0064e9, 1.9018e6, 247.48, 0.237040)
    )
    x = float(np.polyval(cubic, 1 / kelvin))
    y = -3 * x**2 + 2.87 * x - 0.275
    common = 0.0241 + 0.2562 * x - 0.7341 * y
    first = (-1.3515 - 1.7703 * x + 5.9114 * y) / common
    second = (0.03 - 31.4424 * x + 30.0717 * y) / common
    return np.interp(GRID_NM, NODES_NM, np.array([1.0, first, second]) @ DAYLIGHT)


def ratios(curves: dict[str, Array], kelvin: float) -> tuple[float, float]:
    """R/G and B/G of a grey in the light of a lamp."""
    photons = lamp(kelvin) * GRID_NM
    red, green, blue = (
        float(photons @ np.interp(GRID_NM, NODES_NM, curves[channel])) for channel in "RGB"
    )
    return red / green, blue / green


def fit(points: Array) -> Array:
    """Find the four numbers of `efficiency` by least squares of the ratios' logarithms."""

    def off(numbers: Array) -> Array:
        curves = efficiency(*numbers)
        return np.ravel([np.log(np.array(ratios(curves, p[0])) / p[1:]) for p in points])

    found: Array = least_squares(off, START).x
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description="Fit the colours of the presets' sensor.")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    file = parser.parse_args().data / "imx477" / "imx477.json"
    parts = {}
    for each in json.loads(file.read_text())["algorithms"]:
        parts |= each
    points = np.array(parts["rpi.awb"]["ct_curve"]).reshape(-1, 3)
    numbers = fit(points)
    curves = efficiency(*numbers)
    red, cut_nm, blue, blue_nm = numbers
    print(f"red {red:.3f}, blue {blue:.3f} at {blue_nm:.1f} nm, infrared cut at {cut_nm:.1f} nm")
    print("  K       R/G     fit           B/G     fit")
    off = []
    for kelvin, *wanted in points:
        found = ratios(curves, kelvin)
        off.append([here / there - 1 for here, there in zip(found, wanted, strict=True)])
        print(
            f"  {kelvin:.0f}",
            *(
                f"   {there:.4f}  {here:.4f} {100 * error:+5.1f} %"
                for there, here, error in zip(wanted, found, off[-1], strict=True)
            ),
        )
    rms = 100 * np.sqrt(np.mean(np.square(off), axis=0))
    print(f"rms: R/G {rms[0]:.1f} %, B/G {rms[1]:.1f} %")
    noise, black = parts["rpi.noise"], parts["rpi.black_level"]["black_level"]
    # Both are on a scale of 16 bits; the variance is the signal times the slope's square.
    print(
        f"black {black / 16:g} counts of 12 bits, "
        f"{noise['reference_slope'] ** 2 / 16:.3f} counts to the electron"
    )
    for channel in "RGB":
        print(channel, np.round(curves[channel], 3).tolist())
    ours = LoadedCamera.of(preset("paper")).quantum_efficiency
    print(f"preset: at most {_away(ours, curves):.4f} away")


def _away(ours: SpectralCurve, curves: dict[str, Array]) -> float:
    return max(float(abs(ours.at(name, NODES_NM) - curve).max()) for name, curve in curves.items())


def _edge(beyond_nm: Array, width_nm: float) -> Array:
    rise: Array = 1 / (1 + np.exp(-beyond_nm / width_nm))
    return rise


def _bump(centre_nm: float, below_nm: float, above_nm: float) -> Array:
    width = np.where(centre_nm > NODES_NM, below_nm, above_nm)
    shape: Array = np.exp(-(((NODES_NM - centre_nm) / width) ** 2) / 2)
    return shape


if __name__ == "__main__":
    main()
