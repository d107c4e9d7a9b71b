"""When a sensor's lines are exposed, and what fraction of it each frame of a video takes."""

from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.camera.sensor import Sensor


@dataclass(frozen=True)
class Shutter:
    r"""Exposure of every line of a sensor, from its start to its end.

    Line y is exposed from :math:`t_0(y)` to :math:`t_0(y) + e`; the first begins at 0.

    Parameters
    ----------
    starts_s
        :math:`t_0`, (rows,), float64; zeros of a global shutter.
    exposure_s
        e, above 0.
    """

    starts_s: Tensor
    exposure_s: float

    @classmethod
    def of(cls, sensor: Sensor, exposure_s: float) -> "Shutter":
        """That of a sensor (`Sensor.rolling`); global where it has no line time.

        Parameters
        ----------
        sensor
            The sensor.
        exposure_s
            Of every line, above 0.
        """
        down = torch.arange(sensor.rows, dtype=torch.float64)
        nearest = torch.minimum(down, down.flip(0))
        lines = {"down": down, "up": down.flip(0), "in": nearest, "out": nearest.max() - nearest}
        order = lines[sensor.rolling or "down"]
        return cls(order * (sensor.line_time_us or 0.0) * 1e-6, exposure_s)

    @property
    def duration_s(self) -> float:
        """From the start of the first line to the end of the last."""
        return float(self.starts_s.max()) + self.exposure_s

    def frames(self, count: int) -> Tensor:
        """Times at which so many frames of equal length begin and end, (count + 1,), in s."""
        return torch.linspace(0, self.duration_s, count + 1, dtype=torch.float64)

    def fractions(self, times_s: Tensor) -> Tensor:
        r"""Fraction of each line's exposure that lies in each frame (`antipa2019`).

        .. math:: m_k(y) = |[t_0(y), t_0(y) + e] ∩ [T_k, T_{k+1}]| / e

        Parameters
        ----------
        times_s
            :math:`T_k`, (frames + 1,), increasing.

        Returns
        -------
        Tensor
            (frames, rows), float32. Of frames that cover the whole exposure, they sum to 1.
        """
        begin = torch.maximum(self.starts_s, times_s[:-1, None])
        end = torch.minimum(self.starts_s + self.exposure_s, times_s[1:, None])
        return ((end - begin).clamp_min(0) / self.exposure_s).float()


def developed_rows(
    lines: Tensor, mosaic: str | None, channels: tuple[str, ...], size: tuple[int, int]
) -> Tensor:
    """Values of a sensor's lines on the pixels of a measurement that was developed from them.

    Parameters
    ----------
    lines
        (frames, lines of the sensor).
    mosaic
        Colours of the superpixel, row by row; None without.
    channels
        Of the measurement: ``R``, ``G`` and ``B`` are means of the superpixel's lines with that
        colour, others of all.
    size
        (height, width) of the measurement, whose pixels are means of as many lines.

    Returns
    -------
    Tensor
        (frames, channels, height, width); columns are views of one.
    """
    by = lines.shape[-1] // size[0]
    tall = lines[:, : by * size[0]].reshape(len(lines), size[0], by)
    rows = []
    for name in channels:
        phases = [n for n in (0, 1) if mosaic and name in mosaic[2 * n : 2 * n + 2]]
        part = tall if len(phases) != 1 else tall[..., phases[0] :: 2]
        rows.append(part.mean(dim=-1))
    return torch.stack(rows, dim=1)[..., None].expand(-1, -1, -1, size[1])
