"""The reconstruction problem of eq. 7, normalised so that no constant factor matters."""

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import FieldPsf
from nolens.camera.values import all_finite, squares
from nolens.errors import DataError, OptionError
from nolens.operators import (
    CroppedConvolution,
    FieldConvolution,
    FiniteDifference,
    Geometry,
    LinearOperator,
    SlowLightRemoval,
)
from nolens.solvers.data_terms import Gaussian
from nolens.solvers.functionals import (
    L1,
    Functional,
    GroupSparsity,
    NonNegative,
    OpponentL1,
    padded_difference,
)
from nolens.solvers.inputs import (
    Plane,
    Support,
    channels_of,
    mask_of,
    one_of,
    support_of,
    weight_of,
)

_COLOURS = ("R", "G", "B")
BASIS_ERROR = 0.03
"""Of PSFs over the field that are combinations of fewer (decision 18)."""
_UNIFORM = 0.9
"""Fraction of the data that a uniform scene explains where the scene fills the view."""
_UNIT_SIDE = 1000
"""Pixels along a square sensor on which a weight of 1 is a `Problem.tau` of 1."""


class Prior(StrEnum):
    """Regularising term R(v) of the objective."""

    AUTO = "auto"
    """Total variation: of the colours together where the scene fills the view of a colour sensor or
    the PSF varies over the field, of each channel otherwise."""
    TV = "tv"
    """Anisotropic total variation ‖Ψv‖₁, as in the paper."""
    ISOTROPIC_TV = "isotropic-tv"
    """Isotropic total variation Σ‖(Ψv)[i]‖₂."""
    COLOUR_TV = "colour-tv"
    """Anisotropic total variation of the colours together, for colour sensors: of their mean, and
    1.6 times as much of how colours differ."""
    L1 = "l1"
    """‖v‖₁, for scenes of few bright points."""
    NONE = "none"
    """Non-negativity alone."""


