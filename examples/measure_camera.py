# %% [markdown]
# # Measure a camera
# How fine are the PSF's lines, to which spatial frequency does it stand out of the noise, and how
# much does it change over the field?

# %%
import nolens as nl

camera = nl.Camera("small")
frames = [nl.simulate_point(camera, "300mm", seed=seed) for seed in range(4)]
psf = nl.calibrate_psf(frames, "3.1um")
figures = nl.measure_psf(psf, "3.1um", channel=1)
print(f"lines {figures.line_width_um:.1f} µm wide")
print(f"above the noise up to {figures.usable_per_mm:.0f} line pairs per mm")
psf.save("measure_camera.png")

# %%
field = nl.measure_field(camera, angles=("0deg", "2deg", "4deg", "6deg"))
for each in field.psfs:
    print(f"{each.angle_deg:.0f}°: correlation {each.correlation:.2f}, light {each.light:.2f}")
