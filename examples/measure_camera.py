# %% [markdown]
# # Measure a camera
# How fine are the PSF's lines, to which spatial frequency does it stand out of the noise, and how
# much does it change over the field?

# %%
import nolens as nl
from nolens.experiments.off_axis import peak_correlation

camera = nl.Camera("small")
frames = [nl.simulate_point(camera, "300mm", seed=seed) for seed in range(4)]
psf = nl.calibrate_psf(frames, "3.1um")
figures = nl.measure_psf(psf, "3.1um", channel=1)
print(f"lines {figures.line_width_um:.1f} µm wide")
print(f"above the noise up to {figures.usable_per_mm:.0f} line pairs per mm")
psf.save("measure_camera.png")

# %%
correlation = {}
ahead = nl.psf(camera, "300mm", wavelengths=1).values[1]
for degrees in (2, 4, 6):
    side = nl.psf(camera, "300mm", angle=(f"{degrees}deg", "0deg"), wavelengths=1).values[1]
    correlation[degrees] = peak_correlation(ahead, side).frame
print(correlation)
