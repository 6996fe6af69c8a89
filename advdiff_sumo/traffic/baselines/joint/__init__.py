"""The traffic model's roll-out of one whole scene on the CPU, with its exact gradient by all latents at once.

``diffusion.fast_decoder`` has the gradient of a few rows against a trace; Strive moves everybody, and what one does
changes what the others see. The same function as ``models.decoder``, equal up to rounding, in numpy: for a handful of
vehicles most of the time of tensors goes into their bookkeeping.
"""
