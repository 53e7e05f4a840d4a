"""The same learning, sooner: `training.loop` runs without any of it, and learns the same.

`acceleration` says what is in use, and why not. Kernels for a CPU are in `sparse` (the network)
and `fused` (the loss); `actor` plays without waiting for a GPU, `graphs` replays what a GPU does,
`parallel` trains one agent in several processes. Nobody has to read it to change PPO: what a
training is given that is not astray's own network and loss runs as it is written.
"""
