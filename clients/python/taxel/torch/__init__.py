"""Networks in torch: the served numbers, on any device, with gradients by position and force.

network = taxel.torch.load("ffnn").to("cuda")
position = torch.tensor([[0.0, 0.0, -0.007]], device="cuda")  # (n, 3), m
force = torch.tensor([[0.0, 0.0, 1.0]], device="cuda", requires_grad=True)  # (n, 3), N
channels = network(network.window(position, force))  # (n, 21), counts
channels[:, 1].sum().backward()  # force.grad: counts of pdc for a newton
"""

from taxel.errors import MissingDependency

try:
    from taxel.torch.network import Network, load
except ModuleNotFoundError as error:
    raise MissingDependency("taxel.torch", str(error.name), "train") from None

__all__ = ["Network", "load"]
