"""Windows of torch's tensors, with gradients by positions and forces."""

import torch
from torch import Tensor

from taxel.errors import InvalidArgument
from taxel.windows import WindowSpec
from taxel.windows.combinations import Position
from taxel.windows.window_columns import MOVED_M, steps_of


def newest_window(spec: WindowSpec, position: Tensor, force: Tensor) -> Tensor:
    """The newest window of each fingertip, from its past, as `taxel.windows` builds it.

    Args:
        spec: what a window holds.
        position: (n, t, 3), in each sensor's frame, m: the last t ticks, 10 ms apart, the newest last. Or
            (n, 3), if nothing has changed for long.
        force: of the same shape, on each finger, N.

    Returns:
        (n, f), without extra features.

    Raises:
        InvalidArgument: a shape is wrong, or there are too few ticks.
    """
    ticks = spec.look_back + spec.look_ahead + 1
    if position.ndim == 2:
        position, force = (each.unsqueeze(1).expand(-1, ticks, -1) for each in (position, force))
    if position.ndim != 3 or position.shape[1] < ticks or position.shape[2] != 3:
        raise InvalidArgument(
            f"position has shape {tuple(position.shape)}: expected (n, 3), or (n, t, 3) with at least "
            f"{ticks} ticks"
        )
    if force.shape != position.shape:
        raise InvalidArgument(f"force has shape {tuple(force.shape)}: expected {tuple(position.shape)}")
    middle = position.shape[1] - 1 - spec.look_ahead - spec.shift
    columns = [_nearest_moved(position, middle, which) for which in spec.positions]
    columns += [force[:, middle + step] for step in spec.force_steps]
    return torch.cat(columns, dim=1)


def _nearest_moved(position: Tensor, middle: int, which: Position) -> Tensor:
    """As `taxel.windows.window_columns` chooses it, (n, 3)."""
    farthest, *others = steps_of(which)
    found = position[:, middle + farthest]
    for step in others:
        candidate = position[:, middle + step]
        moved = ((candidate - position[:, middle]).abs() > MOVED_M).any(dim=1, keepdim=True)
        found = torch.where(moved, candidate, found)
    return found
