"""Where sensor, scene and PSF lie in the period of the transforms."""

from dataclasses import dataclass

from nolens.errors import OptionError
from nolens.kernels import fast_length


@dataclass(frozen=True)
class Region:
    """Rectangle of scene pixels, in the sensor's frame.

    Scene pixel (i, j) is the one whose light, through the centre of the PSF, falls on sensor
    pixel (i, j). A scene can reach beyond the sensor, so `top` and `left` may be negative.
    """

    top: int
    left: int
    height: int
    width: int

    @classmethod
    def centred(cls, height: int, width: int, sensor: tuple[int, int]) -> "Region":
        """Support of the given size around the centre of the sensor."""
        return cls((sensor[0] - height) // 2, (sensor[1] - width) // 2, height, width)


@dataclass(frozen=True)
class _Axis:
    """The same along one axis: offsets in the period, and which PSF cells can matter."""

    period: int
    sensor_start: int
    scene_start: int
    scene_length: int
    psf_start: int
    psf_stop: int


@dataclass(frozen=True)
class Geometry:
    """Layout of one convolution: windows are (top, left, height, width) in the period.

    Parameters
    ----------
    period
        (height, width) of the transforms.
    sensor, scene
        Windows of the measurement and of the pixels that light can come from.
    psf
        Window of the PSF array that can reach the sensor from the scene.
    psf_shift
        Where the first pixel of that window lies, relative to zero shift.
    origin
        Scene pixel, in the sensor's frame, of the scene's first row and column.
    """

    period: tuple[int, int]
    sensor: tuple[int, int, int, int]
    scene: tuple[int, int, int, int]
    psf: tuple[int, int, int, int]
    psf_shift: tuple[int, int]
    origin: tuple[int, int]

    @classmethod
    def lay_out(
        cls, sensor: tuple[int, int], psf: tuple[int, int], region: Region | None
    ) -> "Geometry":
        r"""Shortest fast period in which no wrap-around reaches the sensor.

        For a PSF with offsets from o₀ to o₁ and scene pixels from t to t + r − 1, the shifted
        copies of the convolution miss the sensor's pixels 0 … N − 1 when the period is at least
        max(t + r + o₁, N − t − o₀). Offsets that carry no light from the scene to the sensor
        are cut off first, so sensor + support − 1 is enough for a support that overlaps the
        sensor, and for a scene without limits sensor + PSF − 1.

        Parameters
        ----------
        sensor, psf
            (height, width) in pixels of the same pitch. Zero shift is the PSF's pixel
            (height // 2, width // 2).
        region
            Pixels that light can come from; None for every pixel that the sensor can see, with
            the whole period as the scene.

        Raises
        ------
        OptionError
            If the support has no pixel from which the PSF reaches the sensor.
        """
        if region is None:
            axes = [
                _unlimited(sensor[0], psf[0], of_rows=False),
                _unlimited(sensor[1], psf[1], of_rows=True),
            ]
            scene_origin = tuple(a.scene_start - a.sensor_start for a in axes)
        else:
            axes = [
                _confined(sensor[0], psf[0], region.top, region.height, of_rows=False),
                _confined(sensor[1], psf[1], region.left, region.width, of_rows=True),
            ]
            scene_origin = (region.top, region.left)
        rows, columns = axes
        return cls(
            period=(rows.period, columns.period),
            sensor=(rows.sensor_start, columns.sensor_start, *sensor),
            scene=(
                rows.scene_start,
                columns.scene_start,
                rows.scene_length,
                columns.scene_length,
            ),
            psf=(
                rows.psf_start,
                columns.psf_start,
                rows.psf_stop - rows.psf_start,
                columns.psf_stop - columns.psf_start,
            ),
            psf_shift=(rows.psf_start - psf[0] // 2, columns.psf_start - psf[1] // 2),
            origin=(scene_origin[0], scene_origin[1]),
        )


def _unlimited(sensor: int, psf: int, *, of_rows: bool) -> _Axis:
    period = fast_length(sensor + psf - 1, of_rows=of_rows)
    return _Axis(period, (period - sensor) // 2, 0, period, 0, psf)


def _confined(sensor: int, psf: int, start: int, length: int, *, of_rows: bool) -> _Axis:
    centre = psf // 2
    low = max(-centre, -(start + length - 1))
    high = min(psf - 1 - centre, sensor - 1 - start)
    if length < 1 or high < low:
        raise OptionError(
            f"no light from the support (pixels {start} to {start + length - 1} of the sensor's "
            f"frame, which has {sensor}) reaches the sensor through a PSF of {psf} pixels; "
            "give a support that overlaps the sensor"
        )
    sensor_start = max(0, -start)
    span = max(sensor_start + sensor, sensor_start + start + length)
    needed = max(start + length + high, sensor - start - low, span)
    return _Axis(
        fast_length(needed, of_rows=of_rows),
        sensor_start,
        sensor_start + start,
        length,
        low + centre,
        high + centre + 1,
    )
