# %% [markdown]
# # A first picture
# Two files become a photograph: what the sensor measured of a scene, and its point spread
# function (PSF), which is what it measures of a point source. Here a small simulated camera
# stands for a real one.

# %%
from skimage import data

import nolens as nl

camera = nl.Camera("small")
shot = nl.simulate(data.astronaut(), camera, angle="10deg", distance="300mm", field_points=3)
nl.save_frame(shot.frame, "raw.dng")
nl.save_frame(nl.simulate_point(camera, "300mm"), "psf.dng")

# %% [markdown]
# With files of your own, begin here.

# %%
photo = nl.reconstruct("raw.dng", "psf.dng")
photo.save("first_picture.png")
photo

# %% [markdown]
# `tau` weighs the smoothness against the data: larger is smoother. `quality="draft"` is there at
# once.

# %%
draft = nl.reconstruct("raw.dng", "psf.dng", quality="draft")
smooth = nl.reconstruct("raw.dng", "psf.dng", tau=1e-3)