@dataclass(frozen=True)
class Problem:
    r"""Minimise ½‖b − CMv‖² + τ R(v) over v ≥ 0, v = 0 outside the support (`uvimprint`, eq. 7).

    Every channel is one such problem in **normalised units**: its PSF (as far as it can reach the
    sensor) and its valid data are divided by their ℓ2 norms. So the solution follows a change of
    either scale exactly, and τ need not change with it. `unscale` takes such a scene back
    to measurement over PSF.

    Make one with `Problem.build`.
    """

    forward: CroppedConvolution = field(repr=False)
    data: Tensor = field(repr=False)
    """(channels, height, width) of the sensor, unit norm, zero where not valid."""
    valid: Tensor = field(repr=False)
    """bool, like `data`: pixels that take part in the fit."""
    tau: float
    prior: Prior
    scale: Tensor = field(repr=False)
    """Measurement's norm over PSF's norm, for each channel."""
    psf_norm: Tensor = field(repr=False)
    tau_unit: float = 1.0
    """`tau` of a weight of 1 that means the same at any binning, support and number of channels."""
    slow_light: bool = True
    """Whether the slowest parts of the light on the sensor count. Without them (`SlowLightRemoval`)
    b and CMv are those less these parts; ADMM takes that where the measurement is in its linear
    step, and other splittings count all."""

    @classmethod
    def build(
        cls,
        psf: Plane,
        data: Plane,
        *,
        valid: Plane | None = None,
        support: Support | None = None,
        tau: float = 1e-4,
        prior: Prior | str = Prior.TV,
        field_psf: FieldPsf | None = None,
        basis_error: float = BASIS_ERROR,
        mapped: bool = False,
    ) -> "Problem":
        """Normalise PSF and measurement, and transform the PSF.

        Arrays may be tensors or NumPy's; those become float32. No gradient goes through a solver.

        Parameters
        ----------
        psf
            `(channels, height, width)`, `(1, height, width)` or `(height, width)`, of the sensor's
            size or larger, background removed, floating point.
        data
            `(channels, height, width)` or `(height, width)`, linear, background removed.
        valid
            Like `data`, bool: False where a pixel is to be left out of the fit (saturated).
        support
            Pixels of the sensor's frame that light can come from: a `PixelRectangle`,
            (height, width) around the sensor's middle, or (top, left, height, width); None for
            no limit.
        tau
            Weight of the prior in normalised units, ≥ 0.
        prior
            What the scene is assumed to be like: a `Prior` or its text.
        field_psf
            PSFs at several field points, in place of `psf`, which then only sets the units; of
            the data's channels or one, as large as the data or larger.
        basis_error
            With which fewer PSFs may take their places (`FieldConvolution`).
        mapped
            Whether their transfer functions are in temporary files (`FieldConvolution`).

        Raises
        ------
        DataError
            If shapes, types or devices do not fit, or PSF or data hold NaN or nothing but zeros.
        OptionError
            If `tau`, `prior` or `support` is none, or no light from the support reaches the sensor.
        """
        tau, prior = weight_of(tau), one_of(Prior, prior, "prior")
        psf, data = channels_of(psf, "PSF"), channels_of(data, "measurement")
        valid = mask_of(valid, data)
        _check_fit(psf, data, valid)
        precision = torch.promote_types(psf.dtype, data.dtype)
        psf, data = psf.to(precision), data.to(precision)
        sensor = (data.shape[-2], data.shape[-1])
        confined = support_of(support, sensor)
        if field_psf is None:
            forward = CroppedConvolution(psf, sensor, confined)
        else:
            for each in field_psf.values:
                _check_fit(each, data, valid)
            middle = torch.tensor([side // 2 for side in sensor])
            forward = FieldConvolution(
                field_psf.values.to(precision),
                field_psf.places + middle,
                sensor,
                confined,
                error=basis_error,
                mapped=mapped,
            )
        top, left, height, width = Geometry.build(
            sensor, (psf.shape[-2], psf.shape[-1]), confined
        ).psf
        psf_norm = _norm(psf[:, top : top + height, left : left + width], "the PSF")
        data = torch.where(valid, data, 0)
        data_norm = _norm(data, "the measurement (without saturated pixels)")
        forward.scale_(1 / psf_norm)
        problem = cls(
            forward=forward,
            data=data / data_norm,
            valid=valid,
            tau=tau,
            prior=prior,
            scale=data_norm / psf_norm,
            psf_norm=psf_norm,
            tau_unit=_tau_unit(psf, psf_norm, sensor, prior),
        )
        if prior is Prior.COLOUR_TV and problem.channels != len(_COLOURS):
            raise OptionError(
                f"prior {prior} is for three colours, and the measurement has "
                f"{problem.channels} channels: give tv"
            )
        if prior is not Prior.AUTO:
            return problem
        together = problem.channels == len(_COLOURS) and (
            field_psf is not None or min(problem.uniform_levels()) > 0
        )
        return replace(problem, prior=Prior.COLOUR_TV if together else Prior.TV)

    @property
    def by_channel(self) -> "Problem":
        """The same with a prior of each channel by itself."""
        return replace(self, prior=Prior.TV) if self.prior is Prior.COLOUR_TV else self

    @property
    def in_linear_step(self) -> bool:
        """Whether ADMM has to keep the measurement in its linear step (`DataStep`)."""
        return self.prior is Prior.COLOUR_TV or isinstance(self.forward, FieldConvolution)

    def uniform_levels(self) -> list[float]:
        """Level c of each channel that minimises ‖b − c·CM1‖²; zeros where that explains little.

        Where it explains most of the measurement, the scene fills the view.
        """
        even = (self.data.new_ones(1, side) for side in self.scene_shape[1:])
        (light,) = self.forward.of_products(*even)
        glow = torch.where(self.valid, light, 0)
        overlap = (glow * self.data).sum(dim=-1).double().sum(dim=-1)
        levels = overlap / squares(glow).clamp_min(1e-300)
        explained = float((levels * overlap).mean())  # of ‖b‖² = 1
        return levels.tolist() if explained > _UNIFORM else [0.0] * self.channels

    @property
    def weight(self) -> float:
        """Weight of the prior as users give it: `tau` over `tau_unit`."""
        return self.tau / self.tau_unit

    def weighted(self, weight: float) -> "Problem":
        """The same problem with another `weight`."""
        return replace(self, tau=weight * self.tau_unit)

    def measuring(self, data: Plane, valid: Plane | None = None) -> "Problem":
        """The same problem for another measurement: the PSF is not transformed again.

        Parameters
        ----------
        data, valid
            As `build` takes them, of the same sizes.

        Raises
        ------
        DataError
            If they do not fit, or hold NaN or nothing but zeros.
        """
        data = channels_of(data, "measurement").to(self.data)
        valid = mask_of(valid, data).to(data.device)
        if data.shape != self.data.shape:
            raise DataError(
                f"the measurement is {tuple(data.shape)}, and those before it were "
                f"{tuple(self.data.shape)}: (channels, height, width) must be the same"
            )
        data = torch.where(valid, data, 0)
        if not all_finite(data):
            raise DataError("the measurement holds NaN or infinity; give finite values")
        norm = _norm(data, "the measurement (without saturated pixels)")
        return replace(self, data=data / norm, valid=valid, scale=norm / self.psf_norm)

    def to(self, device: torch.device) -> "Problem":
        """The same problem on a device."""
        tensors = {
            each: getattr(self, each).to(device) for each in ("data", "valid", "scale", "psf_norm")
        }
        return replace(self, forward=self.forward.to(device), **tensors)

    @property
    def channels(self) -> int:
        """Number of channels of the measurement."""
        return self.data.shape[0]

    def single(self, channel: int) -> "Problem":
        """The problem of one channel."""
        part = slice(channel, channel + 1)
        return replace(
            self,
            forward=self.forward.single(channel % self.forward.channels),
            data=self.data[part],
            valid=self.valid[part],
            scale=self.scale[part],
        )

    @property
    def channel_weights(self) -> Tensor:
        """Power of each channel in the measurement, of 1: errors count as they are in counts."""
        power = (self.scale * self.psf_norm).double().square().flatten().cpu()
        return power / power.sum()

    @property
    def varied(self) -> bool:
        """Whether the prior weighs differences of neighbouring pixels."""
        return self.tau > 0 and self.prior not in (Prior.L1, Prior.NONE)

    @property
    def padded_pixels(self) -> int:
        """Pixels of the padded shape, those of all channels together."""
        return self.channels * math.prod(self.forward.geometry.padded)

    @property
    def scene_shape(self) -> tuple[int, int, int]:
        """(channels, height, width) of a scene."""
        return (self.channels, *self.forward.geometry.scene[2:])

    @property
    def frame(self) -> tuple[int, int, int, int]:
        """Window (top, left, height, width) of a scene that is its photograph.

        The support; without one, the sensor's frame. Around that lies what the sensor sees of its
        surroundings.
        """
        if self.forward.support is not None:
            return (0, 0, *self.forward.geometry.scene[2:])
        return self.sensor_frame

    @property
    def sensor_frame(self) -> tuple[int, int, int, int]:
        """Window (top, left, height, width) of a scene that lies where the sensor does."""
        origin = self.forward.geometry.origin
        return (-origin[0], -origin[1], *self.forward.sensor)

    def transfer(self, channel: int) -> Tensor:
        """Half spectrum of a channel's PSF; a single PSF serves all channels."""
        return self.forward.transfer[channel % self.forward.channels]

    def counted(self, image: Tensor) -> Tensor:
        """What counts of an image on the sensor: valid pixels, and no slow light where it does not.

        Parameters
        ----------
        image
            (channels, height, width); it may be what is returned.
        """
        if not self.slow_light:
            return self._removal(image)
        return image if self._all_valid else torch.where(self.valid, image, 0)

    @cached_property
    def _all_valid(self) -> bool:
        return bool(self.valid.all())

    @property
    def counted_forward(self) -> LinearOperator:
        """What counts of CMv, as an operator."""
        return self.forward if self.slow_light else self._removal @ self.forward

    @cached_property
    def _removal(self) -> SlowLightRemoval:
        return SlowLightRemoval(self.valid)

    def residual(self, scene: Tensor) -> Tensor:
        """What counts of b − CMv, zero on pixels that are not valid; normalised."""
        return self.counted(self.data - self.forward(scene))

    def objective(self, scene: Tensor, residual: Tensor | None = None) -> float:
        """Value of the objective, mean over channels, of a scene in normalised units.

        Parameters
        ----------
        scene
            `(channels, height, width)` of the scene's pixels; it is the caller's to make it
            non-negative.
        residual
            Of this scene, where it is known.
        """
        left = self.residual(scene) if residual is None else residual
        value = 0.5 * squares(left).sum() + self.tau * self.regulariser(scene)
        return float(value) / self.channels

    def regulariser(self, scene: Tensor) -> Tensor:
        """R(v) of the whole padded shape, so with the step to zero at a support's edge; float64."""
        if self.prior in (Prior.L1, Prior.NONE):
            prior = self.regularising
            return scene.new_zeros((), dtype=torch.float64) if prior is None else prior(scene)
        height, width = self._varied_shape
        framed = nnf.pad(scene, (0, width - scene.shape[-1], 0, height - scene.shape[-2]))
        # Some rows at a time: differences of all of them are the most that a run would hold.
        bands = FiniteDifference((height, width)).bands(framed)
        return torch.stack([self.norm_of_differences(each) for each in bands]).sum()

    @property
    def regularising(self) -> Functional | None:
        """R as a functional; None without a prior."""
        if self.prior is Prior.NONE:
            return None
        if self.prior is Prior.L1:
            return L1()
        difference = padded_difference(self.scene_shape[1:], self._varied_shape)
        return self.norm_of_differences @ difference

    @property
    def _varied_shape(self) -> tuple[int, int]:
        """(height, width) of differences: those of the whole padded shape are zero further than a
        pixel from the scene.
        """
        scene, whole = self.forward.geometry.scene[2:], self.forward.geometry.padded
        height, width = (min(n + 1, most) for n, most in zip(scene, whole, strict=True))
        return height, width

    @property
    def norm_of_differences(self) -> Functional:
        """Of (channels, 2, height, width): what makes them a total variation."""
        if self.prior is Prior.COLOUR_TV:
            return OpponentL1.of_scene(-4)
        return GroupSparsity(-3) if self.prior is Prior.ISOTROPIC_TV else L1()

    @property
    def functionals(self) -> list[Functional]:
        """The objective's, of all channels together, for the solvers of any."""
        data = Gaussian(self.counted(self.data), valid=self.valid) @ self.counted_forward
        prior = self.regularising
        weighed = [] if prior is None or self.tau == 0 else [self.tau * prior]
        return [data, *weighed, NonNegative()]

    def gain_corrected(self, scene: Tensor) -> tuple[Tensor, float]:
        """Every channel times the factor f that minimises the objective, and the objective.

        Colours that are taken together have one factor.

        The iterate's mean is held by all pixels that it lights, and comes to rest last: it can
        be some per cent off, each channel in its own way, when the picture has long been there. As
        all priors are homogeneous, R(fv) = f R(v), the best factor is
        f = (⟨b, CMv⟩ − τR(v)) / ‖CMv‖² where that is above zero.

        Parameters
        ----------
        scene
            `(channels, height, width)` in normalised units, non-negative.
        """
        data = self.counted(self.data)
        fit = (data - self.residual(scene)).double()
        overlap, power = (fit * data).sum(dim=(-2, -1)), fit.square().sum(dim=(-2, -1))
        if self.prior is Prior.COLOUR_TV:
            prior = self.tau * self.regulariser(scene)
            overlap, power = overlap.sum(dim=0, keepdim=True), power.sum(dim=0, keepdim=True)
        else:
            prior = self.tau * torch.stack([self.regulariser(each[None]) for each in scene])
        factor = ((overlap - prior) / power.clamp_min(1e-300))[:, None, None]
        if not bool((factor > 0).all()):
            factor = torch.ones_like(factor)
        left = data - factor * fit
        scene = factor.to(scene.dtype) * scene
        return scene, self.objective(scene, left)

    def unscale(self, scene: Tensor) -> Tensor:
        """Scene in units of measurement over PSF, from one in normalised units."""
        return scene * self.scale


def _tau_unit(psf: Tensor, psf_norm: Tensor, sensor: tuple[int, int], prior: Prior) -> float:
    r"""What makes a weight mean the same at any binning and support.

    Means over b×b pixels make the data's norm b times smaller, and that of a PSF without much
    detail, too: the normalised scene is b² times brighter on b² times fewer pixels, and its total
    variation, along edges b times shorter, b times as large; its ℓ1 norm stays. A support changes
    the part of the PSF that reaches the sensor, and with its norm the scene's; the norm of a part
    as large as the sensor stays. So

    .. math:: u = \frac{\|p\|_{reach}}{\|p\|_{sensor}} \sqrt{N / 10^6},

    for a sensor of N pixels; without the root for the ℓ1 norm.
    """
    (height, width), (rows, columns) = sensor, psf.shape[-2:]
    top, left = rows // 2 - height // 2, columns // 2 - width // 2
    middle = psf[:, top : top + height, left : left + width]
    norm = torch.linalg.vector_norm(middle, dim=(-2, -1), dtype=torch.float64)
    reach = psf_norm.double().flatten() / norm.clamp_min(torch.finfo(torch.float32).tiny)
    length = 1.0 if prior is Prior.L1 else math.sqrt(height * width) / _UNIT_SIDE
    return float(reach.mean()) * length


def _check_fit(psf: Tensor, data: Tensor, valid: Tensor) -> None:
    if psf.shape[0] not in (1, data.shape[0]):
        raise DataError(
            f"the PSF has {psf.shape[0]} channels and the measurement {data.shape[0]}; "
            "give one PSF for all channels or one for each"
        )
    if psf.shape[1] < data.shape[1] or psf.shape[2] < data.shape[2]:
        raise DataError(
            f"the PSF has {psf.shape[1]}×{psf.shape[2]} pixels (height × width) and the "
            f"measurement {data.shape[1]}×{data.shape[2]}; the PSF must be as large or larger"
        )
    if not psf.device == data.device == valid.device:
        raise DataError(
            f"the PSF is on {psf.device}, the measurement on {data.device} and its mask on "
            f"{valid.device}; put all on one device"
        )
    for name, tensor in (("PSF", psf), ("measurement", torch.where(valid, data, 0))):
        if not all_finite(tensor):
            raise DataError(f"the {name} holds NaN or infinity; give finite values")


def _norm(tensor: Tensor, what: str) -> Tensor:
    norm: Tensor = torch.linalg.vector_norm(tensor, dim=(-2, -1), keepdim=True, dtype=torch.float64)
    if not bool((norm > 0).all()):
        raise DataError(f"{what} is zero everywhere in at least one channel; nothing to solve")
    return norm.to(tensor.dtype)
