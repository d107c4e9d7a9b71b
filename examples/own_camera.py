# %% [markdown]
# # Your own camera
# A camera is a sensor, layers and a mask, described in `camera.toml`. `nolens camera show small`
# prints one to start from. Here its resin becomes thinner, so that the lenslets no longer focus
# on the sensor.

# %%
from pathlib import Path

import nolens as nl
from nolens.camera import preset_text

text = preset_text("small")
text = text.replace('thickness = "1.06 mm"', 'thickness = "0.4 mm"')
Path("camera.toml").write_text(text, encoding="utf-8")

# %%
thick, thin = nl.Camera("small"), nl.Camera("camera.toml")
sharp, blurred = (nl.psf(each, "300mm", wavelengths=1) for each in (thick, thin))
sharp.save("own_camera-sharp.png")
blurred.save("own_camera-blurred.png")

# %% [markdown]
# The width of the PSF's lines is the finest detail that the camera passes on.

# %%
width_um = {
    name: nl.measure_psf(psf, "3.1um", channel=1).line_width_um
    for name, psf in (("1.06 mm", sharp), ("0.4 mm", blurred))
}
print(width_um)
