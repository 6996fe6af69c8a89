"""The background ``diffusion``: latent diffusion, natural or guided against the target (the paper's method)."""
