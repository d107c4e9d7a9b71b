# %% [markdown]
# # Calibrate a camera, and extend its PSF beyond the sensor
# Raw frames of a point source become a PSF: averaged, without black level and stray light. A
# camera without an aperture has light up to the sensor's edges; captures from the side show how
# the PSF goes on there.

# %%
from dataclasses import replace

import nolens as nl

preset = nl.Camera("small")
mask = preset.loaded.camera.mask.model_copy(update={"aperture": None})
open_mask = preset.loaded.camera.model_copy(update={"mask": mask})
camera = nl.Camera(replace(preset.loaded, camera=open_mask))

# %%
psfs = {}
for right in ("-5deg", "0deg", "5deg"):
    for up in ("-4deg", "0deg", "4deg"):
        frame = nl.simulate_point(camera, "300mm", angle=(right, up), wavelengths=1)
        psfs[right, up] = nl.calibrate_psf(frame, "3.1um", stray_light="none", centre=False)

# %%
wide = nl.stitch_psfs(psfs, camera)
wide.save("calibrate_and_stitch.png")
print(f"{camera.size} pixels became {wide.size}, which serve scenes of {wide.support}")
wide
