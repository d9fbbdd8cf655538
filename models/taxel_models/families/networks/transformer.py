"""The paper's transformer encoder: a vision transformer for regression.

Dosovitskiy et al. 2021 (arXiv 2010.11929), as Zai El Amri and Navarro-Guerrero use it: a window's
values in patches of three, a class token, learned position embeddings, pre-norm blocks with GELU,
and a linear head on the class token.
"""

import math
from typing import Annotated

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn
from torch.nn import functional
from typing_extensions import override

from taxel_models.families.networks.network import NetworkFamily, Shape
from taxel_models.families.networks.recipe import Recipe

PATCH = 3
"""Values in a patch: one position or one force."""


class TransformerHyperparameters(Recipe):
    """The paper's search space."""

    layers: Annotated[int, Field(ge=1)]
    heads: Annotated[int, Field(ge=1)]
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.0
    embedding: Annotated[int, Field(ge=1)]
    hidden: Annotated[int, Field(ge=1)]

    @model_validator(mode="after")
    def _heads_divide_the_embedding(self) -> "TransformerHyperparameters":
        if self.embedding % self.heads:
            raise ValueError(f"embedding {self.embedding} is not a multiple of {self.heads} heads")
        return self


class _Block(nn.Module):
    """Attention, then two dense layers, each after a normalisation and added to its input."""

    def __init__(self, chosen: TransformerHyperparameters) -> None:
        super().__init__()
        width = chosen.embedding
        self.heads = chosen.heads
        self.before_attention = nn.LayerNorm(width)
        self.queries_keys_values = nn.Linear(width, 3 * width)
        self.attended = nn.Linear(width, width)
        self.before_dense = nn.LayerNorm(width)
        self.widen = nn.Linear(width, chosen.hidden)
        self.narrow = nn.Linear(chosen.hidden, width)
        self.dropout = nn.Dropout(chosen.dropout)

    def forward(self, tokens: Tensor) -> Tensor:
        tokens = tokens + self.dropout(self.attend(self.before_attention(tokens)))
        hidden = self.dropout(functional.gelu(self.widen(self.before_dense(tokens))))
        result: Tensor = tokens + self.dropout(self.narrow(hidden))
        return result

    def attend(self, tokens: Tensor) -> Tensor:
        """Scaled dot-product attention (Vaswani et al. 2017, equation 1), written out for export."""
        length, width = tokens.shape[1], tokens.shape[2]
        size = width // self.heads
        parts = self.queries_keys_values(tokens).reshape(-1, length, 3, self.heads, size)
        queries, keys, values = parts.permute(2, 0, 3, 1, 4).unbind(0)
        weights = torch.softmax(queries @ keys.transpose(-2, -1) / math.sqrt(size), dim=-1)
        result: Tensor = self.attended((weights @ values).transpose(1, 2).reshape(-1, length, width))
        return result


class _Encoder(nn.Module):
    """(n, columns) to (n, outputs)."""

    def __init__(self, shape: Shape, chosen: TransformerHyperparameters) -> None:
        super().__init__()
        self.patches = shape.spec.length // PATCH
        self.embed = nn.Linear(PATCH, chosen.embedding)
        self.class_token = nn.Parameter(torch.randn(1, 1, chosen.embedding) * 0.02)
        self.positions = nn.Parameter(torch.randn(1, self.patches + 1, chosen.embedding) * 0.02)
        self.dropout = nn.Dropout(chosen.dropout)
        self.blocks = nn.Sequential(*(_Block(chosen) for _ in range(chosen.layers)))
        self.normalise = nn.LayerNorm(chosen.embedding)
        self.head = nn.Linear(chosen.embedding, shape.outputs)

    def forward(self, columns: Tensor) -> Tensor:
        patches = self.embed(columns.reshape(-1, self.patches, PATCH))
        token = self.class_token + torch.zeros_like(patches[:, :1])
        tokens = self.dropout(torch.cat([token, patches], dim=1) + self.positions)
        first: Tensor = self.head(self.normalise(self.blocks(tokens)[:, 0]))
        return first


class TransformerFamily(NetworkFamily):
    """A transformer encoder."""

    name = "transformer"
    hyperparameters = TransformerHyperparameters

    @override
    def build(self, shape: Shape, hyperparameters: TransformerHyperparameters) -> nn.Module:
        return _Encoder(shape, hyperparameters)
