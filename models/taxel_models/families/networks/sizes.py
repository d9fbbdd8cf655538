"""Parameter counts of the networks beside the published ones.

`python -m taxel_models.families.networks.sizes` prints the table of docs/models.md. The counts
follow from the architectures with the paper's hyperparameters. Where they disagree, the paper's inference
table contradicts its own hyperparameter table.
"""

from typing import Final

from taxel.windows import COMBINATIONS, WindowSpec
from taxel_models.families.networks.network import NetworkFamily
from taxel_models.families.published import published_parameters
from taxel_models.families.registry import family, resolve

COMPARED: Final = ("network-b", "ffnn", "transformer")
TOLERANCE: Final = 0.01


def count(name: str, combination: int) -> int:
    """Learnable parameters of a family's network with the paper's hyperparameters."""
    kind = family(name)
    assert isinstance(kind, NetworkFamily)
    network = kind.build(
        kind.shape(WindowSpec.of(combination), kind.extras), resolve(kind, combination, {})
    )
    return sum(part.numel() for part in network.parameters())


def agrees(name: str, combination: int) -> bool:
    """Whether the count is within 1 % of the published one."""
    published = published_parameters(name, combination)
    return abs(count(name, combination) - published) <= TOLERANCE * published


def markdown() -> str:
    """A table of all counts. A count that disagrees is in bold."""
    lines = ["| inputs | " + " | ".join(f"{name}, published | ours" for name in COMPARED) + " |"]
    lines.append("| --- |" + " --- | --- |" * len(COMPARED))
    for combination in COMBINATIONS:
        cells = []
        for name in COMPARED:
            ours = f"{count(name, combination):,}"
            mark = "" if agrees(name, combination) else "**"
            cells += [f"{published_parameters(name, combination) // 1000} K", f"{mark}{ours}{mark}"]
        lines.append(f"| {combination} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(markdown())
