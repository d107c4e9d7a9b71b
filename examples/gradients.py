# %% [markdown]
# # Gradients through the model
# Every operator is differentiable: `torch` optimises a scene under a loss of your own. Here it is
# a Huber loss and a penalty on the scene's second differences, by Adam.

# %%
import torch
from skimage import data

import nolens as nl

camera = nl.Camera("small")
shot = nl.simulate(data.astronaut(), camera, angle="10deg", distance="300mm", field_points=1)
psf = nl.psf(camera, "300mm", support=shot.support, wavelengths=1).values
scale = shot.values.abs().amax(dim=(-2, -1), keepdim=True)
light = psf.sum(dim=(-2, -1), keepdim=True)
forward = nl.operators.CroppedConvolution(psf / light, shot.size, shot.support)

# %%
scene = torch.full(forward.domain_shape, 0.3, requires_grad=True)
optimiser = torch.optim.Adam([scene], lr=0.03)
losses = []
for _ in range(400):
    fit = torch.nn.functional.huber_loss(forward(scene.abs()), shot.values / scale, delta=0.05)
    rough = scene.diff(n=2, dim=-1).abs().mean() + scene.diff(n=2, dim=-2).abs().mean()
    loss = fit + 1e-5 * rough
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    losses.append(loss.item())
photo = nl.Image(scene.detach().abs() * scale / light, shot.channels)
photo.save("gradients.png")
print(f"loss {losses[0]:.2e} to {losses[-1]:.2e}, {nl.psnr(photo, shot.expected):.1f} dB")
