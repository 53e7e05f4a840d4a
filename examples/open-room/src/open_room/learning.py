"""A network with another activation, and a loss with one term more."""

from torch import nn

from astray.agents.mlp import MLP
from astray.training import ppo


class Tanh(MLP):
    """The two-layer perceptron with hyperbolic tangents."""

    def __init__(self, architecture):
        a = architecture
        super().__init__(a.shape, list(a.largest), a.actions, a.width)
        self.features.relu1, self.features.relu2 = nn.Tanh(), nn.Tanh()


def modest(network, minibatch, config):
    """PPO's loss, and a tenth of the mean square of the logits."""
    losses = ppo.loss(network, minibatch, config)
    size = (network(minibatch.observation)[0] ** 2).mean()
    return losses | {"loss": losses["loss"] + 0.1 * size, "size": size}
