# %% [markdown]
# # Design a mask
# A mask is a height map. This one is a regular array of lenslets with the focal length of the
# camera; any array of heights in µm will do.

# %%
import math

import nolens as nl
from nolens.design.masks import focusing_radius_um, lenslet_array

camera = nl.Camera("small")
media = camera.twin.media(550.0)
radius_um = math.copysign(focusing_radius_um(camera.twin), media.below - media.above)
surface = lenslet_array(
    radius_um=radius_um,
    pitch_um=70.0,
    arrangement="hexagonal",
    smoothing_um=6.0,
    size=(1032, 1096),
    grid_um=1.55,
)
regular = camera.with_relief(surface.height_um, "1.55um")

# %% [markdown]
# Regular lenslets focus as well as random ones, but their PSF repeats itself, and so does the
# photograph.

# %%
psf = nl.psf(regular, "300mm", wavelengths=1)
psf.save("design_mask.png")
for name, each in (("random", nl.psf(camera, "300mm", wavelengths=1)), ("regular", psf)):
    figures = nl.measure_psf(each, "3.1um", channel=1)
    print(f"{name}: lines {figures.line_width_um:.1f} µm wide, contrast {figures.contrast:.2f}")
