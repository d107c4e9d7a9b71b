# %% [markdown]
# # From a scene to a measurement and back
# The simulated camera computes its PSF by diffraction, lets it vary over the field, and adds the
# sensor's noise. A scene twice as wide has four times the pixels, from as many measurements.

# %%
from skimage import data

import nolens as nl

camera = nl.Camera("small")
psnr_db = {}
for angle in ("8deg", "16deg"):
    shot = nl.simulate(data.astronaut(), camera, angle=angle, distance="300mm", field_points=3)
    psf = nl.psf(camera, "300mm", support=shot.support, wavelengths=1)
    photo = nl.reconstruct(shot, psf)
    psnr_db[angle] = nl.psnr(photo, shot.expected)
    photo.save(f"simulate-{angle}.png")
print(psnr_db)

# %% [markdown]
# What the sensor measured of the last one.

# %%
shot.save("simulate-measurement.png")
shot
