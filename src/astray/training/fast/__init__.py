"""Accelerated training: it learns the same as `training.loop`, which runs without it.

`acceleration` reports what is in use, and why. CPU kernels are in `sparse` (the network) and
`fused` (the loss). `actor` plays without waiting for a GPU, `graphs` replays GPU work, `parallel`
trains one agent in several processes. To change PPO you need not read this: any network or loss
that is not astray's own runs as it is written.
"""
