# %% [markdown]
# # Refocus after the capture
# The PSF grows as the scene comes nearer. PSFs of two distances give that of every distance
# between, so that one measurement can be focused anywhere, or at the distance where it is
# sharpest.

# %%
from skimage import data

import nolens as nl

camera = nl.Camera("small")
shot = nl.simulate(data.astronaut(), camera, angle="12deg", distance="14mm", field_points=3)
psfs = {
    each: nl.psf(camera, each, support=shot.support, wavelengths=1) for each in ("10mm", "300mm")
}

# %%
far = nl.refocus(shot, psfs, "300mm", tau=1e-5)
sharp = nl.refocus(shot, psfs, tau=1e-5)
far.save("refocus-300mm.png")
sharp.save("refocus-sharpest.png")
print(f"sharpest at {sharp.distance_um / 1e3:.1f} mm; the scene is at 14 mm")
sharp
