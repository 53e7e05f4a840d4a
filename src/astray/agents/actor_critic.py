"""Base classes of astray's networks: linear policy and value heads on one hidden layer."""

from collections import OrderedDict

import torch
from torch import Tensor, nn


class ActorCritic(nn.Module):
    """Observations [B, ...] uint8 -> logits [B, actions], values [B]."""

    policy: nn.Linear
    value: nn.Linear

    def forward(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        return self.heads(self.hidden(observations))

    def hidden(self, observations: Tensor) -> Tensor:
        """Return features [B, F] of observations [B, ...]; the heads are linear in them."""
        raise NotImplementedError

    def heads(self, features: Tensor) -> tuple[Tensor, Tensor]:
        return self.policy(features), self.value(features).squeeze(-1)

    def add_heads(self, features: int, actions: int) -> None:
        """Add the last layers, and initialise all weights."""
        self.policy = nn.Linear(features, actions)
        self.value = nn.Linear(features, 1)
        initialise(self)


class Pixels(ActorCritic):
    """Network for images [B, H, W, C]: features of the planes that `see` computes."""

    features: nn.Module

    def hidden(self, observations: Tensor) -> Tensor:
        kind, planes = self.kind(observations), observations.permute(0, 3, 1, 2)
        # In place where they are a copy: another one of a minibatch leaves the processor's caches.
        whole = planes.dtype == torch.uint8
        planes = planes.to(kind).div_(255) if whole else planes.to(kind) / 255
        return self.features(self.see(planes))

    def kind(self, observations: Tensor) -> torch.dtype:
        """Return the dtype that the first convolution of images [B, H, W, C] rounds to."""
        device = observations.device.type
        if torch.is_autocast_enabled(device):
            return torch.get_autocast_dtype(device)
        return self.policy.weight.dtype

    def see(self, planes: Tensor) -> Tensor:
        """Map planes [B, C, H, W] in 0 to 1 to [B, D, h, w]."""
        raise NotImplementedError


def dense(inputs: int, *widths: int) -> nn.Sequential:
    """Build dense layers with ReLUs on flat inputs: linear and relu, with numbers if several."""
    layers: OrderedDict[str, nn.Module] = OrderedDict(flatten=nn.Flatten())
    for k, width in enumerate(widths, 1):
        number = k if len(widths) > 1 else ""
        layers |= {f"linear{number}": nn.Linear(inputs, width), f"relu{number}": nn.ReLU()}
        inputs = width
    return nn.Sequential(layers)


@torch.no_grad()
def initialise(network: nn.Module) -> None:
    """Initialise as in the original: Xavier-uniform, near-uniform policy, orthogonal value."""
    for name, module in network.named_modules():
        if isinstance(module, nn.Conv2d | nn.Linear):
            if name == "policy":
                nn.init.orthogonal_(module.weight, gain=0.01)
            elif name == "value":
                nn.init.orthogonal_(module.weight, gain=1.0)
            else:
                nn.init.xavier_uniform_(module.weight)
            assert module.bias is not None
            nn.init.zeros_(module.bias)
