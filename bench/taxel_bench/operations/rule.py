"""What an operation costs, by the rule that graphs and networks are counted by.

- A matrix product costs 2 k for each value that it gives, k being the length of the sums: a
  multiply-add is two operations. A bias adds 1 a value.
- Element-wise arithmetic and activations cost 1 a value that they give.
- Softmax costs 5 a value (compare, subtract, exponentiate, add, divide), layer normalisation 7
  (add for the mean, subtract it, square, add, divide, scale, shift).
- Sums and means cost 1 a value that they take.
- Whatever only moves or shapes values costs nothing.
"""

from typing import Final

ELEMENTWISE: Final = 1
SOFTMAX: Final = 5
LAYER_NORMALISATION: Final = 7
REDUCTION: Final = 1


def product(terms: int, *, bias: bool = False) -> int:
    """Operations for each value of a matrix product whose sums have so many terms."""
    return 2 * terms + bias
